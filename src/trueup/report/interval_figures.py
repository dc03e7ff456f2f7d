"""Intervals of fitted parameters against the model as it came: one small figure per quantity; see `figures`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from trueup.core.fit_result import FittedParameter
from trueup.core.parameters import split_name
from trueup.report.chooser import Figure
from trueup.report.figures import reference_line, rounded
from trueup.report.fit_words import KINDS, is_factor, kind_of, nominal_words, shown_value
from trueup.report.labels import plot_text
from trueup.report.numbers import pretty_unit, significant, with_unit
from trueup.report.palette import KIND_STYLES, Style

# Intervals that reach farther than this factor are cut: the data say nothing there anyway.
_FARTHEST = 1000.0
_ROBOT = "robot"
_ROOMY = 12


@dataclass(frozen=True)
class IntervalRow:
    """One parameter against the model as it came.

    Attributes:
        target: joint, body, or `robot`.
        value: factor or difference.
        low: lower end of the interval, on the same scale.
        high: upper end.
        kind: one of `KINDS`.
        side: `low` or `high` for a parameter that ended on that bound.
        hint: the numbers in words.
    """

    target: str
    value: float
    low: float
    high: float
    kind: str
    side: str
    hint: str


@dataclass(frozen=True)
class Panel:
    """The parameters of one quantity.

    Attributes:
        quantity: its name.
        unit: of the differences.
        factors: whether the rows are factors on a log axis, or else differences.
        rows: in the order of the fit.
    """

    quantity: str
    unit: str
    factors: bool
    rows: tuple[IntervalRow, ...]


def interval_panels(parameters: Sequence[FittedParameter]) -> list[Panel]:
    """What was fitted, by quantity, relative to the model as it came."""
    groups: dict[str, list[FittedParameter]] = {}
    for item in parameters:
        if not item.frozen:
            groups.setdefault(split_name(item.name)[0], []).append(item)
    return [
        Panel(
            name,
            items[0].unit,
            factors := all(map(is_factor, items)),
            tuple(_row(item, factors=factors) for item in items),
        )
        for name, items in groups.items()
    ]


def _row(item: FittedParameter, *, factors: bool) -> IntervalRow:
    value, (low, high) = shown_value(item), item.interval
    ends = f"{significant(low)} to {significant(high)}"
    shown = with_unit(significant(value), item.unit)
    said = item.nominal or 0.0
    hint = f"{with_unit(nominal_words(item), item.unit)} → {shown} ({ends}), {KINDS[kind_of(item)][1]}"

    def relative(number: float) -> float:
        return number / said if factors else number - said

    return IntervalRow(
        split_name(item.name)[1] or _ROBOT,
        relative(value),
        relative(low),
        relative(high),
        kind_of(item),
        item.at_bound,
        hint,
    )


def factor_span(panels: Sequence[Panel]) -> tuple[float, float]:
    """The range of factors that all panels share, so that their intervals compare; it holds 1."""
    rows = [row for panel in panels if panel.factors for row in panel.rows]
    low = min([1.0, *(min(row.low, row.value) for row in rows)])
    high = max([1.0, *(max(row.high, row.value) for row in rows)])
    low, high = max(low, 1.0 / _FARTHEST), min(high, _FARTHEST)
    pad = max((high / low) ** 0.04, 1.02)
    return low / pad, high * pad


def factor_ticks(low: float, high: float) -> list[float]:
    """Round factors between two factors: decades, 1-2-5, or even steps, whichever gives a handful."""
    decades = math.log10(high / low)
    if decades < 0.5:
        step = next(step for step in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0) if (high - low) / step <= 6)
        first, last = math.ceil(low / step), math.floor(high / step)
        return [round(number * step, 6) for number in range(first, last + 1)]
    series = (1, 2, 5) if decades < 1.6 else (1, 3) if decades < 2.5 else (1,)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [digit * 10.0**power for power in powers for digit in series]
    return [float(f"{tick:.3g}") for tick in ticks if low <= tick <= high]


def intervals_figure(panel: Panel, span: tuple[float, float]) -> Figure:
    """Value and 95 % interval of each parameter of one quantity; a line marks the model as it came."""
    data: list[dict[str, Any]] = []
    for kind in [kind for kind in KIND_STYLES if any(row.kind == kind for row in panel.rows)]:
        rows = [_inside(row, span) if panel.factors else row for row in panel.rows if row.kind == kind]
        data += [_interval_lines(rows, KIND_STYLES[kind]), _interval_dots(rows, KIND_STYLES[kind], kind)]
    names = [plot_text(row.target) for row in panel.rows]
    layout = {
        "height": 84 + (26 if len(names) <= _ROOMY else 19) * len(names),
        "showlegend": False,
        "margin": {"t": 4, "b": 4},
        "xaxis": _factor_axis(span) if panel.factors else _difference_axis(panel),
        "yaxis": {
            "type": "category",
            "categoryorder": "array",
            "categoryarray": names,
            "range": [len(names) - 0.4, -0.6],
        },
        "shapes": [reference_line(1.0 if panel.factors else 0.0)],
    }
    return {"data": data, "layout": layout}


def _inside(row: IntervalRow, span: tuple[float, float]) -> IntervalRow:
    """With what lies beyond the axis moved onto its edge; the hint keeps the numbers."""
    low, high = span
    ends = {name: min(max(getattr(row, name), low), high) for name in ("value", "low", "high")}
    return replace(row, **ends)


def _interval_lines(rows: Sequence[IntervalRow], style: Style) -> dict[str, Any]:
    x: list[float | None] = []
    y: list[str | None] = []
    for row in rows:
        x += [rounded(row.low), rounded(row.high), None]
        y += [plot_text(row.target), plot_text(row.target), None]
    return {
        "type": "scatter",
        "mode": "lines",
        "x": x,
        "y": y,
        "line": {"color": style.color, "dash": style.dash, "width": 2.5},
        "hoverinfo": "skip",
    }


def _interval_dots(rows: Sequence[IntervalRow], style: Style, kind: str) -> dict[str, Any]:
    symbols = [
        f"triangle-{'left' if row.side == 'low' else 'right'}" if kind == "bound" else style.symbol for row in rows
    ]
    return {
        "type": "scatter",
        "mode": "markers",
        "name": KINDS[kind][1],
        "x": [rounded(row.value) for row in rows],
        "y": [plot_text(row.target) for row in rows],
        "marker": {"color": style.color, "symbol": symbols, "size": 10, "line": {"width": 1.5}},
        "text": [plot_text(row.hint) for row in rows],
        "hovertemplate": "%{y}: %{text}<extra></extra>",
    }


def _factor_axis(span: tuple[float, float]) -> dict[str, Any]:
    ticks = factor_ticks(*span)
    return {
        "type": "log",
        "range": [rounded(math.log10(end)) for end in span],
        "tickvals": ticks,
        "ticktext": [f"×{tick:g}" for tick in ticks],
        "title": {"text": "fitted / model as it came"},
    }


def _difference_axis(panel: Panel) -> dict[str, Any]:
    ends = [0.0, *(end for row in panel.rows for end in (row.low, row.high, row.value))]
    pad = 0.05 * (max(ends) - min(ends)) or 1.0
    unit = pretty_unit(panel.unit)
    title = "fitted − model as it came"
    return {
        "title": {"text": plot_text(f"{title} [{unit}]" if unit else title)},
        "range": [rounded(min(ends) - pad), rounded(max(ends) + pad)],
        "nticks": 6,
        "zeroline": False,
    }
