"""What a fit can change, held against compiled models and plain simulations."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest

from identify.recovery_cases import ARM, JOINTS, SERVO, TORQUE, Truth, arm, nominal_of
from trueup.errors import ConfigError
from trueup.identify import IdentifyConfig, Nominal, Problem, SegmentRule, identify, make_segments
from trueup.identify.config import SolverChoice, make_parameters
from trueup.identify.export import save_model
from trueup.robots import ControllerSpec, JointSpec, RobotSpec
from trueup.sim import MujocoSimulator

VELOCITY = ControllerSpec(kind="velocity", kv=5.0)
PID = ControllerSpec(kind="pid", kp=50.0, kv=2.0, ki=30.0)
PD = ControllerSpec(kind="pd", kp=50.0, kv=2.0)
SETTINGS = SolverChoice(max_iterations=20)

ONE = """
<mujoco>
  <compiler {compiler}/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="link">
      <inertial pos="0.2 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <joint name="a" axis="0 1 0" {joint}/>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""


def one_joint(folder, actuator="", *, joint="", compiler='angle="radian"', command="position", controller=None, **spec):
    """A robot with one joint, with its model's own actuator unless a controller is given."""
    path = folder / "one.xml"
    path.write_text(ONE.format(compiler=compiler, joint=joint, actuator=actuator))
    controller = controller or ControllerSpec(kind="model", command=command)
    robot = RobotSpec("one", (JointSpec("a", **spec),), path.name, controller=controller)
    return Nominal(robot, path)


def written(nominal, fit):
    """The compiled model after all parameters have been written at their values."""
    parameters = make_parameters(fit, nominal)
    return Problem(nominal, parameters, ()).candidate({item.name: item.value for item in parameters}).compile()


def torque_at(model, *, position=0.0, velocity=0.0, command=0.0):
    """What the actuators do to the first joint, by MuJoCo alone; away from qpos0 by `position`."""
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0], data.ctrl[:] = position, velocity, command
    mujoco.mj_forward(model, data)
    return float(data.qfrc_actuator[0])


@dataclass(frozen=True)
class Hardware(Truth):
    """Logs of a robot with a controller of its own, made without a single quantity of the catalogue."""

    real: RobotSpec | None = None
    model: str = ""

    def simulator(self):
        nominal = Nominal(self.real, self.model)
        return nominal.simulator, nominal.candidate()


def logs_of(folder, controller, *, size=0.5, seconds=6.0, **changes):
    """Motions of an arm whose file has the elbow's damping at 0.5 instead of 0.2, with other gains."""
    robot, path = arm(folder, controller)
    real = folder / "real.xml"
    real.write_text(ARM.replace('name="elbow" axis="0 1 0" damping="0.2"', 'name="elbow" axis="0 1 0" damping="0.5"'))
    other = replace(robot, controller=replace(controller, **changes))
    hardware = Hardware(robot, Nominal(robot, path), {}, other, real)
    logs = [hardware.log(seed, name=f"log{seed}", size=size, seconds=seconds) for seed in (1, 2, 3)]
    return robot, path, {"train": logs[:2], "val": logs[2:]}


def covers(found, name, true, *, share):
    item = found.result[name]
    assert item.interval[0] * (1 - share) < true < item.interval[1] * (1 + share), f"{name}: {item}"
    assert item.value == pytest.approx(true, rel=share), f"{name}: {item}"


@pytest.mark.long
def test_a_velocity_servo_is_recovered_by_the_default_fit(tmp_path):
    robot, path, logs = logs_of(tmp_path, VELOCITY, kv=8.0)
    found = identify(logs, robot, path, config=IdentifyConfig(solver=SETTINGS))
    assert not any(item.name.startswith("kp") for item in found.result.parameters)
    assert found.result["kv[shoulder]"].nominal == 5.0
    # Only masses tell how large a torque is, and they are taken to be known to 10 % each.
    for joint in JOINTS:
        item = found.result[f"kv[{joint}]"]
        assert item.interval[0] < 8.0 < item.interval[1], item
        assert item.value == pytest.approx(8.0, rel=0.2)
    fitted = found.candidate().compile()
    np.testing.assert_array_equal(fitted.actuator_biasprm[:, 1], 0.0)
    np.testing.assert_allclose(fitted.actuator_gainprm[:, 0], -fitted.actuator_biasprm[:, 2])
    errors = found.result.errors
    assert errors["fitted"]["val"].value < 0.2 * errors["nominal"]["val"].value


