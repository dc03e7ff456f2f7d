"""Fifty robots of one kind, each identified by itself; one of them has been worn out.

Individuals 1 to 50 of the lab's upper body, three short motions each to fit and one to judge; the friction of the last
is twice that of its kind. What it takes per robot, what the fleet has in common, and whether the worn one is found.
"""

from __future__ import annotations

import os
import resource
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.table import Row, at_least, rounded, shown
from trueup.core.atomic import write_json
from trueup.core.provenance import provenance
from trueup.dataset import Dataset
from trueup.identify import IdentifyConfig
from trueup.identify.config import SolverChoice
from trueup.lab import LabSpec, load_lab
from trueup.record import RecordSettings
from trueup.record.planset import load_plans
from trueup.robots import load_robot
from trueup.stages import LabRig, record
from trueup.stages.fleet import fleet
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "fleet.json"
ROBOT, UNITS, WORN = "upper_body", 50, 2.0
_GROUP = {"kind": "joint", "moving": "all", "velocity_share": [0.3, 1.0]}
PLANS = {
    "name": "fleet",
    "seed": 5,
    "workspace": "empty",
    "motion": {"clock": {"rate_hz": 200.0, "rest_s": 0.3}},
    "groups": [
        {"name": "train", "count": 3 * UNITS, "split": "train", **_GROUP},
        {"name": "test", "count": UNITS, "split": "test", **_GROUP},
    ],
}
CONFIG = IdentifyConfig(
    fit={"kp": "all", "frictionloss": "all", "damping": "all"}, solver=SolverChoice(max_iterations=8)
)
SETTINGS = RecordSettings(control_hz=200.0, record_hz=100.0, tolerance_rad=0.5, path_tolerance_rad=1.0)


def run() -> list[Row]:
    """Record, identify, keep the result, and look for the worn one."""
    result = measured(UNITS)
    write_json(RESULT, rounded(result))
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    errors = {name: [unit["errors"][name]["test"] for unit in result["units"]] for name in ("stock", "fitted")}
    better = sum(fitted < stock for fitted, stock in zip(errors["fitted"], errors["stock"], strict=True))
    friction = [row for row in result["parameters"] if row["name"].startswith("frictionloss")]
    found = sum(result["worn"] in row["apart"] for row in friction)
    others = sum(len(set(row["apart"]) - {result["worn"]}) for row in result["parameters"])
    return [
        at_least("units better than the stock model on test", better, len(result["units"]), "units"),
        shown("RMSE on test, stock, median", 1e3 * float(np.median(errors["stock"])), "mrad"),
        shown("RMSE on test, fitted, median", 1e3 * float(np.median(errors["fitted"])), "mrad"),
        at_least("the worn one is found by its friction", found, 1, "joints"),
        shown(
            "others that are called unlike the rest", others, f"of {len(result['parameters']) * len(result['units'])}"
        ),
        shown("identification, processor time per robot", result["cpu_s"] / len(result["units"]), "s"),
        shown("identification, two processes", result["wall_s"], "s"),
        shown("results per robot", result["bytes"] / len(result["units"]) / 1e6, "MB"),
    ]


def measured(units: int) -> dict[str, Any]:
    """What a fleet of so many says."""
    folder = Path(tempfile.mkdtemp(prefix="fleet-"))
    try:
        return _measured(units, folder)
    finally:
        shutil.rmtree(folder)


def _measured(units: int, folder: Path) -> dict[str, Any]:
    robot, lab = load_robot(ROBOT), load_lab("upper_body", robot=ROBOT)
    (folder / "plans.yaml").write_text(yaml.safe_dump(PLANS))
    plans = load_plans(folder / "plans.yaml")
    rigs = [LabRig(lab if unit < units else _worn(lab), unit, seed=5) for unit in range(1, units + 1)]
    record(folder / "data", robot, rigs, plans, settings=SETTINGS, jobs=os.cpu_count() or 1)
    data = Dataset(folder / "data")
    worn = rigs[-1].unit
    began, used = time.perf_counter(), _cpu_s()
    found = fleet([data.path], robot, folder / "out", config=CONFIG)
    wall_s, cpu_s = time.perf_counter() - began, _cpu_s() - used
    own = sum(file.stat().st_size for file in (folder / "out").rglob("*") if file.is_file())
    return {
        "provenance": provenance(config={"machine": {"name": machine_name()}}, seed=5),
        "robot": ROBOT,
        "worn": worn,
        "factor": WORN,
        "motion_s": float(np.mean([episode.measured.time_s[-1] for episode in data])),
        "motions": len(data),
        "joints": len(robot.joint_names),
        "fitted": len(found.units[0].parameters),
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "processes": os.cpu_count(),
        "bytes": own,
        "units": [{"name": unit.name, "status": unit.status, "errors": unit.errors} for unit in found.units],
        "parameters": [asdict(row) for row in found.parameters],
    }


def _worn(lab: LabSpec) -> LabSpec:
    friction = lab.friction
    more = {
        name: tuple(WORN * value for value in getattr(friction, name))
        for name in ("breakaway_positive", "breakaway_negative")
    }
    return replace(lab, friction=replace(friction, **more))


def _cpu_s() -> float:
    """Processor time of this process and of those that it has waited for [s]."""
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return sum(usage.ru_utime + usage.ru_stime for usage in (own, children))
