"""`trueup torque`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.markup import escape
from rich.table import Table

from trueup.cli import options
from trueup.cli.console import answer, note, out, problem, track
from trueup.core.torque_result import RIVALS, TORQUE_METHODS, TorqueResult

_METHOD_WORDS = {"graybox": "gray box", "dynamics": "inverse dynamics"}


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("torque")(torque)


def torque(
    data: Annotated[Path, typer.Argument(help="Dataset, or logs of any known format.")],
    robot: options.Robot,
    out_dir: options.Results = None,
    method: Annotated[
        Literal["graybox", "dynamics"] | None,
        typer.Option("--method", help="Terms of each joint, or the equation of motion; both if not given."),
    ] = None,
    model: options.Model = None,
    drop_flagged: options.TrainFlagged = None,
    format: options.Format = None,
    mapping: options.Mapping = None,
    unit: options.Units = None,
    command_topic: options.CommandTopic = None,
    measured_topic: options.MeasuredTopic = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Explain torques or currents on motions not fitted.

    By terms of each joint and by the equation of motion, beside three simple rivals, of which the best counts.

    Exit code 3 if nothing is nearer to the torques than that one.
    """
    from trueup.stages import torque as run

    out_dir = options.folder_for(out_dir, data, of="torque")
    explained = run(
        data,
        options.robot_of(robot, data),
        out_dir,
        methods=TORQUE_METHODS if method is None else (method,),
        model=model,
        drop_flagged=drop_flagged,
        format=format,
        options=options.reading(mapping, unit, command_topic, measured_topic, robot),
        overwrite=overwrite,
        track=track,
    )
    result = explained.result
    answer(result)
    out.print(torque_table(result))
    for name, why in result.left_out.items():
        note(f"{_METHOD_WORDS.get(name, RIVALS.get(name, name))}: {why}")
    for line in result.notes:
        note(line)
    for line in verdicts(result):
        out.print(line, markup=False)
    out.print(f"results: {out_dir}", markup=False)
    if not result.any_nearer:
        problem(
            f"nothing is nearer to the torques than {RIVALS[result.rival]}",
            "Keep the model, or fit more motions, like those that are held out."
            if result.rival == "model"
            else "Record motions that accelerate more, in more poses, or look whether the torque is one.",
        )
    return 0 if result.any_nearer else 3


def torque_table(result: TorqueResult) -> Table:
    """One row per joint: its torque, and the error of each method and rival, absolute and as a share."""
    judged = {
        "test": "test motions",
        "val": "val motions",
        "folds": "motions that were held out in turn",
    }[result.held_out]
    what = {"torque": "torque", "current": "current", "command": "commanded torque"}[result.source]
    table = Table(title=f"RMS error of the {what} on {result.motions} {judged}", title_justify="left")
    table.add_column("joint")
    names = [name for name in (*result.methods, *RIVALS) if name in result.total]
    table.add_column("RMS", justify="right")
    for name in names:
        table.add_column(_METHOD_WORDS.get(name, name), justify="right")
    factors = any(own.factor is not None for own in result.joints.values())
    if factors:
        table.add_column("factor", justify="right")
    for joint, own in result.joints.items():
        cells = [
            f"{own.errors[name].rmse.value:.3g} ({_percent(own.errors[name].rmse.value / own.rms)})"
            if name in own.errors
            else ""
            for name in names
        ]
        last = []
        if factors:
            per = "Nm/A" if own.unit != "N" else "N/A"
            last = ["" if own.factor is None else f"{own.factor:.3g} {per} ({own.factor_from})"]
        table.add_row(escape(joint), f"{own.rms:.3g} {own.unit}", *cells, *last)
    shares = [_percent(result.total[name].rmse.value) for name in names]
    table.add_row("mean share", "", *shares, *([""] if factors else []), style="bold")
    return table


def verdicts(result: TorqueResult) -> list[str]:
    """A sentence for each method, beside the best of the simple rivals."""
    lines = []
    for method in result.methods:
        score = result.total[method]
        share, less = score.rmse.value, score.reduction
        against = share + less.value
        better = result.better(method)
        change = f"{_percent(abs(less.value) / against)} {'less' if less.value >= 0 else 'more'}" if against else ""
        word = {True: "better", False: "worse", None: f"{result.motions} motions cannot tell"}[better]
        lines.append(
            f"{_METHOD_WORDS[method]}: an error of {_percent(share)} of the torque's RMS, mean over joints; "
            f"the best simple rival, {RIVALS[result.rival]}, {_percent(against)}: {change} ({word})"
        )
    return lines


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
