"""Motions that were recorded at several settings of the position gain: each is simulated with its own."""

from dataclasses import replace

import numpy as np
import pytest

from identify.plain_truth import pendulum_logs
from trueup.check.checking import check_motions
from trueup.core.episode import EpisodeMeta
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError
from trueup.identify import Nominal, Problem, SegmentRule, SolveSettings, identify, make_segments, solve
from trueup.identify.causes import Motions
from trueup.identify.config import make_parameters
from trueup.identify.export import fitted_robot, save_model
from trueup.identify.regression import GrayboxSettings, fit_graybox, servo_start
from trueup.identify.solution import fingerprint_of
from trueup.identify.start import servo_regressed
from trueup.robots import (
    ControllerSpec,
    JointGains,
    JointSpec,
    MotorSpec,
    RobotSpec,
    Setup,
    SimulationSpec,
    load_robot,
    refuse_other_gains,
    refuse_unknown_gains,
    setup_of,
)
from trueup.robots.written import robot_yaml
from trueup.sim import make_simulator
from trueup.stages import prepare, replay
from trueup.stages.replaying import kp_factors

SETTINGS = (200.0, 100.0, 400.0)
NAMES = ("kp", "kv", "frictionloss")


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    return pendulum_logs(tmp_path_factory.mktemp("pendulum"), kp_settings=SETTINGS, seconds=3.0, armature=0.01)


def written(pendulum, folder):
    with DatasetWriter.create(folder, DatasetInfo()) as writer:
        for split, logs in pendulum.episodes.items():
            for log in logs:
                writer.append(replace(log, meta=replace(log.meta, split=split)))
    return Dataset(folder)


def at(setting):
    return EpisodeMeta(f"at{setting}", kp_setting=setting)


def problem_of(robot, pendulum):
    nominal = Nominal(replace(robot, simulation=SimulationSpec(timestep_s=0.001)), pendulum.model)
    segments, _ = make_segments(pendulum.episodes["train"], nominal.simulator, SegmentRule())
    return Problem(nominal, make_parameters(dict.fromkeys(NAMES, "all"), nominal), segments)


def robot_of(motor=None, **controller):
    return RobotSpec("one", (JointSpec("j"),), "one.xml", controller=ControllerSpec(**controller), motor=motor)


@pytest.mark.long
def test_the_gain_at_the_stated_setting_is_recovered_and_a_replay_leaves_noise(pendulum, tmp_path):
    problem = problem_of(pendulum.robot, pendulum)
    problem = problem.with_parameters(servo_regressed(problem, pendulum.episodes["train"]))
    found = solve(problem, SolveSettings())
    values = found.parameters.values(found.z)
    for name in ("kp[j]", "kv[j]", "frictionloss[j]"):
        assert values[name] == pytest.approx(pendulum.truth[name], rel=0.05)
    candidate = problem.candidate(values)
    save_model(candidate, tmp_path / "model.fitted.xml")
    (tmp_path / "robot.yaml").write_text(robot_yaml(fitted_robot(candidate)))
    robot = load_robot(tmp_path / "robot.yaml")
    assert robot.controller.kp_setting == 200.0
    dataset = written(pendulum, tmp_path / "data")
    replay(dataset, robot, label="mujoco/fitted", jobs=1)
    for meta in dataset.metas:
        episode = dataset.episode(meta.id, runs=["mujoco/fitted"])
        error = episode.run("mujoco/fitted")["position"] - episode.measured["position"]
        assert np.sqrt(np.mean(error**2)) < 8e-4  # the noise has 3e-4


def test_with_one_gain_for_all_the_truth_does_not_fit(pendulum):
    def left(robot):
        problem = problem_of(robot, pendulum)
        problem = problem.with_parameters(problem.parameters.at(pendulum.truth))
        return problem, np.sqrt(np.sum(problem.residuals(problem.parameters.start[None]) ** 2))

    problem, own = left(pendulum.robot)
    unsaid, one = left(replace(pendulum.robot, controller=replace(pendulum.robot.controller, kp_setting=None)))
    assert own < 0.1 * one
    assert fingerprint_of(problem, SolveSettings()) != fingerprint_of(unsaid, SolveSettings())
    # What a late drive would add goes with the gain of each motion.
    motions = Motions(problem, problem.parameters.start)
    stiff = motions.late(0.01)[-1].field
    for segment, course in motions.courses.items():
        assert course.model.actuator_gainprm[0, 0] == pytest.approx(18.0 * segment.setup.kp_factor)
        moved = course.position[:, 100:-1] - course.position[:, 90:-11]
        assert stiff[segment][:, 100:] == pytest.approx(18.0 * segment.setup.kp_factor * moved, abs=1e-9)


