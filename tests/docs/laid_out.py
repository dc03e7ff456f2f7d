"""What the text of a page takes to be there: logs, datasets, robots, networks under the names that it uses."""

import json
import shutil
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest
import yaml
from benchmarks.networks import real_time

from dataset.test_import_rosbag import ARRAY, JOINT_STATE, ROS2, START_NS, STEP_NS, array, motion, states, write_bag
from docs import smaller, user_files
from docs.command_lines import blocks_of, lines
from trueup.cli.main import main
from trueup.dataset import Dataset, DatasetWriter
from trueup.lab import record_demo
from trueup.robots import find_model, load_robot
from trueup.stages import demonstrating

# Short ones of each split, and those of whose quality the pages say something.
SO101 = {
    "train": ("slow_precision", "fast_transitions", "single_joint_wrist_roll", "workspace_sweep"),
    "val": ("staircase_motion",),
    "test": ("symmetric_motion",),
}
PENDULUM = {"train": ("trajectory_00", "trajectory_11"), "val": ("trajectory_12",), "test": ("trajectory_13",)}
LIMITS = """<custom>
    <numeric name="velocity_limit" data="3 3 3"/>
    <numeric name="acceleration_limit" data="20 20 20"/>
  </custom>"""

# The demo arm without its drives, of which a mesh is missing.
URDF = """<robot name="arm">
  <link name="base"/>
  <link name="column">
    <visual><geometry><mesh filename="package://arm/meshes/column.stl"/></geometry></visual>
    <inertial><mass value="0.8"/>
      <inertia ixx="0.0012" iyy="0.0012" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper_arm"><inertial><origin xyz="0.12 0 0"/><mass value="0.7"/>
    <inertia ixx="0.0006" iyy="0.004" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="forearm"><inertial><origin xyz="0.11 0 0"/><mass value="0.45"/>
    <inertia ixx="0.0002" iyy="0.0016" izz="0.0016" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="yaw" type="revolute"><parent link="base"/><child link="column"/><origin xyz="0 0 0.12"/>
    <axis xyz="0 0 1"/><limit lower="-2.8" upper="2.8" effort="12" velocity="5"/></joint>
  <joint name="shoulder" type="revolute"><parent link="column"/><child link="upper_arm"/><origin xyz="0 0 0.05"/>
    <axis xyz="0 1 0"/><limit lower="-1.9" upper="1.9" effort="12" velocity="5"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper_arm"/><child link="forearm"/><origin xyz="0.25 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-2.4" upper="2.4" effort="12" velocity="5"/></joint>
</robot>
"""


def run(*words):
    """A command that must go well."""
    with pytest.raises(SystemExit) as left:
        main([str(word) for word in words])
    assert left.value.code == 0, words


class Shelf:
    """What several pages need, made once; pages get copies."""

    def __init__(self, folder, fixture):
        self.folder, self.fixture = folder, fixture

    @cached_property
    def demo(self):
        """Two motions of each split of the demo arm, with what its simulator makes of them."""
        whole, data = Dataset(demonstrating.demo_dataset(self.folder / "demo")), self.folder / "demo_arm"
        with DatasetWriter.create(data, whole.info) as writer:
            for name in (name for split in ("train", "val", "test") for name in whole.select(split=split)[:2]):
                writer.append(whole.episode(name))
        shortened(data, 5.0, 2)
        run("replay", data, "--robot", "demo_arm")
        return data

    def panda(self, unit):
        """Three short motions of a virtual Panda."""
        data = self.folder / f"panda-{unit}"
        if not data.is_dir():
            options = ("--robot", "panda", "--unit", unit, "--plan", "paper", "--scale", "0.001", "--jobs", 1)
            run("record", *options, "--out", data)
            shortened(data, 1.5, 2)
        return data

    @cached_property
    def body(self):
        """A motion of each kind of a virtual upper body."""
        rates = ("--control-hz", 50, "--tolerance-rad", 1, "--path-tolerance-rad", 2, "--scale", "0.001", "--jobs", 1)
        options = ("--robot", "upper_body", "--lab", "upper_body", "--plan", "upper_body", *rates)
        run("record", *options, "--out", self.folder / "body")
        shortened(self.folder / "body", 3.0, 3)
        return self.folder / "body"


def lay(shelf, page):
    """All that a page needs before its first line."""
    for name, text in smaller.FILES.items():
        put(Path("small", name), text)
    for block in blocks_of(page):
        if block.what == "file":
            put(Path(block.value), block.body)
    for name, make in LAID.get(page, {}).items():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        make(shelf, Path(name))


def before(line):
    """What has to be done before this line, which is the first one that begins so."""
    return [
        prepare
        for (page, words), prepare in BEFORE.items()
        if page == line.page and line == next(own for own in lines(page) if own.begins(words))
    ]


