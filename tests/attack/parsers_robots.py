"""Descriptions of robots, models, labs and fits."""

from __future__ import annotations

import functools
import json
import shutil
from collections.abc import Iterator
from dataclasses import asdict
from importlib import resources
from pathlib import Path

import yaml

from attack.harness import Parser, Unsound
from trueup.align import JointMap
from trueup.core.config import read_yaml
from trueup.identify import IdentifyConfig, Knowledge, Nominal
from trueup.lab import LabSpec, draw_truth, load_lab
from trueup.lab.truth import Truth
from trueup.record import load_plans, load_workspace
from trueup.record.urdf import urdf_velocity_limits
from trueup.robots import find_model, load_robot
from trueup.robots.model import compile_spec, load_spec
from trueup.sim import make_simulator

ROBOT = """
schema: trueup.robot/1
name: arm
model: arm.xml
description: two joints
joints:
  - {name: a, log: A, log_unit: deg, scale: 1.5, offset: 0.1, position_limits: [-1.0, 1.0], torque_limit: 5.0}
  - {name: b, sign: -1}
scored: [a]
ignore: [c]
controller: {kind: position, kp: 10.0, kv: 1.0, delay_s: 0.01, per_joint: {b: {kp: 5.0, delay_s: 0.02}}}
simulation: {timestep_s: 0.002, contacts: false, gravity_compensation: true}
replay: {window_s: 0.5, initial_velocity: zero, settle_s: 0.1}
friction: {a: {stribeck: 0.1, load: 0.05, asymmetry: 0.1, dead_band: 0.001}, b: {tanh_coulomb: 0.1, static_positive: 0.1}}
"""
MODEL = """<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <default><joint damping="0.1" armature="0.01"/></default>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="a" type="hinge" axis="0 1 0" range="-2 2" frictionloss="0.1"/>
      <geom name="g" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
      <body name="lower" pos="0 0 -0.3">
        <inertial pos="0 0 -0.1" mass="0.3" diaginertia="0.001 0.001 0.0005"/>
        <joint name="b" type="hinge" axis="0 1 0"/>
        <site name="tool" pos="0 0 -0.2"/>
      </body>
    </body>
  </worldbody>
  <keyframe><key name="home" qpos="0.1 0.2"/></keyframe>
</mujoco>
"""
URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"><inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <link name="upper">
    <inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="0.5"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
    <visual><geometry><mesh filename="package://arm/upper.stl"/></geometry></visual>
    <collision><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.02" length="0.2"/></geometry></collision>
  </link>
  <link name="lower"><inertial><mass value="0.3"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
    <collision><geometry><mesh filename="file://lower.stl" scale="1 1 1"/></geometry></collision></link>
  <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="2"/></joint>
  <joint name="b" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.2"/><axis xyz="0 1 0"/><dynamics damping="0.1" friction="0.1"/></joint>
</robot>
"""


def make_robot(folder: Path) -> None:
    """A description with every key, and its model."""
    (folder / "robot.yaml").write_text(ROBOT)
    (folder / "arm.xml").write_text(MODEL)


def read_robot(folder: Path) -> Iterator[Exception]:
    """As far as a simulator."""
    robot = load_robot(folder / "robot.yaml")
    JointMap.from_dict(robot.joint_rules())
    make_simulator("mujoco", robot, find_model(robot, folder=folder))
    yield from ()


def make_mjcf(folder: Path) -> None:
    """One file."""
    (folder / "arm.xml").write_text(MODEL)


def read_mjcf(folder: Path) -> Iterator[Exception]:
    """As far as a compiled model."""
    compile_spec(load_spec(folder / "arm.xml"), folder / "arm.xml")
    yield from ()


def make_urdf(folder: Path) -> None:
    """One file, one of its meshes not there."""
    (folder / "arm.urdf").write_text(URDF)


def read_urdf(folder: Path) -> Iterator[Exception]:
    """As far as a compiled model."""
    urdf_velocity_limits(folder / "arm.urdf")
    compile_spec(load_spec(folder / "arm.urdf"), folder / "arm.urdf")
    yield from ()


def make_map(folder: Path) -> None:
    """A map with every key."""
    (folder / "map.yaml").write_text(
        'joints:\n  a: {log: A, sign: -1, scale: 2.0, offset: 0.5, log_unit: "1", unit: m}\n  b: {log: B, log_unit: deg}\nignore: [C, D]\n'
    )


def read_map(folder: Path) -> Iterator[Exception]:
    """There and back."""
    JointMap.from_dict(JointMap.from_dict(read_yaml(folder / "map.yaml")).to_dict())
    yield from ()


def make_lab(folder: Path) -> None:
    """Every key of a lab, and an individual of it."""
    lab = json.loads(json.dumps(asdict(LabSpec())))
    (folder / "lab.yaml").write_text(yaml.safe_dump(lab))
    draw_truth(LabSpec(), unit=1).save(folder / "truth.json")


def read_lab(folder: Path) -> Iterator[Exception]:
    """An individual of it."""
    truth = draw_truth(load_lab(folder / "lab.yaml"), unit=1)
    if not all(abs(value) < float("inf") for joint in truth.joints.values() for value in asdict(joint).values()):
        raise Unsound("a robot with numbers that are not finite")
    yield from ()


def read_truth(folder: Path) -> Iterator[Exception]:
    """As it is."""
    Truth.load(folder / "truth.json")
    yield from ()


@functools.cache
def nominal() -> Nominal:
    """A shipped arm with position servos."""
    robot = load_robot("demo_arm")
    return Nominal(robot, find_model(robot))


IDENTIFY = """
schema: trueup.identify/1
fit:
  delay_s: {shared: true, start: 0.01, low: 0.0, high: 0.05, prior_std: 0.01}
  damping: all
  frictionloss: {targets: [JOINT], low: 0.001}
  armature: {frozen: true}
