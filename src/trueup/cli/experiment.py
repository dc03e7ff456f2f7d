"""`trueup experiment`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trueup.cli import options
from trueup.cli.console import answer, note, out
from trueup.cli.fit_tables import experiment_table
from trueup.errors import ConfigError, OutputExists

_KINDS = ("breakaway", "constant-torque", "coast")


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("experiment")(experiment)


def experiment(
    kind: Annotated[str, typer.Argument(help="breakaway, constant-torque or coast.")],
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset with recordings of it.")],
    robot: options.Robot,
    out_file: Annotated[Path | None, typer.Option("--out", help="JSON file for the result.")] = None,
    joints: Annotated[str | None, typer.Option("--joints", help="Comma-separated; those that were driven.")] = None,
    breakaway: Annotated[
        Path | None, typer.Option("--breakaway", help="Result of a breakaway experiment, for constant-torque.")
    ] = None,
    delay_s: Annotated[
        float | None, typer.Option("--delay-s", help="Commands act this much later [s]; the robot's own if not given.")
    ] = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Evaluate recordings that isolate one thing.

    Breakaway torques, offset and asymmetry, friction while coasting.
    """
    from trueup.dataset import Dataset
    from trueup.robots import load_robot
    from trueup.stages.experimenting import experiment as run

    if kind not in _KINDS:
        raise ConfigError(f"there is no experiment {kind!r}", available=_KINDS)
    if out_file is not None and out_file.exists() and not overwrite:
        raise OutputExists(f"{out_file} exists", hint="Give --overwrite, or choose another --out.")
    described = load_robot(robot)
    names = None if joints is None else options.names_among(joints, described.joint_names)
    found = run(
        Dataset(dataset),
        described,
        kind,  # type: ignore[arg-type]
        joints=names,
        breakaway=breakaway,
        delay_s=delay_s,
    )
    answer(found)
    out.print(experiment_table(found))
    for line in found.problems:
        note(line)
    if out_file is not None:
        found.save(out_file)
        out.print(f"result: {out_file}", markup=False)
    return 0
