"""`trueup policy curves`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from trueup.cli import options
from trueup.cli.console import answer, out
from trueup.errors import OutputExists


def register(app: typer.Typer) -> None:
    """Add the command to the group."""
    app.command("curves")(curves)


def curves(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Folders of policies, or with policies anywhere below.")
    ],
    out_file: Annotated[Path, typer.Option("--out", help="HTML file for the curves.")],
    by: Annotated[
        list[str] | None,
        typer.Option(
            "--by", help="Key of the configuration, such as learner.gamma, or folder; all that differ if not given."
        ),
    ] = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Draw how trainings went, with the range over seeds.

    Grouped by what differs between them.
    """
    from trueup.report.curves_page import write_curves
    from trueup.report.learning_curves import summaries
    from trueup.stages.policy_trials import find_trials
    from trueup.zoo import folder_of

    if out_file.is_dir() or (out_file.exists() and not overwrite):
        said = "is a folder" if out_file.is_dir() else "exists"
        raise OutputExists(f"{out_file} {said}", hint="Give --overwrite, or choose another file as --out.")
    trials = find_trials([folder_of(run) for run in runs])
    draws = "trainings" if by else "seeds"
    table = Table(title=f"best rounds of trainings, mean over {draws}")
    table.add_column("group", overflow="fold")
    for heading in (draws, "best distance", "best reward", "minutes"):
        table.add_column(heading, justify="right")
    found = summaries(trials, by or ())
    answer([asdict(row) for row in found])
    for row in found:
        table.add_row(
            Text(row.title),
            str(row.runs),
            f"{100 * row.distance_m:.1f} cm",
            f"{row.reward:.3f}",
            f"{row.minutes:.1f}",
        )
    out.print(table)
    out.print(f"report: {write_curves(trials, out_file, by=by or ())}", markup=False)
    return 0
