"""A fit as tables for the terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from trueup.cli.tables import number
from trueup.core.attribution import Attribution
from trueup.core.fit_result import IDENTIFIED, FitResult, FittedParameter

if TYPE_CHECKING:
    from trueup.identify.experiments import ExperimentResult

_STYLE = {"yes": "", "effective": "cyan", "weakly": "yellow", "no": "red"}
_HINT = {
    "not-identifiable": "Record motions that show these parameters (see the remarks in the table), or freeze them.",
    "unexplained": "See what may be missing in the report, or use the model for motions like these only.",
    "signal-worse": "Check sign, scale and unit of that signal, or weigh it (signals: {torque: …}) and fit again.",
    "at-bound": "Widen the bound in the configuration, or doubt the structure of the model.",
    "not-converged": "Allow more iterations, evaluations, seconds or starts (solver: …); run again with --overwrite.",
    "no-better": "Check that robot, model and logs belong together: joint map, units, delays, payload.",
}


def parameter_table(fit: FitResult) -> Table:
    """One row per fitted parameter; what is not determined is red."""
    table = Table(title="fitted parameters [95 % interval]", title_justify="left")
    for name, side in (("parameter", "left"), ("model said", "right"), ("fitted", "right"), ("interval", "right")):
        table.add_column(name, justify="right" if side == "right" else "left")
    table.add_column("unit")
    table.add_column("how sure", overflow="fold")
    for item in fit.free:
        low, high = item.interval
        stuck = item.at_bound and not item.absent and item.low != item.value != 0.0
        style = "red" if stuck else _STYLE[item.identified]
        table.add_row(
            escape(item.name),
            "none" if item.nominal is None else f"{item.nominal:.4g}",
            f"{item.value:.4g}",
            f"[{low:.3g}, {high:.3g}]",
            item.unit,
            escape(_remark(item)),
            style=style,
        )
    return table


def model_table(fit: FitResult) -> Table:
    """One row per model that was tried."""
    splits = [split for split in ("train", "val", "test") if any(split in row.splits for row in fit.models)]
    table = Table(
        title="models that were tried: position RMSE, mean over motions [95 % interval]", title_justify="left"
    )
    table.add_column("model")
    table.add_column("parameters", justify="right")
    for split in splits:
        table.add_column(split, justify="right")
    table.add_column("seconds", justify="right")
    for row in fit.models:
        cells = [escape(number(row.splits[split])) if split in row.splits else "" for split in splits]
        table.add_row(row.name + (" *" if row.chosen else ""), str(row.parameters), *cells, f"{row.seconds:.1f}")
    return table


def experiment_table(found: ExperimentResult) -> Table:
    """One row per joint and quantity."""
    table = Table(title=f"{found.experiment.replace('_', ' ')} [95 % interval]", title_justify="left")
    for name in ("joint", "quantity"):
        table.add_column(name)
    table.add_column("value", justify="right")
    table.add_column("what it means", overflow="fold")
    for joint, items in found.joints.items():
        for name, finding in items.items():
            style = "" if finding.status == "ok" else "yellow"
            table.add_row(escape(joint), name, escape(number(finding.estimate)), escape(finding.sentence), style=style)
    return table


def attribution_table(attribution: Attribution) -> Table:
    """One row per joint: how much of its mean square error each cause takes away."""
    table = Table(
        title=f"where the gap comes from: share of the mean square error on {attribution.split}", title_justify="left"
    )
    table.add_column("joint")
    labels = attribution.labels
    for label in labels.values():
        table.add_column(label, justify="right")
    for joint, shares in {**attribution.shares, "all joints": attribution.shares_total}.items():
        cells = [shares[cause] for cause in labels]
        table.add_row(
            escape(joint), *("" if math.isnan(share) else f"{round(100 * share, 1) + 0.0:.1f} %" for share in cells)
        )
    return table


def status_line(fit: FitResult) -> tuple[str, str | None]:
    """The status as a sentence, and what to do about it."""
    free = fit.free
    count = {word: sum(item.identified == word for item in free) for word in IDENTIFIED}
    effective = f"{count['effective']} known as effective values, " if count["effective"] else ""
    text = (
        f"status: {fit.status}; of {len(free)} fitted parameters, {count['yes']} determined, {effective}"
        f"{count['weakly']} weakly determined, {count['no']} not determined"
    )
    if fit.ended_by_time:
        return f"{text}; stopped at the time limit", "Give it more time (--budget), and run again with --overwrite."
    return text, _HINT.get(fit.status)


def _remark(item: FittedParameter) -> str:
    return item.sentence.partition(": ")[0] if item.identified in ("yes", "effective") else item.sentence