@pytest.mark.long
def test_a_pid_controller_is_recovered_by_the_default_fit(tmp_path):
    robot, path, logs = logs_of(tmp_path, PID, kp=80.0)
    found = identify(logs, robot, path, config=IdentifyConfig(solver=SETTINGS))
    assert found.result["kp[shoulder]"].nominal == 50.0
    assert not any(item.name.startswith("torque_offset") for item in found.result.parameters)
    for joint in JOINTS:
        covers(found, f"kp[{joint}]", 80.0, share=0.15)
    errors = found.result.errors
    assert errors["fitted"]["val"].value < 0.2 * errors["nominal"]["val"].value


def test_the_gains_of_a_pid_move_candidates_as_they_move_the_robot(tmp_path):
    _, _, logs = logs_of(tmp_path, PID, kp=80.0, kv=3.0, ki=60.0)
    nominal = Nominal(arm(tmp_path, PID)[0], tmp_path / "real.xml")
    segments, _ = make_segments(logs["train"][:1], nominal.simulator, SegmentRule())
    parameters = make_parameters({"kp": "all", "kv": "all", "ki": "all"}, nominal)
    assert {item.name: item.value for item in parameters} == {
        **{f"kp[{joint}]": 50.0 for joint in JOINTS},
        **{f"kv[{joint}]": 2.0 for joint in JOINTS},
        **{f"ki[{joint}]": 30.0 for joint in JOINTS},
    }
    problem = Problem(nominal, parameters, segments)
    true = np.log([80.0, 80.0, 3.0, 3.0, 60.0, 60.0])
    rms = [np.sqrt(np.mean(row**2) * row.size) for row in problem.residuals(np.array([parameters.start, true]))]
    assert rms[0] > 5e-3
    assert rms[1] == pytest.approx(1e-3, rel=0.1), "what is left is the noise of the encoder"


@pytest.mark.parametrize(
    ("controller", "name"),
    [
        (VELOCITY, "kp"),
        (VELOCITY, "dead_band"),
        (VELOCITY, "ki"),
        (VELOCITY, "torque_gain"),
        (PID, "torque_offset"),
        (PID, "dead_band"),
        (PID, "static_positive"),
        (SERVO, "static_positive"),
        (SERVO, "ki"),
        (SERVO, "torque_limit"),
        (TORQUE, "kp"),
        (TORQUE, "kv"),
        (TORQUE, "dead_band"),
    ],
)
@pytest.mark.parametrize("choice", ["all", ["elbow"], {"shared": True}])
def test_what_a_drive_does_not_have_is_refused(tmp_path, controller, name, choice):
    with pytest.raises(ConfigError, match=f"fit: {name} needs"):
        make_parameters({name: choice}, nominal_of(tmp_path, controller)[1])


def test_models_that_cannot_be_tried_are_refused_before_the_search(tmp_path):
    nominal = nominal_of(tmp_path, VELOCITY)[1]
    with pytest.raises(ConfigError, match="kp needs a position servo"):
        IdentifyConfig(fit={"damping": "all"}, models={"more": ("kp",)}).resolved(nominal)


def test_only_the_joints_that_have_it_are_fitted_and_shared(tmp_path):
    _, path = arm(tmp_path)
    actuators = (
        '<actuator><general name="s" joint="shoulder" gainprm="1" biastype="affine" biasprm="0 -30 0"/>'
        '<general name="e" joint="elbow" gainprm="1" biastype="affine" biasprm="0 0 -5"/></actuator>'
    )
    path.write_text(ARM.replace("</mujoco>", f"{actuators}</mujoco>"))
    robot = RobotSpec(
        "arm",
        tuple(map(JointSpec, JOINTS)),
        path.name,
        controller=ControllerSpec(kind="model", command="torque"),
    )
    nominal = Nominal(robot, path)
    assert make_parameters({"kp": "all"}, nominal).names == ("kp[shoulder]",)
    model = written(nominal, {"kp": {"shared": True, "start": 50.0}})
    np.testing.assert_array_equal(model.actuator_biasprm[:, :3], [[0, -50, 0], [0, 0, -5]])
    assert model.actuator_gainprm[0, 0] == pytest.approx(50.0 / 30.0), "the command keeps its scale"


