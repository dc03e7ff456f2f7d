"""`trueup init`."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from trueup.cli import options
from trueup.cli.check import mend_lines
from trueup.cli.console import note, out, warning
from trueup.core.check_result import Finding
from trueup.errors import ImpossibleLinks


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("init")(init)


def init(
    model: Annotated[Path, typer.Argument(help="MJCF or URDF.", exists=True, dir_okay=False)],
    logs: Annotated[Path | None, typer.Argument(help="Logs of the robot, of any known format.")] = None,
    out_dir: Annotated[Path, typer.Option("--out", help="Folder that robot.yaml is written to.")] = Path(),
    format: options.Format = None,
    mapping: options.Mapping = None,
    unit: options.Units = None,
    command_topic: options.CommandTopic = None,
    measured_topic: options.MeasuredTopic = None,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", help="LeRobot's calibration of the arm (JSON).", exists=True, dir_okay=False),
    ] = None,
    repair: Annotated[
        bool, typer.Option("--repair", help="Use a copy of a URDF in which impossible masses and inertias are mended.")
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Take what is likely, and `--repair` where it is needed, without a question.")
    ] = False,
    overwrite: options.Overwrite = False,
) -> int:
    """Write robot.yaml from a model and logs.

    Joints, limits, gains and base are read from the model; how the robot is driven, what its joints are called, their
    signs and units, from the logs. On a terminal, it asks about what is likely and not certain.
    """
    from trueup.stages import draft

    def agreed(finding: Finding) -> bool:
        if yes or not sys.stdin.isatty():
            return yes
        warning(finding.evidence)
        for line in mend_lines(finding, most=1):
            out.print(f"  {line}", markup=False)
        return typer.confirm("Write it so?", default=False)

    drafted = partial(
        draft,
        model,
        logs,
        out=out_dir,
        format=format,
        options=options.reading(mapping, unit, command_topic, measured_topic),
        calibration=calibration,
        overwrite=overwrite,
        ask=agreed,
    )
    try:
        found = drafted(repair=repair)
    except ImpossibleLinks as error:
        asked = not yes and sys.stdin.isatty()
        if asked:
            warning(str(error))
        if not (typer.confirm("Use a copy with possible ones?", default=False) if asked else yes):
            raise
        found = drafted(repair=True)
    for line in found.taken:
        out.print(f"  {line}", markup=False)
    for finding in found.findings:
        warning(finding.evidence)
        for line in mend_lines(finding):
            out.print(f"  {line}", markup=False)
    for line in found.unsure:
        note(line)
    for file in found.files:
        out.print(f"wrote {file}", markup=False)
    source = logs if logs is not None else "LOGS"
    read_with = [file for file in found.files if file.name == "mapping.yaml"] or ([mapping] if mapping else [])
    with_mapping = "".join(f" --mapping {file}" for file in read_with)
    line = f"next: trueup close {source} --robot {found.files[-1]}{with_mapping} --out runs/{found.robot.name}"
    out.print(line, markup=False)
    return 0
