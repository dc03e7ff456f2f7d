"""`trueup close`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trueup.cli import options
from trueup.cli.console import note, out, problem, track
from trueup.cli.convert import show_flags, show_import
from trueup.cli.gap import hold_bars
from trueup.cli.tables import ladder_table, verdicts
from trueup.dataset.importers.base import ImportOptions

if TYPE_CHECKING:
    from trueup.stages import Closed


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("close")(close)


def close(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset, or logs of any known format.")],
    robot: options.Robot,
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the results.")],
    model: options.Model = None,
    format: options.Format = None,
    mapping: options.Mapping = None,
    unit: options.Units = None,
    command_topic: options.CommandTopic = None,
    measured_topic: options.MeasuredTopic = None,
    splits: options.Splits = None,
    drop_flagged: options.DropFlagged = False,
    fail_above: options.FailAbove = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
    skip_bad: options.SkipBad = False,
) -> int:
    """From logs to the ladder: import if needed, check, replay, measure, report."""
    from trueup.measure import parse_bar, refuse_unknown
    from trueup.robots import load_robot
    from trueup.stages import STOCK
    from trueup.stages import close as run

    bars = [parse_bar(text) for text in fail_above or []]
    refuse_unknown(bars, runs=(STOCK,))
    closed = run(
        dataset,
        load_robot(robot),
        out_dir,
        model=model,
        format=format,
        options=ImportOptions(
            mapping=mapping,
            units=options.unit_choices(unit),
            command_topic=command_topic,
            measured_topic=measured_topic,
        ),
        splits=options.splits_choice(splits),
        drop_flagged=drop_flagged,
        seed=seed,
        jobs=jobs,
        overwrite=overwrite,
        resume=resume,
        track=track,
        on_import=show_import,
    )
    show(closed, out_dir)
    hold_bars(closed.measurement.gap, bars)
    refused = closed.replayed.failed or (closed.imported and closed.imported.refused)
    return 2 if refused and not skip_bad else 0


def show(closed: Closed, out_dir: Path) -> None:
    """Ladder, verdicts, and the report's path."""
    from trueup.report import write_report

    if not closed.imported:
        show_flags(closed.measurement.quality)
    for name, error in closed.replayed.failed.items():
        problem(f"{name} was not replayed: {error.what}: {error.details}", error.hint)
    out.print(ladder_table(closed.ladder))
    if any(rung.chosen for rung in closed.ladder.rungs):
        out.print("* best on val", markup=False)
    for line in verdicts(closed.measurement.gap):
        out.print(line, markup=False)
    for line in closed.measurement.gap.settings["warnings"]:
        note(line)
    out.print(f"report: {write_report(out_dir)}", markup=False)
