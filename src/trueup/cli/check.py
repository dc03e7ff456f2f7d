"""`trueup check`."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Annotated

import typer

from trueup.cli import options
from trueup.cli.console import note, out, problem, warning
from trueup.core.check_result import SEVERITIES, CheckResult, CheckSeverity, Finding
from trueup.errors import OutputExists

GO_ON = "Mend what is said above and begin again with --overwrite, or go on as it is with --resume --force."


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("check")(check)


def check(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    robot: options.Robot,
    out_file: Annotated[Path | None, typer.Option("--out", help="JSON file for the findings.")] = None,
    model: options.Model = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Look whether logs, robot.yaml and model fit together.

    Signs, names, units, zeros, clocks, gravity, control mode: in seconds, and before any fit.

    Exit code 3 if something is certainly wrong.
    """
    from trueup.dataset import Dataset
    from trueup.robots import load_robot
    from trueup.stages import check_setup as run

    if out_file is not None and out_file.exists() and not overwrite:
        raise OutputExists(f"{out_file} exists", hint="Give --overwrite, or choose another --out.")
    checked = run(Dataset(dataset), load_robot(robot), model=model)
    show_findings(checked)
    for line in checked.unseen:
        note(line)
    counts = [(sum(one.severity == severity for one in checked.findings), severity) for severity in SEVERITIES]
    said = ", ".join(f"{count} {severity}" for count, severity in counts if count) or "nothing wrong seen"
    out.print(f"{said} in {checked.motions} motions", markup=False)
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
