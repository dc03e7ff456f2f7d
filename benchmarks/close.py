"""`trueup close` on the real SO-101, and `trueup demo`, with their defaults: how near they come, and what they take.

Half an hour. Each is a process of its own, as a user starts it. Writes `benchmarks/results/close.json`, from which the
section of docs/close.md is made.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.recordings import recording
from benchmarks.table import Row, at_most, rounded, shown
from trueup.core.atomic import make_folder, write_json
from trueup.core.close_result import CloseResult
from trueup.core.fit_result import FitResult
from trueup.core.provenance import provenance
from trueup.core.results import Ladder, Rung
from trueup.dataset import Dataset
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "close.json"
SPLITS = ("train", "val", "test")
# With 3 the command says of its result that a part of it is missing or of no use; the result is there all the same.
_ENDS = (0, 3)
_ERROR_BAR_RAD, _CLOSE_BAR_S, _DEMO_BAR_S = 0.0105, 1200.0, 360.0


def run() -> list[Row]:
    """Close, demonstrate, keep the result; nothing without the recording."""
    logs = recording("so101_sage")
    if logs is None:
        return []
    load = list(os.getloadavg())
    with TemporaryDirectory() as name:
        folder = Path(name)
        result = {
            "schema": "trueup.close_benchmark/1",
            "so101": measured(folder / "so101", "close", str(logs), "--robot", "so101"),
            "demo": measured(folder / "demo", "demo", "--full"),
        }
        hashes = {robot: Dataset(folder / robot / "dataset").hash for robot in ("so101", "demo")}
    machine = {"name": machine_name(), "load_before": load}
    result["provenance"] = provenance(config={"machine": machine, "data": hashes}, seed=0)
    make_folder(RESULT.parent)
    write_json(RESULT, rounded(result))
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    so101, demo = result["so101"], result["demo"]
    best = chosen(so101)
    return [
        at_most(
            f"SO-101, test: position RMSE of {best['name']}", best["errors"]["test"]["value"], _ERROR_BAR_RAD, "rad"
        ),
        *(
            shown(f"SO-101, test: {rung['name']}", rung["errors"]["test"]["value"], "rad")
            for rung in so101["ladder"]
            if rung is not best
        ),
        at_most("SO-101: the whole command", so101["seconds"], _CLOSE_BAR_S, "s"),
        *(shown(f"SO-101: {step['name']}", step["seconds"], "s") for step in so101["steps"]),
        at_most("demo: the whole command", demo["seconds"], _DEMO_BAR_S, "s"),
    ]


def chosen(call: Mapping[str, Any]) -> Mapping[str, Any]:
    """The rung that is the best on val."""
    found: Mapping[str, Any] = next(rung for rung in call["ladder"] if rung["chosen"])
    return found


def measured(out: Path, *command: str) -> dict[str, Any]:
    """What a command leaves in a folder, and how long it took.

    Raises:
        RuntimeError: it left nothing.
    """
    began = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "trueup.cli.main", *command, "--out", str(out)], check=False)
    seconds = time.perf_counter() - began
    if done.returncode not in _ENDS:
        raise RuntimeError(f"trueup {' '.join(command)} ended with {done.returncode}")
    return {"seconds": seconds, "code": done.returncode, **left_in(out)}


def left_in(out: Path) -> dict[str, Any]:
    """Ladder, steps and status of the fit, of a folder of results."""
    close = CloseResult.load(out / "close.json")
    fit = out / "fit.json"
    return {
        "budget_s": close.budget_s,
        "ladder": [_rung(rung) for rung in Ladder.load(out / "ladder.json").rungs],
        "steps": [
            {"name": step.name, "status": step.status, "seconds": step.seconds, "what": step.what}
            for step in close.steps
        ],
        "measuring_s": close.measuring_s,
        "fit": FitResult.load(fit).status if fit.is_file() else None,
    }


def _rung(rung: Rung) -> dict[str, Any]:
    errors = {split: rung.splits[split]["position"]["rmse"] for split in SPLITS if split in rung.splits}
    return {
        "name": rung.name,
        "seconds": rung.seconds,
        "chosen": rung.chosen,
        "errors": {split: item.total.to_json() for split, item in errors.items()},
    }
