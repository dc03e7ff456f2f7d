"""The figures of the report as plotly's JSON, one function per figure.

They are plain dictionaries: building `plotly.graph_objects` would only validate what the tests validate, and
cost a second per report. Fonts and grid follow the reader's theme and are set by the page's script.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from trueup.core.analysis import BinnedCurve, HorizonCurve, Lag
from trueup.core.results import Estimate
from trueup.report.chooser import Figure
from trueup.report.labels import plot_text, run_title, source_title
from trueup.report.numbers import interval, pretty_unit, quantity
from trueup.report.palette import Style


def rounded(value: float | None) -> float | None:
    """Six significant digits, which no screen can tell from more; None for what is not finite."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.6g}")


def whiskers(estimates: Sequence[Estimate]) -> dict[str, Any]:
    """Plotly's error bars from the value to both ends of the interval; none where there is no interval."""
    up = [rounded(item.high - item.value) if item.high is not None else None for item in estimates]
    down = [rounded(item.value - item.low) if item.low is not None else None for item in estimates]
    return {
        "type": "data",
        "symmetric": False,
        "array": [value or 0.0 for value in up],
        "arrayminus": [value or 0.0 for value in down],
        "thickness": 1.5,
        "width": 3,
    }


def bars_figure(
    groups: Sequence[str], bars: Mapping[str, Mapping[str, Estimate]], styles: Mapping[str, Style], *, title: str
) -> Figure:
    """Horizontal bars with interval whiskers, one group of bars per row.

    Args:
        groups: names of the rows, top to bottom.
        bars: name of a bar (its legend entry) -> row -> estimate.
        styles: how each bar is drawn.
        title: title of the value axis, with unit.
    """
    data = []
    for label, values in bars.items():
        rows = [row for row in groups if row in values and math.isfinite(values[row].value)]
        estimates = [values[row] for row in rows]
        style = styles[label]
        data.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": plot_text(run_title(label)),
                "y": [plot_text(row) for row in rows],
                "x": [rounded(item.value) for item in estimates],
                "error_x": whiskers(estimates),
                "marker": hatched(style),
                "text": [hint_of(item) for item in estimates],
                "textposition": "none",
                "hovertemplate": "%{y}: %{text}",
            }
        )
    axis: dict[str, Any] = {"title": {"text": plot_text(title)}, "rangemode": "tozero"}
    limit = _whisker_limit([item for values in bars.values() for item in values.values()])
    if limit is not None:
        axis |= {"range": [0, limit], "title": {"text": f"{plot_text(title)}<br>whiskers cut at the edge"}}
    height = 96 + len(groups) * (14 + 17 * len(bars))
    layout = {
        "barmode": "group",
        "height": max(180, height),
        "xaxis": axis,
        "yaxis": {
            "type": "category",
            "categoryorder": "array",
            "categoryarray": [plot_text(row) for row in groups],
            "autorange": "reversed",
        },
    }
    return {"data": data, "layout": layout}


def bins_figure(curves: Mapping[str, BinnedCurve], styles: Mapping[str, Style], *, against: str, signal: str) -> Figure:
    """Median of |residual| with its quartile band over bins of another quantity, one curve per run."""
    data: list[dict[str, Any]] = []
    units: tuple[str, str] = ("", "")
    for label, curve in curves.items():
        units = (curve.x_unit, curve.y_unit)
        filled = [row for row, median in enumerate(curve.median) if math.isfinite(median)]
        x = [rounded(curve.centers[row]) for row in filled]
        low = [rounded(curve.q25[row]) for row in filled]
        high = [rounded(curve.q75[row]) for row in filled]
        style = styles[label]
        data += [
            band(label, x, low, high, style),
            {
                "type": "scatter",
                "x": x,
                "y": [rounded(curve.median[row]) for row in filled],
                "customdata": [[low[i], high[i], curve.count[row]] for i, row in enumerate(filled)],
                "hovertemplate": "%{y:.3g} (quartiles %{customdata[0]:.3g} to %{customdata[1]:.3g}; "
                "%{customdata[2]} samples)",
                "mode": "lines+markers",
                "name": plot_text(run_title(label)),
                "legendgroup": plot_text(label),
                "line": {"color": style.color, "dash": style.dash, "width": 2},
                "marker": {"color": style.color, "symbol": style.symbol, "size": 6},
            },
        ]
    layout = {
        "height": 340,
        "xaxis": {"title": {"text": plot_text(_with_unit(f"measured {against}", units[0]))}},
        "yaxis": {"title": {"text": plot_text(_with_unit(f"|{signal} residual|", units[1]))}, "rangemode": "tozero"},
    }
    return {"data": data, "layout": layout}


