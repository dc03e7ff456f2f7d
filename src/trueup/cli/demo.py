"""`trueup demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trueup.cli import options
from trueup.cli.close import show
from trueup.cli.console import err, out, track


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("demo")(demo)


def demo(
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("runs/demo"),
    robot: Annotated[
        str, typer.Option("--robot", help="panda, or demo_arm: three joints, simulated and fitted in seconds.")
    ] = "panda",
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Record virtual hardware, whose physics its model does not know, and close on the recording."""
    from trueup.stages.demonstrating import demo as run

    # Before the first motion come processes that start and plans that are made.
    err.print(f"planning and recording motions of a virtual {robot}", markup=False)
    closed = run(out_dir, robot=robot, seed=seed, jobs=jobs, overwrite=overwrite, track=track)  # type: ignore[arg-type]
    out.print(
        f"{len(closed.dataset)} motions of a virtual {robot}, whose physics its model does not know", markup=False
    )
    show(closed, out_dir)
    return 0
