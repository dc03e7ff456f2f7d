"""The figure of docs/verdict-worth.md: where the truth lies in the interval of each number called determined."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

WIDTH, ROW, LEFT, TOP, RIGHT = 560, 30, 130, 34, 130
REACH = 2.5  # intervals to either side; what is further stands at the edge
# Okabe-Ito, with another shape besides: told apart without colour vision.
STYLE = (
    "text{font:12px system-ui,sans-serif;fill:#222}.name{text-anchor:end}.x{text-anchor:middle;font-size:10px}"
    ".label{text-anchor:middle;font-size:11px}.frame{fill:#fff;stroke:#bbb}.band{fill:#0072B2;opacity:.08}"
    ".rule{stroke:#e6e6e6}.zero{stroke:#999}.in{fill:#0072B2;fill-opacity:.45}.out{stroke:#D55E00;stroke-width:1.6}"
)


def figure(about: str, cases: Mapping[str, Sequence[float]]) -> str:
    """One row per robot: 0 is the fitted number, -1 and 1 are the ends of its interval.

    Args:
        about: what the figure shows.
        cases: robot -> how far the truth is from each number, in units of its interval.
    """
    height, bottom = ROW * max(1, len(cases)), TOP + ROW * max(1, len(cases))
    total = LEFT + WIDTH + RIGHT
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total} {bottom + 62}" role="img" aria-label="{about}">',
        f'<style>{STYLE}</style><rect width="100%" height="100%" fill="#fff"/>',
        f'<rect x="{LEFT}" y="{TOP}" width="{WIDTH}" height="{height}" class="frame"/>',
        f'<rect x="{_x(-1):.1f}" y="{TOP}" width="{_x(1) - _x(-1):.1f}" height="{height}" class="band"/>',
        f'<line x1="{_x(0):.1f}" x2="{_x(0):.1f}" y1="{TOP}" y2="{bottom}" class="zero"/>',
        f'<text x="{LEFT + WIDTH + 10}" y="{TOP - 10}">in the interval</text>',
    ]
    for tick in (-2, -1, 0, 1, 2):
        shown = str(tick).replace("-", "\N{MINUS SIGN}")
        parts.append(f'<text x="{_x(tick):.1f}" y="{bottom + 16}" class="x">{shown}</text>')
    for number, (case, values) in enumerate(cases.items()):
        parts += _row(case, values, TOP + ROW * number)
    middle = LEFT + WIDTH / 2
    parts.append(
        f'<text x="{middle}" y="{bottom + 33}" class="label">truth minus fitted number, in units of the interval</text>'
    )
    parts.append(
        f'<text x="{LEFT}" y="{bottom + 54}">dots: in the interval &#160; crosses: outside; at the edge, further than '
        f"{REACH:g}</text></svg>"
    )
    return "\n".join(parts) + "\n"


def _row(case: str, values: Sequence[float], top: float) -> Iterator[str]:
    yield f'<line x1="{LEFT}" x2="{LEFT + WIDTH}" y1="{top}" y2="{top}" class="rule"/>'
    yield f'<text x="{LEFT - 8}" y="{top + ROW / 2 + 4:.1f}" class="name">{case}</text>'
    for number, value in enumerate(values):
        x = _x(max(-REACH, min(REACH, value)))
        y = top + 6 + (ROW - 12) * (number * 0.618 % 1)  # apart, where many are at the same place
        if abs(value) <= 1:
            yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" class="in"/>'
        else:
            yield f'<path d="M{x - 3:.1f} {y - 3:.1f}l6 6m0 -6l-6 6" class="out"/>'
    held = sum(abs(value) <= 1 for value in values)
    yield f'<text x="{LEFT + WIDTH + 10}" y="{top + ROW / 2 + 4:.1f}">{held} of {len(values)}</text>'


def _x(value: float) -> float:
    return LEFT + WIDTH * (value + REACH) / (2 * REACH)
