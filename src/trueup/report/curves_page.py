"""The page of `trueup policy curves`: how trainings went, grouped by what differs between them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from trueup.core.atomic import write_text
from trueup.core.provenance import version
from trueup.core.trials import Trial, differing_keys
from trueup.report.builder import render_page
from trueup.report.chooser import Cell, Chooser, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.learning_curves import Over, Summary, curves_of, summaries
from trueup.report.numbers import fixed, plural, significant, with_unit
from trueup.report.palette import cycled_styles
from trueup.report.policy_figures import learning_figure
from trueup.report.sections.base import Section

FOOTER = (
    "distance: median over episodes at their end · reward: mean of a control step · minutes: of all threads together"
)
_OVER: dict[Over, tuple[str, str]] = {
    "steps": ("control steps", "control steps of all arms"),
    "minutes": ("processor time", "processor time [min]"),
}


def build_curves(trials: Sequence[Trial], by: Sequence[str] = ()) -> str:
    """The curves of trainings as one self-contained HTML page; equal inputs give equal bytes.

    Args:
        trials: at least one, each with a history.
        by: keys whose values make the groups; all that differ if there are none.

    Raises:
        ConfigError: no configuration has a key of `by`.
    """
    return render_page("Training curves", [f"trueup {version()}"], [learning_section(trials, by)], footer=FOOTER)


def write_curves(trials: Sequence[Trial], out: Path | str, by: Sequence[str] = ()) -> Path:
    """Build the page of trainings and write it atomically.

    Args:
        trials: at least one, each with a history.
        out: where to write.
        by: keys whose values make the groups; all that differ if there are none.

    Returns:
        The path that was written.

    Raises:
        TrueupError: as `build_curves`, or the file cannot be written.
    """
    path = Path(out)
    write_text(path, build_curves(trials, by))
    return path


def learning_section(trials: Sequence[Trial], by: Sequence[str] = ()) -> Section:
    """Curves over steps and minutes, and a table."""
    rows = summaries(trials, by)
    best = min(rows, key=lambda row: row.distance_m)
    count = plural(len(trials), "training")
    lead = f"{count} in {plural(len(rows), 'group')}. " if len(trials) > 1 else "One training. "
    context = {
        "lead": f"{lead}Nearest: {best.title}, {_cm(best.distance_m)} from the goal.",
        "differing": ", ".join(by or differing_keys(trials)),
        "draws": "trainings" if by else "seeds",
        "curves": _curves(trials, by),
        "table": _table(rows, "trainings" if by else "seeds"),
    }
    return Section("learning", "Training", context)


def _curves(trials: Sequence[Trial], by: Sequence[str]) -> Chooser | None:
    def make(over: Over) -> Variant:
        distance, reward = (curves_of(trials, over, quantity, by) for quantity in ("distance_m", "reward"))
        styles = cycled_styles(["", *(curve.title for curve in distance)])
        across = _OVER[over][1]
        return Variant(
            figures={
                "distance": learning_figure(
                    distance, styles, across=across, up="median distance [cm]", factor=100.0, log=True
                ),
                "reward": learning_figure(
                    reward, styles, across=across, up="reward of a control step", factor=1.0, log=False
                ),
            }
        )

    menu = Menu("Over", [(over, words) for over, (words, _) in _OVER.items()])
    return make_chooser("learning-curves", [menu], make, preferred=("steps",))


def _table(rows: Sequence[Summary], draws: str) -> Chooser | None:
    shown = [
        TableRow(
            row.title,
            [
                Cell(str(row.runs)),
                Cell(_cm(row.distance_m), note=_range(row, 100.0, row.distances_m)),
                Cell(significant(row.reward), note=_range(row, 1.0, row.rewards)),
                Cell(fixed(row.minutes, 1)),
            ],
        )
        for row in rows
    ]
    caption = f"Best rounds, mean over {draws}; below it the least and the largest. Minutes of processor time."
    table = Table(["Group", draws.capitalize(), "Best distance", "Best reward", "Minutes"], shown, caption)
    return make_chooser("learning-table", [], lambda: Variant({"trainings": table}), preferred=())


def _cm(value_m: float) -> str:
    return with_unit(significant(100.0 * value_m), "cm")


def _range(row: Summary, factor: float, ends: tuple[float, float]) -> str:
    return f"{significant(factor * ends[0])} to {significant(factor * ends[1])}" if row.runs > 1 else ""
