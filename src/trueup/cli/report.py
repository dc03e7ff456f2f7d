"""`trueup report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trueup.cli import options
from trueup.cli.console import out
from trueup.errors import OutputExists


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("report")(report)


def report(
    folder: Annotated[Path, typer.Argument(help="Folder with the results of another command.")],
    out_file: Annotated[Path | None, typer.Option("--out", help="HTML file; FOLDER/report.html if not given.")] = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Render saved results as one self-contained HTML file."""
    from trueup.report import write_report

    if out_file is not None and out_file.exists() and not overwrite:
        raise OutputExists(f"{out_file} exists", hint="Give --overwrite, or choose another --out.")
    out.print(f"report: {write_report(folder, out_file)}", markup=False)
    return 0