@pytest.mark.long
def test_a_joint_that_stands_still_keeps_every_number_of_its_model(tmp_path):
    bare = ARM.replace('damping="0.2" frictionloss="0.15" armature="0.03"', "")
    robot, path = arm(tmp_path)
    path.write_text(bare)
    truth = Truth(robot, Nominal(robot, path), {"damping[shoulder]": 0.9, "delay_s[shoulder]": 0.02})

    logs = []
    for seed in (1, 2):
        phase = np.random.default_rng(seed).uniform(3.0, 5.0)
        log = truth.log(
            seed,
            name=f"log{seed}",
            seconds=4.0,
            command=lambda t, phase=phase: np.stack([0.4 * np.sin(phase * t) * (t % 1 < 0.7), 0 * t], axis=1),
        )
        still = log.measured["position"].copy()
        still[:, 1] = 0.0
        measured = replace(log.measured, signals={**log.measured.signals, "position": still})
        logs.append(replace(log, measured=measured))
    config = IdentifyConfig(solver=SolverChoice(max_iterations=5))
    found = identify({"train": logs[:1], "val": logs[1:]}, robot, path, config=config)
    given, fitted = Nominal(robot, path).model, found.candidate().compile()
    for field in ("dof_damping", "dof_frictionloss", "dof_armature"):
        assert getattr(given, field)[1] == getattr(fitted, field)[1] == 0.0, field
    for field in ("jnt_actfrclimited", "actuator_forcelimited"):
        assert not getattr(fitted, field).any(), field
    np.testing.assert_array_equal(given.actuator_gainprm[1], fitted.actuator_gainprm[1])
    np.testing.assert_array_equal(given.actuator_biasprm[1], fitted.actuator_biasprm[1])
    assert found.result["damping[elbow]"].nominal == found.result["damping[elbow]"].value == 0.0


def test_what_the_model_said_is_neither_the_start_nor_the_users(tmp_path):
    nominal = one_joint(tmp_path, '<position name="m" joint="a" kp="20"/>')
    fit = {"damping": {"start": 0.7}, "frictionloss": "all", "kp": {"start": 33.0}, "kv": "all"}
    said = {item.name: (item.nominal, item.value) for item in make_parameters(fit, nominal)}
    assert said == {
        "damping[a]": (0.0, 0.7),
        "frictionloss[a]": (0.0, pytest.approx(0.02 * nominal.size("a").torque)),
        "kp[a]": (20.0, 33.0),
        "kv[a]": (0.0, 0.1),
    }


@pytest.mark.parametrize("shared", [False, True])
def test_frozen_by_the_user_is_left_alone_and_frozen_at_a_start_is_written(tmp_path, shared):
    _, nominal = nominal_of(tmp_path)
    left = written(nominal, {"damping": {"frozen": True, "shared": shared}, "mass": {"frozen": True}})
    np.testing.assert_array_equal(left.dof_damping, [0.4, 0.2])
    np.testing.assert_array_equal(left.body_mass, nominal.model.body_mass)
    zero = written(nominal, {"damping": {"frozen": True, "shared": shared, "start": 0.0}})
    np.testing.assert_array_equal(zero.dof_damping, 0.0)


def test_a_limit_on_the_joint_is_read_and_moved(tmp_path):
    robot, path = arm(tmp_path, PD)
    limited = replace(robot, joints=tuple(replace(joint, torque_limit=87.0) for joint in robot.joints))
    nominal = Nominal(limited, path)
    assert [item.value for item in make_parameters({"torque_limit": "all"}, nominal)] == [87.0, 87.0]
    model = written(nominal, {"torque_limit": {"targets": ["shoulder"], "start": 50.0}})
    assert torque_at(model, position=-9.0) == pytest.approx(50.0)
    np.testing.assert_array_equal(model.jnt_actfrcrange, [[-50, 50], [-87, 87]])


def test_an_asymmetric_limit_stays_asymmetric_behind_a_gear(tmp_path):
    nominal = one_joint(tmp_path, '<position name="m" joint="a" kp="100" gear="5" forcerange="-1 2"/>')
    assert make_parameters({"torque_limit": "all"}, nominal)["torque_limit[a]"].value == 10.0
    model = written(nominal, {"torque_limit": {"start": 5.0}})
    assert torque_at(model, position=-1.0) == pytest.approx(5.0)
    assert torque_at(model, position=1.0) == pytest.approx(-2.5)


