"""`trueup augment eval`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trueup.cli import options
from trueup.cli.augment_tables import (
    confidence_table,
    cut_table,
    error_table,
    gated_lines,
    joint_gap_table,
    shown_groups,
)
from trueup.cli.console import answer, note, out, track, warning
from trueup.cli.gap import hold_bars
from trueup.core.timeseries import BODY_PREFIX

if TYPE_CHECKING:
    from trueup.core.augment_result import AugmentResult


def register(app: typer.Typer) -> None:
    """Add the command to the group."""
    app.command("eval")(evaluate)


def evaluate(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset with a simulated run.")],
    models: Annotated[
        list[Path],
        typer.Option("--model", help="Folder of a trained network, or zoo:NAME; repeat it to compare networks."),
    ],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for augment.json, gap.json and report.html.")],
    run: Annotated[
        str | None,
        typer.Option(
            "--run", help="Simulated run to correct; the one that the networks were trained for if not given."
        ),
    ] = None,
    split: Annotated[str, typer.Option("--split", help="train, val, test, or all.")] = "test",
    project: Annotated[
        bool,
        typer.Option("--project", help="Also measure the robot that is nearest to corrected bodies."),
    ] = False,
    drop_flagged: options.DropFlagged = False,
    fail_above: options.FailAbove = None,
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
) -> int:
    """Say what learned corrections are worth.

    Joint by joint, with intervals; writes augment.json and a report.

    Every correction is stored as a run of the dataset.
    """
    from trueup.dataset import Dataset
    from trueup.measure import parse_bar
    from trueup.report import write_report
    from trueup.stages import evaluate as measure
    from trueup.zoo import folder_of

    bars = [parse_bar(text) for text in fail_above or []]
    evaluated = measure(
        Dataset(dataset),
        [folder_of(model) for model in models],
        out_dir,
        run=run,
        split=split,
        drop_flagged=drop_flagged,
        project=project,
        seed=seed,
        overwrite=overwrite,
        track=track,
    )
    answer(evaluated.result)
    show(evaluated.result)
    for line in evaluated.warnings:
        warning(line)
    for line in evaluated.notes:
        note(line)
    out.print(f"report: {write_report(out_dir)}", markup=False)
    hold_bars(evaluated.measurement.gap, bars)
    return 0


def show(result: AugmentResult) -> None:
    """Per group of motions what is left of the errors, then how far the networks can be trusted."""
    from trueup.report.body_units import evaluation_for_people

    result = evaluation_for_people(result)
    main = result.main_signal
    others = [signal for signal in result.signals if signal != main]
    for condition in shown_groups(result):
        out.print(cut_table(result, condition, main))
        for kind in (False, True):  # bodies are no joints, and have columns of their own
            if own := [signal for signal in others if signal.startswith(BODY_PREFIX) == kind]:
                out.print(error_table(result, condition, own))
    joined = joint_gap_table(result)
    if joined.row_count:
        out.print(joined)
    confidence = confidence_table(result, main)
    if confidence.row_count:
        out.print(confidence)
    for line in gated_lines(result):
        note(line)