@pytest.mark.long
def test_regressions_know_the_gain_of_each_motion(tmp_path):
    pendulum = pendulum_logs(tmp_path, kp_settings=SETTINGS, torque=True)
    logs = pendulum.episodes["train"]
    model = Nominal(pendulum.robot, pendulum.model).model
    factors = [setup_of(pendulum.robot, log.meta).kp_factor for log in logs]
    given = {"joints": ("j",), "signal": "position", "gains": {"j": 30.0}, "limits": {}}
    assert servo_start(logs, model, **given, kp_factors=factors).kp["j"] == pytest.approx(18.0, rel=0.1)
    found = fit_graybox(logs, settings=GrayboxSettings(kp_setting=200.0)).joints["j"].blocks[0]
    assert found.coefficients["K_p"].value == pytest.approx(18.0, rel=0.02)
    # Where nobody says at which it is to be, it is that at the largest.
    found = fit_graybox(logs).joints["j"].blocks[0]
    assert found.coefficients["K_p"].value == pytest.approx(36.0, rel=0.02)


def test_a_check_knows_the_gain_of_each_motion(pendulum):
    truth = pendulum.model.read_text().replace('kp="30.0" kv="0.6"', 'kp="18.0" kv="0.9"')
    path = pendulum.model.with_name("true.xml")
    path.write_text(truth)
    logs = [log for own in pendulum.episodes.values() for log in own]
    assert not check_motions(logs, pendulum.robot, path)[0]
    unsaid = replace(pendulum.robot, controller=replace(pendulum.robot.controller, kp_setting=None))
    with pytest.raises(ConfigError, match="set differently from motion to motion"):
        check_motions(logs, unsaid, path)


def test_several_settings_are_refused_where_nobody_says_which_kp_is_for(pendulum, tmp_path):
    unsaid = replace(pendulum.robot, controller=replace(pendulum.robot.controller, kp_setting=None))
    message = (
        r"^robot 'pendulum': the position gains of the drives were set differently from motion to motion: got kp_setting "
        r"100, 200, 400; expected one.*\n?.*controller: \{kp_setting: 200\}"
    )
    dataset = written(pendulum, tmp_path / "data")
    with pytest.raises(ConfigError, match=message):
        replay(dataset, unsaid, model=pendulum.model, jobs=1)
    assert not dataset.runs
    with pytest.raises(ConfigError, match=message):
        identify(pendulum.episodes, unsaid, pendulum.model)
    assert kp_factors(dataset, unsaid) == {}
    assert kp_factors(dataset, pendulum.robot) == {"m1": 0.5, "m2": 2.0, "m4": 0.5, "m5": 2.0}
    same = [name for name, meta in zip(dataset.ids, dataset.metas, strict=True) if meta.kp_setting == 400.0]
    assert replay(dataset, unsaid, model=pendulum.model, ids=same, jobs=1).replayed == len(same)


def test_a_compensation_has_one_gain(pendulum, tmp_path):
    pytest.importorskip("torch")
    with pytest.raises(ConfigError, match=r"compensate simulates every motion with the same .* kp_setting 100, 400"):
        prepare(written(pendulum, tmp_path / "data"), pendulum.robot, model=pendulum.model, jobs=1)


def test_which_motions_are_simulated_as_they_are():
    position = {"kind": "position", "kp": 3.0}
    refuse_unknown_gains(robot_of(**position), [at(None), at(None)])
    refuse_unknown_gains(robot_of(**position), [at(None), at(400.0), at(400.0)])
    assert setup_of(robot_of(**position), at(400.0)) == Setup()
    assert setup_of(robot_of(**position, kp_setting=400.0), at(None)) == Setup()
    assert setup_of(robot_of(**position, kp_setting=400.0), at(100.0)) == Setup(kp_factor=0.25)
    # Commands that go around position gains.
    for controller in ({"kind": "torque"}, {"kind": "velocity", "kv": 1.0}, {"command": "torque"}):
        refuse_unknown_gains(robot_of(**controller), [at(100.0), at(400.0)])
    with pytest.raises(ConfigError, match="set differently"):
        refuse_unknown_gains(robot_of(kind="velocity-integrator", kp=1.0), [at(100.0), at(400.0)])
    refuse_other_gains(robot_of(**position, kp_setting=400.0), [at(400.0), at(None)], what="this")
    with pytest.raises(
        ConfigError, match="this simulates every motion with the same position gains: got kp_setting 100"
    ):
        refuse_other_gains(robot_of(**position, kp_setting=400.0), [at(400.0), at(100.0)], what="this")


