"""One color, dash, symbol and hatching per run, so that color is never the only cue.

The hues are those of Okabe and Ito (Color Universal Design, 2008) that stand out on white and on near-black.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass

from trueup.report.labels import COMMAND, SPLITS, ordered, ordered_runs


@dataclass(frozen=True)
class Style:
    """How one run or split is drawn.

    Attributes:
        color: CSS color.
        dash: plotly dash of lines.
        symbol: plotly marker symbol.
        pattern: plotly hatching of bars, empty for a plain bar.
    """

    color: str
    dash: str
    symbol: str
    pattern: str

    def to_json(self) -> dict[str, str]:
        """For the script of the report."""
        return asdict(self)


_COMMAND_STYLE = Style("#808080", "dot", "circle-open", ".")
_CYCLE = (
    Style("#0072b2", "solid", "circle", ""),
    Style("#d55e00", "dash", "square", "/"),
    Style("#009e73", "dashdot", "diamond", "x"),
    Style("#cc79a7", "longdash", "triangle-up", "-"),
    Style("#e69f00", "longdashdot", "triangle-down", "|"),
    Style("#56b4e9", "dash", "cross", "+"),
)
_SPLIT_STYLES = {
    "train": Style("#808080", "dot", "circle-open", "."),
    "val": Style("#e69f00", "dash", "square", "/"),
    "test": Style("#0072b2", "solid", "circle", ""),
}


def run_styles(labels: Iterable[str]) -> dict[str, Style]:
    """The style of every run; the same labels always get the same styles."""
    runs = [label for label in ordered_runs(set(labels)) if label != COMMAND]
    styles = {label: _CYCLE[number % len(_CYCLE)] for number, label in enumerate(runs)}
    return {COMMAND: _COMMAND_STYLE, **styles}  # in the order of the report


def split_styles(splits: Iterable[str]) -> dict[str, Style]:
    """The style of every split."""
    names = ordered(splits, SPLITS)
    spare = iter(_CYCLE[2:] * len(names))
    return {name: _SPLIT_STYLES.get(name) or next(spare) for name in names}