def put(path, text):
    """A file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def shortened(data, seconds, each):
    """The first seconds of so many motions of each split; the last of train becomes one of val, where there is none."""
    whole, path = Dataset(data), f"{data}.short"
    splits = {split: list(whole.select(split=split)[:each]) for split in dict.fromkeys(whole.splits.values())}
    if "val" not in splits and len(splits.get("train", ())) > 1:
        splits["val"] = [splits["train"].pop()]
    with DatasetWriter.create(Path(path), whole.info) as writer:
        for split, names in splits.items():
            for episode in map(whole.episode, names):
                series = {
                    name: kind.rows(slice(0, int(np.searchsorted(kind.time_s, kind.time_s[0] + seconds))))
                    for name, kind in (("measured", episode.measured), ("command", episode.command))
                }
                writer.append(replace(episode, meta=replace(episode.meta, split=split), **series))
    shutil.rmtree(data)
    Path(path).rename(data)


# What a page takes to be there at its beginning.


def demo_data(shelf, path):
    """The demo arm's motions."""
    shutil.copytree(shelf.demo, path)


def demo_logs(shelf, path):
    """The same as logs."""
    run("export", shelf.demo, "--out", path)


def demo_table(_, path):
    """A CSV file for each of them, in milliseconds and degrees."""
    path.mkdir()
    for episode in list(record_demo())[:3]:
        series = episode.measured, episode.command
        rows = np.column_stack([1000 * series[0].time_s, *(np.degrees(kind["position"]) for kind in series)])
        header = "t_ms,yaw,shoulder,elbow,yaw_cmd,shoulder_cmd,elbow_cmd"
        np.savetxt(path / f"{episode.id}.csv", rows, fmt="%.4f", delimiter=",", header=header, comments="")


def demo_tables(_, path):
    """A folder for each of them: states, and commands at half the rate in a file of their own."""
    for episode in list(record_demo())[:3]:
        (path / episode.id).mkdir(parents=True)
        for name, series, letter, step in (("state", episode.measured, "q", 1), ("command", episode.command, "u", 2)):
            rows = np.column_stack([series.time_s, series["position"]])[::step]
            header = ",".join(["t", *(f"{letter}{number}" for number in (1, 2, 3))])
            np.savetxt(path / episode.id / f"{name}.csv", rows, delimiter=",", header=header, comments="")


def demo_with(kg):
    """Motions of the demo arm that carry this [kg], as a dataset under data/ and as logs elsewhere."""

    def make(shelf, path):
        whole, data = Dataset(shelf.demo), path if path.parts[0] == "data" else Path("small", path.name)
        with DatasetWriter.create(data, whole.info) as writer:
            for name in (own for own in whole.ids if whole.episode(own).meta.payload_kg == kg):
                writer.append(whole.episode(name))
        if data != path:
            run("export", data, "--out", path)

    return make


def demo_robot(_, path):
    """The demo arm under another name, its model beside it, with limits to design motions within."""
    robot = load_robot("demo_arm")
    path.write_text(json.dumps({**robot.to_dict(), "name": path.stem, "model": f"{path.stem}.xml"}))
    model = find_model(robot).read_text()
    assert model.count("<default>") == 1
    path.with_suffix(".xml").write_text(model.replace("<default>", f"{LIMITS}\n  <default>"))


def mirrored_logs(shelf, path):
    """The demo arm's logs under other names of joints, of which the last counts the other way round in what is measured."""
    whole, data = Dataset(shelf.demo), Path("small", "mirrored")
    names = dict(zip(whole.info.joints, ("joint_1", "joint_2", "joint_3"), strict=True))

    def called(series, signs):
        signals = {signal: values * signs for signal, values in series.signals.items()}
        return replace(series, joints=tuple(names[joint] for joint in series.joints), signals=signals)

    units = {signal: {names[joint]: unit for joint, unit in own.items()} for signal, own in whole.info.units.items()}
    with DatasetWriter.create(data, replace(whole.info, joints=tuple(names.values()), units=units, robot="")) as writer:
        for episode in map(whole.episode, whole.ids):
            series = {"measured": called(episode.measured, (1, 1, -1)), "command": called(episode.command, (1, 1, 1))}
            writer.append(replace(episode, **series))
    run("export", data, "--out", path)


def panda(unit):
    """Motions of a Panda of the lab."""
    return lambda shelf, path: shutil.copytree(shelf.panda(unit), path)


def body(shelf, path):
    """Motions of an upper body of the lab."""
    shutil.copytree(shelf.body, path)


def so101(shelf, path):
    """A few motions of the real arm."""
    logs = shelf.fixture("so101_logs")
    for name in (*(name for own in SO101.values() for name in own), "model"):
        shutil.copytree(logs / name, path / name)
    (path / "split.json").write_text(json.dumps(SO101))


def pendulum(shelf, path):
    """A few of the recordings of the double pendulum."""
    logs = shelf.fixture("double_pendulum_logs")
    shutil.copytree(logs / "model", path / "model")
    for name in (name for own in PENDULUM.values() for name in own):
        shutil.copy(logs / f"{name}.csv", path)
    (path / "split.json").write_text(json.dumps(PENDULUM))


