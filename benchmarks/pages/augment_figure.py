"""The figure of docs/learned-corrections.md: error by number of motions, with the residual and with the plain loss."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import log

from benchmarks.pages.augment_data import TARGETS, TEST_NAMES, counts_of
from trueup.core.augment_result import ALL_JOINTS, AugmentResult
from trueup.core.results import Estimate

NAME = "learned-corrections.svg"
WIDTH, HEIGHT, LEFT, GAP, TOP = 380, 190, 56, 70, 34
# Okabe-Ito: told apart without colour vision; the plain loss is dashed as well, and drawn a little to the right.
COLORS = {"residual": "#0072B2", "plain": "#D55E00"}
ASIDE = {"residual": -3.0, "plain": 3.0}
STYLE = (
    "text{font:12px system-ui,sans-serif;fill:#222}.title{font-size:14px;font-weight:600}"
    ".y{text-anchor:end;font-size:10px}.x{text-anchor:middle;font-size:10px}.label{text-anchor:middle;font-size:11px}"
    ".frame{fill:#fff;stroke:#bbb}polyline{fill:none;stroke-width:1.6}line{stroke-width:1.2}"
)


def figure(amounts: AugmentResult) -> str:
    """Torque RMSE of all joints on two tests, like Fig. 12 of the LSTM thesis; whiskers are 95 % intervals."""
    counts = counts_of(amounts)
    about = "Torque error by number of train motions, with the residual and with the plain loss"
    total = LEFT + 2 * WIDTH + GAP + 20
    legend = "blue: residual loss &#160; orange, dashed: plain loss &#160; whiskers: 95 % over test motions"
    bottom = TOP + HEIGHT + 64
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total} {bottom}" role="img" aria-label="{about}">',
        f'<style>{STYLE}</style><rect width="100%" height="100%" fill="#fff"/>',
    ]
    for number, test in enumerate(("multi-joint", "cartesian")):
        parts += _panel(amounts, counts, test, LEFT + number * (WIDTH + GAP))
    parts.append(f'<text x="{LEFT}" y="{TOP + HEIGHT + 56}">{legend}</text></svg>')
    return "\n".join(parts) + "\n"


def _panel(amounts: AugmentResult, counts: Sequence[int], test: str, x0: int) -> Iterator[str]:
    curves = {
        target: [amounts.model(f"amount-{count}-{target}").cuts[test]["torque"][ALL_JOINTS].rmse for count in counts]
        for target in TARGETS
    }
    top = _ceiling(max(_high(item) for curve in curves.values() for item in curve))
    yield f'<text x="{x0}" y="20" class="title">{TEST_NAMES[test]}</text>'
    yield f'<rect x="{x0}" y="{TOP}" width="{WIDTH}" height="{HEIGHT}" class="frame"/>'
    middle = TOP + HEIGHT / 2
    yield f'<text transform="translate({x0 - 38},{middle:.1f}) rotate(-90)" class="label">torque RMSE [Nm]</text>'
    for tick in (0.0, top / 2, top):
        yield f'<text x="{x0 - 5}" y="{_y(tick, top) + 4:.1f}" class="y">{tick:g}</text>'
    for count in counts:
        yield f'<text x="{_x(count, counts, x0):.1f}" y="{TOP + HEIGHT + 16}" class="x">{count}</text>'
    yield f'<text x="{x0 + WIDTH / 2:.1f}" y="{TOP + HEIGHT + 33}" class="label">train motions</text>'
    for target, curve in curves.items():
        yield from _curve(target, [_x(count, counts, x0) + ASIDE[target] for count in counts], curve, top)


def _curve(target: str, places: Sequence[float], curve: Sequence[Estimate], top: float) -> Iterator[str]:
    color = COLORS[target]
    dash = ' stroke-dasharray="5 3"' if target == "plain" else ""
    points = " ".join(f"{x:.1f},{_y(item.value, top):.1f}" for x, item in zip(places, curve, strict=True))
    yield f'<polyline points="{points}" stroke="{color}"{dash}/>'
    for x, item in zip(places, curve, strict=True):
        yield f'<circle cx="{x:.1f}" cy="{_y(item.value, top):.1f}" r="3" fill="{color}"/>'
        if item.low is not None and item.high is not None:
            ends = f'y1="{_y(item.low, top):.1f}" y2="{_y(item.high, top):.1f}"'
            yield f'<line x1="{x:.1f}" x2="{x:.1f}" {ends} stroke="{color}"/>'


def _x(count: int, counts: Sequence[int], x0: int) -> float:
    """Every doubling is as wide."""
    share = log(count / counts[0]) / log(counts[-1] / counts[0]) if len(counts) > 1 else 0.5
    return x0 + 30 + (WIDTH - 60) * share


def _y(value: float, top: float) -> float:
    return TOP + HEIGHT * (1 - value / top)


def _high(item: Estimate) -> float:
    return item.value if item.high is None else item.high


def _ceiling(value: float) -> float:
    """The next number that begins with 1, 2, 4 or 6 and goes on with zeros."""
    power = 10.0 ** _exponent(value)
    return next(step * power for step in (1, 2, 4, 6, 10) if step * power >= value)


def _exponent(value: float) -> int:
    return int(f"{value:e}".split("e")[1])
