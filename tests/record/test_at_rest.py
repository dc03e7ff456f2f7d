"""What touches while the robot rests is how it is made, and in the way of no motion."""

import numpy as np
import pytest

from trueup.draft import draft_robot
from trueup.record import Workspace
from trueup.record.excitation import DesignSettings
from trueup.record.scene import Scene
from trueup.stages.designing import design

# A turntable that stands 3 mm above the floor, an arm, and two fingers whose shapes overlap by 4 mm.
HAND = """
<mujoco>
  <worldbody>
    <body name="table" pos="0 0 {height}">
      <joint name="turn" axis="0 0 1" range="-90 90"/>
      <geom name="plate" type="cylinder" size="0.1 0.05" mass="1"/>
      <body name="arm" pos="0 0 0.05">
        <joint name="lift" axis="0 1 0" range="-60 60"/>
        <geom name="arm" type="capsule" fromto="0 0 0.03 0 0 0.3" size="0.03" mass="1"/>
        <body name="one" pos="0.018 0 0.36">
          <joint name="one" axis="0 1 0" range="-5 40" armature="0.01"/>
          <geom name="one" type="capsule" fromto="0 0 0 0 0 0.1" size="0.02" mass="0.1"/>
        </body>
        <body name="other" pos="-0.018 0 0.36">
          <joint name="other" axis="0 1 0" range="-40 5" armature="0.01"/>
          <geom name="other" type="capsule" fromto="0 0 0 0 0 0.1" size="0.02" mass="0.1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <keyframe><key name="home" qpos="0 0 0 0"/></keyframe>
  <actuator>{actuators}</actuator>
</mujoco>
"""
JOINTS = ("turn", "lift", "one", "other")
RATES = {"velocity": dict.fromkeys(JOINTS, 1.0), "acceleration": dict.fromkeys(JOINTS, 5.0)}


def hand(folder, height=0.053):
    path = folder / "hand.xml"
    actuators = "".join(f'<position name="{name}" joint="{name}" kp="2" kv="0.1"/>' for name in JOINTS)
    path.write_text(HAND.format(height=height, actuators=actuators))
    return draft_robot(path).robot, path


def scene(folder, height=0.053, **more):
    robot, path = hand(folder, height)
    return Scene(robot, model=path, **RATES, **more)


def test_neighbours_that_overlap_and_what_stands_on_the_floor_are_free(tmp_path):
    made = scene(tmp_path, workspace=Workspace())
    assert made.free(made.home)
    assert made.in_workspace == ""
    # The arm itself must not reach the floor, though the turntable stands on it.
    assert not scene(tmp_path, workspace=Workspace(floor_m=0.2)).free(np.array([0.0, 1.0, 0.0, 0.0]))


def test_links_that_are_far_apart_and_deep_in_each_other_are_not(tmp_path):
    robot, path = hand(tmp_path)
    post = '<geom name="post" type="box" size="0.05 0.05 0.05" pos="0.018 0 0.5"/>'
    path.write_text(path.read_text().replace("<worldbody>", f"<worldbody>{post}"))
    made = Scene(robot, model=path, **RATES)
    assert not made.free(made.home)


@pytest.mark.long
def test_the_default_floor_is_left_out_where_the_robot_is_in_it(tmp_path):
    robot, path = hand(tmp_path, height=-0.2)
    limits = {"velocity_limits": RATES["velocity"], "acceleration_limits": RATES["acceleration"]}
    few = DesignSettings(duration_s=4.0, harmonics=2, evaluations=8)
    made = design(robot, tmp_path / "out", count=1, model=path, settings=few, jobs=1, **limits)
    assert len(made.plans) == 1
    assert any("floor" in line and "--workspace" in line for line in made.notes)


@pytest.mark.parametrize("floor_m", [0.0, None])
def test_a_free_robot_is_told_nothing(tmp_path, floor_m):
    assert scene(tmp_path, workspace=Workspace(floor_m=floor_m)).in_workspace == ""
