"""Identification of two real robots from their recordings: by default, and one friction model after the other.

Writes `benchmarks/results/real_robots.json`, from which docs/real-robots.md is made.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import trueup
from benchmarks.recordings import recording
from benchmarks.table import Row, at_most, shown
from trueup.core.atomic import make_folder, write_json
from trueup.core.fit_result import ModelRow
from trueup.core.provenance import provenance
from trueup.core.results import Metrics
from trueup.dataset import Dataset
from trueup.identify import IdentifyConfig, Nominal
from trueup.identify.model_search import ModelSearch
from trueup.robots import find_model
from trueup.stages.identifying import FITTED, Identified
from trueup.stages.motions import motions_of
from trueup.stages.replaying import STOCK

RESULT = Path(__file__).parent / "results" / "real_robots.json"
JOBS = os.cpu_count() or 1
SPLITS = ("train", "val", "test")

# What every friction model stands on: a servo with its delay, gain and offset, on links of unknown mass.
_DRIVE = dict.fromkeys(("delay_s", "kp", "armature", "torque_offset", "mass"), "all")
# Name -> what is added, and whether dry friction is held hard.
_FRICTION: Mapping[str, tuple[tuple[str, ...], bool]] = {
    "as the model has it, soft": ((), False),
    "as the model has it, hard": ((), True),
    "viscous": (("damping",), False),
    "viscous, tanh": (("damping", "tanh_coulomb", "tanh_velocity"), False),
    "viscous, Coulomb, soft": (("damping", "frictionloss"), False),
    "viscous, Coulomb, hard": (("damping", "frictionloss"), True),
    "viscous, Coulomb, hard, asymmetry": (("damping", "frictionloss", "asymmetry"), True),
    "viscous, Coulomb, hard, Stribeck": (("damping", "frictionloss", "stribeck", "stribeck_velocity"), True),
    "viscous, Coulomb, hard, load": (("damping", "frictionloss", "load"), True),
}
_SO101_BAR, _SECONDS_BAR, _PENDULUM_BAR = 0.0130, 600.0, 0.6


def run() -> list[Row]:
    """Import, fit, score, write the result file; nothing without the recordings."""
    arm, pendulum = recording("so101_sage"), recording("dfki_double_pendulum_A0")
    if arm is None or pendulum is None:
        return []
    with TemporaryDirectory() as name:
        folder = Path(name)
        result = {
            "schema": "trueup.real_robots/1",
            "so101": _default(arm, "so101", folder),
            "double_pendulum": _default(pendulum, "double_pendulum", folder),
            "friction": _friction_models(folder / "so101", "so101"),
        }
        hashes = {robot: Dataset(folder / robot).hash for robot in ("so101", "double_pendulum")}
    result["provenance"] = provenance(config={"threads": JOBS, "data": hashes}, seed=0)
    make_folder(RESULT.parent)
    write_json(RESULT, result)
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    so101, double = result["so101"]["runs"], result["double_pendulum"]["runs"]
    share = double[FITTED]["test"]["value"] / double[STOCK]["test"]["value"]
    return [
        at_most("SO-101, test: position RMSE", so101[FITTED]["test"]["value"], _SO101_BAR, "rad"),
        shown("SO-101, test: stock", so101[STOCK]["test"]["value"], "rad"),
        at_most("SO-101: the whole command", result["so101"]["seconds"], _SECONDS_BAR, "s"),
        at_most("double pendulum, test: fitted / stock", share, _PENDULUM_BAR, "x"),
        shown("double pendulum: the whole command", result["double_pendulum"]["seconds"], "s"),
    ]


def _default(logs: Path, robot: str, folder: Path) -> dict[str, Any]:
    """What `trueup identify` finds without any configuration."""
    trueup.import_logs(logs, folder / robot)
    began = time.perf_counter()
    found = trueup.fit(
        Dataset(folder / robot),
        trueup.load_robot(robot),
        folder / f"{robot}_fit",
        jobs=JOBS,
        on_progress=lambda model, state: _say(f"{robot}, {model}: {state.rms:.4g} after {state.evaluations}"),
    )
    seconds = time.perf_counter() - began
    return {
        "seconds": round(seconds, 1),
        "status": found.fit.status,
        "statements": list(found.fit.statements),
        "counts": {word: sum(item.identified == word for item in found.fit.free) for word in ("yes", "weakly", "no")},
        "models": [_row(row) for row in found.fit.models],
        "runs": {label: _errors(found, label) for label in (STOCK, FITTED)},
        "episodes": {
            name: {
                "split": found.measurement.gap.splits[name],
                **{
                    label: dict(found.measurement.gap.episodes[label][name]["position"]["rmse"])
                    for label in (STOCK, FITTED)
                },
            }
            for name in found.measurement.gap.episodes[STOCK]
        },
    }


def _errors(found: Identified, label: str) -> dict[str, Any]:
    def one(metrics: Metrics) -> dict[str, Any]:
        return metrics["position"]["rmse"].to_json()

    return {split: one(metrics) for split, metrics in found.measurement.gap.runs[label].items() if split in SPLITS}


def _friction_models(data: Path, name: str) -> list[dict[str, Any]]:
    """Each friction model on the same drive, fitted on train, scored on all splits."""
    robot = trueup.load_robot(name)
    dataset = Dataset(data)
    path = find_model(robot, folder=dataset.info.model_path(dataset.path))
    logs = motions_of(dataset, robot).by_split
    rows = []
    for label, (extra, hard) in _FRICTION.items():
        config = IdentifyConfig(fit={**_DRIVE, **dict.fromkeys(extra, "all")}, models={})
        search = ModelSearch(
            Nominal(robot, path, hard_friction=hard),
            logs,
            config,
            jobs=JOBS,
            seed=0,
            checkpoints=None,
            on_progress=None,
        )
        best, _ = search.climb()
        row = _row(replace(search.scored_row(best, chosen=False), name=label))
        rows.append(row)
        errors = ", ".join(f"{split} {row['splits'][split]['value']:.5f}" for split in SPLITS)
        _say(f"{name}, friction {label}: {errors} rad, {row['seconds']:.0f} s")
    return rows


def _row(row: ModelRow) -> dict[str, Any]:
    splits = {split: estimate.to_json() for split, estimate in row.splits.items()}
    return {**asdict(replace(row, splits={})), "splits": splits}


def _say(text: str) -> None:
    print(text, flush=True)
