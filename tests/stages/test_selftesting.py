"""A self-test draws robots around a model, moves them by given commands, and says what a fit makes of them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from identify.recovery_cases import JOINTS, SERVO, TORQUE
from identify.recovery_cases import arm as coarse_arm
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.selftest_result import SelftestResult
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import DatasetInfo, DatasetWriter
from trueup.errors import ConfigError, DataError, NotIdentifiable
from trueup.identify import IdentifyConfig, Nominal
from trueup.identify.config import make_parameters
from trueup.identify.selftest import DrawnSimulator, Sensors, draw_truth
from trueup.robots import ControllerSpec, SimulationSpec
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode
from trueup.stages import selftest
from trueup.stages.selftest_motions import designed_motions
from trueup.stages.selftesting import _leader

VELOCITY = ControllerSpec(kind="velocity", kv=20.0)
FEW = {"kp": "all", "frictionloss": "all"}


SIDE_BY_SIDE = """
<mujoco><compiler angle="radian"/><option integrator="implicitfast"/><worldbody>
<body name="upper"><inertial pos="0.15 0 0" mass="1.2" diaginertia="0.003 0.012 0.012"/>
  <joint name="shoulder" axis="0 1 0" damping="0.4" frictionloss="0.3" armature="0.05"/></body>
<body name="lower"><inertial pos="0.12 0 0" mass="0.6" diaginertia="0.001 0.005 0.004"/>
  <joint name="elbow" axis="0 0 1" damping="0.2" frictionloss="0.15" armature="0.03"/></body>
