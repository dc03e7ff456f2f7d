"""Files as four kinds of users have them: bags of a ROS 2 arm, a LeRobot dataset, a trainer's arrays, a rig's CSV."""

import shutil
import xml.etree.ElementTree as ET

import mujoco
import numpy as np

from dataset.test_import_lerobot import foreign
from dataset.test_import_rosbag import ARRAY, JOINT_STATE, ROS2, START_NS, array, state, write_bag
from trueup.dataset import Dataset
from trueup.robots import find_model, load_robot

# Of the real SO-101, those that are short.
ARM_MOTIONS = ("slow_precision", "fast_transitions", "single_joint_wrist_roll", "staircase_motion", "symmetric_motion")
RIG_MOTIONS = ("trajectory_00", "trajectory_11", "trajectory_12", "trajectory_13")


def ros2_arm(shelf, path):
    """A URDF, and a bag for each motion: joint states at 200 Hz, position commands without names."""
    path.mkdir()
    for name, episode in episodes(shelf.demo):
        measured, command = episode.measured, episode.commanded()
        joints = list(measured.joints)[::-1]  # as joint_state_broadcaster pleases
        states = [
            (START_NS + int(1e9 * time_s) + 1_000_000, state(ROS2, START_NS + int(1e9 * time_s), joints, *rows))
            for time_s, *rows in zip(
                measured.time_s, *(measured[own][:, ::-1] for own in ("position", "velocity")), strict=True
            )
        ]
        told = [
            (START_NS + int(1e9 * time_s), array(ROS2, row))
            for time_s, row in zip(command.time_s, command["position"], strict=True)
        ]
        topics = {"/joint_states": (JOINT_STATE, states), "/forward_position_controller/commands": (ARRAY, told)}
        write_bag(path / name, topics)


def urdf(_, path):
    """The demo arm as a URDF, which knows nothing of its drives."""
    model = mujoco.MjModel.from_xml_path(str(find_model(load_robot("demo_arm"))))
    robot = ET.Element("robot", name="arm")
    for body in range(model.nbody):
        link = ET.SubElement(robot, "link", name=model.body(body).name)
        if model.body_mass[body]:
            own = ET.SubElement(link, "inertial")
            ET.SubElement(own, "origin", xyz=words(model.body_ipos[body]))
            ET.SubElement(own, "mass", value=f"{model.body_mass[body]:g}")
            axes = dict(zip(("ixx", "iyy", "izz"), model.body_inertia[body], strict=True))
            ET.SubElement(
                own, "inertia", ixy="0", ixz="0", iyz="0", **{key: f"{value:g}" for key, value in axes.items()}
            )
        if body:
            joints = [joint for joint in range(model.njnt) if model.jnt_bodyid[joint] == body]
            name = model.joint(joints[0]).name if joints else f"{model.body(body).name}_fixed"
            made = ET.SubElement(robot, "joint", name=name, type="revolute" if joints else "fixed")
            ET.SubElement(made, "parent", link=model.body(model.body_parentid[body]).name)
            ET.SubElement(made, "child", link=model.body(body).name)
            ET.SubElement(made, "origin", xyz=words(model.body_pos[body]))
            if joints:
                low, high = model.jnt_range[joints[0]]
                ET.SubElement(made, "axis", xyz=words(model.jnt_axis[joints[0]]))
                ET.SubElement(made, "limit", lower=f"{low:g}", upper=f"{high:g}", effort="12", velocity="6")
    ET.ElementTree(robot).write(path)


def words(values):
    return " ".join(f"{value:g}" for value in values)


def lerobot(shelf, path):
    """Real motions of an SO-101 as LeRobot keeps them: degrees, the gripper from 0 to 100, 30 frames per second."""
    from trueup.dataset.importers import sage
    from trueup.dataset.importers.base import ImportOptions

    logs = shelf.fixture("so101_logs")
    sources = {source.id: source for source in sage.scan(logs, ImportOptions()).episodes}
    rows, frames = {"observation.state": [], "action": []}, []
    for motion in ARM_MOTIONS:
        episode = sources[motion].load()
        command = episode.commanded()
        time_s = np.arange(episode.measured.time_s[0], episode.measured.time_s[-1], 1 / 30)
        for feature, series in (("observation.state", episode.measured), ("action", command)):
            values = np.column_stack([np.interp(time_s, series.time_s, own) for own in series["position"].T])
            rows[feature].append(in_its_units(values))
        frames.append(len(time_s))
    names = [f"{joint.name}.pos" for joint in load_robot("so101").joints]
    features = {feature: (names, np.concatenate(own)) for feature, own in rows.items()}
    foreign(path, features, frames=tuple(frames), fps=30)


def in_its_units(values):
    return np.column_stack([np.degrees(values[:, :-1]), 100 * values[:, -1] / 1.75])


def so101(shelf, path):
    """The arm's model, as the Menagerie has it."""
    shutil.copy(shelf.fixture("so101_logs") / "model" / "so101.xml", path)


def rollouts(shelf, path):
    """What a script logged while a policy ran: an array for each signal, a file for each motion."""
    path.mkdir()
    for name, episode in episodes(shelf.demo):
        command = episode.commanded()
        at = np.clip(np.searchsorted(command.time_s, episode.measured.time_s, side="right") - 1, 0, None)
        np.savez(
            path / f"{name}.npz",
            time=episode.measured.time_s,
            dof_names=np.array(episode.measured.joints),
            dof_pos=episode.measured["position"],
            dof_vel=episode.measured["velocity"],
            target_dof_pos=command["position"][at],
        )


def trained_model(_, path):
    """The MJCF that policies were trained in."""
    shutil.copy(find_model(load_robot("demo_arm")), path)


def rig_logs(shelf, path):
    """Four recordings of the real double pendulum."""
    path.mkdir()
    for name in RIG_MOTIONS:
        shutil.copy(shelf.fixture("double_pendulum_logs") / f"{name}.csv", path)


def rig_model(shelf, path):
    """Its model."""
    shutil.copy(shelf.fixture("double_pendulum_logs") / "model" / "double_pendulum_A0.xml", path)


def episodes(data):
    whole = Dataset(data)
    return [(name, whole.episode(name)) for name in whole.ids]
