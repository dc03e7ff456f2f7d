"""One color, dash, symbol and hatching per run, so that color is never the only cue.

The hues are those of Okabe and Ito (Color Universal Design, 2008) that stand out on white and on near-black.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from itertools import cycle

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


# How sure a fitted parameter is: dash and symbol tell it without color.
KIND_STYLES = {
    "yes": Style("#0072b2", "solid", "circle", ""),
    "effective": Style("#56b4e9", "solid", "circle-open", ""),
    "weakly": Style("#e69f00", "dash", "diamond", ""),
    "zero": Style("#808080", "dot", "circle-open", ""),
    "no": Style("#d55e00", "dot", "x", ""),
    "bound": Style("#cc79a7", "dash", "triangle-left", ""),
}
_CAUSE_STYLES = {
    "delay": Style("#56b4e9", "dash", "cross", "/"),
    "gains": Style("#0072b2", "solid", "circle", ""),
    "friction": Style("#d55e00", "dash", "square", "x"),
    "gravity": Style("#009e73", "dashdot", "diamond", "-"),
    "inertia": Style("#cc79a7", "longdash", "triangle-up", "|"),
    "unexplained": Style("#808080", "dot", "circle-open", "."),
}


def run_styles(labels: Iterable[str]) -> dict[str, Style]:
    """The style of every run; the same labels always get the same styles."""
    runs = [label for label in ordered_runs(set(labels)) if label != COMMAND]
    styles = {label: _nth(number) for number, label in enumerate(runs)}
    return {COMMAND: _COMMAND_STYLE, **styles}  # in the order of the report


def split_styles(splits: Iterable[str]) -> dict[str, Style]:
    """The style of every split."""
    names = ordered(splits, SPLITS)
    spare = iter(_CYCLE[2:] * len(names))
    return {name: _SPLIT_STYLES.get(name) or next(spare) for name in names}


def cause_styles(causes: Iterable[str]) -> dict[str, Style]:
    """The style of every part of a gap."""
    spare = cycle(_CYCLE[4:])
    return {cause: _CAUSE_STYLES.get(cause) or next(spare) for cause in causes}


def cycled_styles(names: Iterable[str]) -> dict[str, Style]:
    """Styles for things that stand for themselves, in their order; the first is what the others are compared with."""
    first, *others = list(names)
    return {first: _COMMAND_STYLE, **{name: _nth(number) for number, name in enumerate(others)}}


def _nth(number: int) -> Style:
    """A style of the cycle; from its second round on each color comes with the marks of its neighbor."""
    marks = _CYCLE[(number + number // len(_CYCLE)) % len(_CYCLE)]
    return replace(marks, color=_CYCLE[number % len(_CYCLE)].color)