def test_of_two_limits_the_smaller_one_rules(tmp_path):
    nominal = one_joint(
        tmp_path, '<position name="m" joint="a" kp="100" forcerange="-4 4"/>', joint='actuatorfrcrange="-7 7"'
    )
    assert make_parameters({"torque_limit": "all"}, nominal)["torque_limit[a]"].value == 4.0
    assert nominal.simulator.torque_limits == {"a": 4.0}
    for limit in (2.0, 12.0):
        model = written(nominal, {"torque_limit": {"start": limit}})
        assert torque_at(model, position=-1.0) == pytest.approx(limit)


def test_a_limit_that_the_user_asks_for_is_added(tmp_path):
    nominal = one_joint(tmp_path, '<position name="m" joint="a" kp="100" gear="-5"/>')
    item = make_parameters({"torque_limit": {"start": 3.0}}, nominal)["torque_limit[a]"]
    assert (item.nominal, item.value) == (None, 3.0)
    model = written(nominal, {"torque_limit": {"start": 3.0}})
    assert torque_at(model, position=-1.0) == pytest.approx(3.0)
    assert torque_at(model, position=1.0) == pytest.approx(-3.0)


def test_bounds_reach_to_what_the_model_says(tmp_path):
    controller = replace(SERVO, delay_s=0.25)
    nominal = one_joint(tmp_path, controller=controller, joint='ref="-0.5" damping="1e-7"')
    found = make_parameters({"delay_s": "all", "joint_offset": "all", "damping": "all"}, nominal)
    for name, value in (("delay_s[a]", 0.25), ("joint_offset[a]", 0.5), ("damping[a]", 1e-7)):
        assert found[name].nominal == pytest.approx(value)
        assert found[name].low <= found[name].nominal <= found[name].high
    assert found["delay_s[a]"].value == 0.25
    assert found["joint_offset[a]"].value == 0.5


@pytest.mark.parametrize("compiler", ['angle="radian"', 'angle="degree"', ""])
def test_the_zero_of_a_joint_is_in_radians_whatever_the_file_says(tmp_path, compiler):
    joint = 'range="-1 1.5" ref="0.1" springref="0.3" stiffness="2"'
    if compiler != 'angle="radian"':
        joint = 'range="-57.29577951308232 85.94366926962348" ref="5.729577951308232" springref="17.188733853924695" stiffness="2"'
    nominal = one_joint(tmp_path, '<motor name="m" joint="a"/>', joint=joint, compiler=compiler, command="torque")
    assert make_parameters({"joint_offset": "all"}, nominal)["joint_offset[a]"].value == pytest.approx(-0.1)
    model = written(nominal, {"joint_offset": {"start": -0.2}})
    assert model.qpos0[0] == pytest.approx(0.2)
    np.testing.assert_allclose(model.jnt_range[0], [-0.9, 1.6])
    assert model.qpos_spring[0] == pytest.approx(0.4)


def test_the_zero_of_a_slide_is_in_metres(tmp_path):
    nominal = one_joint(
        tmp_path,
        '<motor name="m" joint="a"/>',
        joint='type="slide" ref="0.1" range="-1 1"',
        compiler="",
        command="torque",
    )
    model = written(nominal, {"joint_offset": {"start": -0.2}})
    assert model.qpos0[0] == pytest.approx(0.2)
    np.testing.assert_allclose(model.jnt_range[0], [-0.9, 1.1])


def test_numbers_of_a_geared_drive_are_those_of_the_joint(tmp_path):
    actuator = '<general name="m" joint="a" gear="5" biastype="affine" gainprm="10" biasprm="0.3 -10 -0.4"/>'
    nominal = one_joint(tmp_path, actuator)
    found = make_parameters({"kp": "all", "kv": "all", "torque_offset": "all"}, nominal)
    rest = torque_at(nominal.model)
    assert found["torque_offset[a]"].value == pytest.approx(rest)
    assert found["kp[a]"].value == pytest.approx((torque_at(nominal.model, position=-0.01) - rest) / 0.01)
    assert found["kv[a]"].value == pytest.approx((torque_at(nominal.model, velocity=-0.01) - rest) / 0.01)
    model = written(nominal, {"kp": {"start": 60.0}, "kv": {"start": 3.0}, "torque_offset": {"start": -0.7}})
    assert torque_at(model) == pytest.approx(-0.7)
    assert torque_at(model, position=0.1) == pytest.approx(-0.7 - 6.0)
    assert torque_at(model, velocity=0.1) == pytest.approx(-0.7 - 0.3)
    # What goes into the actuator stays in its own unit, 5 of them to a radian.
    assert torque_at(model, position=0.1, command=0.5) == pytest.approx(-0.7)


