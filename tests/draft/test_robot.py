"""A model says what its robot is, as far as a model can."""

import mujoco
import numpy as np
import pytest

from trueup.core.protocols import RolloutRequest
from trueup.draft import draft_robot
from trueup.errors import ConfigError
from trueup.robots import BaseSpec
from trueup.sim import MujocoSimulator

BODIES = """
<body name="base" pos="0 0 .5">{base}<inertial pos="0 0 0" mass="2" diaginertia=".02 .02 .02"/>
  <body name="upper"><joint name="shoulder" axis="0 1 0" range="-100 100"/>
    <inertial pos="0 0 -.2" mass="1.5" diaginertia=".02 .02 .002"/>
    <body name="lower" pos="0 0 -.4"><joint axis="0 1 0" range="-140 10"/>
      <inertial pos="0 0 -.1" mass=".5" diaginertia=".003 .003 .0005"/>
      <body name="finger" pos="0 0 -.25"><joint name="grip" type="slide" axis="1 0 0" range="0 .05"/>
        <inertial pos="0 0 0" mass=".02" diaginertia="1e-5 1e-5 1e-5"/>
      </body></body></body></body>"""
SERVOS = '<position name="a" joint="shoulder" kp="80" kv="4"/><position joint="lower" kp="30" kv="1"/>'
MOTORS = '<motor joint="shoulder"/><motor joint="lower"/>'


def write(folder, actuators="", *, base="", more="", name="two_link"):
    path = folder / f"{name}.xml"
    joints = f"<actuator>{actuators}</actuator>" if actuators else ""
    # A joint without a name is called as its body.
    bodies = BODIES.format(base=base).replace('"lower" pos', '"lower" pos')
    named = (
        bodies
        if 'joint="lower"' not in joints
        else bodies.replace('<joint axis="0 1 0" range="-140', '<joint name="lower" axis="0 1 0" range="-140')
    )
    path.write_text(f"<mujoco><worldbody>{named}</worldbody>{joints}{more}</mujoco>")
    return path


def test_joints_with_servos_follow_positions_and_the_others_are_left_out(tmp_path):
    found = draft_robot(write(tmp_path, SERVOS))
    assert found.robot.joint_names == ("shoulder", "lower")
    assert (found.robot.controller.kind, found.robot.controller.signal) == ("model", "position")
    assert found.robot.name == "two_link"
    np.testing.assert_allclose(found.robot.joints[0].position_limits, np.deg2rad([-100, 100]), rtol=1e-6)
    assert not found.invented
    assert not found.unsure


def test_motors_follow_torques_in_windows(tmp_path):
    robot = draft_robot(write(tmp_path, MOTORS)).robot
    assert (robot.controller.kind, robot.controller.signal) == ("model", "torque")
    assert robot.replay.window_s == 0.5


@pytest.mark.parametrize("signal", ["position", "velocity"])
@pytest.mark.parametrize("actuators", ["", MOTORS])
def test_servos_that_the_model_lacks_are_invented_and_said(tmp_path, signal, actuators):
    found = draft_robot(write(tmp_path, actuators), signal=signal)
    assert found.robot.controller.kind == signal
    assert found.invented
    assert "invented" in " ".join(found.unsure)


def test_invented_servos_hold_the_robot_and_follow(tmp_path):
    robot = draft_robot(write(tmp_path)).robot
    simulator = MujocoSimulator.from_robot(robot, tmp_path / "two_link.xml")
    time_s = np.arange(0.0, 4.0, simulator.timestep_s)
    start = np.array([0.4, -0.9, 0.02])
    command = start + np.outer(1 - np.cos(2 * np.pi * 0.5 * time_s), [0.3, -0.2, 0.005])
    request = RolloutRequest(start[None], np.zeros((1, 3)), {"position": command[None]})
    position = simulator.rollout(request).position[0, 1:]
    # At 0.5 Hz a critically damped servo of 5 Hz lags by a fifth of a radian; its weight is 0.05 rad at most.
    assert np.abs(position - command)[:, :2].max() < 0.2
    assert np.abs(position - command)[:, 2].max() < 0.02


@pytest.mark.parametrize("step", [0.001, 0.004])
def test_invented_gains_are_stable_at_the_step_of_the_model(tmp_path, step):
    path = write(tmp_path, more=f'<option timestep="{step}"/>')
    robot = draft_robot(path).robot
    model = MujocoSimulator.from_robot(robot, path).model
    data, full = mujoco.MjData(model), np.empty((model.nv, model.nv))
    kp = np.array([robot.controller.gain("kp", name) for name in robot.joint_names])
    for pose in np.random.default_rng(0).uniform(model.jnt_range[:, 0], model.jnt_range[:, 1], (20, 3)):
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        # Twice the step times the frequency of the fastest mode has to stay below 2 for an explicit step.
        fastest = np.sqrt(np.linalg.eigvals(np.linalg.solve(full, np.diag(kp))).real.max())
        assert step * fastest < 1.0


def test_a_floating_base_is_held_and_said(tmp_path):
    found = draft_robot(write(tmp_path, SERVOS, base="<freejoint/>"))
    assert found.robot.base == BaseSpec()
    assert "held" in found.unsure[0]
    key = '<keyframe><key name="stand" qpos="0 0 1 1 0 0 0 0 0 0"/></keyframe>'
    assert draft_robot(write(tmp_path, SERVOS, base="<freejoint/>", more=key)).robot.base == BaseSpec(held="stand")


def test_followers_are_no_joints_of_the_robot(tmp_path):
    more = '<equality><joint joint1="grip" joint2="shoulder" polycoef="0 .02 0 0 0"/></equality>'
    assert "grip" not in draft_robot(write(tmp_path, more=more)).robot.joint_names


def test_wanted_joints_come_in_their_order_and_strangers_are_refused(tmp_path):
    path = write(tmp_path, SERVOS)
    assert draft_robot(path, joints=["lower", "shoulder"]).robot.joint_names == ("lower", "shoulder")
    with pytest.raises(ConfigError, match="wrist"):
        draft_robot(path, joints=["wrist"])


def test_a_model_without_joints_is_refused(tmp_path):
    path = tmp_path / "box.xml"
    path.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(ConfigError, match="no joint that moves"):
        draft_robot(path)


def test_a_joint_without_a_name_is_called_as_its_body(tmp_path):
    assert draft_robot(write(tmp_path)).robot.joint_names == ("shoulder", "lower", "grip")


def test_masses_of_which_no_gains_can_be_made_are_refused(tmp_path):
    """A joint that nothing is behind, beside one that carries more than anything does."""
    path = write(tmp_path)
    path.write_text(
        path.read_text().replace('mass="1.5" diaginertia=".02 .02 .002"', 'mass="1e30" diaginertia="1 1 1"')
    )
    with pytest.raises(ConfigError, match="no gains of servos can be made up"):
        draft_robot(path)
