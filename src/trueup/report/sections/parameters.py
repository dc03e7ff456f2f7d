"""What was identified, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trueup.core.fit_result import FitResult, FittedParameter
from trueup.core.parameters import split_name
from trueup.report.chooser import Chooser, Variant, make_chooser
from trueup.report.fit_words import (
    CAUSES,
    KINDS,
    as_sentence,
    change_words,
    kind_of,
    nominal_words,
    shown_value,
    sure_sentence,
)
from trueup.report.folder import RunFolder
from trueup.report.interval_figures import factor_span, interval_panels, intervals_figure
from trueup.report.labels import ordered
from trueup.report.numbers import plain, plural, pretty_unit, significant, with_unit
from trueup.report.sections.base import Section

# Longer lists begin folded, one line per quantity.
OPEN_ROWS = 48


@dataclass(frozen=True)
class ParameterRow:
    """One parameter as printed.

    Attributes:
        head: joint or body; the quantity for what the robot has once.
        nominal: what the model said.
        value: what was fitted.
        interval: its 95 % interval.
        change: factor or difference.
        bounds: where the search had to stay.
        kind: one of `KINDS`.
        sign: of that kind.
        words: that kind.
        remark: what the fit says about it.
    """

    head: str
    nominal: str
    value: str
    interval: str
    change: str
    bounds: str
    kind: str
    sign: str
    words: str
    remark: str


@dataclass(frozen=True)
class ParameterGroup:
    """The parameters of one quantity.

    Attributes:
        quantity: its name in files.
        title: what it is.
        unit: of all numbers in the table.
        cause: part of the gap that it belongs to.
        targets: heading of the first column.
        counts: sign and number of each kind, for the folded table.
        rows: one per joint or body.
    """

    quantity: str
    title: str
    unit: str
    cause: str
    targets: str
    counts: tuple[tuple[str, str, int], ...]
    rows: tuple[ParameterRow, ...]


def parameters_section(run: RunFolder) -> Section | None:
    """Only after an identification."""
    if run.fit is None:
        return None
    groups = parameter_groups(run.fit.free, run.gap.joints)
    context = {
        "lead": sure_sentence(run.fit),
        "facts": fit_facts(run.fit),
        "kinds": kind_counts(run.fit),
        "chooser": intervals_chooser(run.fit),
        "panels": [(item.quantity, item.title) for item in groups],
        "groups": groups,
        "open": sum(len(group.rows) for group in groups) <= OPEN_ROWS,
        "frozen": [(item.name, with_unit(plain(item.value), item.unit)) for item in run.fit.parameters if item.frozen],
        "left_out": left_out(run.fit.data),
    }
    return Section("parameters", "Parameters: what was identified, and how sure", context)


def parameter_groups(parameters: Sequence[FittedParameter], joints: Sequence[str]) -> list[ParameterGroup]:
    """By quantity, in the order of the causes, and in the order of the fit within."""
    found: dict[str, list[FittedParameter]] = {}
    for item in parameters:
        found.setdefault(split_name(item.name)[0], []).append(item)
    causes = ordered({item.cause for item in parameters}, CAUSES)
    names = sorted(found, key=lambda name: causes.index(found[name][0].cause))
    return [_group(name, found[name], joints) for name in names]


def intervals_chooser(fit: FitResult) -> Chooser | None:
    """One small figure per quantity; there is nothing to choose."""
    panels = interval_panels(fit.parameters)
    span = factor_span(panels)
    figures = {panel.quantity: intervals_figure(panel, span) for panel in panels}
    return make_chooser("parameters-chooser", [], lambda: Variant(figures=figures), preferred=()) if figures else None


def kind_counts(fit: FitResult) -> list[tuple[str, str, str]]:
    """Kind, sign and `7 determined`, of the kinds that occur: the legend of the figures."""
    kinds = [kind_of(item) for item in fit.parameters]
    return [(kind, sign, f"{kinds.count(kind)} {words}") for kind, (sign, words) in KINDS.items() if kind in kinds]


def fit_facts(fit: FitResult) -> list[str]:
    """What it was fitted to and by what, as far as the fit says so."""
    data, solver = fit.data, fit.solver
    episodes, seconds, samples = data.get("episodes"), data.get("seconds"), data.get("samples")
    parts = [plural(len(episodes), "motion")] if isinstance(episodes, Sequence) else []
    parts += [f"{significant(seconds)}\N{NO-BREAK SPACE}s"] if isinstance(seconds, int | float) else []
    parts += [plural(samples, "sample")] if isinstance(samples, int) else []
    sentences = [f"Fitted to {', '.join(parts)}."] if parts else []
    window = data.get("window_s")
    if isinstance(window, int | float):
        sentences.append(f"Each window of {window:g}\N{NO-BREAK SPACE}s starts from the measured state.")
    name = solver.get("name")
    if isinstance(name, str):
        steps = [(solver.get("iterations"), "iteration"), (solver.get("evaluations"), "evaluation")]
        counts = [plural(number, noun) for number, noun in steps if isinstance(number, int)]
        took = solver.get("seconds")
        counts += [f"{significant(took)}\N{NO-BREAK SPACE}s"] if isinstance(took, int | float) else []
        counts += [f"stopped: {solver['stop']}"] if isinstance(solver.get("stop"), str) else []
        sentences.append(f"Solver {name}: {', '.join(counts)}." if counts else f"Solver {name}.")
    if isinstance(solver.get("why"), str) and solver["why"]:
        sentences.append(f"Why: {solver['why'].rstrip('.')}.")
    return sentences


def left_out(data: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Motions that were neither fitted nor judged by: their split, and why."""
    splits = [data[key] for key in ("flagged", "refused") if isinstance(data.get(key), Mapping)]
    motions = [(split, own) for item in splits for split, own in item.items() if isinstance(own, Mapping)]
    return [(str(name), f"{why} ({split})") for split, own in motions for name, why in own.items()]


def _group(name: str, items: Sequence[FittedParameter], joints: Sequence[str]) -> ParameterGroup:
    kinds = [kind_of(item) for item in items]
    targets = {split_name(item.name)[1] for item in items}
    heading = "Joint" if targets <= set(joints) else "" if targets == {""} else "Body or joint"
    return ParameterGroup(
        quantity=name,
        title=items[0].label,
        unit=pretty_unit(items[0].unit),
        cause=items[0].cause,
        targets=heading,
        counts=tuple((kind, sign, kinds.count(kind)) for kind, (sign, _) in KINDS.items() if kind in kinds),
        rows=tuple(_row(item) for item in items),
    )


def _row(item: FittedParameter) -> ParameterRow:
    kind = kind_of(item)
    sign, words = KINDS[kind]
    if kind == "bound":
        sign = "◀" if item.at_bound == "low" else "▶"
        words = f"on its {'lower' if item.at_bound == 'low' else 'upper'} bound"
    item_value, (low, high) = shown_value(item), item.interval
    return ParameterRow(
        head=split_name(item.name)[1] or item.name,
        nominal=nominal_words(item),
        value=plain(item_value) if item.at_bound else significant(item_value),
        interval=f"{significant(low)} to {significant(high)}",
        change=change_words(item),
        bounds=f"{plain(item.low)} to {plain(item.high)}",
        kind=kind,
        sign=sign,
        words=words,
        remark=as_sentence(item.sentence),
    )
