"""`trueup demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trueup.cli import options
from trueup.cli.close import show
from trueup.cli.console import out, track


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("demo")(demo)


def demo(
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("runs/demo"),
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Close on the built-in arm, whose hardware has other gains, friction, delay and payload than its model."""
    from trueup.stages.demonstrating import demo as run

    closed = run(out_dir, seed=seed, jobs=jobs, overwrite=overwrite, track=track)
    out.print("12 motions of the built-in arm, recorded on hardware that its model does not know", markup=False)
    show(closed, out_dir)
    return 0