def test_the_torque_of_a_geared_motor_is_that_of_the_joint(tmp_path):
    nominal = one_joint(tmp_path, '<motor name="m" joint="a" gear="5"/>', command="torque")
    assert make_parameters({"torque_gain": "all"}, nominal)["torque_gain[a]"].value == 5.0
    model = written(nominal, {"torque_gain": {"start": 6.0}, "torque_offset": {"start": 0.5}})
    assert torque_at(model, command=1.0) == pytest.approx(6.5)


def test_a_degree_joint_travels_in_the_file(tmp_path):
    joint, motor = 'range="-60 60" ref="10"', '<motor name="m" joint="a"/>'
    nominal = one_joint(tmp_path, motor, joint=joint, compiler="", command="torque")
    parameters = make_parameters({"joint_offset": {"start": -0.2}}, nominal)
    save_model(Problem(nominal, parameters, ()).candidate({}), tmp_path / "fitted.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "fitted.xml"))
    assert model.qpos0[0] == pytest.approx(0.2)
    np.testing.assert_allclose(model.jnt_range[0], np.deg2rad([-70.0, 50.0]) + 0.2, atol=1e-5)


def test_a_slide_has_units_of_its_own(tmp_path):
    nominal = one_joint(
        tmp_path, '<position name="m" joint="a" kp="9" forcerange="-5 5"/>', joint='type="slide" damping="1"'
    )
    names = ("delay_s", "kp", "kv", "torque_offset", "torque_limit", "joint_offset", "damping", "armature")
    units = {item.quantity: item.unit for item in make_parameters(dict.fromkeys(names, "all"), nominal)}
    assert units == {
        "delay_s": "s",
        "kp": "N/m",
        "kv": "N s/m",
        "torque_offset": "N",
        "torque_limit": "N",
        "joint_offset": "m",
        "damping": "N s/m",
        "armature": "kg",
    }
    (zero,) = make_parameters({"encoder_zero": "all"}, nominal, ["log"])
    assert (zero.name, zero.unit) == ("encoder_zero[log:a]", "m")


@pytest.mark.long
@pytest.mark.parametrize("choice", [["log1:elbow"], {"frozen": True}, {"targets": ["log1:elbow"], "frozen": True}])
def test_zeros_of_single_recordings_can_be_chosen_and_frozen(tmp_path, choice):
    robot, nominal = nominal_of(tmp_path, TORQUE)
    truth = Truth(robot, nominal, {"damping[elbow]": 0.5})
    logs = [truth.log(seed, name=f"log{seed}", size=6.0, seconds=3.0) for seed in (1, 2)]
    config = IdentifyConfig(fit={"damping": "all", "encoder_zero": choice}, models={}, solver=SETTINGS)
    found = identify({"train": logs[:1], "val": logs[1:]}, robot, tmp_path / "arm.xml", config=config)
    assert {item.name for item in found.result.parameters} == {"damping[shoulder]", "damping[elbow]"}
    assert set(found.result.data["encoder_zeros"]) == ({"log1:elbow"} if isinstance(choice, list) else set())


def test_zeros_of_single_recordings_cannot_be_shared(tmp_path):
    with pytest.raises(ConfigError, match="encoder_zero: shared"):
        make_parameters({"encoder_zero": {"shared": True}}, nominal_of(tmp_path, TORQUE)[1], ["log1"])


def test_a_shared_number_that_is_frozen_is_written_to_every_joint(tmp_path):
    _, nominal = nominal_of(tmp_path, SERVO)
    first, second = nominal.model.dof_frictionloss
    assert first != second
    parameters = make_parameters({"frictionloss": {"shared": True, "start": float(first), "frozen": True}}, nominal)
    model = Problem(nominal, parameters, ()).candidate({}).compile()
    np.testing.assert_allclose(model.dof_frictionloss, first)


def test_a_shared_limit_holds_for_joints_that_had_none(tmp_path):
    robot, path = arm(tmp_path)
    limited = replace(robot.joints[1], torque_limit=20.0)
    nominal = Nominal(replace(robot, joints=(robot.joints[0], limited)), path)
    parameters = make_parameters({"torque_limit": {"shared": True, "start": 9.0}}, nominal)
    model = Problem(nominal, parameters, ()).candidate({}).compile()
    limits = MujocoSimulator(model, nominal.robot, nominal.simulator.channels).torque_limits
    assert limits == pytest.approx({"shoulder": 9.0, "elbow": 9.0})
