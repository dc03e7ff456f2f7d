"""The papers' data set on virtual hardware: how far the twins are from the robot, and what a payload changes.

Writes `benchmarks/results/panda.json`, from which docs/panda.md is made.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.table import Row, at_least, at_most, shown
from trueup.core.atomic import make_folder, write_json
from trueup.core.provenance import provenance
from trueup.dataset import Dataset
from trueup.lab import LabSpec
from trueup.record import load_plans
from trueup.robots import load_robot
from trueup.stages import LabRig, gap, record, replay

RESULT = Path(__file__).parent / "results" / "panda.json"
JOBS = os.cpu_count() or 1
SIGNALS = ("position", "velocity", "torque")
GOOD, DART, ROUGH = "mujoco/stock", "dart/stock", "mujoco/rough"
PAYLOADS_KG = (0.0, 1.0, 2.0, 3.0)
# The twin's gains were chosen on units 1 and 2 and other motions.
UNSEEN_UNITS, UNSEEN_SEED = (5, 6), 7
_AVERAGED = 50  # samples, half a second, as in the LSTM thesis


def run() -> list[Row]:
    """Record, replay, measure, write the result file; about ten minutes."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        known = _recorded(folder / "known", 0.1, unit=1, seed=0)
        runs = {
            GOOD: _replayed(known, "panda", GOOD, "mujoco"),
            DART: _replayed(known, "panda", DART, "dart"),
            ROUGH: _replayed(known, "panda_rough", ROUGH, "mujoco"),
        }
        unseen = []
        for unit in UNSEEN_UNITS:
            data = _recorded(folder / f"unit{unit}", 0.1, unit=unit, seed=UNSEEN_SEED)
            unseen.append({"unit": unit, "groups": _replayed(data, "panda", GOOD, "mujoco")})
        loads = _recorded(folder / "loads", 0.03, unit=1, seed=0, payloads_kg=PAYLOADS_KG)
        for label, engine in ((GOOD, "mujoco"), (DART, "dart")):
            _replayed(loads, "panda", label, engine)
        measured = gap(loads, runs=[GOOD, DART])
        trends = _trends(measured)
        result = {
            "schema": "trueup.panda/1",
            "motions": {meta.condition: _count(known, meta.condition) for meta in known.metas},
            "runs": runs,
            "unseen": unseen,
            "trends": trends,
            "payload_motions": len(loads) // len(PAYLOADS_KG),
            "provenance": provenance(config={"jobs": JOBS, "data": {"known": known.hash, "loads": loads.hash}}, seed=0),
        }
    make_folder(RESULT.parent)
    write_json(RESULT, result)
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    own, other = (np.array(result["runs"][run]["multi-joint"]["torque"]["mse"]) for run in (GOOD, ROUGH))
    fresh = np.array([part["groups"]["multi-joint"]["torque"]["mse"] for part in result["unseen"]])
    slope = result["trends"][GOOD]["torque"]["rmse"]
    return [
        at_most("twin, multi-joint torque MSE, worst joint", own.max(), 40, "Nm2"),
        at_least("twin, multi-joint torque MSE, best joint", own.min(), 5, "Nm2"),
        at_most("the same on other units and motions, worst", fresh.max(), 40, "Nm2"),
        at_least("the same on other units and motions, best", fresh.min(), 5, "Nm2"),
        shown("rough twin, multi-joint torque MSE, worst joint", other.max(), "Nm2"),
        at_least("torque error per kg of payload, lower end", slope["low"], 0, "Nm/kg"),
    ]


def _recorded(out: Path, scale: float, *, unit: int, seed: int, payloads_kg: Sequence[float] = (0.0,)) -> Dataset:
    plans = replace(load_plans("paper"), seed=seed).scaled(scale)
    rig = LabRig(LabSpec(), number=unit, seed=seed)
    record(out, load_robot("panda"), rig, plans, payloads_kg=payloads_kg, jobs=JOBS)
    return Dataset(out)


def _replayed(data: Dataset, robot: str, label: str, engine: str) -> dict[str, Any]:
    """Group -> signal -> error of each joint over all samples of the group, after a replay."""
    replay(data, load_robot(robot), engine=engine, label=label, jobs=JOBS)
    squares: dict[str, dict[str, list[np.ndarray]]] = {}
    for episode in data.episodes(runs=[label]):
        simulated = episode.run(label)
        measured = episode.measured.rows(slice(len(episode.measured) - len(simulated), None))
        for signal in SIGNALS:
            error = simulated[signal] - measured[signal]
            own = squares.setdefault(episode.meta.condition, {})
            own.setdefault(signal, []).append(np.square(error).mean(axis=0))
            kernel = np.ones(_AVERAGED) / _AVERAGED
            smooth = np.stack([np.convolve(column, kernel, "valid") for column in error.T], axis=1)
            own.setdefault(f"{signal} averaged", []).append(np.square(smooth).mean(axis=0))
    return {
        group: {
            signal: {
                "mse": np.mean(signals[signal], axis=0).tolist(),
                "averaged_mse": np.mean(signals[f"{signal} averaged"], axis=0).tolist(),
            }
            for signal in SIGNALS
        }
        for group, signals in squares.items()
    }


def _trends(measured: Any) -> dict[str, Any]:
    """Run -> signal -> metric -> slope of the mean of the joints."""
    found = measured.engines.trends
    return {
        run: {
            signal: {
                metric: {**joints[""].slope.to_json(), "at_zero": joints[""].at_zero, "verdict": joints[""].verdict}
                for metric, joints in metrics.items()
            }
            for signal, metrics in signals.items()
        }
        for run, signals in found.items()
    }


def _count(data: Dataset, condition: str) -> int:
    return sum(meta.condition == condition for meta in data.metas)
