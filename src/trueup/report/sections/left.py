"""What is left after the fit, and the models that were tried."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from trueup.core.fit_result import FitResult, ModelRow
from trueup.core.results import Estimate
from trueup.report.chooser import Cell, Chooser, Figure, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.figures import bars_figure
from trueup.report.fit_words import as_sentence
from trueup.report.folder import RunFolder
from trueup.report.labels import SPLITS, ordered, split_title
from trueup.report.numbers import plural, pretty_unit, quantity, significant
from trueup.report.palette import cycled_styles
from trueup.report.sections.base import Section
from trueup.report.sections.cells import change_cell, estimate_cell, seconds_cell

NOMINAL = "model as it came"
ALL_JOINTS = "mean of scored joints"
# More joints than these make a figure of several screens; the table has them all the same.
DRAWN_JOINTS = 12


@dataclass(frozen=True)
class LeftRow:
    """What is left of one joint, as printed.

    Attributes:
        joint: its name.
        rms: size of what is left.
        memory: over what time it is correlated with itself.
        white: whether it looks like noise.
        sentence: the same in words.
    """

    joint: str
    rms: str
    memory: str
    white: bool
    sentence: str


def left_section(run: RunFolder) -> Section | None:
    """Only after an identification."""
    if run.fit is None:
        return None
    rows = left_rows(run.fit, run.gap.joints)
    context = {
        "rows": rows,
        "summary": left_summary(rows),
        "chooser": models_chooser(run.fit, run.gap.joints),
    }
    return Section("left", "What is left: residual, and the models that were tried", context)


def left_rows(fit: FitResult, joints: Sequence[str]) -> list[LeftRow]:
    """Joint by joint; the unit is that of the errors, the motions are those that were fitted."""
    unit = next((error.unit for splits in fit.errors.values() for error in splits.values()), "")
    rows = []
    for joint in ordered(fit.whiteness, joints):
        item = fit.whiteness[joint]
        # The sentence begins with the joint, which stands beside it here.
        sentence = item.sentence.removeprefix(f"{joint}: ")
        memory = f"{significant(item.correlation_s, 2)}\N{NO-BREAK SPACE}s" if item.correlation_s > 0 else "none"
        rows.append(LeftRow(joint, quantity(item.rms, unit), memory, item.white, as_sentence(sentence)))
    return rows


def left_summary(rows: Sequence[LeftRow]) -> str:
    """On how many joints a better model could still help."""
    if not rows:
        return ""
    noise = sum(row.white for row in rows)
    if noise == len(rows):
        return "The remaining error is noise on every joint: a better model of this kind would not help."
    if noise == 0:
        return (
            "On no joint is the remaining error only noise: the model misses something, and the intervals are widened "
            "for that."
        )
    return (
        f"The remaining error is noise on {noise} of {plural(len(rows), 'joint')}; on the others the model misses "
        "something, and their intervals are widened for that."
    )


def models_chooser(fit: FitResult, joints: Sequence[str]) -> Chooser | None:
    """The models on each split, joint by joint."""
    models = tried_models(fit)
    splits = ordered({split for row in models for split in row.splits}, SPLITS)
    if not splits:
        return None
    overview = models_table(models, splits)

    def make(split: str) -> Variant:
        rows = model_bars(models, split, joints)
        title = f"position RMSE [{pretty_unit(_unit(models, split))}]"
        return Variant(
            tables={"models": overview, "model-joints": joints_table(rows, split)},
            figures={"models": models_figure(rows, title)},
        )

    preferred = next(split for split in ("test", "val", *splits) if split in splits)
    menu = Menu("Split", [(split, split_title(split)) for split in splits])
    return make_chooser("models-chooser", [menu], make, preferred=(preferred,))


def tried_models(fit: FitResult) -> list[ModelRow]:
    """The models of the fit, after the nominal one; names that occur twice are numbered."""
    rows = list(fit.models)
    if not rows and "fitted" in fit.errors:
        rows = [ModelRow("fitted", (), len(fit.free), 0.0, fit.errors["fitted"], chosen=True)]
    if "nominal" in fit.errors:
        rows.insert(0, ModelRow(NOMINAL, (), 0, 0.0, fit.errors["nominal"]))
    seen: dict[str, int] = {}
    named = []
    for row in rows:
        seen[row.name] = seen.get(row.name, 0) + 1
        named.append(replace(row, name=f"{row.name} ({seen[row.name]})") if seen[row.name] > 1 else row)
    return named


def models_table(models: Sequence[ModelRow], splits: Sequence[str]) -> Table:
    """One row per model, one column per split."""
    base = next((row.quantities for row in models if row.quantities), ())
    rows = []
    for row in models:
        extra = [name for name in row.quantities if name not in base]
        what = f"+ {', '.join(extra)}" if extra else ", ".join(row.quantities)
        cells = [_error_cell(row, models[0], split) for split in splits]
        seconds = seconds_cell(row.seconds) if row.seconds else Cell("–")
        rows.append(
            TableRow(model_title(row), [Cell(str(row.parameters)), *cells, seconds], note=what, strong=row.chosen)
        )
    columns = ["Model", "Parameters", *(split_title(split).capitalize() for split in splits), "Time to fit"]
    caption = (
        "RMSE of position, mean of the scored joints and of the motions, 95 % interval below it; the percentage is the "
        "change against the first row. Models are fitted on train, the starred one is chosen on validation."
    )
    return Table(columns, rows, caption)


def model_bars(models: Sequence[ModelRow], split: str, joints: Sequence[str]) -> dict[str, dict[str, Estimate]]:
    """Model -> mean and joints -> error."""
    found: dict[str, dict[str, Estimate]] = {}
    for row in models:
        if split not in row.splits:
            continue
        mean = above_zero(row.splits[split])
        per_joint = row.per_joint.get(split, {})
        own = {joint: Estimate(float(per_joint[joint]), mean.unit) for joint in ordered(per_joint, joints)}
        found[model_title(row)] = {ALL_JOINTS: mean, **own}
    return found


def models_figure(bars: Mapping[str, Mapping[str, Estimate]], title: str) -> Figure:
    """Bars per joint and model, the mean first."""
    rows = list(dict.fromkeys(row for values in bars.values() for row in values))
    shown = rows if len(rows) <= DRAWN_JOINTS + 1 else rows[:1]
    drawn = {label: {row: values[row] for row in shown if row in values} for label, values in bars.items()}
    figure = bars_figure(shown, drawn, cycled_styles(bars), title=title)
    for bar in figure["data"]:
        # Only the mean has an interval: plotly draws no whisker where the list has ended.
        bar["error_x"] |= {end: bar["error_x"][end][:1] for end in ("array", "arrayminus")}
    return figure


def joints_table(bars: Mapping[str, Mapping[str, Estimate]], split: str) -> Table:
    """The numbers of the figure: one row per joint, one column per model."""
    heads = list(dict.fromkeys(row for values in bars.values() for row in values))
    rows = [
        TableRow(head, [estimate_cell(values.get(head)) for values in bars.values()], strong=head == ALL_JOINTS)
        for head in heads
    ]
    return Table(["Joint", *bars], rows, f"RMSE of position per joint, {split_title(split)}, mean over motions.")


def model_title(row: ModelRow) -> str:
    """With a star for the chosen one."""
    return f"★ {row.name}" if row.chosen else row.name


def above_zero(estimate: Estimate) -> Estimate:
    """With its interval cut at zero, below which no RMSE lies: with two motions Student's t would reach there."""
    return estimate if estimate.low is None else replace(estimate, low=max(0.0, estimate.low))


def _error_cell(row: ModelRow, first: ModelRow, split: str) -> Cell:
    if split not in row.splits:
        return Cell("–")
    return change_cell(above_zero(row.splits[split]), None if row is first else first.splits.get(split))


def _unit(models: Sequence[ModelRow], split: str) -> str:
    return next(row.splits[split].unit for row in models if split in row.splits)
