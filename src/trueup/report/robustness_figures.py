"""Figures of how far a correction carries: the share of the error that is gone (SAT, Fig. 9 and 10); see `figures`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from trueup.core.results import Estimate
from trueup.report.chooser import Figure
from trueup.report.figures import rounded, whiskers
from trueup.report.labels import plot_text
from trueup.report.palette import Style
from trueup.report.robustness_words import gone_words

# Lines stand beside each other, this share of the axis apart: equal whiskers would hide each other.
_BESIDE = 0.012
_GONE = "error that is gone [%]"


def sizes_figure(
    as_it_is: Estimate, lines: Mapping[str, Mapping[float, Estimate]], styles: Mapping[str, Style]
) -> Figure:
    """Share of the error that is gone over the share of the largest size, one line with whiskers per perturbation.

    Args:
        as_it_is: with the simulator as it is, where all lines begin.
        lines: perturbation -> share of its largest size -> share of the error.
        styles: how each line is drawn.
    """
    most = max((share for points in lines.values() for share in points), default=1.0)
    data = []
    for number, (name, points) in enumerate(lines.items()):
        shift = _BESIDE * most * (number - 0.5 * (len(lines) - 1))
        known = {0.0: as_it_is, **points}
        data.append(
            {
                **_marks(name, list(known.values()), styles[name]),
                "mode": "lines+markers",
                "x": [rounded(100.0 * (share + shift)) for share in known],
                "customdata": [rounded(100.0 * share) for share in known],
                "hovertemplate": "%{customdata} % of the size: %{text}",
                "line": {"color": styles[name].color, "dash": styles[name].dash, "width": 1.5},
            }
        )
    layout = {
        "height": 400,
        "xaxis": {"title": {"text": "share of the size [%]"}, "zeroline": False},
        "yaxis": _percent_axis([as_it_is, *(item for points in lines.values() for item in points.values())]),
        "shapes": [_no_help()],
    }
    return {"data": data, "layout": layout}


def datasets_figure(gone: Mapping[str, Estimate], style: Style) -> Figure:
    """Share of the error that is gone on each dataset, in their order."""
    names = [plot_text(name) for name in gone]
    data = [
        {
            **_marks(_GONE, list(gone.values()), style),
            "mode": "lines+markers",
            "x": list(range(len(names))),
            "hovertemplate": "%{text}",
            "line": {"color": style.color, "dash": "dot", "width": 1.0},
            "showlegend": False,
        }
    ]
    layout = {
        "height": 320,
        "xaxis": {
            "tickvals": list(range(len(names))),
            "ticktext": names,
            "range": [-0.5, len(names) - 0.5],
            "zeroline": False,
        },
        "yaxis": _percent_axis(list(gone.values())),
        "shapes": [_no_help()],
    }
    return {"data": data, "layout": layout}


def _marks(name: str, values: Sequence[Estimate], style: Style) -> dict[str, Any]:
    shown = [_in_percent(item) for item in values]
    return {
        "type": "scatter",
        "name": plot_text(name),
        "y": [rounded(item.value) for item in shown],
        "error_y": whiskers(shown) | {"color": style.color},
        "marker": {"color": style.color, "symbol": style.symbol, "size": 8},
        "text": [gone_words(item) for item in values],
    }


def _in_percent(item: Estimate) -> Estimate:
    low, high = (None if end is None else 100.0 * end for end in (item.low, item.high))
    return Estimate(100.0 * item.value, "%", low, high)


def _percent_axis(values: Sequence[Estimate]) -> dict[str, Any]:
    """From no help, or the worst harm, to all of the error; whiskers of two motions may leave it."""
    least = min([0.0, *(100.0 * item.value for item in values)])
    ends = min([least, *(100.0 * item.low for item in values if item.low is not None)])
    low = max(ends, least - 50.0)
    return {"title": {"text": _GONE}, "range": [rounded(low - 4.0), 102], "zeroline": False}


def _no_help() -> dict[str, Any]:
    """A horizontal line behind the data: below it, a correction harms."""
    line = {"color": "#808080", "width": 2}
    return {"type": "line", "xref": "paper", "yref": "y", "x0": 0, "x1": 1, "y0": 0, "y1": 0, "layer": "below"} | {
        "line": line
    }
