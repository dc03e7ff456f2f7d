"""Figures of what policies do (ES thesis, Fig. 4.4 to 4.6) and of how they learn (2.1 to 2.7); see `figures`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from trueup.report.chooser import Figure
from trueup.report.episode_curves import cumulative, spread
from trueup.report.figures import band, reference_line, rounded
from trueup.report.labels import plot_text
from trueup.report.learning_curves import Curve
from trueup.report.palette import Style

# Of logarithmic axes: plotly's own leave out which decade a 2 or a 5 is of.
_TICKS = [digit * 10.0**power for power in range(-3, 4) for digit in (1, 2, 5)]
_TITLE_ROOM = {"t": 26}
View = Literal["top", "side"]
VIEWS: Mapping[View, tuple[int, int, str, str]] = {"top": (0, 1, "x [m]", "y [m]"), "side": (0, 2, "x [m]", "z [m]")}


def reward_figure(
    title: str,
    reward: Float[np.ndarray, "E T"],
    row: int,
    style: Style,
    *,
    control_s: float,
    span: tuple[float, float],
) -> Figure:
    """Reward of the control steps of one episode, before the band of all.

    Args:
        title: which episode it is.
        reward: of all episodes.
        row: of this one.
        style: of its line.
        control_s: length of a control step [s].
        span: of the axis, the same for all episodes beside each other.
    """
    steps, ends = spread(reward, (0.0, 1.0))
    x = [rounded(value) for value in control_s * (steps + 1)]
    low, high = (_numbers(own) for own in ends)
    shade = band("all episodes", x, low, high, Style("#808080", "solid", "circle", ""))
    own = _numbers(reward[row])
    line = {
        "type": "scatter",
        "mode": "lines",
        "name": plot_text(title),
        "x": [rounded(control_s * (step + 1)) for step in range(len(own))],
        "y": own,
        "line": {"color": style.color, "dash": style.dash, "width": 2},
        "hovertemplate": "%{x:.2f} s: %{y:.3f}",
        "showlegend": False,
    }
    layout = {
        "height": 220,
        "margin": _TITLE_ROOM,
        "annotations": [_heading(title)],
        "xaxis": {"title": {"text": "time [s]"}, "rangemode": "tozero"},
        "yaxis": {"title": {"text": "reward of a step"}, "range": [rounded(span[0]), rounded(span[1])]},
    }
    return {"data": [shade, line], "layout": layout}


def distance_figure(
    distances: Mapping[str, Float[np.ndarray, "E T"]], styles: Mapping[str, Style], *, control_s: float, near_m: float
) -> Figure:
    """Distance from the goal over time: median, and a band in which eight of ten episodes are, per policy [cm]."""
    data: list[dict[str, Any]] = []
    for label, curves in distances.items():
        steps, (low, middle, high) = spread(100.0 * curves)
        x = [rounded(value) for value in control_s * (steps + 1)]
        ends = (_numbers(low), _numbers(high))
        data += [band(label, x, *ends, styles[label]), _line(label, x, middle, styles[label])]
        data[-1] |= {
            "customdata": [list(pair) for pair in zip(*ends, strict=True)],
            "hovertemplate": "%{y:.3g} cm (10 to 90 %: %{customdata[0]:.3g} to %{customdata[1]:.3g})",
        }
    layout = {
        "height": 340,
        "xaxis": {"title": {"text": "time [s]"}, "rangemode": "tozero"},
        "yaxis": {"title": {"text": "distance from the goal [cm]"}, "rangemode": "tozero"},
        "shapes": [_level(100.0 * near_m)],
    }
    return {"data": data, "layout": layout}


def finals_figure(
    finals: Mapping[str, Float[np.ndarray, "E"]], styles: Mapping[str, Style], *, near_m: float
) -> Figure:
    """Which share of the goals is nearer at the end than so much, per policy [cm]; a line is where one is reached."""
    data = []
    for label, values in finals.items():
        x, share = cumulative(100.0 * values)
        data.append(_line(label, [rounded(value) for value in x], 100.0 * share, styles[label]))
        data[-1]["line"] |= {"shape": "hv"}
        data[-1]["hovertemplate"] = "%{y:.0f} % of the goals within %{x:.3g} cm"
    layout = {
        "height": 320,
        "xaxis": {"title": {"text": "distance from the goal at the end [cm]"}, "rangemode": "tozero"},
        "yaxis": {"title": {"text": "share of the goals [%]"}, "range": [0, 102]},
        "shapes": [reference_line(rounded(100.0 * near_m) or 0.0)],
    }
    return {"data": data, "layout": layout}


def map_figure(
    view: View,
    goals: Float[np.ndarray, "E 3"],
    final_m: Float[np.ndarray, "E"],
    reached: Float[np.ndarray, "E"],
    *,
    start_m: Sequence[float],
    most_m: float,
) -> Figure:
    """Where the goals are, colored by the distance at the end [cm]: a point that was reached, a cross that was not.

    Args:
        view: from above, or from the side.
        goals: [m].
        final_m: distance at the end [m].
        reached: 1 where that is a success, else 0.
        start_m: where the end of the arm was at the start, (3,) [m].
        most_m: where the scale of colors ends, the same in both views [m].
    """
    across, up, *titles = VIEWS[view]
    own = 100.0 * final_m
    goal_marks = {
        "type": "scatter",
        "mode": "markers",
        "name": "goal",
        "x": _numbers(goals[:, across]),
        "y": _numbers(goals[:, up]),
        "text": [f"{value:.3g} cm" for value in own.tolist()],
        "hovertemplate": "%{text}",
        "marker": {
            "color": _numbers(own),
            "colorscale": "Viridis",
            "cmin": 0,
            "cmax": rounded(100.0 * most_m),
            "symbol": ["circle" if value else "x" for value in reached.tolist()],
            "size": 10,
            "line": {"width": 1, "color": "#808080"},
            "colorbar": {"title": {"text": "cm", "side": "top"}, "thickness": 12, "outlinewidth": 0},
        },
        "showlegend": False,
    }
    start = {
        "type": "scatter",
        "mode": "markers",
        "name": "start",
        "x": [rounded(start_m[across])],
        "y": [rounded(start_m[up])],
        "marker": {"symbol": "star-open", "size": 14, "color": "#d55e00", "line": {"width": 2}},
        "hovertemplate": "start",
        "showlegend": False,
    }
    layout = {
        "height": 340,
        "margin": _TITLE_ROOM,
        "annotations": [_heading("from above" if view == "top" else "from the side")],
        "xaxis": {"title": {"text": titles[0]}, "constrain": "domain", "zeroline": False},
        "yaxis": {"title": {"text": titles[1]}, "scaleanchor": "x", "zeroline": False},
    }
    return {"data": [goal_marks, start], "layout": layout}


def demands_figure(demands: Mapping[str, Float[np.ndarray, "E"]], style: Style) -> Figure:
    """Shares of the time of each episode [%]: a joint is given its largest torque, or is too fast.

    Args:
        demands: what is counted -> of each episode.
        style: of the marks.
    """
    data = [
        {
            "type": "box",
            "name": plot_text(name),
            "x": _numbers(100.0 * values),
            "orientation": "h",
            "boxpoints": "all",
            "jitter": 0.6,
            "pointpos": 0,
            "fillcolor": "rgba(128,128,128,0.12)",
            "line": {"color": "#808080", "width": 1},
            "marker": {"color": style.color, "symbol": "circle-open", "size": 6},
            "hovertemplate": "%{x:.1f} %",
            "showlegend": False,
        }
        for name, values in demands.items()
    ]
    layout = {
        "height": 90 + 70 * len(data),
        "xaxis": {"title": {"text": "share of the time of an episode [%]"}, "range": [-2, 102]},
        "yaxis": {"type": "category", "autorange": "reversed"},
    }
    return {"data": data, "layout": layout}


def learning_figure(
    curves: Sequence[Curve], styles: Mapping[str, Style], *, across: str, up: str, factor: float, log: bool
) -> Figure:
    """How trainings went: mean over seeds, and a band from the least to the largest.

    Args:
        curves: one per group.
        styles: how each is drawn.
        across: title of the axis below.
        up: title of the other one, with unit.
        factor: from the curves' unit to that of the axis.
        log: whether that axis is logarithmic.
    """
    data: list[dict[str, Any]] = []
    for curve in curves:
        x, low, high = _numbers(curve.x), _numbers(factor * curve.low), _numbers(factor * curve.high)
        if curve.runs > 1:
            data.append(band(curve.title, x, low, high, styles[curve.title]))
        line = _line(curve.title, x, factor * curve.mean, styles[curve.title])
        if len(x) <= 30:
            line |= {"mode": "lines+markers"}
            line["marker"] = {"color": styles[curve.title].color, "symbol": styles[curve.title].symbol, "size": 6}
        line["customdata"] = [list(pair) for pair in zip(low, high, strict=True)]
        line["hovertemplate"] = "%{y:.3g} (%{customdata[0]:.3g} to %{customdata[1]:.3g})"
        data.append(line)
    layout = {
        # On a phone the legend takes a line per group.
        "height": 320 + 20 * len(curves),
        "xaxis": {"title": {"text": across}, "rangemode": "tozero"},
        "yaxis": {
            "title": {"text": up},
            **({"type": "log", "tickvals": _TICKS, "ticktext": [f"{tick:g}" for tick in _TICKS]} if log else {}),
        },
        "showlegend": True,
    }
    return {"data": data, "layout": layout}


def _line(label: str, x: Sequence[float | None], y: Float[np.ndarray, "N"], style: Style) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": plot_text(label),
        "legendgroup": plot_text(label),
        "x": list(x),
        "y": _numbers(y),
        "line": {"color": style.color, "dash": style.dash, "width": 2},
    }


def _numbers(values: Float[np.ndarray, "N"]) -> list[float | None]:
    return [rounded(value) for value in values.tolist()]


def _heading(text: str) -> dict[str, Any]:
    """A title above a small figure."""
    return {
        "text": plot_text(text),
        "xref": "paper",
        "yref": "paper",
        "x": 0,
        "y": 1,
        "xanchor": "left",
        "yanchor": "bottom",
        "showarrow": False,
    }


def _level(y: float) -> dict[str, Any]:
    """A dotted horizontal line behind the data."""
    line = {"color": "#808080", "width": 1.5, "dash": "dot"}
    return {"type": "line", "xref": "paper", "yref": "y", "x0": 0, "x1": 1, "y0": rounded(y), "y1": rounded(y)} | {
        "layer": "below",
        "line": line,
    }
