"""One network for all servos: trained on a KickBot held at its pelvis, tested on robots that it never saw (SAT, VI).

Records virtual hardware, trains what is missing under runs/sat (an hour and a half on two cores), evaluates on
animations, and writes `benchmarks/results/sat.json`, from which a part of docs/building-blocks.md is made.

    python -m benchmarks sat
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from benchmarks.pages.sat import BARS, UNSEEN
from benchmarks.sat_models import ABOUT, ANIMATIONS, LAB, MODELS, RUN, TESTS, TRAIN_MOTIONS, data_of, folder_of, train
from benchmarks.table import Row, at_least, rounded, shown
from trueup.augment.trained import Trained
from trueup.core.atomic import make_folder, write_json
from trueup.core.model_card import ModelCard
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset
from trueup.measure import ccc, paired_difference, ratio_interval

RESULT = Path(__file__).parent / "results" / "sat.json"
SIMULATOR, CURRENT, WHOLE, SAT = "simulator", "sat-current", "whole", "sat"
UNITS = {"position": "deg", "velocity": "rad/s", "current": "A"}
CURRENT_BAR = 0.75
# Of the attention's profile (Fig. 11).
PROFILED = ("sat", "attention", "attention-dense")

# Signal -> metric -> one value per motion.
Errors = dict[str, dict[str, list[float]]]


def run() -> list[Row]:
    """Record, train, evaluate, write the result file."""
    for name in MODELS:
        train(name)
    errors = {test: errors_of(data_of(test), {name: folder_of(name) for name in MODELS}) for test in TESTS}
    result = {
        "schema": "trueup.sat/1",
        "lab": LAB,
        "train_motions": TRAIN_MOTIONS,
        "about": dict(ABOUT),
        "errors": errors,
        "cuts": {
            test: {name: cuts_of(own[SIMULATOR], own[name]) for name in own if name != SIMULATOR}
            for test, own in errors.items()
        },
        "modular": {test: _pair(own[SAT], own[WHOLE]) for test, own in errors.items() if WHOLE in own},
        "attention": {name: _profile(name) for name in PROFILED},
        "training": {name: _training(name) for name in MODELS},
        "provenance": provenance(
            config={"models": {name: config.to_json() for name, config in MODELS.items()}},
            seed=0,
            data_hash=data_of("train").hash,
        ),
    }
    make_folder(RESULT.parent)
    write_json(RESULT, rounded(result))
    return rows(result)


def errors_of(data: Dataset, models: Mapping[str, Path]) -> dict[str, Errors]:
    """Model -> errors of each motion, the simulator's first; a network of a whole robot serves no other joints."""
    found: dict[str, Errors] = {SIMULATOR: {}}
    trained = {name: Trained.load(folder) for name, folder in models.items()}
    for episode in data.episodes(runs=[RUN]):
        simulated = episode.run(RUN)
        _count(found[SIMULATOR], episode.measured, simulated, tuple(UNITS))
        for name, model in trained.items():
            if not model.card.modular and set(model.card.joints) != set(simulated.joints):
                continue  # a network of the whole robot has no other
            corrected = {output.signal for output in model.card.outputs}
            of = tuple(signal for signal in UNITS if signal in corrected)
            _count(found.setdefault(name, {}), episode.measured, model.predict(episode, RUN), of)
    return found


def _count(into: Errors, measured: TimeSeries, said: TimeSeries, signals: Sequence[str]) -> None:
    """Mean and largest error and CCC of a motion, means over joints (SAT, VI-A)."""
    for signal in signals:
        error, truth, own = apart(measured, said, signal)
        scale = np.degrees(1.0) if UNITS[signal] == "deg" else 1.0
        values = {
            "mae": float(scale * np.abs(error).mean()),
            "max": float(scale * np.abs(error).max(axis=0).mean()),
            # Of a joint that rests there is no trend to follow.
            "ccc": float(np.nanmean(np.where(np.ptp(truth, axis=0) > 0, ccc(truth, own), np.nan))),
        }
        for metric, value in values.items():
            into.setdefault(signal, {}).setdefault(metric, []).append(value)


