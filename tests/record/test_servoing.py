"""A robot that takes torques, led along positions: springs that suit its inertia, and logs that say what was sent."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trueup.dataset import Dataset
from trueup.errors import ConfigError, DataError, MissingSignal, RobotStopped
from trueup.lab import LabSpec, SimulatedRobot, VirtualRobot, draw_truth
from trueup.lab.spec import Controller
from trueup.record import ClockSettings, MotionGroup, MotionSettings, PlanSetSpec, RecordSettings, Springs, TorqueServo
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator
from trueup.stages import make_rig, record, replay
from trueup.stages.rigs import ServoedRig

ROBOT = load_robot("panda_torque")
PATH = find_model(ROBOT)
SIMULATOR = MujocoSimulator.from_robot(ROBOT, PATH)
MODEL = SIMULATOR.model
MOST = np.array([joint.torque_limit for joint in ROBOT.joints])
HOME = MODEL.key("home").qpos[SIMULATOR.places[0]]
SPEC = PlanSetSpec(
    "two",
    (MotionGroup("multi", "joint", 2, velocity_share=(0.4, 0.6)),),
    seed=4,
    motion=MotionSettings(clock=ClockSettings(rate_hz=250.0, rest_s=0.1)),
)
RATES = RecordSettings(control_hz=250.0, record_hz=250.0)


def springs(**options):
    return Springs(MODEL, ROBOT.joint_names, MOST, **options)


def simulated():
    return SimulatedRobot(SIMULATOR.clone(), position=HOME, steps_per_control=4)


def lab():
    return VirtualRobot(draw_truth(replace(LabSpec(), controller=Controller(kind="torque")), unit=1))


def test_springs_give_the_joints_the_acceleration_that_they_are_asked_for():
    """By MuJoCo's forward dynamics of the same arm, without friction and weight."""
    spec = mujoco.MjSpec.from_file(str(PATH))
    for joint in spec.joints:
        joint.damping[0] = joint.frictionloss = 0.0
    spec.option.gravity = [0, 0, 0]
    bare = spec.compile()
    data = mujoco.MjData(bare)
    rng = np.random.default_rng(0)
    made = springs(frequency_hz=2.0)
    w = 4 * np.pi
    for _ in range(5):
        pose, off = HOME + rng.uniform(-0.4, 0.4, 7), rng.uniform(-0.02, 0.02, 7)
        torque = made.torque(pose, np.zeros(7), (pose + off, np.zeros(7)))
        data.qpos[:7], data.qvel[:7] = pose, 0.0
        data.qfrc_applied[:7] = torque
        mujoco.mj_forward(bare, data)
        np.testing.assert_allclose(data.qacc[:7], w**2 * off, rtol=1e-6, atol=1e-9)


def test_springs_are_as_weak_as_the_robot():
    assert (np.abs(springs().torque(HOME, np.zeros(7), (HOME + 2.0, np.zeros(7)))) <= MOST).all()
    assert (springs().torque(HOME, np.zeros(7), (HOME, np.zeros(7))) == 0).all()
    with pytest.raises(ConfigError, match="frequency"):
        springs(frequency_hz=0.0)


@pytest.mark.parametrize("step_s", [0.004, 0.008])
@pytest.mark.parametrize("elbow", [-2.4, -0.3])
def test_it_comes_to_rest_where_it_is_led_also_with_a_slow_loop_and_a_straight_arm(step_s, elbow):
    """With a straight elbow hardly anything hangs on the third joint: springs made for another pose would shake it."""
    pose = HOME.copy()
    pose[3] = elbow
    robot = SimulatedRobot(SIMULATOR.clone(), position=pose, steps_per_control=round(step_s / 0.001))
    servo = TorqueServo(robot, springs(), step_s=step_s)
    servo.write({"position": pose + 0.1})
    servo.wait_until_s(4.0)
    np.testing.assert_allclose(robot.read()["position"], pose + 0.1, atol=1e-3)
    assert np.abs(robot.read()["velocity"]).max() < 1e-3


@pytest.mark.long
def test_logs_say_what_was_sent_so_that_the_robot_s_own_simulator_moves_the_same(tmp_path):
    rig = make_rig("mujoco", ROBOT, PATH, control_hz=250.0)
    assert isinstance(rig, ServoedRig)
    record(tmp_path / "data", ROBOT, rig, SPEC, settings=RATES)
    data = Dataset(tmp_path / "data")
    whole = replace(ROBOT, replay=replace(ROBOT.replay, window_s=None))
    replay(data, whole, label="mujoco/whole")
    for name in data.ids:
        episode = data.episode(name, runs=["mujoco/whole"])
        assert set(episode.commanded().signals) == {"position", "velocity", "torque"}
        assert (np.abs(episode.commanded()["torque"]) <= MOST).all()
        measured, run = episode.measured["position"], episode.run("mujoco/whole")["position"]
        assert np.abs(measured - measured[0]).max() > 0.3
        np.testing.assert_allclose(run[: len(measured)], measured, atol=1e-3)


def test_a_torque_driven_lab_is_recorded_and_stays_near_its_commands(tmp_path):
    rig = make_rig("lab", ROBOT, PATH, unit=2, control_hz=250.0)
    summary = record(tmp_path / "data", ROBOT, rig, SPEC, settings=RATES)
    assert (summary.recorded, dict(summary.flagged)) == (2, {})
    data = Dataset(tmp_path / "data")
    assert {episode.meta.unit for episode in data} == {"lab-2"}
    again = make_rig("lab", ROBOT, PATH, unit=2, control_hz=250.0, servo_hz=2.0)
    assert again.describe() != rig.describe()
    assert rig.truth() == draw_truth(replace(LabSpec(), controller=Controller(kind="torque")), unit=2)


def test_a_stop_is_said_with_the_next_command_and_recovered_from():
    robot = lab()
    servo = TorqueServo(robot, springs())
    servo.write({"position": HOME})
    robot.stop()
    servo.wait_until_s(servo.now_s() + 0.1)
    with pytest.raises(RobotStopped):
        servo.write({"position": HOME})
    servo.recover()
    servo.write({"position": servo.read()["position"]})


def test_what_is_no_command_is_refused():
    servo = TorqueServo(simulated(), springs(), step_s=0.004)
    for wrong in ({"velocity": np.zeros(7)}, {"position": HOME, "torque": np.zeros(7)}):
        with pytest.raises(MissingSignal):
            servo.write(wrong)
    for values in (np.zeros(6), np.full(7, np.nan)):
        with pytest.raises(DataError, match="one finite value per joint"):
            servo.write({"position": values})
    with pytest.raises(ConfigError, match="take torques"):
        TorqueServo(VirtualRobot(draw_truth(unit=1)), springs())
    unlimited = replace(ROBOT, joints=tuple(replace(joint, torque_limit=None) for joint in ROBOT.joints))
    with pytest.raises(ConfigError, match="no limit"):
        make_rig("lab", unlimited, PATH)
