"""How far a correction carries: datasets, and simulators that are off."""

from __future__ import annotations

from trueup.core.robustness_result import ERROR_KINDS, ErrorKind, Improvement, RobustnessResult, RobustnessRow
from trueup.report.body_units import robustness_for_people
from trueup.report.chooser import Cell, Chooser, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.figures import bars_figure
from trueup.report.folder import RunFolder
from trueup.report.numbers import NOTHING, interval, percent, plural, pretty_unit, quantity
from trueup.report.palette import cycled_styles
from trueup.report.robustness_figures import datasets_figure, sizes_figure
from trueup.report.robustness_words import gone_interval, lead, sentences, size_words
from trueup.report.sections.base import Section

_SIMULATOR, _CORRECTED = "simulator", "corrected"


def robustness_section(run: RunFolder) -> Section | None:
    """Only where the robustness of a correction was looked at."""
    return None if run.robustness is None else section_of(run.robustness)


def section_of(result: RobustnessResult) -> Section:
    """The section, which needs no other result."""
    shown = robustness_for_people(result)
    context = {
        "lead": lead(result),
        "sentences": sentences(result),
        "notes": result.notes,
        "datasets": datasets_chooser(shown),
        "sizes": sizes_chooser(shown),
    }
    return Section("robustness", "Robustness: how far the correction carries", context)


def datasets_chooser(result: RobustnessResult) -> Chooser | None:
    """Errors and improvement per dataset, with the simulator as it is."""
    styles = cycled_styles([_SIMULATOR, _CORRECTED])

    def make(kind: ErrorKind) -> Variant:
        errors = {row.dataset: row.errors[kind] for row in result.datasets}
        rows = [
            TableRow(row.dataset, _cells(row.errors[kind]), note=plural(row.motions, "motion"))
            for row in result.datasets
        ]
        bars = {
            _SIMULATOR: {name: item.simulated for name, item in errors.items()},
            _CORRECTED: {name: item.corrected for name, item in errors.items()},
        }
        unit = next(iter(errors.values())).simulated.unit
        title = f"{ERROR_KINDS[kind]} of {result.signal} [{pretty_unit(unit)}]"
        figures = {"errors": bars_figure(list(errors), bars, styles, title=title)}
        if len(errors) > 1:
            gone = {name: item.gone for name, item in errors.items()}
            figures["datasets"] = datasets_figure(gone, styles[_CORRECTED])
        caption = f"{ERROR_KINDS[kind].capitalize()} per motion, mean over motions, with 95 % intervals over motions."
        return Variant({"datasets": Table(["Dataset", *_HEADS], rows, caption)}, figures)

    return make_chooser("robustness-datasets", [_kinds()], make, preferred=("mae",))


def sizes_chooser(result: RobustnessResult) -> Chooser | None:
    """Improvement over the size of what is off."""
    if not result.perturbed:
        return None
    first, styles = result.datasets[0], cycled_styles(["", *result.perturbed])

    def make(kind: ErrorKind) -> Variant:
        rows = [TableRow("as it is", [Cell(NOTHING), *_cells(first.errors[kind]), Cell(NOTHING)])]
        for name, own in result.perturbed.items():
            rows += [TableRow(name, _off_cells(row, kind), note=size_words(row.size)) for row in own]
        columns = ["Simulator", "Share of the size", *_HEADS, "Least"]
        draws = max(row.draws for own in result.perturbed.values() for row in own)
        caption = (
            f"{ERROR_KINDS[kind].capitalize()} on {first.dataset} ({plural(first.motions, 'motion')}); each motion "
            f"counts with its mean over {plural(draws, 'simulator')} drawn at random; 95 % intervals over motions, "
            "not over draws. Sizes are standard deviations. Least: under the draw in which the correction takes least "
            "of the mean error away."
        )
        lines = {name: {row.share: row.errors[kind].gone for row in own} for name, own in result.perturbed.items()}
        figure = sizes_figure(first.errors[kind].gone, lines, styles)
        return Variant({"sizes": Table(columns, rows, caption)}, {"sizes": figure})

    return make_chooser("robustness-sizes", [_kinds()], make, preferred=("mae",))


_HEADS = ("Simulator's error", "Corrected", "Gone")


def _kinds() -> Menu:
    return Menu("Error", [(kind, words) for kind, words in ERROR_KINDS.items()])


def _off_cells(row: RobustnessRow, kind: ErrorKind) -> list[Cell]:
    least = NOTHING if row.least is None else percent(row.least, sign=False)
    return [Cell(percent(row.share, sign=False)), *_cells(row.errors[kind]), Cell(least)]


def _cells(item: Improvement) -> list[Cell]:
    errors = [Cell(quantity(own.value, own.unit), note=interval(own)) for own in (item.simulated, item.corrected)]
    return [*errors, Cell(percent(item.gone.value, sign=False), note=gone_interval(item.gone), tone=item.verdict)]