def apart(
    measured: TimeSeries, said: TimeSeries, signal: str
) -> tuple[Float64[np.ndarray, "T J"], Float64[np.ndarray, "T J"], Float64[np.ndarray, "T J"]]:
    """Measured minus said, and both, at the stamps of what is said that the measurement covers."""
    truth = measured.select(list(said.joints))
    inside = (said.time_s >= truth.time_s[0]) & (said.time_s <= truth.time_s[-1])
    time_s = said.time_s[inside]
    there = np.stack([np.interp(time_s, truth.time_s, own) for own in truth[signal].T], axis=1)
    own = np.asarray(said[signal][inside], np.float64)
    return there - own, there, own


def cuts_of(base: Errors, own: Errors) -> dict[str, Any]:
    """Signal -> metric -> share of the simulator's error that is gone, with its paired interval."""
    found: dict[str, Any] = {}
    for signal, metric in itertools.product(own, ("mae", "max")):
        value, low, high = (float(end[0]) for end in ratio_interval(*_columns(own, base, signal, metric)))
        found.setdefault(signal, {})[metric] = {"value": 1 - value, "low": 1 - high, "high": 1 - low}
    return found


def _columns(own: Errors, base: Errors, signal: str, metric: str) -> tuple[np.ndarray, np.ndarray]:
    one, other = (by_animation(errors[signal][metric])[:, None] for errors in (own, base))
    return one, other


def by_animation(values: Sequence[float]) -> np.ndarray:
    """Means over the motions that play the same animation: faster, slower and larger ones are no draws of their own."""
    return np.array([np.mean(values[number::ANIMATIONS]) for number in range(ANIMATIONS)], np.float64)


def _pair(own: Errors, base: Errors) -> dict[str, Any]:
    """The modular network against that of the whole robot, animation by animation."""
    return {
        metric: paired_difference(
            by_animation(own["position"][metric]),
            by_animation(base["position"][metric]),
            run=SAT,
            baseline=WHOLE,
            split="test",
            signal="position",
            metric=metric,
            unit="deg",
        ).to_json()
        for metric in ("mae", "max")
    }


def _profile(name: str) -> list[float]:
    """Mean share of attention on each past sample, the present one first (Fig. 11)."""
    from trueup.augment import Augmentation
    from trueup.augment.attention import attention_profile

    found = attention_profile(Augmentation.load(folder_of(name)), _first(data_of("kickbot_a"), 4), RUN)
    assert found is not None
    return list(found.mean)


def _first(data: Dataset, count: int) -> Iterator[Any]:
    yield from itertools.islice(data.episodes(runs=[RUN]), count)


def _training(name: str) -> dict[str, Any]:
    card = ModelCard.load(folder_of(name))
    made = card.provenance["training"]
    return {
        "seconds": made["seconds"],
        "epochs": len(made["history"]),
        "best_epoch": made["best_epoch"],
        "motions": made["motions"],
        "off": [[output.signal, output.joint, output.reason] for output in card.outputs if output.gate == 0],
    }


def rows(result: Mapping[str, Any]) -> list[Row]:
    rows = []
    for test, metric in itertools.product(UNSEEN, BARS):
        cut = result["cuts"][test][SAT]["position"][metric]["value"]
        rows.append(at_least(f"{test}, never seen: position {metric}, SAT against simulator", cut, BARS[metric], ""))
    for test in TESTS:
        before, after = (np.mean(result["errors"][test][name]["current"]["ccc"]) for name in (SIMULATOR, CURRENT))
        rows.append(shown(f"{test}: CCC of the current, simulator", float(before), ""))
        rows.append(at_least(f"{test}: CCC of the current, SAT", float(after), CURRENT_BAR, ""))
    for test, pair in result["modular"].items():
        high = pair["mae"]["difference"]["high"]
        rows.append(shown(f"{test}: modular - whole robot, position MAE, upper end", high, "deg"))
    return rows
