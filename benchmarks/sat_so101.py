"""One network for all servos of a real arm: trained on three of them, tested on two that it never saw (SAT, VI-A).

Identifies the recorded SO-101, trains what is missing under runs/sat_so101, evaluates on the test motions, and writes
`benchmarks/results/sat_so101.json`, from which a part of docs/building-blocks.md is made.

    python -m benchmarks sat_so101    # an hour on one core, most of it training
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import sat_choice
from benchmarks.augment_models import ARM_MODELS, so101
from benchmarks.sat_choice import SEEN, sat
from benchmarks.table import Row, at_most, rounded, shown
from trueup.augment import AugmentConfig
from trueup.augment.config import OptimizerConfig
from trueup.augment.networks.sat import SatConfig
from trueup.core.atomic import make_folder, write_text
from trueup.core.model_card import ModelCard
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset
from trueup.measure import paired_difference
from trueup.robots import load_robot
from trueup.stages import FITTED, augment, evaluate
from trueup.stages.correcting import in_run_names

RESULT = Path(__file__).parent / "results" / "sat_so101.json"
FOLDER = Path("runs") / "sat_so101"
UNSEEN = ("wrist_flex", "wrist_roll")
SEEDS = (0, 1, 2)
METRICS = ("mae", "rmse")
SIMULATOR, HELD = "simulator", "held"
_RESTING = 0.05  # rad/s
# Trained with every seed.
REPEATED = ("sat", "sat-sensed")
_PAIRS = (("sat-all", "realeasy-rt"), ("sat-all", "sat-whole"))
GROUPS: Mapping[str, Sequence[str]] = {
    **{joint: (joint,) for joint in (*SEEN, *UNSEEN)},
    "seen": SEEN,
    "unseen": UNSEEN,
    "all": (*SEEN, *UNSEEN),
}


def sensed(joints: Sequence[str]) -> AugmentConfig:
    """The same beside a robot: it also reads what the encoder said one sample before (SAT, V)."""
    config = sat(joints)
    return replace(
        config,
        network=SatConfig(hidden=(16,), heads=2, history=32, feedback="zero", dropout=0.0),
        data=replace(config.data, reads=("velocity",), measured=("position",)),
        optimizer=OptimizerConfig(rate=3e-3, weight_decay=1e-2),
        epochs=5,
    )


# All correct the position that the identified simulator says. An epoch of whole arms has a tenth of the batches.
MODELS: Mapping[str, AugmentConfig] = {
    "sat": sat(SEEN),
    "sat-sensed": sensed(SEEN),
    "realeasy-rt": ARM_MODELS["so101-rt"].config,
    "realeasy": ARM_MODELS["so101-precise"].config,
    "sat-whole": replace(sat(modular=False), epochs=10),
    "sat-all": sat(),
}


def run() -> list[Row]:
    """Identify, train, evaluate, write the result file; nothing without the recordings."""
    arm = so101()
    if arm is None:
        return []
    for seed in SEEDS:
        for name in MODELS:
            if seed in seeds_of(name):
                train(arm, name, seed)
    chosen = sat_choice.rows(arm, FOLDER / "choice.json")
    return score(arm, chosen)


def score(arm: Dataset, chosen: Mapping[str, Any]) -> list[Row]:
    """Look at the test motions with what is trained, and write the result file."""
    made = [(name, seed) for name in MODELS for seed in seeds_of(name)]
    evaluated = evaluate(arm, [folder_of(*item) for item in made], FOLDER / "evaluated", run=FITTED, overwrite=True)
    motions = sorted(arm.select(split="test"))
    errors = {SIMULATOR: _as_means([_errors(arm, motions, FITTED)]), HELD: _as_means([_held(arm, motions)])}
    for name in MODELS:
        errors[name] = _as_means([_errors(arm, motions, label_of(name, seed)) for seed in seeds_of(name)])
    result = {
        "schema": "trueup.sat_so101/1",
        "motions": motions,
        "seen": list(SEEN),
        "unseen": list(UNSEEN),
        "errors": errors,
        "differences": {
            f"{name} - {base}": _differences(errors[name], errors[base], name, base)
            for name, base in [*((name, SIMULATOR) for name in (HELD, *MODELS)), ("sat-sensed", HELD), *_PAIRS]
        },
        "rungs": {rung.name: rung.splits["test"]["position"]["rmse"].to_json() for rung in evaluated.ladder.rungs},
        "left": _left_by_simulator(arm, motions),
        "training": {name: [_training(name, seed) for seed in seeds_of(name)] for name in MODELS},
        "choice": chosen,
        "provenance": provenance(
            config={"models": {name: config.to_json() for name, config in MODELS.items()}},
            seed=SEEDS[0],
            data_hash=arm.hash,
        ),
    }
    make_folder(RESULT.parent)
    write_text(RESULT, json.dumps(rounded(result), allow_nan=False, separators=(",", ":")) + "\n")
    return rows(result)


def seeds_of(name: str) -> Sequence[int]:
    """Of the trainings of a model; what the claim is about is trained more than once."""
    return SEEDS if name in REPEATED else SEEDS[:1]


def folder_of(name: str, seed: int) -> Path:
    """Where a model is kept."""
    return FOLDER / "models" / _called(name, seed)


def label_of(name: str, seed: int) -> str:
    """The run that it makes."""
    return f"{FITTED}+{_called(name, seed)}"


def _called(name: str, seed: int) -> str:
    return name if seed == SEEDS[0] else f"{name}.{seed}"


def train(arm: Dataset, name: str, seed: int) -> Path:
    """Train a model, or find it trained; returns its folder."""
    folder = folder_of(name, seed)
    augment(
        [arm],
        folder,
        run=FITTED,
        config=MODELS[name],
        robot=load_robot("so101"),
        name=_called(name, seed),
        seed=seed,
        jobs=1,
        resume=True,
    )
    return folder


# Of one run: metric -> joint -> one error per motion [rad].
Errors = dict[str, dict[str, list[float]]]


def _errors(arm: Dataset, motions: Sequence[str], label: str) -> Errors:
    return _errors_of((run.joints, apart) for run, apart in _apart(arm, motions, label))


def _errors_of(found: Iterable[tuple[Sequence[str], np.ndarray]]) -> Errors:
    errors: Errors = {metric: {joint: [] for joint in (*SEEN, *UNSEEN)} for metric in METRICS}
    for joints, apart in found:
        for joint in (*SEEN, *UNSEEN):
            own = apart[:, joints.index(joint)]
            errors["mae"][joint].append(float(np.abs(own).mean()))
            errors["rmse"][joint].append(float(np.sqrt((own**2).mean())))
    return errors


def _as_means(trainings: Sequence[Errors]) -> dict[str, Any]:
    """Metric -> joints together -> one list per training."""
    return {
        metric: {
            key: [np.mean([errors[metric][joint] for joint in joints], axis=0).tolist() for errors in trainings]
            for key, joints in GROUPS.items()
        }
        for metric in METRICS
    }


def _apart(arm: Dataset, motions: Sequence[str], label: str = FITTED) -> Iterator[tuple[TimeSeries, np.ndarray]]:
    """The simulated motions, and how far the measured position is from them, (T, J) [rad]."""
    info = arm.run_info(FITTED)
    for name in motions:
        episode = in_run_names(arm.episode(name, runs=[label]), info)
        run, truth = episode.run(label), episode.measured.select(list(episode.run(label).joints))
        measured = np.stack([np.interp(run.time_s, truth.time_s, own) for own in truth["position"].T], axis=1)
        yield run, measured - run["position"]


def _left_by_simulator(arm: Dataset, motions: Sequence[str]) -> dict[str, dict[str, float]]:
    """Joint -> what share of the squared error is there at rest, and goes with one offset or one delay per motion."""
    found = {}
    for joint in (*SEEN, *UNSEEN):
        total = rest = offset = delay = 0.0
        for run, apart in _apart(arm, motions):
            at = run.joints.index(joint)
            error, speed = apart[:, at], run["velocity"][:, at]
            total += float((error**2).sum())
            rest += float((error[np.abs(speed) < _RESTING] ** 2).sum())
            offset += float(len(error) * error.mean() ** 2)
            delay += float((error @ speed) ** 2 / max(float(speed @ speed), 1e-12))
        found[joint] = {"rest": rest / total, "offset": offset / total, "delay": delay / total}
    return found


def _held(arm: Dataset, motions: Sequence[str]) -> Errors:
    """What needs no network: the simulator and the error that the encoder has shown one sample before."""
    return _errors_of(
        (run.joints, np.diff(apart, axis=0, prepend=np.zeros_like(apart[:1]))) for run, apart in _apart(arm, motions)
    )


def _differences(own: Mapping[str, Any], base: Mapping[str, Any], run: str, baseline: str) -> dict[str, Any]:
    """Metric -> joints -> paired difference over whole motions, of the means over trainings."""
    return {
        metric: {
            key: paired_difference(
                np.mean(own[metric][key], axis=0),
                np.mean(base[metric][key], axis=0),
                run=run,
                baseline=baseline,
                split="test",
                signal="position",
                metric=metric,
                unit="rad",
            ).to_json()
            for key in GROUPS
        }
        for metric in METRICS
    }


def _training(name: str, seed: int) -> dict[str, Any]:
    card = ModelCard.load(folder_of(name, seed))
    made = card.provenance["training"]
    return {
        "seconds": round(made["seconds"], 1),
        "best_epoch": made["best_epoch"],
        "off": [[output.signal, output.joint, output.reason] for output in card.outputs if output.gate == 0],
    }


def rows(result: Mapping[str, Any]) -> list[Row]:
    found = result["differences"]
    high = found[f"sat-sensed - {SIMULATOR}"]["mae"]["unseen"]["difference"]["high"]
    rows = [at_most("wrist, never seen: SAT with sensors - simulator, MAE, upper end", 1e3 * high, 0.0, "mrad")]
    for name in MODELS:
        for key in ("unseen", "all"):
            mean = 1e3 * found[f"{name} - {SIMULATOR}"]["mae"][key]["difference"]["value"]
            rows.append(shown(f"{name} - simulator, MAE, {key}", mean, "mrad"))
    return rows
