"""Shares of the gap as stacked bars; see `figures`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from trueup.report.chooser import Figure
from trueup.report.figures import hatched, reference_line, rounded
from trueup.report.labels import plot_text
from trueup.report.numbers import percent
from trueup.report.palette import Style


def shares_figure(
    shares: Mapping[str, Mapping[str, float]], titles: Mapping[str, str], styles: Mapping[str, Style]
) -> Figure:
    """Stacked bars: how much of the squared error each cause took away, row by row.

    A negative share is drawn to the left of zero; the bars to the right then reach beyond 100 %, as they must for the
    sum to be 100 %.

    Args:
        shares: row -> cause -> share of 1.
        titles: cause -> its name, in the order of the stack.
        styles: how each cause is drawn.
    """
    rows = [row for row in shares if any(math.isfinite(value) for value in shares[row].values())]
    data = []
    for cause, title in titles.items():
        shown = [row for row in rows if math.isfinite(shares[row].get(cause, math.nan))]
        data.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": plot_text(title),
                "y": [plot_text(row) for row in shown],
                "x": [rounded(100.0 * shares[row][cause]) for row in shown],
                "marker": hatched(styles[cause]),
                "text": [percent(shares[row][cause], sign=False) for row in shown],
                "textposition": "none",
                "hovertemplate": "%{y}: %{text}",
            }
        )
    layout = {
        "barmode": "relative",
        "bargap": 0.35,
        # On a phone the legend takes a line per cause.
        "height": 90 + 20 * len(titles) + 34 * len(rows),
        "xaxis": {
            "title": {"text": "share of the squared error [%]"},
            "range": share_range([shares[row] for row in rows]),
        },
        "yaxis": {
            "type": "category",
            "categoryorder": "array",
            "categoryarray": [plot_text(row) for row in rows],
            "range": [len(rows) - 0.4, -0.6],
        },
        "shapes": [reference_line(100.0), reference_line(0.0)],
        "legend": {"traceorder": "normal"},
    }
    return {"data": data, "layout": layout}


def share_range(rows: Sequence[Mapping[str, float]]) -> list[float]:
    """The axis of stacked shares in percent: 0 to 100 at least, and all of what sticks out on either side."""
    finite = [[value for value in row.values() if math.isfinite(value)] for row in rows]
    low = min([0.0, *(sum(value for value in values if value < 0) for values in finite)])
    high = max([1.0, *(sum(value for value in values if value > 0) for values in finite)])
    pad = 0.02 * (high - low)
    return [float(f"{100 * (low - pad if low < 0 else 0.0):.6g}"), float(f"{100 * (high + pad):.6g}")]
