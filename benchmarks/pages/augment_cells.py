"""Cells of the tables in docs/learned-corrections.md: numbers short enough for seven joints in a row."""

from __future__ import annotations

import math
from collections.abc import Iterable

from trueup.core.augment_result import Cut
from trueup.core.results import Estimate
from trueup.report.numbers import NOTHING, significant

MARKS = {"better": "", "undecided": " ~", "worse": " **worse**"}


def short(value: float) -> str:
    """Two significant digits, all digits before the point."""
    return f"{value:.0f}" if abs(value) >= 9.95 else significant(value, 2)


def factor(estimate: Estimate, verdict: str = "better") -> str:
    """`36 [26, 49]`, with a mark where nothing is sure or it got worse."""
    if not math.isfinite(estimate.value):
        return NOTHING
    return f"{short(estimate.value)}{_ends(estimate)}{MARKS[verdict]}"


def _ends(estimate: Estimate) -> str:
    if estimate.low is None:
        return ""
    return f" [{short(estimate.low)}, {NOTHING if estimate.high is None else short(estimate.high)}]"


def less(item: Cut) -> str:
    """The same in percent of the simulator's error: `53 [48, 57]`."""
    ends = [_percent(end) for end in (item.factor.low, item.factor.high) if end is not None]
    between = f" [{', '.join(ends)}]" if len(ends) == 2 else ""
    return f"{_percent(item.factor.value)}{between}{MARKS[item.verdict]}"


def _percent(times: float) -> str:
    return f"{100 * (1 - 1 / times):.0f}" if math.isfinite(times) and times > 0 else NOTHING


def span(values: Iterable[float], places: int = 2) -> str:
    """`0.88 to 0.95`; one number where they are the same."""
    ends = sorted(values)
    texts = list(dict.fromkeys(f"{end:.{places}f}" for end in (ends[0], ends[-1])))
    return " to ".join(texts)


def milli(value: float) -> str:
    """In thousandths: mrad, mrad/s."""
    return significant(1e3 * value, 3) if 1e3 * value < 100 else f"{1e3 * value:.0f}"


def listed(words: Iterable[str]) -> str:
    """`a, b and c`."""
    *rest, last = words
    return f"{', '.join(rest)} and {last}" if rest else last
