"""`trueup check`."""

from __future__ import annotations

import contextlib
from collections.abc import Collection
from pathlib import Path
from typing import Annotated

import typer

from trueup.cli import options
from trueup.cli.console import answer, note, out, problem, track, warning
from trueup.core.check_result import SEVERITIES, CheckResult, CheckSeverity, Finding
from trueup.errors import OutputExists

GO_ON = "Fix the errors above and start again with --overwrite, or continue anyway with --resume --force."


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("check")(check)


def check(
    data: Annotated[Path, typer.Argument(help="Dataset, or logs of any known format.")],
    robot: options.Robot,
    out_file: Annotated[Path | None, typer.Option("--out", help="JSON file for the findings.")] = None,
    model: options.Model = None,
    format: options.Format = None,
    mapping: options.Mapping = None,
    unit: options.Units = None,
    command_topic: options.CommandTopic = None,
    measured_topic: options.MeasuredTopic = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Look whether logs, robot.yaml and model fit together.

    Signs, names, units, zeros, clocks, gravity, control mode: in seconds, and before any fit.

    Exit code 3 if something is certainly wrong.
    """
    from trueup.stages import check_setup as run
    from trueup.stages.importing import dataset_of

    if out_file is not None and out_file.exists() and not overwrite:
        raise OutputExists(f"{out_file} exists", hint="Give --overwrite, or choose another --out.")
    choices, spec = options.reading(mapping, unit, command_topic, measured_topic, robot), options.robot_of(robot, data)
    with contextlib.ExitStack() as stack:
        dataset, notes = dataset_of(data, stack, robot=spec, format=format, options=choices, track=track)
        checked = run(dataset, spec, model=model)
    for line in notes:
        note(line)
    answer(checked)
    show_findings(checked)
    for line in checked.unseen:
        note(line)
    counts = [(sum(one.severity == severity for one in checked.findings), severity) for severity in SEVERITIES]
    said = ", ".join(f"{count} {severity}" for count, severity in counts if count) or "no problems found"
    out.print(f"{said} in {checked.motions} motion{'s' if checked.motions != 1 else ''}", markup=False)
    if out_file is not None:
        checked.save(out_file)
        out.print(f"findings: {out_file}", markup=False)
    return 3 if checked.certain else 0


def show_findings(checked: CheckResult, *, only: Collection[CheckSeverity] = SEVERITIES) -> None:
    """Each finding, and below it what mends it."""
    for finding in checked.findings:
        if finding.severity not in only:
            continue
        say = {"certain": problem, "likely": warning, "note": note}[finding.severity]
        say(f"{finding.severity}: {_words(finding)}" if finding.severity == "likely" else _words(finding))
        if finding.severity != "note":
            for line in mend_lines(finding):
                out.print(f"  {line}", markup=False)


def _words(finding: Finding) -> str:
    """The evidence, with the joints in front where it does not name them."""
    named = all(joint in finding.evidence for joint in finding.joints)
    return finding.evidence if named else f"{', '.join(finding.joints)} {finding.evidence}"


def mend_lines(finding: Finding, *, most: int = 3) -> list[str]:
    """What mends a finding, line by line, the likeliest first."""
    lines = []
    for number, mend in enumerate(finding.mends[:most]):
        begin = f"{'or, in ' if number else 'in '}{mend.where}" if mend.where != "recording" else "at the robot"
        lines.append(f"{begin}: {mend.words}" if mend.words else f"{begin}:")
        lines += [f"    {line}" for line in mend.lines.split("\n") if line]
    return lines
