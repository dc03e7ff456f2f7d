"""What has the right kinds of values and makes no sense is refused here, before it fails in the middle of a page."""

from __future__ import annotations

from pathlib import Path

from trueup.core.augment_result import ANY_CONDITION, AugmentResult
from trueup.core.fit_result import FitResult
from trueup.core.results import GapResult
from trueup.core.robustness_result import ERROR_KINDS, RobustnessResult
from trueup.errors import DataError


def check_gap(gap: GapResult, path: Path) -> None:
    """Whether there is anything in gap.json.

    Raises:
        DataError: there are no runs.
    """
    if not any(gap.runs.values()):
        raise DataError(f"{path} holds no runs")


def check_fit(fit: FitResult, path: Path) -> None:
    """Names and shares of fit.json.

    Raises:
        DataError: a parameter occurs twice, or a correlation or a part of a vector of length 1 is none.
    """
    names = [item.name for item in fit.parameters]
    if len(set(names)) < len(names):
        raise DataError(f"{path}: a parameter occurs twice", got=names)
    for row in (*fit.correlation.values(), *(direction.weights for direction in fit.directions)):
        for name, value in row.items():
            if not abs(value) <= 1.0 + 1e-6:
                raise DataError(f"{path} is broken: {name}", got=value, expected="a number from -1 to 1")


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


def check_robustness(result: RobustnessResult, path: Path) -> None:
    """Whether every row of robustness.json has all errors, and there is one with the simulator as it is.

    Raises:
        DataError: it has not, or there is none.
    """
    if not result.datasets:
        raise DataError(f"{path} has no row with the simulator as it is")
    for row in result.rows:
        if row.errors.keys() != ERROR_KINDS.keys():
            raise DataError(f"{path} is broken: errors on {row.dataset}", got=list(row.errors), expected=ERROR_KINDS)
