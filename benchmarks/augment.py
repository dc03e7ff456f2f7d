"""Learned corrections on the papers' data set and on a real arm: all methods, tests, units and simulators.

Trains what is missing under runs/augment (`benchmarks.augment_models`; an hour and a half on two cores), evaluates, and
writes `benchmarks/results/augment.json`, from which docs/learned-corrections.md is made.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.augment_models import (
    AMOUNTS,
    ARM_MODELS,
    FOLDER,
    GOOD,
    JOBS,
    MODELS,
    OTHER_UNITS,
    ROUGH,
    data_of,
    so101,
    train_all,
)
from benchmarks.pages.augment_bars import ARM, LINES, OTHER_UNIT, TORQUE
from benchmarks.table import Row, at_least, at_most, rounded, shown
from trueup.core.atomic import make_folder, write_text
from trueup.core.augment_result import AugmentResult
from trueup.core.model_card import ModelCard
from trueup.core.provenance import provenance
from trueup.core.results import Ladder
from trueup.dataset import Dataset
from trueup.stages import FITTED, evaluate

RESULT = Path(__file__).parent / "results" / "augment.json"
SIGNALS = ("position", "velocity", "torque")
METHODS = (
    *("realeasy", "realeasy-rt", "paper", "paper-rt", "gru", "mlp", "linear", "transformer"),
    *("moving-average", "moving-average-rt"),
)
REALEASY = ("realeasy", "realeasy-rt", "panda-realeasy-rt")


def run() -> list[Row]:
    """Train, evaluate, write the result file."""
    train_all()
    known = data_of(1)
    lab = _evaluated(known, METHODS, "lab", GOOD)
    rough = _evaluated(known, ("rough", "rough-rt"), "rough", ROUGH)
    amounts = [f"amount-{count}-{target}" for count in (*AMOUNTS, 1376) for target in ("residual", "plain")]
    by_amount = _evaluated(known, amounts, "amounts", GOOD)
    others = {unit: _evaluated(data_of(unit, 0.1), REALEASY, f"unit{unit}", GOOD, split="all") for unit in OTHER_UNITS}
    arm = so101()
    real = None if arm is None else _evaluated(arm, tuple(ARM), "so101", FITTED)
    result = {
        "schema": "trueup.learned/1",
        "lab": _stored(lab),
        "rough": _stored(rough),
        "amounts": _stored(by_amount, promises=False),
        "others": {str(unit): _stored(item) for unit, item in others.items()},
        "so101": None if real is None else _stored(real),
        "so101_rungs": {} if real is None else _rungs(),
        "training": {name: _training(name) for name in (*MODELS, *(ARM_MODELS if arm is not None else ()))},
        "provenance": provenance(config={"jobs": JOBS}, seed=0, data_hash=known.hash),
    }
    make_folder(RESULT.parent)
    write_text(RESULT, json.dumps(result, allow_nan=False, separators=(",", ":")) + "\n")
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    lab = AugmentResult.from_json(result["lab"])
    others = {unit: AugmentResult.from_json(own) for unit, own in result["others"].items()}
    return [*_lab_rows(lab), *_other_rows(others), *_so101_rows(result["so101_rungs"])]


def _evaluated(data: Dataset, names: Sequence[str], what: str, run: str, split: str = "test") -> AugmentResult:
    out = FOLDER / "evaluated" / what
    folders = [FOLDER / "models" / name for name in names]
    return evaluate(data, folders, out, run=run, split=split, overwrite=True).result


def _stored(result: AugmentResult, *, promises: bool = True) -> Any:
    """What the page needs: no list of motions, no more digits than anyone reads."""
    models = result.models if promises else [replace(item, coverage={}, reliability={}) for item in result.models]
    return rounded(replace(result, models=tuple(models), conditions_of={}).to_json())


def _rungs() -> dict[str, Any]:
    """Rung -> position RMSE on test as identification counts it: mean over motions of the mean over joints."""
    ladder = Ladder.load(FOLDER / "evaluated" / "so101" / "ladder.json")
    return {rung.name: rung.splits["test"]["position"]["rmse"].to_json() for rung in ladder.rungs}


def _training(name: str) -> dict[str, Any]:
    card = ModelCard.load(FOLDER / "models" / name)
    made = card.provenance["training"]
    return {
        "seconds": made["seconds"],
        "epochs": len(made["history"]),
        "best_epoch": made["best_epoch"],
        "val": card.metrics["val"],
        "warmup_steps": card.warmup_steps,
        "off": [[output.signal, output.joint, output.reason] for output in card.outputs if output.gate == 0],
    }


def _factors(result: AugmentResult, model: str, condition: str, signal: str) -> dict[str, float]:
    cuts = result.model(model).cuts[condition][signal]
    return {joint: cut.factor.value for joint, cut in cuts.items() if joint in result.joints}


def _lab_rows(lab: AugmentResult) -> list[Row]:
    rows = []
    for model, bar in TORQUE.items():
        torque = _factors(lab, model, "multi-joint", "torque")
        rows.append(at_least(f"{model}: multi-joint torque MSE cut, worst joint", min(torque.values()), bar, "x"))
        lines = _factors(lab, model, "cartesian", "torque")
        rows.append(at_least(f"{model}: cartesian torque MSE cut, worst joint", min(lines.values()), LINES, "x"))
        for signal in ("position", "velocity"):
            worst = min(min(_factors(lab, model, condition, signal).values()) for condition in lab.conditions)
            rows.append(at_least(f"{model}: {signal} MSE cut, worst joint of any test", worst, 1.0, "x"))
    return rows


def _other_rows(others: Mapping[str, AugmentResult]) -> list[Row]:
    rows = []
    for unit, result in others.items():
        for model in REALEASY:
            worst = min(_factors(result, model, "", "torque").values())
            rows.append(at_least(f"unit {unit}, {model}: torque MSE cut, worst joint", worst, OTHER_UNIT, "x"))
    return rows


def _so101_rows(rungs: Mapping[str, Any]) -> list[Row]:
    """RMSE as identification counts it: mean over motions of the mean over joints of each motion's RMSE."""
    if not rungs:
        return []
    rows = [shown("SO-101: identified simulator, position RMSE", rungs["fitted"]["value"], "rad")]
    for name, bar in ARM.items():
        rows.append(at_most(f"SO-101: {name}, position RMSE", rungs[f"fitted+{name}"]["value"], bar, "rad"))
    return rows
