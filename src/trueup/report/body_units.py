"""Errors of bodies as people speak of them: millimeters and degrees, where files have meters and radians."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from trueup.core.augment_result import AugmentResult, Cut, JointGap, Pooled
from trueup.core.results import Estimate, GapResult, Ladder, Metrics
from trueup.core.robustness_result import Improvement, RobustnessResult

# Signal -> unit of an error -> the unit that is shown.
_SHOWN = {"body.position": {"m": "mm", "m^2": "mm^2"}, "body.rotation": {"rad": "deg", "rad^2": "deg^2"}}
_FACTORS = {"mm": 1e3, "mm^2": 1e6, "deg": 180 / math.pi, "deg^2": (180 / math.pi) ** 2}
_OF_SIGNAL = {"body.position": "mm", "body.rotation": "deg"}


def gap_for_people(gap: GapResult) -> GapResult:
    """The gap with the errors of bodies in mm and degrees."""
    return replace(
        gap,
        runs={run: {split: _metrics(item) for split, item in splits.items()} for run, splits in gap.runs.items()},
        paired=tuple(replace(pair, difference=_shown(pair.signal, pair.difference)) for pair in gap.paired),
        groups={
            name: {value: {run: _metrics(item) for run, item in runs.items()} for value, runs in values.items()}
            for name, values in gap.groups.items()
        },
        episodes={
            run: {
                motion: {signal: _scaled(signal, values) for signal, values in signals.items()}
                for motion, signals in motions.items()
            }
            for run, motions in gap.episodes.items()
        },
    )


def ladder_for_people(ladder: Ladder) -> Ladder:
    """The ladder likewise."""
    rungs = [
        replace(rung, splits={split: _metrics(metrics) for split, metrics in rung.splits.items()})
        for rung in ladder.rungs
    ]
    return replace(ladder, rungs=rungs)


def evaluation_for_people(result: AugmentResult) -> AugmentResult:
    """What corrections are worth, likewise."""

    def pooled(signal: str, item: Pooled) -> Pooled:
        return replace(item, mse=_shown(signal, item.mse), rmse=_shown(signal, item.rmse))

    def cut(signal: str, item: Cut) -> Cut:
        return replace(item, mse=_shown(signal, item.mse), rmse=_shown(signal, item.rmse))

    return replace(
        result,
        gaps=_joint_gaps(result.gaps),
        measured_gaps=_joint_gaps(result.measured_gaps),
        simulated={
            name: {signal: {own: pooled(signal, item) for own, item in items.items()} for signal, items in tree.items()}
            for name, tree in result.simulated.items()
        },
        models=tuple(
            replace(
                model,
                cuts={
                    name: {
                        signal: {own: cut(signal, item) for own, item in items.items()}
                        for signal, items in tree.items()
                    }
                    for name, tree in model.cuts.items()
                },
                gaps=_joint_gaps(model.gaps),
            )
            for model in result.models
        ),
    )


def robustness_for_people(result: RobustnessResult) -> RobustnessResult:
    """How far a correction carries, in mm for bodies; and in degrees for joints, as the paper has it."""

    def shown(item: Estimate) -> Estimate:
        return _scaled_to("deg", item) if item.unit == "rad" else _shown(result.signal, item)

    def improvement(item: Improvement) -> Improvement:
        return replace(item, simulated=shown(item.simulated), corrected=shown(item.corrected))

    rows = tuple(
        replace(row, errors={kind: improvement(item) for kind, item in row.errors.items()}) for row in result.rows
    )
    return replace(result, rows=rows)


def _joint_gaps(gaps: Mapping[str, JointGap]) -> Mapping[str, JointGap]:
    position, rotation = _OF_SIGNAL
    return {
        joint: JointGap(
            _shown(position, gap.apart),
            _shown(position, gap.apart_max),
            _shown(rotation, gap.turned),
            _shown(rotation, gap.turned_max),
        )
        for joint, gap in gaps.items()
    }


def _metrics(metrics: Metrics) -> Metrics:
    return {
        signal: {
            name: replace(
                item,
                total=_shown(signal, item.total),
                per_joint={own: _shown(signal, value) for own, value in item.per_joint.items()},
            )
            for name, item in items.items()
        }
        for signal, items in metrics.items()
    }


def _shown(signal: str, estimate: Estimate) -> Estimate:
    unit = _SHOWN.get(signal, {}).get(estimate.unit)
    return estimate if unit is None else _scaled_to(unit, estimate)


def _scaled_to(unit: str, estimate: Estimate) -> Estimate:
    factor = _FACTORS[unit]
    low, high = (None if end is None else factor * end for end in (estimate.low, estimate.high))
    return Estimate(factor * estimate.value, unit, low, high)


def _scaled(signal: str, metrics: Mapping[str, Mapping[str, float]]) -> Mapping[str, Mapping[str, float]]:
    if signal not in _OF_SIGNAL:
        return metrics
    factor = _FACTORS[_OF_SIGNAL[signal]]
    return {name: {own: factor * value for own, value in values.items()} for name, values in metrics.items()}
