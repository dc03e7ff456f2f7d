"""Which engine is nearer to the robot, payload by payload, on the same motions (GapONet, 3.3)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64

from trueup.core.engines import ANY_PAYLOAD
from trueup.core.results import GapResult, PairedDifference
from trueup.measure.columns import mean
from trueup.measure.comparison import COMMAND_RUN
from trueup.measure.uncertainty import paired_difference

NEARER_METRICS: Mapping[str, tuple[str, ...]] = {
    "position": ("rmse", "max", "smoothness"),
    "velocity": ("rmse",),
    "torque": ("rmse",),
}


def nearer_of(
    result: GapResult, payload_kg: Mapping[str, float | None], *, motions: Mapping[str, str], seed: int = 0
) -> dict[str, tuple[PairedDifference, ...]]:
    """Payload in kg as text, `""` for all motions -> engine against engine; empty with one engine.

    Runs are compared that are called alike in two engines (`mujoco/stock`, `dart/stock`), or else all of different
    engines. Repetitions of a motion count as one: their mean is drawn, not they.

    Args:
        result: with values episode by episode.
        payload_kg: episode -> payload [kg].
        motions: episode -> the motion that was executed, the same for its repetitions.
        seed: of the bootstrap.
    """
    pairs = engine_pairs([label for label in result.runs if label != COMMAND_RUN])
    loads = sorted({load for load in payload_kg.values() if load is not None})
    groups = {ANY_PAYLOAD: list(payload_kg)} if pairs else {}
    for load in loads if pairs else ():
        groups[f"{load:.12g}"] = [name for name, own in payload_kg.items() if own == load]
    found: dict[str, tuple[PairedDifference, ...]] = {}
    for payload, names in groups.items():
        items = []
        for (baseline, run), (signal, metric) in itertools.product(pairs, _metrics()):
            unit = _unit(result, run, signal, metric)
            both = [name for name in names if name in result.episodes[run] and name in result.episodes[baseline]]
            values = [_totals(result, label, both, signal, metric) for label in (run, baseline)]
            known = np.isfinite(values[0]) & np.isfinite(values[1])
            if unit is None or not known.any():
                continue
            executed = np.array([motions.get(name) or name for name in both])[known]
            _, group = np.unique(executed, return_inverse=True)
            first, second = (np.bincount(group, item[known]) / np.bincount(group) for item in values)
            items.append(
                paired_difference(
                    first,
                    second,
                    run=run,
                    baseline=baseline,
                    split="all",
                    signal=signal,
                    metric=metric,
                    unit=unit,
                    seed=seed,
                )
            )
        if items:
            found[payload] = tuple(items)
    return found


def engine_pairs(labels: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of runs of different engines: those of the same name, or all if there are none."""
    pairs = [
        (first, second)
        for first, second in itertools.combinations(labels, 2)
        if first.partition("/")[0] != second.partition("/")[0]
    ]
    alike = [(first, second) for first, second in pairs if first.partition("/")[2] == second.partition("/")[2]]
    return alike or pairs


def _metrics() -> list[tuple[str, str]]:
    return [(signal, metric) for signal, own in NEARER_METRICS.items() for metric in own]


def _unit(result: GapResult, run: str, signal: str, metric: str) -> str | None:
    found = result.runs[run].get("all", {}).get(signal, {}).get(metric)
    return None if found is None else found.total.unit


def _totals(result: GapResult, run: str, names: Sequence[str], signal: str, metric: str) -> Float64[np.ndarray, "E"]:
    """The mean over scored joints, episode by episode."""
    rows = [result.episodes[run][name].get(signal, {}).get(metric, {}) for name in names]
    table = np.array([[row.get(joint, np.nan) for row in rows] for joint in result.scored_joints], dtype=np.float64)
    return mean(table.reshape(len(result.scored_joints), len(names)))