</worldbody></mujoco>
"""


def arm(folder, controller=SERVO):
    """The arm at a step of which there are whole ones between two commands."""
    robot, path = coarse_arm(folder, controller)
    return replace(robot, simulation=SimulationSpec(timestep_s=0.002)), path


def config(fit=None, *, motion_s=12.0, **data):
    base = IdentifyConfig(fit=fit or FEW, models={})
    return replace(base, data=replace(base.data, budget_s=motion_s, **data))


def dataset(folder, *, signal="position", still=(), motions=2, noise=0.0):
    """Commands and what a robot that follows them at once would have measured."""
    unit = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}[signal]
    with DatasetWriter.create(folder, DatasetInfo(robot="arm")) as writer:
        for number in range(motions):
            time_s = np.arange(600) / 100.0
            rng = np.random.default_rng(number)
            waves = rng.uniform(0.2, 1.5, (2, 4, 1)) * time_s + rng.uniform(0, 1, (2, 4, 1))
            values = 0.15 * np.minimum(1.0, time_s)[:, None] * np.sin(2 * np.pi * waves).sum(axis=1).T
            values[:, [JOINTS.index(name) for name in still]] = 0.3
            told = values if signal == "position" else np.gradient(values, time_s, axis=0)
            seen = values + noise * np.random.default_rng(number).standard_normal(values.shape)
            series = (("rad", seen, "position"), (unit, told, signal))
            measured, command = (
                TimeSeries(time_s, JOINTS, {name: own}, same_units({name: of}, JOINTS)) for of, own, name in series
            )
            writer.append(Episode(EpisodeMeta(f"m{number}", split="train"), measured, command))
    return folder


def verdicts_of(result):
    (truth,) = result.truths
    return {item.name: item.verdict for item in truth.numbers}


@pytest.mark.long
def test_numbers_that_motions_show_are_recovered_and_the_file_says_so(tmp_path):
    robot, path = arm(tmp_path)
    result = selftest(robot, model=path, config=config(), jobs=1, seed=1, budget_s=None)
    (truth,) = result.truths
    assert set(verdicts_of(result).values()) == {"recovered"}
    for item in truth.numbers:
        assert item.interval[0] <= item.truth <= item.interval[1]
        assert item.truth != item.nominal
    assert max(abs(np.log(item.truth / item.nominal)) for item in truth.numbers if item.nominal) > 0.1
    assert result.motion_s == pytest.approx(12.0, rel=0.3)
    assert set(result.noise.values()) == {3e-4}
    result.save(tmp_path / "selftest.json")
    assert SelftestResult.load(tmp_path / "selftest.json").truths == result.truths
    assert json.loads((tmp_path / "selftest.json").read_text())["schema"] == "trueup.selftest/1"


@pytest.mark.long
def test_a_joint_that_does_not_move_stays_open(tmp_path):
    robot, path = arm(tmp_path)
    path.write_text(SIDE_BY_SIDE)  # or the shoulder would move the elbow
    data = dataset(tmp_path / "data", still=("elbow",), noise=2e-4)
    result = selftest(robot, data, model=path, config=config(), jobs=1, seed=1, budget_s=None)
    found = verdicts_of(result)
    assert {own for name, own in found.items() if "elbow" in name} == {"open"}
    assert {own for name, own in found.items() if "shoulder" in name} == {"recovered"}
    (truth,) = result.truths
    assert all("{target}" in item.excite and "elbow" in item.sentence for item in truth.of("open"))
    assert result.noise["shoulder"] == pytest.approx(2e-4, rel=0.1)  # what the logs show


BY_TORQUE = {"frictionloss": "all", "delay_s": "all", "encoder_zero": "all", "damping": "all"}
BY_VELOCITY = {"kv": "all", "frictionloss": "all", "delay_s": "all"}


@pytest.mark.parametrize(
    ("drive", "fit", "given"),
    [
        pytest.param(TORQUE, BY_TORQUE, False, id="designed-torque", marks=pytest.mark.long),
        pytest.param(TORQUE, BY_TORQUE, True, id="data-torque", marks=pytest.mark.slow),  # a minute and a half
        pytest.param(VELOCITY, BY_VELOCITY, False, id="designed-velocity"),
        pytest.param(VELOCITY, BY_VELOCITY, True, id="data-velocity"),
    ],
)
def test_robots_that_are_led_follow_the_motion(tmp_path, drive, fit, given):
    robot, path = arm(tmp_path, drive)
    data = dataset(tmp_path / "data", signal=robot.controller.signal) if given else None
    # Windows of torque-driven motions are dear.
    fewer = config(fit, motion_s=6.0 if drive is TORQUE else 12.0)
    result = selftest(robot, data, model=path, config=fewer, jobs=1, budget_s=None)
    (truth,) = result.truths
    assert not any(item.name.startswith("encoder_zero") for item in truth.numbers)
    for item in truth.numbers:
        if not item.name.startswith("delay_s"):
            assert item.value == pytest.approx(item.truth, rel=0.15), item.name


@pytest.mark.parametrize("drive", [TORQUE, VELOCITY, SERVO], ids=["torque", "velocity", "position"])
def test_a_drawn_robot_goes_the_way_of_the_motion(tmp_path, drive):
    robot, path = arm(tmp_path, replace(drive, kp=10 * drive.kp))  # a servo that its weight does not pull far away
    nominal = Nominal(robot, path)
    parameters = make_parameters(IdentifyConfig().resolved(nominal).fit, nominal, ("designed/00",))
    values = draw_truth(parameters, nominal, np.random.default_rng(3))
    motion = designed_motions(nominal, path, 4.0, seed=0)["train"][0]
    drawn = DrawnSimulator(robot, path, parameters, values, leader=_leader(nominal))
    drawn.prepare([EpisodeMeta("one")])
    log = drawn.log(motion, Sensors.flat(2, 1e-6, moving=False), np.random.default_rng(0))
    way = motion.measured["position"]
    error = log.measured["position"] - way[-len(log.measured) :]
    assert np.abs(error).max() < 0.5 * np.ptp(way, axis=0).min()
    assert np.array_equal(log.command.time_s, motion.command.time_s)
    if drive is SERVO:
        assert np.array_equal(log.command["position"], motion.command["position"])


def test_commands_are_late_by_the_true_delay(tmp_path):
    """Against the replay of the package with the same numbers at a fine step."""
    robot, path = arm(tmp_path)
    nominal = Nominal(replace(robot, simulation=SimulationSpec(timestep_s=1e-4)), path)
    parameters = make_parameters({"delay_s": "all"}, Nominal(robot, path))
    motion = designed_motions(Nominal(robot, path), path, 4.0, seed=0)["train"][0]
    logs = {}
    for delay_s in (0.0, 0.0123):
        drawn = DrawnSimulator(robot, path, parameters, {f"delay_s[{name}]": delay_s for name in JOINTS})
        drawn.prepare([EpisodeMeta("one")])
        logs[delay_s] = drawn.log(motion, Sensors.flat(2, 1e-12, moving=False), np.random.default_rng(0))
        simulator = MujocoSimulator(nominal.candidate().compile(), nominal.robot, nominal.simulator.channels)
        same = replay_episode(motion, simulator, ReplaySettings(delay_s=delay_s, settle_s=2.0))
        assert np.abs(logs[delay_s].measured["position"] - same["position"]).max() < 2e-4
    late = np.abs(logs[0.0123].measured["position"] - logs[0.0].measured["position"]).max()
    assert late > 5e-3


def test_truths_are_drawn_around_the_model(tmp_path):
    robot, path = arm(tmp_path)
    path.write_text(path.read_text().replace('armature="0.03"', 'armature="0"'))
    nominal = Nominal(robot, path)
    fit = {**IdentifyConfig().resolved(nominal).fit, "kp": {"prior_std": 0.01}, "damping": {"frozen": True}}
    parameters = make_parameters(fit, nominal)
    draws = [draw_truth(parameters, nominal, np.random.default_rng(seed)) for seed in range(300)]
    assert not any(name.startswith("damping") for name in draws[0])
    spread = {
        name: np.std([np.log(own[name]) for own in draws]) for name in draws[0] if parameters[name].transform == "log"
    }
    assert spread["frictionloss[shoulder]"] == pytest.approx(0.3, rel=0.15)
    assert spread["mass[upper]"] == pytest.approx(0.1, rel=0.15)
    assert spread["kp[elbow]"] == pytest.approx(0.01, rel=0.15)
    elbow = np.array([own["armature[elbow]"] for own in draws])  # the model has none
    assert elbow.min() > 0
    assert np.median(elbow) == pytest.approx(0.1 * nominal.size("elbow").inertia, rel=0.1)
    for own in draws:
        assert all(own[f"delay_s[{name}]"] >= 0 for name in JOINTS)
        assert all(item.low <= own[item.name] <= item.high for item in parameters.free)


def test_a_robot_that_diverges_is_said_to(tmp_path):
    robot, path = arm(tmp_path, replace(SERVO, kp=1e12))
    with pytest.raises(DataError, match="5 were drawn around its model"):
        selftest(robot, model=path, config=config(), jobs=1)


def test_bad_input_is_told(tmp_path):
    robot, path = arm(tmp_path)
    for options in ({"seeds": 0}, {"noise": -1.0}, {"budget_s": 0.0}, {"format": "csv"}):
        with pytest.raises(ConfigError):
            selftest(robot, model=path, **options)
    data = dataset(tmp_path / "data")
    with pytest.raises(ConfigError, match="is a dataset"):
        selftest(robot, data, model=path, format="csv")
    still = dataset(tmp_path / "still", still=JOINTS)
    with pytest.raises(NotIdentifiable):
        selftest(robot, still, model=path, config=config(), jobs=1)
