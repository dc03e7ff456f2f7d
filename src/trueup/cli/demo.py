"""`trueup demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from trueup.cli import options
from trueup.cli.close import Step, exit_code, show, watching
from trueup.cli.console import begins, out, track


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("demo")(demo)


def demo(
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("runs/demo"),
    full: Annotated[
        bool, typer.Option("--full", help="A virtual Panda with payloads, networks included; needs more packages.")
    ] = False,
    robot: Annotated[
        Literal["panda", "demo_arm"] | None,
        typer.Option("--robot", help="panda is --full; demo_arm: the small arm, which carries something now and then."),
    ] = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    until: Annotated[
        Step | None, typer.Option("--until", help="Last step: identify; augment with --robot or --full.")
    ] = None,
    budget: Annotated[
        str, typer.Option("--budget", help="Time for all of it, e.g. 5m; `none` for as long as it takes.")
    ] = "5m",
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Close the gap of a small virtual arm, as a first look.

    A small arm is recorded whose gains, friction and delay its model does not know; they are identified, and tested
    on motions that were not used.

    Exit code 3 if a step failed or the fit is of no use.
    """
    from trueup.robots import load_robot
    from trueup.stages.demonstrating import demo as run
    from trueup.stages.demonstrating import told

    chosen: Literal["panda", "demo_arm"] = "panda" if full else robot or "demo_arm"
    first = not full and robot is None
    with watching() as watch:
        closed = run(
            out_dir,
            robot=chosen,
            loads=not first,
            seed=seed,
            jobs=jobs,
            overwrite=overwrite,
            resume=resume,
            until=until or ("identify" if first else "augment"),
            budget_s=options.budget_s(budget),
            # Before the first motion come processes that start and plans that are made.
            on_begin=lambda: begins(f"planning and recording motions of a virtual {chosen}"),
            track=track,
            watch=watch,
        )
    out.print(
        f"{len(closed.dataset)} motions of a virtual {chosen}, whose physics its model does not know", markup=False
    )
    show(closed, out_dir)
    for line in told(closed, load_robot(chosen)):
        out.print(line, markup=False)
    if first:
        out.print("With your own robot: trueup close LOGS --model MODEL.xml", markup=False)
    return exit_code(closed)
