"""What learned corrections are worth, as tables for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from trueup.core.augment_result import (
    ALL_JOINTS,
    ANY_CONDITION,
    AugmentResult,
    Cut,
    JointGap,
    ModelEvaluation,
    group_title,
    joint_title,
)
from trueup.core.results import Estimate
from trueup.core.timeseries import BODY_PREFIX

# More joints than this do not fit beside each other.
_MOST_COLUMNS = 10
_SIMULATION = "simulation"
_NOTHING = "-"


def shown_groups(result: AugmentResult) -> list[str]:
    """The conditions, and all motions together only if that says more."""
    named = [name for name in result.conditions if name != ANY_CONDITION]
    complete = sum(result.motions[name] for name in named) == result.motions[ANY_CONDITION]
    return named if named and complete else list(result.conditions)


def cut_table(result: AugmentResult, condition: str, signal: str) -> Table:
    """MSE of one signal joint by joint, and how many times smaller a correction makes it (Realeasy, Table II)."""
    joints = result.joints_of(condition, signal)
    stock, unit = result.simulated[condition][signal], result.unit_of(condition, signal, "mse")
    rows = [[_SIMULATION, *(_value(stock[joint].mse, unit) for joint in joints)]]
    for model in result.models:
        cuts = model.cuts[condition].get(signal, {})
        rows.append([model.name, *(_cut_cell(cuts.get(j), unit, off=result.is_off(model, signal, j)) for j in joints)])
    title = (
        f"{signal} MSE{_bracketed(unit)}, {_group_line(result, condition)}; "
        "x: times smaller than the simulation [95 % interval]"
    )
    return _laid_out(title, [""], [joint_title(joint, signal) for joint in joints], rows)


def error_table(result: AugmentResult, condition: str, signals: Sequence[str]) -> Table:
    """RMSE of other signals, with a word where a correction does not make it smaller for sure."""
    joints = list(dict.fromkeys(joint for signal in signals for joint in result.joints_of(condition, signal)))
    rows = []
    for signal in signals:
        stock, unit = result.simulated[condition][signal], result.unit_of(condition, signal, "rmse")
        about = f"{signal}{_bracketed(unit)}"
        known = [stock.get(joint) for joint in joints]
        rows.append([about, _SIMULATION, *(_NOTHING if item is None else _value(item.rmse, unit) for item in known)])
        for model in result.models:
            cuts = model.cuts[condition].get(signal, {})
            cells = [_error_cell(cuts.get(j), unit, off=result.is_off(model, signal, j)) for j in joints]
            rows.append(["", model.name, *cells])
    bodies = all(signal.startswith(BODY_PREFIX) for signal in signals)
    title = f"RMSE, {_group_line(result, condition)}; ~ undecided, off: switched off by its training"
    return _laid_out(title, ["", ""], [joint_title(joint, signals[0] if bodies else "") for joint in joints], rows)


def joint_gap_table(result: AugmentResult) -> Table:
    """How far corrected bodies have come apart at their joints: mean, and mean over motions of the largest."""
    table = Table(title=_text("bodies apart at their joints: mean, largest of a motion"), title_justify="left")
    table.add_column("joint")
    known = {"measured": result.measured_gaps} if result.measured_gaps else {}
    runs = {**known, _SIMULATION: result.gaps, **{model.name: model.gaps for model in result.models if model.gaps}}
    for name in runs:
        table.add_column(_text(name), justify="right")
    for joint in result.gaps if any(model.gaps for model in result.models) else ():
        cells = [_gap_cell(gaps.get(joint)) for gaps in runs.values()]
        table.add_row(_text(joint_title(joint)), *map(_text, cells))
    return table


def _gap_cell(gap: JointGap | None) -> str:
    if gap is None:
        return _NOTHING
    pairs = ((gap.apart, gap.apart_max), (gap.turned, gap.turned_max))
    return "\n".join(f"{mean.value:.3g}, {most.value:.3g} {mean.unit}" for mean, most in pairs)


def confidence_table(result: AugmentResult, signal: str) -> Table:
    """How often the intervals of a signal hold, and how reliable "far off" is: one row per network and group."""
    table = Table(title=_text(f"{signal}: intervals and warnings, all joints [95 % interval]"), title_justify="left")
    for name in ("", "motions"):
        table.add_column(name, no_wrap=True)
    for name in ("covered", "promised", "half width", "far off", "calibration error", "skill"):
        table.add_column(name, justify="right")
    for model in result.models:
        for condition in shown_groups(result):
            cells = _confidence_cells(model, condition, signal)
            if any(cells):
                about = [model.name, group_title(condition)]
                table.add_row(*map(_text, about), *(_text(cell or _NOTHING) for cell in cells))
    return table


def gated_lines(result: AugmentResult) -> list[str]:
    """Which outputs are switched off and why, one line per network."""
    lines = []
    for model in result.models:
        if model.gated:
            names, reasons = result.off_outputs(model), model.off_reasons
            why = f": {reasons[0]}" + (", and the like" if len(reasons) > 1 else "") if reasons else ""
            lines.append(f"{model.name} leaves {'; '.join(names)} as simulated{why}")
    return lines


def _confidence_cells(model: ModelEvaluation, condition: str, signal: str) -> list[str]:
    coverage = model.coverage.get(condition, {}).get(signal, {}).get(ALL_JOINTS)
    reliability = model.reliability.get(condition, {}).get(signal)
    cells = [""] * 6
    if coverage is not None:
        cells[:3] = [
            f"{_percent(coverage.share)}",
            _NOTHING if model.coverage_note else f"{100 * model.coverage_target:.0f} %",
            f"{coverage.half_width.value:.3g} {coverage.half_width.unit}",
        ]
    if reliability is not None:
        skill = _NOTHING if reliability.skill is None else f"{reliability.skill:.2f}"
        cells[3:] = [f"{100 * reliability.far:.1f} %", f"{100 * reliability.error:.1f} %", skill]
    return cells


def _percent(share: Estimate) -> str:
    if share.low is None or share.high is None:
        return f"{100 * share.value:.1f} %"
    return f"{100 * share.value:.1f} % [{100 * share.low:.1f}, {100 * share.high:.1f}]"


def _group_line(result: AugmentResult, condition: str) -> str:
    """E.g. `multi-joint, test, 42 motions`."""
    count = result.motions[condition]
    split = () if result.split == "all" else (result.split,)
    return ", ".join((group_title(condition), *split, f"{count} motion{'' if count == 1 else 's'}"))


def _value(estimate: Estimate, unit: str) -> str:
    return f"{estimate.value:.3g}" if unit else f"{estimate.value:.3g} {estimate.unit}"


def _cut_cell(cut: Cut | None, unit: str, *, off: bool) -> str:
    if cut is None:
        return _NOTHING
    return "\n".join([_value(cut.mse, unit), *(["off"] if off else _factor_lines(cut))])


def _factor_lines(cut: Cut) -> list[str]:
    factor = cut.factor
    if math.isnan(factor.value):
        return ["nothing left"] if cut.mse.value == 0.0 else []
    word = {"better": "", "undecided": " ~", "worse": " worse"}[cut.verdict]
    if factor.low is None:
        ends = []
    else:
        ends = [f"above {factor.low:.3g}" if factor.high is None else f"[{factor.low:.3g}, {factor.high:.3g}]"]
    return [f"x{factor.value:.3g}{word}", *ends]


def _error_cell(cut: Cut | None, unit: str, *, off: bool) -> str:
    if cut is None:
        return _NOTHING
    word = " off" if off else {"better": "", "undecided": " ~", "worse": " worse"}[cut.verdict]
    return f"{_value(cut.rmse, unit)}{word}"


def _bracketed(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _text(text: str) -> Text:
    """Brackets are no markup here."""
    return Text(text)


def _laid_out(title: str, corners: Sequence[str], names: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """One row per network and one column per joint, or the other way round where there are too many joints."""
    table = Table(title=_text(title), title_justify="left")
    if len(names) <= _MOST_COLUMNS:
        for corner in corners:
            table.add_column(corner, no_wrap=True)
        for name in names:
            table.add_column(_text(name), justify="right")
        for row in rows:
            table.add_row(*map(_text, row))
        return table
    table.add_column("")
    heads, cells = [row[: len(corners)] for row in rows], [row[len(corners) :] for row in rows]
    for head in heads:
        table.add_column(_text("\n".join(part for part in head if part)), justify="right")
    for name, column in zip(names, zip(*cells, strict=True), strict=True):
        table.add_row(_text(name), *map(_text, column))
    return table