def lag_figure(joints: Sequence[str], lags: Mapping[str, Mapping[str, Lag]], styles: Mapping[str, Style]) -> Figure:
    """Delay of the measured motion per joint [ms], with intervals, one symbol per source."""
    data: list[dict[str, Any]] = []
    for label, values in lags.items():
        rows = [joint for joint in joints if joint in values and math.isfinite(values[joint].value_s)]
        estimates = [
            Estimate(
                1e3 * item.value_s, "ms", *(None if end is None else 1e3 * end for end in (item.low_s, item.high_s))
            )
            for item in (values[joint] for joint in rows)
        ]
        style = styles[label]
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": plot_text(source_title(label)),
                "x": [rounded(item.value) for item in estimates],
                "y": [plot_text(joint) for joint in rows],
                "error_x": whiskers(estimates) | {"color": style.color},
                "marker": {"color": style.color, "symbol": style.symbol, "size": 9, "line": {"width": 1.5}},
                "text": [hint_of(item) for item in estimates],
                "hovertemplate": "%{y}: %{text}",
            }
        )
    layout = {
        "height": 120 + 28 * len(joints),
        "xaxis": {"title": {"text": "lag of the measured motion [ms]"}, "zeroline": True},
        "yaxis": {
            "type": "category",
            "categoryorder": "array",
            "categoryarray": [plot_text(joint) for joint in joints],
            "autorange": "reversed",
        },
    }
    return {"data": data, "layout": layout}


def horizon_figure(curves: Mapping[str, HorizonCurve], styles: Mapping[str, Style], *, signal: str) -> Figure:
    """RMSE over the time since the restart from the measured state, one curve per run."""
    data = [
        {
            "type": "scatter",
            "mode": "lines",
            "name": plot_text(run_title(label)),
            "x": [rounded(value) for value in curve.time_s],
            "y": [rounded(value) for value in curve.rmse],
            "line": {"color": styles[label].color, "dash": styles[label].dash, "width": 2},
            "hovertemplate": "%{y:.3g}",
        }
        for label, curve in curves.items()
    ]
    unit = next(iter(curves.values())).unit if curves else ""
    layout = {
        "height": 320,
        "xaxis": {"title": {"text": "time since the restart [s]"}, "rangemode": "tozero"},
        "yaxis": {"title": {"text": plot_text(_with_unit(f"{signal} RMSE", unit))}, "rangemode": "tozero"},
    }
    return {"data": data, "layout": layout}


def _whisker_limit(estimates: Sequence[Estimate]) -> float | None:
    """Where to cut an axis because the interval of two or three motions dwarfs all bars; None if it need not be."""
    finite = [item for item in estimates if math.isfinite(item.value)]
    largest = max((item.value for item in finite), default=0.0)
    if largest <= 0.0 or min((item.value if item.low is None else item.low) for item in finite) < 0.0:
        return None
    limit = 2.5 * largest
    return rounded(limit) if any(item.high is not None and item.high > limit for item in finite) else None


def hatched(style: Style) -> dict[str, Any]:
    """Color and hatching of bars."""
    if not style.pattern:
        return {"color": style.color}
    pattern = {
        "shape": style.pattern,
        "bgcolor": style.color,
        "fgcolor": "#ffffff",
        "fgopacity": 0.7,
        "size": 6,
        "solidity": 0.25,
    }
    return {"color": style.color, "pattern": pattern}


def reference_line(x: float) -> dict[str, Any]:
    """A vertical line behind the data, in both themes."""
    line = {"color": "#808080", "width": 2}
    return {
        "type": "line",
        "xref": "x",
        "yref": "paper",
        "x0": x,
        "x1": x,
        "y0": 0,
        "y1": 1,
        "layer": "below",
        "line": line,
    }


def band(
    label: str,
    x: Sequence[float | None],
    low: Sequence[float | None],
    high: Sequence[float | None],
    style: Style,
) -> dict[str, Any]:
    """A shaded band between two curves, behind the curve of the same label."""
    return {
        "type": "scatter",
        "x": [*x, *reversed(x)],
        "y": [*high, *reversed(low)],
        "fill": "toself",
        "fillcolor": _transparent(style.color),
        "line": {"width": 0},
        "mode": "lines",
        "hoverinfo": "skip",
        "showlegend": False,
        "legendgroup": plot_text(label),
    }


def _transparent(color: str) -> str:
    red, green, blue = (int(color[start : start + 2], 16) for start in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.16)"


def hint_of(estimate: Estimate) -> str:
    """The number and its interval, as they appear over a mark."""
    ends = interval(estimate)
    return quantity(estimate.value, estimate.unit) + (f" ({ends})" if ends else "")


def _with_unit(text: str, unit: str) -> str:
    shown = pretty_unit(unit)
    return f"{text} [{shown}]" if shown else text
