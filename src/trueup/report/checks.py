"""What has the right keys and the wrong values is refused here, before it fails in the middle of a page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from trueup.core.attribution import Attribution
from trueup.core.augment_result import ANY_CONDITION, AugmentResult
from trueup.core.engines import EngineComparison
from trueup.core.fit_result import FitResult, FittedParameter
from trueup.core.results import Estimate, GapResult, Ladder, Metrics
from trueup.errors import DataError

# run, episode, signal, metric, joint
EPISODE_LEVELS = 5


def check_gap(gap: GapResult, path: Path) -> None:
    """Values of gap.json.

    Raises:
        DataError: one is of another kind than it should be, or there are no runs.
    """
    if not gap.runs or not any(gap.runs[label] for label in gap.runs):
        raise DataError(f"{path} holds no runs")
    for splits in gap.runs.values():
        for metrics in splits.values():
            _check_estimates(metrics, path)
    for values in gap.groups.values():
        for runs in values.values():
            for metrics in runs.values():
                _check_estimates(metrics, path)
    for item in gap.paired:
        check_estimate(item.difference, path)
        check_types(path, *((name, str) for name in (item.run, item.baseline, item.split, item.signal, item.metric)))
        if item.verdict not in ("better", "worse", "undecided"):
            raise DataError(f"{path} holds a broken paired difference", got=item)
    check_types(path, *((name, str) for name in (*gap.joints, *gap.scored_joints)))
    check_types(path, (gap.settings, Mapping), (gap.provenance, Mapping), (gap.splits, Mapping))
    check_types(path, *((split, str) for split in gap.splits.values()))
    check_types(path, *((value, float | int) for value in _leaves(gap.episodes, EPISODE_LEVELS, path)))


def check_ladder(ladder: Ladder, path: Path) -> None:
    """Values of ladder.json.

    Raises:
        DataError: one is of another kind than it should be.
    """
    for rung in ladder.rungs:
        check_types(path, (rung.name, str), (rung.seconds, int | float))
        for metrics in rung.splits.values():
            _check_estimates(metrics, path)


def check_fit(fit: FitResult, path: Path) -> None:
    """Values of fit.json.

    Raises:
        DataError: one is of another kind than it should be, or a parameter occurs twice.
    """
    check_types(path, (fit.data, Mapping), (fit.solver, Mapping), (fit.provenance, Mapping))
    check_types(path, *((text, str) for text in fit.statements))
    for item in fit.parameters:
        _check_parameter(item, path)
    names = [item.name for item in fit.parameters]
    if len(set(names)) < len(names):
        raise DataError(f"{path}: a parameter occurs twice", got=names)
    for direction in fit.directions:
        check_types(path, (direction.gain, int | float), (direction.weights, Mapping))
    _check_shares(path, *_leaves(fit.correlation, 2, path))
    _check_shares(path, *(weight for direction in fit.directions for weight in direction.weights.values()))
    for left in fit.whiteness.values():
        check_types(path, (left.rms, int | float), (left.correlation_s, int | float))
        check_types(path, (left.white, bool), (left.sentence, str))
    for row in fit.models:
        check_types(path, (row.name, str), (row.parameters, int), (row.seconds, int | float), (row.chosen, bool))
        check_types(path, *((name, str) for name in row.quantities))
        check_types(path, *((value, int | float) for value in _leaves(row.per_joint, 2, path)))
    estimates = [item for splits in fit.errors.values() for item in splits.values()]
    for estimate in (*estimates, *(item for row in fit.models for item in row.splits.values())):
        check_estimate(estimate, path)


def check_attribution(attribution: Attribution, path: Path) -> None:
    """Values of explain.json.

    Raises:
        DataError: one is of another kind than it should be.
    """
    for step in attribution.steps:
        check_estimate(step.total, path)


def check_engines(engines: EngineComparison, path: Path) -> None:
    """Values of engines.json.

    Raises:
        DataError: one is of another kind than it should be.
    """
    for signals in engines.trends.values():
        for joints in (joints for metrics in signals.values() for joints in metrics.values()):
            for item in joints.values():
                check_estimate(item.slope, path)
                if item.verdict not in ("grows", "falls", "undecided"):
                    raise DataError(f"{path} holds a broken trend", got=repr(item.verdict))
    check_types(path, (engines.provenance, Mapping))
    if engines.plane is not None:
        check_types(path, *((name, str) for name in engines.plane.joints))


def check_augment(augment: AugmentResult, gap: GapResult, path: Path) -> None:
    """Whether augment.json belongs to the measurement beside it, and has a table for each of its groups.

    Raises:
        DataError: it does not, or has not.
    """
    missing = {augment.run, *(model.run for model in augment.models)} - gap.runs.keys()
    if missing:
        raise DataError(f"{path} is about runs that were not measured", got=sorted(missing), available=gap.runs)
    tables = [augment.simulated, *(model.cuts for model in augment.models)]
    if any(table.keys() != augment.motions.keys() for table in tables) or ANY_CONDITION not in augment.motions:
        raise DataError(f"{path} is broken: tables and groups of motions differ", expected=list(augment.motions))


def check_estimate(estimate: Estimate, path: Path) -> None:
    """Unit and ends of a number.

    Raises:
        DataError: one is of another kind than it should be.
    """
    number = int | float | None
    check_types(path, (estimate.unit, str), (estimate.low, number), (estimate.high, number))


def check_types(path: Path, *pairs: tuple[object, Any]) -> None:
    """Each value is of the kind beside it.

    Raises:
        DataError: one is not.
    """
    for value, kind in pairs:
        if not isinstance(value, kind):
            raise DataError(f"{path} is broken", got=repr(value), expected=getattr(kind, "__name__", kind))


def _check_parameter(item: FittedParameter, path: Path) -> None:
    check_types(path, *((text, str) for text in (item.name, item.unit, item.sentence, item.cause, item.transform)))
    ends = list(item.interval)
    said = [] if item.nominal is None else [item.nominal]
    numbers = [item.value, *said, item.start, item.low, item.high, *ends]
    check_types(path, *((number, int | float) for number in numbers), (item.prior_share, int | float | None))
    check_types(path, (item.frozen, bool))
    if len(ends) != 2 or not all(math.isfinite(number) for number in numbers):
        raise DataError(f"{path}: the numbers of {item.name} are broken", got=numbers)
    if item.identified not in ("yes", "weakly", "no") or item.at_bound not in ("", "low", "high"):
        raise DataError(f"{path}: {item.name} is broken", got=f"{item.identified!r}, {item.at_bound!r}")


def _check_shares(path: Path, *values: object) -> None:
    """Correlations, and parts of a vector of length 1."""
    for value in values:
        if not isinstance(value, int | float) or not abs(value) <= 1.0 + 1e-6:
            raise DataError(f"{path} is broken", got=repr(value), expected="a number from -1 to 1")


def _check_estimates(metrics: Metrics, path: Path) -> None:
    for results in metrics.values():
        for result in results.values():
            check_types(path, (result.episodes, int))
            for estimate in (result.total, *result.per_joint.values()):
                check_estimate(estimate, path)


def _leaves(tree: Any, depth: int, path: Path) -> Iterator[object]:
    """The values of mappings that are nested `depth` levels deep."""
    if depth == 0:
        yield tree
        return
    check_types(path, (tree, Mapping))
    for value in tree.values():
        yield from _leaves(value, depth - 1, path)