models: {stribeck: [stribeck, stribeck_velocity], load: [load]}
signals: {position: 1.0, velocity: 0.1}
joints: {JOINT: 0.5}
data: {window_s: 0.5, cut_s: 2.0, budget_s: 100.0, burn_in_s: 0.5, keep_flagged: true}
solver: {name: auto, max_iterations: 20, max_evaluations: 100, max_seconds: 60.0, tolerance: 0.001, loss: soft_l1, starts: 2}
"""


def make_identify(folder: Path) -> None:
    """Every key."""
    joint = nominal().robot.joint_names[0]
    (folder / "identify.yaml").write_text(IDENTIFY.replace("JOINT", joint))
    (folder / "workspace.yaml").write_text(
        "schema: trueup.workspace/1\nfloor_m: 0.0\nboxes:\n  - {name: wall, center_m: [1.0, 0.0, 0.5], size_m: [0.1, 2.0, 1.0], yaw_rad: 0.1}\n"
    )


def read_identify(folder: Path) -> Iterator[Exception]:
    """As far as what is known before a fit, which is what `design` starts from."""
    load_workspace(folder / "workspace.yaml")
    config = IdentifyConfig.load(folder / "identify.yaml")
    known = Knowledge.of_config(config, nominal())
    if not (known.std > 0).all() or not (known.std < float("inf")).all():
        raise Unsound("standard deviations that are none")
    yield from ()


PLANS = """
schema: trueup.plans/1
name: small
workspace: {floor_m: 0.0, boxes: [{name: wall, center_m: [1.0, 0.0, 0.5], size_m: [0.1, 2.0, 1.0]}]}
seed: 8
fractions: {train: 0.84, val: 0.16}
motion: {clock: {rate_hz: 200}}
reference: {duration_s: 3.0, ramp_s: 1.0, degree: 7}
groups:
  - {name: goals, kind: joint, count: 3, moving: single, velocity_share: [0.02, 0.12]}
  - {name: field, kind: random-field, count: 2, moving: all, duration_s: [2, 3], length_s: [0.25, 1.0], velocity_share: [0.3, 1.0]}
  - {name: spline, kind: joint-b-spline, count: 2, moving: all, control_points: 8, pause_share: 0.25, span_s: 0.5, joints: [a, b]}
  - {name: played, kind: animation, count: 1, split: test, speed: [0.85, 1.25], amplitude: [0.8, 1.05]}
animations:
  wave: {duration_s: 3.0, joints: {a: [[1.2, -0.5], [2.0, 0.5]], b: [[1.0, 0.2], [2.5, -0.2]]}}
"""


def make_plans_file(folder: Path) -> None:
    """Every kind of motion that a description may ask for, nearly."""
    (folder / "plans.yaml").write_text(PLANS)


def read_plans_file(folder: Path) -> Iterator[Exception]:
    """Names and splits of all motions."""
    spec = load_plans(folder / "plans.yaml")
    count = sum(group.count for group in spec.groups)
    ids = [spec.id(number) for number in range(min(count, 100))]
    if len(set(ids)) < len(ids):
        raise Unsound("two motions of one name")
    for number in range(len(ids)):
        spec.split(number)
    json.dumps(spec.to_dict(), allow_nan=False)
    yield from ()


def make_lab_of_robot(folder: Path) -> None:
    """A shipped one, which names its robot, and that robot's description."""
    shutil.copy(resources.files("trueup.lab") / "labs" / "upper_body.yaml", folder / "lab.yaml")
    shutil.copy(resources.files("trueup.robots") / "upper_body.yaml", folder / "robot.yaml")


def read_lab_of_robot(folder: Path) -> Iterator[Exception]:
    """The robot, and an individual of the lab's."""
    robot = load_robot(folder / "robot.yaml")
    JointMap.from_dict(robot.joint_rules())
    draw_truth(load_lab(folder / "lab.yaml", robot=robot.name), unit=1)
    yield from ()


PARSERS = (
    Parser("plans.yaml", make_plans_file, read_plans_file),
    Parser("lab of a robot", make_lab_of_robot, read_lab_of_robot),
    Parser("mjcf", make_mjcf, read_mjcf),
    Parser("urdf", make_urdf, read_urdf),
    Parser("robot.yaml", make_robot, read_robot),
    Parser("joint map", make_map, read_map),
    Parser("lab.yaml", make_lab, read_lab),
    Parser("truth.json", make_lab, read_truth),
    Parser("identify.yaml", make_identify, read_identify),
)
