"""Scenes of URDF models: limits from the file where it has them, clear words where it has none."""

import numpy as np
import pytest

from trueup.errors import ConfigError, NoPlan
from trueup.record import Box, ReferenceSettings, Scene, Workspace, check_plan, random_reference
from trueup.record.urdf import urdf_velocity_limits
from trueup.robots import JointSpec, RobotSpec

LINK = """
  <link name="{name}">
    <inertial><origin xyz="0 0 0.2"/><mass value="1"/><inertia ixx="0.02" iyy="0.02" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.03" length="0.36"/></geometry></collision>
  </link>"""
BASE = '<link name="base"><collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>'
JOINTS = """
  <joint name="hip" type="revolute"><parent link="base"/><child link="thigh"/><axis xyz="0 1 0"/>
    <limit lower="-1.0" upper="0.8" effort="20" velocity="{speed}"/></joint>
  <joint name="knee" type="{kind}"><parent link="thigh"/><child link="shank"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit {room}effort="10" velocity="4.0"/></joint>"""
THRUSTS = {"hip": 10.0, "knee": 15.0}


def leg(folder, *, speed="3.0", kind="revolute", links=LINK):
    room = 'lower="-2.0" upper="2.0" ' if kind == "revolute" else ""
    text = (
        BASE
        + links.format(name="thigh")
        + links.format(name="shank")
        + JOINTS.format(speed=speed, kind=kind, room=room)
    )
    (folder / "leg.urdf").write_text(f"<robot name='leg'>{text}\n</robot>")
    return RobotSpec("leg", (JointSpec("hip"), JointSpec("knee")), "leg.urdf", folder=folder)


def test_limits_come_from_the_urdf(tmp_path):
    scene = Scene(leg(tmp_path), acceleration=THRUSTS)
    np.testing.assert_allclose(scene.limits.low, [-1.0, -2.0])
    np.testing.assert_allclose(scene.limits.high, [0.8, 2.0])
    np.testing.assert_allclose(scene.limits.velocity, [3.0, 4.0])
    slower = Scene(leg(tmp_path), velocity={"knee": 1.0}, acceleration=THRUSTS)
    np.testing.assert_allclose(slower.limits.velocity, [3.0, 1.0])


def test_a_urdf_without_meshes_is_planned_around_obstacles(tmp_path):
    # The thigh's cylinder stands in the base: a joint holds them together, so they may touch.
    scene = Scene(leg(tmp_path), workspace=Workspace(floor_m=None), acceleration=THRUSTS)
    assert scene.free(np.array([0.0, 0.0]))
    plan = random_reference(
        scene,
        "multisine",
        ("hip", "knee"),
        np.random.default_rng(0),
        velocity_share=0.5,
        reference=ReferenceSettings(duration_s=4.0),
    )
    assert check_plan(plan, scene.limits, scene) == ()
    wall = Workspace(floor_m=None, boxes=(Box("wall", (0.0, 0.0, 0.85), (0.4, 0.4, 0.2)),))
    blocked = Scene(leg(tmp_path), workspace=wall, acceleration=THRUSTS)
    with pytest.raises(NoPlan, match="in collision"):
        blocked.require_free(np.array([0.0, 0.0]), "upright")
    low_wall = Workspace(floor_m=None, boxes=(Box("wall", (0.0, 0.0, 0.05), (0.4, 0.4, 0.2)),))
    beside = Scene(leg(tmp_path), workspace=low_wall, acceleration=THRUSTS)
    assert not beside.free(np.array([0.0, 0.0])), "what stands around the first link is no part of the base"


@pytest.mark.parametrize("speed", ["0", "", "fast", "inf", "-1"])
def test_a_speed_that_is_none_is_asked_for(tmp_path, speed):
    robot = leg(tmp_path, speed=speed)
    assert urdf_velocity_limits(tmp_path / "leg.urdf") == {"knee": 4.0}
    with pytest.raises(ConfigError, match=r"\['hip'\] have no velocity limit") as caught:
        Scene(robot, acceleration=THRUSTS)
    assert "velocity_limits" in caught.value.hint
    assert Scene(robot, velocity={"hip": 2.0}, acceleration=THRUSTS).limits.velocity[0] == 2.0


def test_what_a_urdf_cannot_say_is_asked_for(tmp_path):
    with pytest.raises(ConfigError, match="no acceleration limit") as caught:
        Scene(leg(tmp_path))
    assert "acceleration_limits" in caught.value.hint
    with pytest.raises(ConfigError, match="'knee' has no position limits"):
        Scene(leg(tmp_path, kind="continuous"), acceleration=THRUSTS)
    missing = LINK.replace('<cylinder radius="0.03" length="0.36"/>', '<mesh filename="package://leg/thigh.stl"/>')
    with pytest.raises(ConfigError, match="does not compile"):
        Scene(leg(tmp_path, links=missing), acceleration=THRUSTS)


def test_files_that_are_no_urdf_have_no_such_limits(tmp_path):
    for text in ("<mujoco/>", "no xml", "", "<robot><joint"):
        (tmp_path / "model.xml").write_text(text)
        assert urdf_velocity_limits(tmp_path / "model.xml") == {}
    assert urdf_velocity_limits(tmp_path / "gone.xml") == {}
