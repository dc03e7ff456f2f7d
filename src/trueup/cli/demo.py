"""`trueup demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from trueup.cli import options
from trueup.cli.close import UntilStep, exit_code, show, watching
from trueup.cli.console import err, out, track


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("demo")(demo)


def demo(
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("runs/demo"),
    robot: Annotated[
        Literal["panda", "demo_arm"],
        typer.Option("--robot", help="panda, or demo_arm: three joints, simulated and fitted in seconds."),
    ] = "panda",
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    until: UntilStep = "augment",
    budget: Annotated[
        str, typer.Option("--budget", help="Time for all of it, e.g. 5m; `none` for as long as it takes.")
    ] = "5m",
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Record virtual hardware, and close on the recording.

    Its model does not know its physics.

    Exit code 3 if a step failed or the fit is of no use.
    """
    from trueup.stages.demonstrating import demo as run

    with watching() as watch:
        closed = run(
            out_dir,
            robot=robot,
            seed=seed,
            jobs=jobs,
            overwrite=overwrite,
            resume=resume,
            until=until,
            budget_s=options.budget_s(budget),
            # Before the first motion come processes that start and plans that are made.
            on_begin=lambda: err.print(f"planning and recording motions of a virtual {robot}", markup=False),
            track=track,
            watch=watch,
        )
    out.print(
        f"{len(closed.dataset)} motions of a virtual {robot}, whose physics its model does not know", markup=False
    )
    show(closed, out_dir)
    return exit_code(closed)
