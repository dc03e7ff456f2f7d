"""Figures of learned corrections: cut factors, one motion, reliability, latencies; see `figures`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from trueup.core.attention import AttentionProfile
from trueup.core.augment_result import Cut, Reliability, joint_title
from trueup.core.results import Estimate
from trueup.core.step_times import StepTimes
from trueup.core.traces import MEASURED, Trace
from trueup.report.augment_words import factor_interval, factor_words
from trueup.report.chooser import Figure
from trueup.report.figures import band, reference_line, rounded, whiskers
from trueup.report.labels import plot_text
from trueup.report.numbers import interval, percent, pretty_unit, quantity
from trueup.report.palette import Style

_GRAY = "#808080"
# Round factors of a log axis.
_TICKS = tuple(digit * 10.0**power for power in range(-4, 7) for digit in (1, 2, 5))
# A share that a log axis still shows.
_LEAST = 1e-6
# Axes and whiskers end here, times the largest and the smallest value.
_BEYOND = 4.0
_COLUMNS = 2
_PANEL_PX = 190


def factor_figure(
    joints: Sequence[str], cuts: Mapping[str, Mapping[str, Cut]], styles: Mapping[str, Style], signal: str = ""
) -> Figure:
    """How many times smaller the MSE is, per joint, one symbol with whiskers per network, on a log axis.

    Args:
        joints: rows, top to bottom.
        cuts: name of a network -> joint -> cut.
        styles: how each network is drawn.
        signal: that it is about.
    """
    known = {
        name: {joint: items[joint] for joint in joints if joint in items and 0.0 < items[joint].factor.value < math.inf}
        for name, items in cuts.items()
    }
    values = [cut.factor.value for items in known.values() for cut in items.values()]
    low, high = _span(known)
    data: list[dict[str, Any]] = []
    room = 0.8 / max(len(known), 1)
    for number, (name, items) in enumerate(known.items()):
        beside = room * (number - 0.5 * (len(known) - 1))
        factors = [cut.factor for cut in items.values()]
        up = [min(item.high or high, high) - item.value if item.low is not None else 0.0 for item in factors]
        down = [item.value - max(item.low, low) if item.low is not None else 0.0 for item in factors]
        style = styles[name]
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": plot_text(name),
                "x": [rounded(item.value) for item in factors],
                "y": [joints.index(joint) + beside for joint in items],
                "error_x": {
                    **whiskers(factors),
                    "array": [rounded(value) for value in up],
                    "arrayminus": [rounded(value) for value in down],
                    "color": style.color,
                },
                "marker": {"color": style.color, "symbol": style.symbol, "size": 8},
                "text": [f"{plot_text(joint_title(joint, signal))}: {_cut_hint(cut)}" for joint, cut in items.items()],
                "hovertemplate": "%{text}",
            }
        )
    ticks = [tick for tick in _TICKS if low <= tick <= high]
    layout = {
        "height": 110 + len(joints) * (16 + 12 * len(known)),
        "shapes": [reference_line(1.0)] if values else [],
        "xaxis": {
            "type": "log",
            "title": {"text": "MSE: times smaller than simulated"},
            "range": [rounded(math.log10(low)), rounded(math.log10(high))],
            "tickvals": ticks,
            "ticktext": [f"{tick:g}" for tick in ticks],
        },
        "yaxis": {
            "tickvals": list(range(len(joints))),
            "ticktext": [plot_text(joint_title(joint, signal)) for joint in joints],
            "range": [len(joints) - 0.45, -0.55],
            "zeroline": False,
        },
    }
    return {"data": data, "layout": layout}


def motion_figure(
    traces: Sequence[Trace], run: str, networks: Mapping[str, str], styles: Mapping[str, Style], *, shown: str
) -> Figure:
    """One signal of one motion, joint by joint: measured, simulated, corrected (LSTM thesis, Figures 11 and 13).

    Args:
        traces: one per joint.
        run: label of the simulated run.
        networks: name of a network -> label of its run.
        styles: run label -> how it is drawn.
        shown: the network that is drawn at once; the others wait in the legend.
    """
    rows = math.ceil(len(traces) / _COLUMNS)
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"height": 70 + rows * _PANEL_PX, "annotations": []}
    gray = Style(_GRAY, "solid", "circle", "")
    for number, trace in enumerate(traces):
        axis = "" if number == 0 else str(number + 1)
        last = number + _COLUMNS >= len(traces)
        layout |= _panel(axis, number, rows, last=last)
        layout["annotations"].append(_panel_title(f"{trace.joint} [{pretty_unit(trace.unit)}]", number, rows))
        time_s = [_short(value) for value in trace.time_s.tolist()]
        named = {MEASURED: ("measured", gray, 4.0), run: ("simulated", styles[run], 1.0)}
        named |= {label: (name, styles[label], 1.8) for name, label in networks.items()}
        for label, (name, style, width) in named.items():
            if label not in trace.curves:
                continue
            dash = "solid" if name in ("simulated", shown) else style.dash
            curve = {
                "type": "scatter",
                "mode": "lines",
                "name": plot_text(name),
                "legendgroup": plot_text(label),
                "showlegend": number == 0,
                "x": time_s,
                "y": [_short(value) for value in trace.curves[label].tolist()],
                "xaxis": f"x{axis}",
                "yaxis": f"y{axis}",
                "line": {"color": style.color, "dash": dash, "width": width},
                "hovertemplate": "%{y:.3g}",
            }
            data.append(curve if name not in networks or name == shown else {**curve, "visible": "legendonly"})
    return {"data": data, "layout": layout}


def reliability_figure(curves: Mapping[str, Reliability], styles: Mapping[str, Style]) -> Figure:
    """Share of samples in which the simulator was far off over the probability that was predicted for it."""
    diagonal = {
        "type": "scatter",
        "mode": "lines",
        "name": "as often as predicted",
        "x": [0, 100],
        "y": [0, 100],
        "line": {"color": _GRAY, "dash": "dot", "width": 1.5},
        "hoverinfo": "skip",
    }
    data: list[dict[str, Any]] = [diagonal]
    for name, curve in curves.items():
        style = styles[name]
        observed = [_in_percent(item) for item in curve.observed]
        data.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": plot_text(name),
                "x": [rounded(100.0 * value) for value in curve.predicted],
                "y": [rounded(item.value) for item in observed],
                "error_y": whiskers(observed) | {"color": style.color},
                "line": {"color": style.color, "dash": style.dash, "width": 1.5},
                "marker": {"color": style.color, "symbol": style.symbol, "size": 8},
                "text": [
                    f"far off in {percent(item.value, sign=False)}{_ends(item)}, "
                    f"{percent(weight, sign=False)} of the samples"
                    for item, weight in zip(curve.observed, curve.weight, strict=True)
                ],
                "hovertemplate": "predicted %{x:.3g} %: %{text}",
            }
        )
    layout = {
        "height": 420,
        "xaxis": {"title": {"text": "predicted probability of far off [%]"}, "range": [-2, 102]},
        "yaxis": {"title": {"text": "share of samples in which it was [%]"}, "range": [-2, 102]},
    }
    return {"data": data, "layout": layout}


def latency_figure(latencies: Mapping[str, StepTimes], styles: Mapping[str, Style]) -> Figure:
    """Histogram of the time of one step, per network, on log axes."""
    data: list[dict[str, Any]] = []
    shapes: list[dict[str, Any]] = []
    for name, item in latencies.items():
        style = styles[name]
        steps = max(sum(count for *_, count in item.bins), 1)
        middle: list[float | None] = []
        share: list[float | None] = []
        for (low, high, count), above in itertools.zip_longest(item.bins, item.bins[1:]):
            middle.append(rounded(math.sqrt(max(low, 1e-3) * max(high, 1e-3))))
            share.append(rounded(100.0 * count / steps))
            if above is not None and above[0] > high:  # no line over times that no step took
                middle.append(None)
                share.append(None)
        data.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": plot_text(name),
                "x": middle,
                "y": share,
                "line": {"color": style.color, "width": 1.5, "shape": "hvh"},
                "marker": {"color": style.color, "symbol": style.symbol, "size": 5},
                "hovertemplate": "%{x:.3g} µs: %{y:.3g} % of the steps",
            }
        )
        if item.period_us is not None and not shapes:
            shapes.append(reference_line(item.period_us))
    layout = {
        "height": 320,
        "shapes": shapes,
        "xaxis": {"type": "log", "title": {"text": "time of one step [µs]"}},
        "yaxis": {"type": "log", "title": {"text": "share of the steps [%]"}},
    }
    return {"data": data, "layout": layout}


def attention_figure(profiles: Mapping[str, AttentionProfile], styles: Mapping[str, Style]) -> Figure:
    """Share of attention over the time before the present sample, with the spread over motions (SAT, Fig. 11).

    On a log axis: the present sample often has many times the share of any other.
    """
    data: list[dict[str, Any]] = []
    for name, item in profiles.items():
        style, lags = styles[name], range(len(item.mean))
        time_ms = [rounded(-1e3 * lag / item.rate_hz) for lag in lags]
        low, high = ([rounded(100.0 * max(share, _LEAST)) for share in shares] for shares in (item.low, item.high))
        curve = {
            "type": "scatter",
            "mode": "lines",
            "name": plot_text(name),
            "legendgroup": plot_text(name),
            "x": time_ms,
            "y": [rounded(100.0 * max(share, _LEAST)) for share in item.mean],
            "customdata": [[lag, low[lag], high[lag]] for lag in lags],
            "line": {"color": style.color, "dash": style.dash, "width": 2},
            "hovertemplate": "%{x:.4g} ms, %{customdata[0]} samples ago: %{y:.3g} % "
            "(%{customdata[1]:.3g} to %{customdata[2]:.3g})",
        }
        data += [band(name, time_ms, low, high, style), curve]
    lengths = {len(item.mean) for item in profiles.values()}
    if len(lengths) == 1:
        alike = rounded(100.0 / lengths.pop())
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": "all samples alike",
                "x": [min(curve["x"][-1] for curve in data[1::2]), 0],
                "y": [alike, alike],
                "line": {"color": _GRAY, "dash": "dot", "width": 1.5},
                "hoverinfo": "skip",
            }
        )
    ends = [value for item in profiles.values() for values in (item.low, item.high) for value in values]
    ticks = [tick for tick in _TICKS if min(ends) / 2 <= tick / 100 <= max(ends) * 2]
    steps_ms = {f"{1e3 / item.rate_hz:.4g}" for item in profiles.values()}
    step = f", {steps_ms.pop()} ms per sample" if len(steps_ms) == 1 else ""
    layout = {
        "height": 340,
        "xaxis": {"title": {"text": f"time before the present sample [ms]{step}"}},
        "yaxis": {
            "type": "log",
            "title": {"text": "share of the attention [%]"},
            "tickvals": ticks,
            "ticktext": [f"{tick:g}" for tick in ticks],
        },
    }
    return {"data": data, "layout": layout}


def _short(value: float) -> float | None:
    """Four significant digits: enough for a small panel, and half the bytes."""
    return float(f"{value:.4g}") if math.isfinite(value) else None


def _span(known: Mapping[str, Mapping[str, Cut]]) -> tuple[float, float]:
    """The range of the factors and, as far as they are near, of their intervals; 1 is in it."""
    factors = [cut.factor for items in known.values() for cut in items.values()]
    low, high = min([1.0, *(item.value for item in factors)]), max([1.0, *(item.value for item in factors)])
    ends = [max(item.low, low / _BEYOND) for item in factors if item.low]
    tops = [min(item.high, high * _BEYOND) for item in factors if item.high]
    return min([low, *ends]) / 1.3, max([high, *tops]) * 1.3


def _panel(axis: str, number: int, rows: int, *, last: bool) -> dict[str, Any]:
    """The axes of one joint, in a grid of two columns."""
    row = number // _COLUMNS
    left, top = _corner(number, rows)
    return {
        f"xaxis{axis}": {
            "domain": [rounded(left), rounded(left + 0.46)],
            "anchor": f"y{axis}",
            "matches": "x" if axis else None,
            "title": {"text": "time [s]"} if last else None,
        },
        f"yaxis{axis}": {
            "domain": [rounded(max(1.0 - (row + 0.78) / rows, 0.0)), rounded(top)],
            "anchor": f"x{axis}",
            "nticks": 5,
        },
    }


def _panel_title(text: str, number: int, rows: int) -> dict[str, Any]:
    """What a panel shows, above it: beside its axis it would take the room of a narrow screen."""
    left, top = _corner(number, rows)
    return {
        "text": plot_text(text),
        "x": rounded(left),
        "y": rounded(top),
        "xref": "paper",
        "yref": "paper",
        "xanchor": "left",
        "yanchor": "bottom",
        "showarrow": False,
    }


def _corner(number: int, rows: int) -> tuple[float, float]:
    """Left and upper edge of a panel, as shares of the figure."""
    row, column = divmod(number, _COLUMNS)
    return 0.54 * column, 1.0 - (row + 0.08) / rows


def _in_percent(item: Estimate) -> Estimate:
    return Estimate(100.0 * item.value, "%", *(None if end is None else 100.0 * end for end in (item.low, item.high)))


def _ends(item: Estimate) -> str:
    if item.low is None or item.high is None:
        return ""
    return f" ({percent(item.low, sign=False)} to {percent(item.high, sign=False)})"


def _cut_hint(cut: Cut) -> str:
    ends = factor_interval(cut.factor)
    left = quantity(cut.mse.value, cut.mse.unit)
    around = interval(cut.mse)
    return f"{factor_words(cut.factor)}{f' ({ends})' if ends else ''}; {left} left{f' ({around})' if around else ''}"