def bag(_, path):
    """200 joint states, and commands without names."""
    values = motion(200)
    commands = [(START_NS + k * STEP_NS, array(ROS2, row)) for k, row in enumerate(values[0])]
    write_bag(path, {"/joint_states": (JOINT_STATE, states(ROS2, values)), "/arm/commands": (ARRAY, commands)})


def network(_, path):
    """A network for a control loop, not trained."""
    real_time(path, hidden=(8, 5))


def of_the_page(page, first, **smaller):
    """A YAML that the page shows, with sizes of its own."""

    def make(_, path):
        (block,) = [block for block in blocks_of(page) if block.first.startswith(first)]
        path.write_text(yaml.safe_dump({**yaml.safe_load(block.body), **smaller}, sort_keys=False))

    return make


def text(content):
    """A file that the page describes."""
    return lambda _, path: path.write_text(content)


LAID = {
    "README": {"logs/so101_sage": so101},
    "close": {"logs/so101_sage": so101},
    "compensation": {"data/body": body},
    "engines": {"data/arm": panda(1)},
    "excitation": {"data/arm": demo_data, "arm.yaml": demo_robot},
    "first-hour": {"logs/so101_sage": so101},
    "fleet": {"data/line-1": panda(1), "data/line-2": panda(2), "fit.yaml": text(smaller.FILES["identify.yaml"])},
    "identification": {"logs/arm": demo_logs, "runs/arm/dataset": demo_data, "arm.yaml": demo_robot},
    "index": {"logs/so101_sage": so101},
    "lerobot": {"pick": user_files.lerobot, "so101.xml": user_files.so101},
    "log-formats": {
        "logs/two_files": demo_tables,
        "logs/run2": bag,
        "bag.yaml": of_the_page("log-formats", "command_joints:"),
    },
    "logs": {"logs/so101_sage": so101, "logs/mine": demo_table, "arm.yaml": demo_robot},
    "payload": {
        "arm.yaml": demo_robot,
        **{
            f"{place}/{name}": demo_with(kg)
            for place in ("data", "logs")
            for name, kg in (("free", 0.0), ("loaded", 0.4))
        },
    },
    "policies": {
        "fit.yaml": of_the_page(
            "policies", "fit:", solver={"max_iterations": 4, "tolerance": 0.5}, data={"budget_s": 2.0}
        ),
        "grid.yaml": of_the_page(
            "policies", "rate:", rate=[0.002], gamma=[0.99], **{"noise, sigma": [["none", 0.1]]}, seed=[0, 1]
        ),
    },
    "real-robots": {"logs/so101_sage": so101, "logs/dfki_double_pendulum_A0": pendulum},
    "robots": {"logs/arm": mirrored_logs, "arm.urdf": text(URDF)},
    "ros2-arm": {"arm.urdf": user_files.urdf, "bags": user_files.ros2_arm},
    "runtime": {"models/panda-rt": network},
    "selftest": {
        "logs/arm": demo_logs,
        "arm.yaml": demo_robot,
        "fit.yaml": text(smaller.FILES["identify.yaml"]),
    },
    "torque-rig": {"logs": user_files.rig_logs, "rig.xml": user_files.rig_model},
    "training": {"logs": user_files.rollouts, "robot.xml": user_files.trained_model},
}

# What it takes to be there further down.


def short(data, seconds, each=6):
    """Less of what was recorded, with a motion of val."""
    return lambda _, __: shortened(data, seconds, each)


def one_of_the_zoo(shelf, monkeypatch):
    """A policy that reaches its goals, in place of one that has hardly been trained."""
    import trueup.zoo

    shutil.move("runs/first", "runs/hardly-trained")
    shutil.copytree(trueup.zoo.folder_of("zoo:panda-reach"), "runs/first")


def trained_one(shelf, monkeypatch):
    """The one that has hardly been trained, with networks to go on with."""
    shutil.rmtree("runs/first")
    shutil.move("runs/hardly-trained", "runs/first")


def few_motions(shelf, monkeypatch):
    """Three of the demo's thirty."""
    monkeypatch.setattr(demonstrating, "_MOTIONS", dict.fromkeys(demonstrating._MOTIONS, 1))


def shorter_still(shelf, monkeypatch):
    """A motion of each split, for causes are fitted one after the other."""
    shortened("runs/arm/dataset", 2.0, 1)
    run("replay", "runs/arm/dataset", "--robot", "demo_arm")


BEFORE = {
    ("building-blocks", "replay data/kickbot"): short("data/kickbot", 2.0),
    ("building-blocks", "replay data/dancebot"): short("data/dancebot", 0.8),
    ("compensation", "identify data/slow"): short("data/slow", 2.0, 2),
    ("identification", "gap runs/arm/dataset"): shorter_still,
    ("index", "demo"): few_motions,
    ("policies", "deploy run runs/first"): one_of_the_zoo,
    ("policies", "policy train --robot runs/fit/robot.fitted.yaml"): trained_one,
}
