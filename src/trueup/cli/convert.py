"""`trueup import` and `trueup export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from trueup.cli import options
from trueup.cli.console import note, out, problem, track
from trueup.core.episode import warning_kinds
from trueup.core.quality import Quality

if TYPE_CHECKING:
    from trueup.stages import ImportSummary


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("import")(import_)
    app.command("export")(export)


def import_(
    source: Annotated[Path, typer.Argument(help="Folder or file with logs.")],
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder of the dataset; data/NAME of the logs if not given.")
    ] = None,
    format: options.Format = None,
    mapping: options.Mapping = None,
    unit: options.Units = None,
    robot: Annotated[
        str | None, typer.Option("--robot", help="Robot of the logs; quality checks use its limits.")
    ] = None,
    command_topic: options.CommandTopic = None,
    measured_topic: options.MeasuredTopic = None,
    splits: options.Splits = None,
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
    skip_bad: options.SkipBad = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only list what would be imported.")] = False,
) -> int:
    """Read logs of any known format into a dataset."""
    from trueup.stages import import_logs, plan_import

    choices = options.reading(mapping, unit, command_topic, measured_topic)
    if dry_run:
        plan = plan_import(source, format=format, options=choices)
        for item in plan.episodes:
            out.print(f"{item.id}  {plan.splits.get(item.id, '')}", markup=False)
        for line in plan.notes:
            note(line)
        out.print(f"{len(plan.episodes)} episodes, format {plan.format}; nothing was written")
        return 0
    summary = import_logs(
        source,
        options.folder_for(out_dir, source, below="data"),
        format=format,
        options=choices,
        robot=options.robot_of(robot, source) if robot else None,
        splits=options.splits_choice(splits),
        seed=seed,
        overwrite=overwrite,
        resume=resume,
        track=track,
    )
    show_import(summary)
    return 0 if skip_bad or not summary.refused else 2


def show_import(summary: ImportSummary) -> None:
    """What was imported, what was refused, what is suspicious."""
    for line in summary.notes:
        note(line)
    for name, kinds in summary.flagged.items():
        note(f"{name}: quality warning: {', '.join(kinds)}")
    for name, error in summary.refused.items():
        problem(f"{name} was not imported: {error.what}: {error.details}", error.hint)
    kept = f", {summary.kept} were there" if summary.kept else ""
    episodes = "1 episode" if summary.imported == 1 else f"{summary.imported} episodes"
    out.print(f"{episodes} imported ({summary.format}){kept} -> {summary.path}", markup=False)


def show_flags(quality: Quality, *, only_dropped: bool = False) -> None:
    """The episodes with quality warnings."""
    for name, item in quality.episodes.items():
        if only_dropped and not item.dropped:
            continue
        kinds = warning_kinds(item.flags)
        if kinds:
            note(f"{name}: quality warning: {', '.join(kinds)}{' (dropped)' if item.dropped else ''}")


def export(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the export.")],
    format: Annotated[Literal["csv", "lerobot"], typer.Option("--format", help="What to write.")] = "csv",
    rate_hz: Annotated[
        int | None, typer.Option("--rate-hz", help="Grid of a LeRobot export [Hz]; the median rate if not given.")
    ] = None,
    task: Annotated[str, typer.Option("--task", help="Task sentence of a LeRobot export.")] = "",
) -> int:
    """Write a dataset as CSV (with a mapping file) or LeRobot v3."""
    from trueup.stages.exporting import export_dataset

    count = export_dataset(dataset, out_dir, format=format, rate_hz=rate_hz, task=task, track=track)
    out.print(f"{count} episodes exported ({format}) -> {out_dir}", markup=False)
    return 0