@pytest.mark.parametrize("wrong", [0.0, -400.0, float("inf"), float("nan")])
def test_settings_that_are_none(wrong):
    with pytest.raises(ConfigError, match=r"controller: kp_setting: got .*; expected a finite number above 0"):
        ControllerSpec("position", kp=1.0, kp_setting=wrong)


@pytest.mark.parametrize("controller", [{"kind": "torque"}, {"kind": "velocity", "kv": 1.0}, {"command": "torque"}])
def test_robots_without_a_position_gain_have_no_setting(controller):
    with pytest.raises(ConfigError, match=r"goes around the position gain of a drive: got kp_setting: 400"):
        ControllerSpec(**controller, kp_setting=400.0)


SERVO = {"kp": 6.0, "kv": 0.5, "kp_setting": 100.0, "per_joint": {"j": JointGains(kp=8.0)}}
ACTUATORS = {
    "servo of the model": '<position name="a" joint="j" kp="8" kv="0.5"/>',
    "damping ratio": '<position name="a" joint="j" kp="8" dampratio="0.7"/>',
    "spring": '<general name="a" joint="j" gainprm="4" biastype="affine" biasprm="0.1 -8 -0.5"/>',
}
CONTROLLERS = {
    **{name: {"kind": "model", "command": "position", "kp_setting": 100.0} for name in ACTUATORS},
    **{kind: {"kind": kind, **SERVO} for kind in ("position", "pd", "pid", "servo", "velocity-integrator")},
    "pid with integral": {"kind": "pid", "ki": 2.0, **SERVO},
}


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("engine", ["mujoco", "dart"])
def test_kp_goes_with_the_setting_and_nothing_else_does(name, engine, tmp_path):
    if engine == "dart":
        pytest.importorskip("dartpy")
    path = tmp_path / "one.xml"
    actuator = ACTUATORS.get(name, '<motor name="a" joint="j"/>')
    path.write_text(
        '<mujoco><option gravity="0 0 0" integrator="implicitfast"/><worldbody><body><joint name="j" axis="0 1 0"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody>'
        f"<actuator>{actuator}</actuator></mujoco>"
    )
    motor = MotorSpec(1.0, 1.0, 0.1, 12.0) if name == "servo" else None
    robot = robot_of(motor, **CONTROLLERS[name])

    integrates = name == "velocity-integrator"

    def torque(factor, command, velocity):
        simulator = make_simulator(engine, robot, path, setup=setup_of(robot, at(100.0 * factor)))
        simulator.reset(np.array([[0.2]]), np.array([[velocity]]))
        if integrates:  # its target is told a step later
            simulator.step({"velocity": np.array([[command]])})
        return simulator.step({robot.controller.signal: np.array([[command]])})["torque"][0, 0]

    held, asked = (0.0, 500.0) if integrates else (0.2, 0.5)
    damped = torque(1.0, held, 0.3)
    assert damped < -0.01
    for factor in (0.5, 4.0):
        assert torque(factor, held, 0.3) == pytest.approx(damped, rel=0.15 if integrates else 0.03)
    soft, stiff = (torque(factor, asked, 0.0) for factor in (0.5, 1.0))
    assert stiff > 1.0
    assert soft == pytest.approx(0.5 * stiff, rel=0.05)


def test_gains_that_are_no_numbers_of_the_model_are_refused(tmp_path):
    path = tmp_path / "one.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody><actuator><general name="a" '
        'joint="j" gaintype="user" biastype="user"/></actuator></mujoco>'
    )
    robot = robot_of(kind="model", command="position", kp_setting=100.0)
    make_simulator("mujoco", robot, path)
    with pytest.raises(
        ConfigError, match=r"'j': kp_setting scales position gains, and that of .* 'a' is none: got mjGAIN_"
    ):
        make_simulator("mujoco", robot, path, setup=Setup(kp_factor=2.0))
