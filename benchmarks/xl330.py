"""`trueup close` on a real servo at four settings of its position gain: one fit of all, tested on another motion.

A Dynamixel XL330 lifts a pendulum. Minutes. Writes `benchmarks/results/xl330.json`.
"""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.recordings import recording
from benchmarks.table import Row, at_most, rounded, shown
from trueup.core.atomic import make_folder, read_json, write_json, write_text
from trueup.core.fit_result import FitResult
from trueup.core.provenance import provenance
from trueup.core.results import GapResult
from trueup.dataset import Dataset
from trueup.stages.identifying import FITTED
from trueup.stages.replaying import STOCK
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "xl330.json"
# In the fourth motion of each gain, lift_and_drop, the torque is switched off half-way: it is left out.
SPLITS = {"sin_sin": "train", "up_and_down": "train", "sin_time_square": "test"}
_OPTIONS = ("--until", "identify", "--jobs", "1")
# With 3 the command says of its result that a part of it is missing or of no use; the result is there all the same.
_ENDS = (0, 3)
_ERROR_BAR_RAD = 0.09

# What is known before a fit: the mass and the length of the pendulum, and a guess of everything else.
_MODEL = """\
<mujoco model="xl330">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="pendulum">
      <joint name="servo" axis="0 1 0" armature="0.002" damping="0.01" frictionloss="0.02"/>
      <inertial pos="0 0 -0.1" mass="0.49" diaginertia="1e-6 1e-6 1e-6"/>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="servo" kp="0.7" kv="0.02"/>
  </actuator>
</mujoco>
"""
_ROBOT = """\
name: xl330
model: xl330.xml
joints:
  - {name: servo, torque_limit: 0.5}
controller: {kind: model, command: position, kp_setting: 400}
"""
_MAPPING = """\
joints: [servo]
episodes: '(?P<motion>.*)\\.csv'
id: "{motion}"
metadata: motions.csv
series:
  measured:
    time: {column: time_s}
    signals:
      position: {columns: [position], unit: rad}
      velocity: {columns: [speed], unit: rad/s}
  command:
    time: {column: time_s}
    signals:
      position: {columns: [goal], unit: rad}
"""


def run() -> list[Row]:
    """Convert, close, keep the result; nothing without the recording."""
    raw = recording("bam_xl330")
    if raw is None:
        return []
    load = list(os.getloadavg())
    with TemporaryDirectory() as name:
        folder = Path(name)
        robot = converted(raw / "raw", folder)
        result = {"schema": "trueup.xl330_benchmark/1", **closed(folder / "logs", robot, folder / "out")}
        data = Dataset(folder / "out" / "dataset").hash
    machine = {"name": machine_name(), "load_before": load}
    result["provenance"] = provenance(config={"machine": machine}, seed=0, data_hash=data)
    make_folder(RESULT.parent)
    write_json(RESULT, rounded(result))
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    errors = result["test"]
    return [
        at_most(
            "XL330, four gains, test: position RMSE, mean over motions", errors[FITTED]["mean"], _ERROR_BAR_RAD, "rad"
        ),
        *(shown(f"XL330, test, fitted: {name}", value, "rad") for name, value in errors[FITTED]["motions"].items()),
        shown("XL330, test: stock, mean over motions", errors[STOCK]["mean"], "rad"),
        shown("XL330: kp at setting 400", result["parameters"]["kp[servo]"], "Nm/rad"),
        shown("XL330: the whole command", result["seconds"], "s"),
    ]


def converted(raw: Path, folder: Path) -> Path:
    """The recordings as CSV files with their metadata and splits in `logs`; the robot's description."""
    logs = folder / "logs"
    make_folder(logs)
    about: list[tuple[str, str, int]] = []
    splits: dict[str, list[str]] = {}
    for path in sorted(raw.glob("*.json")):
        motion = read_json(path)
        if (split := SPLITS.get(motion["trajectory"])) is None:
            continue
        name = f"{motion['trajectory']}_{motion['kp']}"
        entries = motion["entries"]
        columns = [[entry[key] for entry in entries] for key in ("timestamp", "position", "speed", "goal_position")]
        np.savetxt(
            logs / f"{name}.csv",
            np.transpose(columns),
            fmt="%.17g",
            delimiter=",",
            header="time_s,position,speed,goal",
            comments="",
        )
        about.append((name, motion["motor"], motion["kp"]))
        splits.setdefault(split, []).append(name)
    with (logs / "motions.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("id", "robot", "kp_setting"), *about])
    write_json(logs / "split.json", splits)
    write_text(logs / "mapping.yaml", _MAPPING)
    write_text(folder / "xl330.xml", _MODEL)
    write_text(folder / "robot.yaml", _ROBOT)
    return folder / "robot.yaml"


def closed(logs: Path, robot: Path, out: Path) -> dict[str, Any]:
    """What the command leaves, and how long it took.

    Raises:
        RuntimeError: it left nothing.
    """
    began = time.perf_counter()
    command = ["close", str(logs), "--robot", str(robot), "--out", str(out), *_OPTIONS]
    done = subprocess.run([sys.executable, "-m", "trueup.cli.main", *command], check=False)
    seconds = time.perf_counter() - began
    if done.returncode not in _ENDS:
        raise RuntimeError(f"trueup {' '.join(command)} ended with {done.returncode}")
    fit = FitResult.load(out / "fit.json")
    gap = GapResult.load(out / "gap.json")
    return {
        "seconds": seconds,
        "code": done.returncode,
        "status": fit.status,
        "statements": list(fit.statements),
        "suspects": [asdict(suspect) for suspect in fit.suspects],
        "models": {row.name: {split: own.value for split, own in row.splits.items()} for row in fit.models},
        "parameters": {parameter.name: parameter.value for parameter in fit.parameters},
        "test": {label: errors_of(gap, label) for label in (STOCK, FITTED)},
    }


def errors_of(gap: GapResult, label: str) -> dict[str, Any]:
    """Position RMSE of each test motion, and their mean [rad]."""
    motions = {
        name: metrics["position"]["rmse"]["servo"]
        for name, metrics in gap.episodes[label].items()
        if gap.splits[name] == "test"
    }
    return {"motions": motions, "mean": float(np.mean(list(motions.values())))}
