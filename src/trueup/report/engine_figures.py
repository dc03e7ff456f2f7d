"""Figures of engines and payloads: the gap over the payload, and joint trajectories on their two main axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trueup.core.engines import ANY_PAYLOAD, MEASURED, Envelope, JointPlane, Trend
from trueup.core.results import Estimate
from trueup.report.chooser import Figure
from trueup.report.figures import hint_of, rounded, whiskers
from trueup.report.labels import group_order, plot_text, run_title
from trueup.report.palette import Style, cycled_styles

MEASURED_STYLE = Style("#808080", "solid", "circle-open", "")
# Two standard deviations of a normal distribution in the plane hold 86 % of the samples.
_SIGMAS = 2.0
# Runs stand beside each other, this share of the axis apart: equal ones would hide each other.
_BESIDE = 0.015
_CORNERS = 49
_DASHES = ("solid", "dot", "dash", "dashdot", "longdash")


def payload_figure(
    values: Mapping[str, Mapping[float, Estimate]],
    lines: Mapping[str, Trend],
    styles: Mapping[str, Style],
    *,
    title: str,
) -> Figure:
    """A metric over the payload with interval whiskers, one symbol per run, and the straight line through its motions.

    Args:
        values: run -> payload [kg] -> estimate.
        lines: run -> trend.
        styles: how each run is drawn.
        title: title of the value axis, with unit.
    """
    data: list[dict[str, Any]] = []
    loads = [load for points in values.values() for load in points]
    beside = _BESIDE * (max(loads) - min(loads)) if loads else 0.0
    for number, (label, points) in enumerate(values.items()):
        shift = beside * (number - 0.5 * (len(values) - 1))
        known = {load: item for load, item in sorted(points.items()) if math.isfinite(item.value)}
        style, group = styles[label], plot_text(label)
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": plot_text(run_title(label)),
                "legendgroup": group,
                "x": [rounded(load + shift) for load in known],
                "customdata": [rounded(load) for load in known],
                "y": [rounded(item.value) for item in known.values()],
                "error_y": whiskers(list(known.values())) | {"color": style.color},
                "marker": {"color": style.color, "symbol": style.symbol, "size": 9},
                "text": [hint_of(item) for item in known.values()],
                "hovertemplate": "%{customdata} kg: %{text}",
            }
        )
        line = lines.get(label)
        if line is not None and len(known) > 1 and math.isfinite(line.slope.value):
            ends = [min(known), max(known)]
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "legendgroup": group,
                    "showlegend": False,
                    "hoverinfo": "skip",
                    "x": [rounded(load + shift) for load in ends],
                    "y": [rounded(line.at_zero + line.slope.value * load) for load in ends],
                    "line": {"color": style.color, "dash": style.dash, "width": 1.5},
                }
            )
    layout = {
        "height": 360,
        "xaxis": {"title": {"text": "payload [kg]"}},
        "yaxis": {"title": {"text": plot_text(title)}, "zeroline": True},
    }
    return {"data": data, "layout": layout}


def envelope_figure(plane: JointPlane, payload: str, styles: Mapping[str, Style]) -> Figure:
    """Ellipses of two standard deviations around the mean of each source, over all motions or those of a payload."""
    data = []
    for source in _ordered(plane.envelopes, styles):
        envelope = plane.envelopes[source].get(payload)
        if envelope is not None:
            x, y = _ellipse(envelope)
            style = _style(source, styles)
            data.append(_line(source, x, y, style, width=3.0 if source == MEASURED else 2.0))
            data.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "legendgroup": plot_text(source),
                    "showlegend": False,
                    "hoverinfo": "skip",
                    "x": [rounded(envelope.center[0])],
                    "y": [rounded(envelope.center[1])],
                    "marker": {"color": style.color, "symbol": style.symbol, "size": 8},
                }
            )
    return {"data": data, "layout": _plane_layout(plane)}


def path_figure(plane: JointPlane, motion: str, styles: Mapping[str, Style]) -> Figure:
    """The trace of one motion in the plane, measured and in each run."""
    data = []
    for source in _ordered(plane.paths[motion], styles):
        points = plane.paths[motion][source]
        x, y = [point[0] for point in points], [point[1] for point in points]
        data.append(_line(source, x, y, _style(source, styles), width=3.0 if source == MEASURED else 1.5))
    return {"data": data, "layout": _plane_layout(plane)}


def retrace_figure(plane: JointPlane, executed: str) -> Figure:
    """One motion again and again, as measured: a color per payload, a dash per condition; and the ellipse of all."""
    data: list[dict[str, Any]] = []
    shared = plane.envelopes.get(MEASURED, {}).get(ANY_PAYLOAD)
    if shared is not None:
        outline = _line("all motions", *_ellipse(shared), Style("#808080", "dot", "circle-open", ""), width=1.5)
        data.append(outline)
    repetitions = repetitions_of(plane, executed)
    loads = list(dict.fromkeys(_payload_of(plane, motion) for motion in repetitions))
    conditions = list(dict.fromkeys(_condition_of(plane, motion) for motion in repetitions))
    colors = cycled_styles(loads)
    for motion in repetitions:
        points = plane.paths[motion][MEASURED]
        load, condition = _payload_of(plane, motion), _condition_of(plane, motion)
        style = Style(colors[load].color, _DASHES[conditions.index(condition) % len(_DASHES)], "circle", "")
        name = ", ".join(part for part in (condition, f"{load} kg" if load else "") if part) or motion
        data.append(_line(name, [x for x, _ in points], [y for _, y in points], style, width=1.5))
    return {"data": data, "layout": _plane_layout(plane)}


def repetitions_of(plane: JointPlane, executed: str) -> list[str]:
    """The motions whose path was kept that repeat one, by payload and condition."""
    found = [
        motion
        for motion, own in plane.executed.items()
        if own == executed and plane.paths.get(motion, {}).get(MEASURED)
    ]
    loads = group_order({_payload_of(plane, motion) for motion in found})
    return sorted(
        found, key=lambda motion: (loads.index(_payload_of(plane, motion)), _condition_of(plane, motion), motion)
    )


def _payload_of(plane: JointPlane, motion: str) -> str:
    return plane.payloads.get(motion, ANY_PAYLOAD)


def _condition_of(plane: JointPlane, motion: str) -> str:
    return plane.conditions.get(motion, "")


def _ellipse(envelope: Envelope) -> tuple[list[float], list[float]]:
    xx, xy, yy = envelope.covariance
    sizes, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    angle = np.linspace(0.0, 2.0 * np.pi, _CORNERS)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    outline = axes @ (_SIGMAS * np.sqrt(np.maximum(sizes, 0.0))[:, None] * circle)
    return (outline[0] + envelope.center[0]).tolist(), (outline[1] + envelope.center[1]).tolist()


def _line(source: str, x: Sequence[float], y: Sequence[float], style: Style, *, width: float) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": plot_text(source if source == MEASURED else run_title(source)),
        "legendgroup": plot_text(source),
        "x": [rounded(value) for value in x],
        "y": [rounded(value) for value in y],
        "line": {"color": style.color, "dash": style.dash, "width": width},
        "hovertemplate": "%{x:.3g}, %{y:.3g}",
    }


def _plane_layout(plane: JointPlane) -> dict[str, Any]:
    first, second = (
        f"main axis {number} [{plane.unit}], {100 * share:.0f} % of the variance"
        for number, share in enumerate(plane.share, start=1)
    )
    return {
        "height": 460,
        "xaxis": {"title": {"text": plot_text(first)}},
        "yaxis": {"title": {"text": plot_text(second)}, "scaleanchor": "x"},
    }


def _ordered(sources: Mapping[str, object], styles: Mapping[str, Style]) -> list[str]:
    """What was measured lies below the runs."""
    return [name for name in (MEASURED, *styles) if name in sources]


def _style(source: str, styles: Mapping[str, Style]) -> Style:
    return MEASURED_STYLE if source == MEASURED else styles[source]
