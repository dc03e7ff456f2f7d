"""A joint that slides is planned and recorded in meters and newtons."""

import numpy as np
import pytest

from trueup.lab import SimulatedRobot
from trueup.record import MotionGroup, PlanSet, PlanSetSpec, Recorder, RecordSettings, Scene, joint_motion, plan_all
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, SimulationSpec
from trueup.robots.spec import JointGains
from trueup.sim import MujocoSimulator

CRANE = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <body name="cart" pos="0 0 1">
      <joint name="rail" type="slide" axis="1 0 0" range="-0.5 0.5" damping="5"/>
      <geom type="box" size="0.05 0.05 0.05" mass="1"/>
      <body name="arm" pos="0 0 -0.2">
        <joint name="swing" axis="0 1 0" range="-1 1" damping="1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
LIMITS = {"velocity": {"rail": 1.0, "swing": 2.0}, "acceleration": {"rail": 4.0, "swing": 8.0}}


@pytest.fixture
def crane(tmp_path):
    path = tmp_path / "crane.xml"
    path.write_text(CRANE)
    robot = RobotSpec(
        name="crane",
        joints=(JointSpec("rail"), JointSpec("swing")),
        model=path.name,
        controller=ControllerSpec(kind="pd", kp=800.0, kv=40.0, per_joint={"swing": JointGains(kp=60.0, kv=2.0)}),
        simulation=SimulationSpec(timestep_s=0.001),
    )
    return robot, path


def test_recordings_say_meters_and_newtons(crane):
    robot, path = crane
    scene = Scene(robot, model=path, **LIMITS)
    assert scene.length_units == ("m", "rad")
    plan = joint_motion(scene, np.zeros(2), np.array([0.3, 0.4]))
    assert plan.to_series().units["acceleration"] == ("m/s^2", "rad/s^2")
    hardware = SimulatedRobot(MujocoSimulator.from_robot(robot, path))
    done = Recorder(hardware, scene, RecordSettings(settle_s=0.1)).record(plan)
    assert done.flags == ()
    assert done.measured.units["position"] == done.command.units["position"] == ("m", "rad")
    assert done.measured.units["velocity"] == ("m/s", "rad/s")
    assert done.measured.units["torque"] == ("N", "Nm")
    np.testing.assert_allclose(done.measured["position"][-1], [0.3, 0.4], atol=0.02)


def test_stored_plans_keep_their_units(crane, tmp_path):
    robot, path = crane
    spec = PlanSetSpec(
        "crane",
        (MotionGroup("reach", "joint", 2),),
        velocity_limits=LIMITS["velocity"],
        acceleration_limits=LIMITS["acceleration"],
    )
    plan_all(spec, robot, tmp_path / "plans", model=path)
    stored = next(iter(PlanSet(tmp_path / "plans")))
    assert stored.to_series().units["position"] == ("m", "rad")
    assert stored.length_units == ("m", "rad")
