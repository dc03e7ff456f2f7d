"""Where networks with attention look in the past: words, a figure and a table, a part of the learned corrections."""

from __future__ import annotations

from collections.abc import Mapping

from trueup.core.attention import AttentionProfile
from trueup.core.augment_result import AugmentResult
from trueup.core.results import Estimate
from trueup.report.augment_figures import attention_figure
from trueup.report.chooser import Cell, Chooser, Table, TableRow, Variant
from trueup.report.numbers import percent, plural, quantity
from trueup.report.palette import Style

# On the oldest quarter of the history: clearly more than a quarter, and next to nothing.
_MUCH, _LITTLE = 0.35, 0.05
_CAPTION = (
    "Half within: the lag within which half of the attention lies, mean over motions, with its 95 % interval over "
    "motions below it; oldest quarter: the share on the oldest quarter of what the network sees."
)


def attention_chooser(result: AugmentResult, styles: Mapping[str, Style]) -> Chooser | None:
    """Figure and table of the networks that have attention."""
    known = _known(result)
    if not known:
        return None
    columns = ["Network", "Sees back", "Half within", "Present sample", "Oldest quarter", "Motions"]
    rows = [
        TableRow(
            name,
            [
                Cell(quantity(1e3 * item.span_s, "ms"), note=plural(len(item.mean) - 1, "sample")),
                Cell(quantity(1e3 * item.half_s.value, "ms"), note=_ends(item.half_s, 1e3, "ms")),
                Cell(percent(item.mean[0], sign=False)),
                Cell(percent(item.oldest.value, sign=False), note=_ends(item.oldest, 1.0, "")),
                Cell(str(item.motions)),
            ],
        )
        for name, item in known.items()
    ]
    tables = {"attention": Table(columns, rows, _CAPTION)}
    return Chooser("attention-chooser", [], Variant(tables, {"attention": attention_figure(known, styles)}), [])


def attention_sentences(result: AugmentResult) -> list[str]:
    """How far back each network looks, and what that says about its history."""
    return [f"{name} {_looks(item)}" for name, item in _known(result).items()]


def _looks(item: AttentionProfile) -> str:
    samples = plural(len(item.mean) - 1, "sample")
    half = f"{quantity(1e3 * item.half_s.value, 'ms')} ({plural(round(item.half_s.value * item.rate_hz), 'sample')})"
    line = (
        f"sees {quantity(1e3 * item.span_s, 'ms')} back ({samples}); half of its attention lies on the last {half}, "
        f"{percent(item.oldest.value, sign=False)} on the oldest quarter."
    )
    low, high = (item.oldest.value if end is None else end for end in (item.oldest.low, item.oldest.high))
    if low > _MUCH:
        return f"{line} That is more than if all samples counted alike: a longer history is worth a try."
    if high < _LITTLE:
        return f"{line} It hardly uses that: a shorter history may do, and its steps would take less time."
    return line


def _known(result: AugmentResult) -> dict[str, AttentionProfile]:
    return {model.name: model.attention for model in result.models if model.attention is not None}


def _ends(item: Estimate, factor: float, unit: str) -> str:
    if item.low is None or item.high is None:
        return ""
    if not unit:
        return f"{percent(item.low, sign=False)} to {percent(item.high, sign=False)}"
    return f"{quantity(factor * item.low, unit)} to {quantity(factor * item.high, unit)}"
