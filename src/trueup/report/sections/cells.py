"""Table cells that sections share."""

from __future__ import annotations

import math

from trueup.core.analysis import Lag
from trueup.core.results import Estimate
from trueup.report.chooser import Cell
from trueup.report.numbers import NOTHING, fixed, in_degrees, interval, percent, quantity, significant, with_unit

_SIGNS = {"better": "▼ ", "worse": "▲ ", "undecided": "≈ "}


def estimate_cell(estimate: Estimate | None) -> Cell:
    """A value with its interval below and degrees beside it."""
    if estimate is None:
        return Cell(NOTHING)
    return Cell(
        quantity(estimate.value, estimate.unit),
        note=interval(estimate),
        extra=in_degrees(estimate.value, estimate.unit),
    )


def change_cell(estimate: Estimate | None, first: Estimate | None) -> Cell:
    """An error with its interval, and its change against the first one; without degrees, whose place that takes."""
    cell = estimate_cell(estimate)
    if estimate is None or first is None or not (math.isfinite(estimate.value) and first.value > 0):
        return Cell(cell.text, note=cell.note)
    return Cell(cell.text, note=cell.note, extra=percent(estimate.value / first.value - 1.0))


def difference_cell(estimate: Estimate) -> Cell:
    """A signed difference with its interval."""
    text = with_unit(significant(estimate.value, sign=True), estimate.unit)
    return Cell(text, note=interval(estimate, sign=True))


def percent_cell(ratio: float) -> Cell:
    """A signed percentage."""
    return Cell(percent(ratio))


def verdict_cell(verdict: str) -> Cell:
    """The word with a sign."""
    return Cell(_SIGNS.get(verdict, "") + verdict, tone=verdict)


def lag_cell(lag: Lag | None) -> Cell:
    """A delay in milliseconds with its interval."""
    if lag is None or not math.isfinite(lag.value_s):
        return Cell(NOTHING)
    ends = [fixed(1e3 * end, 1) for end in (lag.low_s, lag.high_s) if end is not None]
    return Cell(f"{fixed(1e3 * lag.value_s, 1)}\N{NO-BREAK SPACE}ms", note=" to ".join(ends) if len(ends) == 2 else "")


def seconds_cell(seconds: float) -> Cell:
    """A duration in the unit that suits it."""
    if seconds < 120:
        return Cell(f"{significant(seconds, 2)}\N{NO-BREAK SPACE}s")
    return Cell(f"{fixed(seconds / 60, 1)}\N{NO-BREAK SPACE}min")
