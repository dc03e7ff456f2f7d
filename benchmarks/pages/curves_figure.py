"""Panels of learning curves as one SVG: reward of a control step over control steps, a line per group of seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import ceil, floor

import numpy as np

WIDTH, HEIGHT, LEFT, TOP = 290, 170, 52, 34
ACROSS, DOWN, COLUMNS = WIDTH + 62, HEIGHT + 106, 3
# Okabe-Ito, with dashes besides: told apart without colour vision.
STYLES = (("#0072B2", ""), ("#D55E00", "6 3"), ("#009E73", "2 2"), ("#000000", "8 3 2 3"))
STYLE = (
    "text{font:12px system-ui,sans-serif;fill:#222}.title{font-size:13px;font-weight:600}"
    ".y{text-anchor:end;font-size:10px}.x{text-anchor:middle;font-size:10px}.label{text-anchor:middle;font-size:11px}"
    ".frame{fill:#fff;stroke:#bbb}polyline{fill:none;stroke-width:1.8}.band{opacity:.15}.grid{stroke:#e6e6e6}"
)
# Group -> its seeds, each a list of (control steps, reward).
Panel = Mapping[str, Sequence[Sequence[tuple[float, float]]]]


def figure(about: str, panels: Mapping[str, Panel]) -> str:
    """All panels have the same axes; lines are means over seeds, bands go from the least to the largest.

    The first fifth is left out where it goes below the frame: all begin far down.
    """
    every = [point for panel in panels.values() for seeds in panel.values() for curve in seeds for point in curve]
    last = max(x for x, _ in every)
    low, high = floor(5 * min(y for x, y in every if x > last / 5)) / 5, ceil(5 * max(y for _, y in every)) / 5
    columns = min(COLUMNS, len(panels))
    total = LEFT + columns * ACROSS, DOWN * ceil(len(panels) / columns)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total[0]} {total[1]}" role="img" aria-label="{about}">',
        f'<style>{STYLE}</style><rect width="100%" height="100%" fill="#fff"/>',
        f'<clipPath id="inside"><rect width="{WIDTH}" height="{HEIGHT}"/></clipPath>',
    ]
    for number, (title, panel) in enumerate(panels.items()):
        row, column = divmod(number, columns)
        corner = (LEFT + column * ACROSS, TOP + row * DOWN)
        parts += _panel(title, panel, corner, (low, high), last)
    return "\n".join([*parts, "</svg>"]) + "\n"


def _panel(title: str, panel: Panel, corner: tuple[int, int], span: tuple[float, float], last: float) -> Iterator[str]:
    x0, y0 = corner

    def place(x: float, y: float) -> str:
        return f"{WIDTH * x / last:.1f},{HEIGHT * (span[1] - y) / (span[1] - span[0]):.1f}"

    yield f'<text x="{x0}" y="{y0 - 10}" class="title">{title}</text>'
    yield f'<rect x="{x0}" y="{y0}" width="{WIDTH}" height="{HEIGHT}" class="frame"/>'
    for tick in np.linspace(*span, 5):
        y = y0 + HEIGHT * (span[1] - tick) / (span[1] - span[0])
        yield f'<line x1="{x0}" x2="{x0 + WIDTH}" y1="{y:.1f}" y2="{y:.1f}" class="grid"/>'
        yield f'<text x="{x0 - 5}" y="{y + 4:.1f}" class="y">{tick:.2f}</text>'
    for share in (0.0, 0.5, 1.0):
        x = x0 + WIDTH * share
        yield f'<text x="{x:.1f}" y="{y0 + HEIGHT + 15}" class="x">{share * last / 1000:g}</text>'
    middle = x0 + WIDTH / 2
    yield f'<text x="{middle}" y="{y0 + HEIGHT + 30}" class="label">thousand control steps</text>'
    up = f"translate({x0 - 40},{y0 + HEIGHT / 2}) rotate(-90)"
    yield f'<text transform="{up}" class="label">reward of a control step</text>'
    for number, (name, seeds) in enumerate(panel.items()):
        color, dash = STYLES[number]
        x, ends = _over_seeds(seeds)
        around = [*zip(x, ends[0], strict=True), *reversed([*zip(x, ends[2], strict=True)])]
        yield f'<g transform="translate({x0},{y0})" clip-path="url(#inside)">'
        yield f'<polygon class="band" fill="{color}" points="{" ".join(place(*point) for point in around)}"/>'
        line = " ".join(place(*point) for point in zip(x, ends[1], strict=True))
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        yield f'<polyline stroke="{color}"{dashes} points="{line}"/></g>'
        at = x0 + number * WIDTH / len(panel)
        y = y0 + HEIGHT + 50
        yield f'<line x1="{at:.1f}" x2="{at + 22:.1f}" y1="{y}" y2="{y}" stroke="{color}" stroke-width="2"{dashes}/>'
        yield f'<text x="{at + 27:.1f}" y="{y + 4}">{name}</text>'


def _over_seeds(seeds: Sequence[Sequence[tuple[float, float]]]) -> tuple[list[float], np.ndarray]:
    """Places, and least, mean and largest there: as far as all seeds go (one that diverged ends sooner)."""
    count = min(len(curve) for curve in seeds)
    rows = np.array([[point[1] for point in curve[:count]] for curve in seeds])
    return [point[0] for point in seeds[0][:count]], np.stack([rows.min(axis=0), rows.mean(axis=0), rows.max(axis=0)])
