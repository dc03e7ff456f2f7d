"""`trueup augment time`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from trueup.cli.console import answer, note, out
from trueup.core.sole_writer import writes_alone
from trueup.errors import ConfigError, DataError


def register(app: typer.Typer) -> None:
    """Add the command to the group."""
    app.command("time")(measure)


@writes_alone("out_dir")
def measure(
    model: Annotated[Path, typer.Argument(help="Folder of a trained real-time network, or zoo:NAME.")],
    rate_hz: Annotated[float, typer.Option("--rate", help="Rate of the control loop [Hz].")] = 1000.0,
    seconds: Annotated[float, typer.Option("--seconds", help="How long the loop runs.")] = 10.0,
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder for latency.json; the model's if not given, none for zoo:NAME.")
    ] = None,
) -> int:
    """Say how long a step takes on this machine.

    In a loop at a fixed rate; writes latency.json.

    The report of `trueup augment eval` shows its histogram.
    """
    from trueup.core.atomic import make_folder
    from trueup.core.model_card import ModelCard
    from trueup.core.step_times import LATENCY_NAME
    from trueup.stages import time_steps
    from trueup.zoo import folder_of

    if not (0 < seconds < float("inf")):
        raise ConfigError("--seconds", got=f"{seconds:g}", expected="a positive number")
    folder = folder_of(model)
    # What came with the package is not written to: it may belong to somebody else.
    target = out_dir or (folder if folder == model else None)
    ModelCard.load(folder)
    if out_dir is not None:
        make_folder(out_dir)
    if target is None:
        note("the times of a network of the zoo are not saved without --out")
    elif target.is_dir() and not os.access(target, os.W_OK):  # not found out after the loop
        raise DataError(f"cannot write into {target}", hint="Give another --out.")
    note(f"{seconds:g} s without a word: a display would take part in the loop")
    times, report = time_steps(folder, rate_hz=rate_hz, seconds=seconds)
    answer(times)
    table = Table(title=f"one step of {folder.name}, in a loop at {rate_hz:g} Hz on {times.machine}")
    for column in ("median", "99 %", "99.9 %", "longest", "steps"):
        table.add_column(column, justify="right")
    shown = (times.p50_us, times.p99_us, times.p999_us, times.max_us)
    table.add_row(*(f"{value:.3g} µs" for value in shown), str(times.count))
    out.print(table)
    late = (report.overran_by_step, report.overran_by_waiting, report.overran_by_wakeup, report.skipped)
    causes = ("by the step", "because it was interrupted", "because the loop was woken late", "cycles left out")
    out.print("deadlines missed: " + ", ".join(f"{count} {cause}" for count, cause in zip(late, causes, strict=True)))
    if target is not None:
        times.save(target / LATENCY_NAME)
        out.print(f"times: {target / LATENCY_NAME}", markup=False)
    return 0
