"""`trueup replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trueup.cli import options
from trueup.cli.console import note, out, problem, track


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("replay")(replay)


def replay(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    robot: options.Robot,
    model: options.Model = None,
    engine: Annotated[str, typer.Option("--engine", help="mujoco, dart or warp.")] = "mujoco",
    label: Annotated[str | None, typer.Option("--label", help="Name of the run; ENGINE/stock if not given.")] = None,
    window_s: Annotated[
        float | None, typer.Option("--window-s", help="Restart from the measured state this often [s].")
    ] = None,
    delay_s: Annotated[float | None, typer.Option("--delay-s", help="Commands act this much later [s].")] = None,
    jobs: options.Jobs = None,
    ray: options.Ray = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Replay logged commands in a simulator. The answer is stored beside the measurement."""
    from trueup.dataset import Dataset
    from trueup.stages import replay as run

    summary = run(
        Dataset(dataset),
        options.robot_of(robot, dataset),
        model=model,
        engine=engine,
        label=label,
        window_s=window_s,
        delay_s=delay_s,
        jobs=jobs,
        ray=ray,
        overwrite=overwrite,
        resume=resume,
        track=track,
    )
    for name, error in summary.failed.items():
        problem(f"{name} was not replayed: {error.what}: {error.details}", error.hint)
    kept = f", {summary.kept} were there" if summary.kept else ""
    for line in summary.notes:
        note(line)
    out.print(
        f"{summary.replayed} episodes replayed{kept} in {summary.seconds:.1f} s -> run {summary.label}", markup=False
    )
    return 2 if summary.failed else 0
