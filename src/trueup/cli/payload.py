"""`trueup payload`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trueup.cli import options
from trueup.cli.console import answer, iterations, note, out, problem, track, warning
from trueup.core.payload_result import PAYLOAD_NAME, PayloadResult, Weighed

_BY = {"motion": "by the motion", "torque": "by the torques"}


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("payload")(payload)


def payload(
    free: Annotated[Path, typer.Argument(help="Dataset or logs of motions with nothing in the hand.")],
    loaded: Annotated[Path, typer.Argument(help="Dataset or logs of motions with the payload.")],
    robot: options.Robot,
    out_dir: Annotated[Path | None, typer.Option("--out", help="Folder for the results.")] = None,
    body: Annotated[
        str, typer.Option("--body", help="Body or site that carries it; the site payload, or the last body.")
    ] = "",
    fit: Annotated[
        Path | None, typer.Option("--fit", help="Folder of an earlier fit of FREE, which is not made again.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="YAML that says what to fit of FREE; see docs/identification.md.")
    ] = None,
    model: options.Model = None,
    format: options.Format = None,
    mapping: options.Mapping = None,
    unit: options.Units = None,
    command_topic: options.CommandTopic = None,
    measured_topic: options.MeasuredTopic = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
    force: options.Force = False,
) -> int:
    """Weigh what a robot carries, from its motions.

    They were recorded with it (LOADED) and without it (FREE), and may be driven by position, velocity or torque.

    Mass and center of mass with intervals, and whether to believe them.

    Exit code 3 if the motions do not determine the mass.
    """
    from trueup.identify import IdentifyConfig
    from trueup.stages import payload as run

    with iterations() as (begin, on_progress):
        result = run(
            free,
            loaded,
            options.robot_of(robot, free),
            out=out_dir,
            at=body,
            fit=fit,
            model=model,
            config=IdentifyConfig.load(config) if config else None,
            format=format,
            options=options.reading(mapping, unit, command_topic, measured_topic, robot),
            seed=seed,
            jobs=jobs,
            overwrite=overwrite,
            force=force,
            track=track,
            on_begin=begin,
            on_progress=on_progress,
        )
    show(result)
    if out_dir is not None:
        out.print(f"result: {out_dir / PAYLOAD_NAME}", markup=False)
    return 0 if result.determined else 3


def show(result: PayloadResult) -> None:
    """Mass, center, how well motions are simulated with it, and what to think of it."""
    answer(result)
    order = sorted(result.ways, key=lambda way: way != result.best)
    for way in order:
        own = result.ways[way]
        said = "" if own.determined else ": not determined by these motions"
        out.print(f"payload {_BY[way]}: {_mass(own)}{said}", markup=False)
        if own.carries and own.determined:
            out.print(f"  center of mass in the frame of {result.frame}: {_center(own)}", markup=False)
    held = result.held_out
    if held is not None:
        count = len(held.motions)
        out.print(
            f"held out ({count} motion{'s' * (count > 1)}): position RMSE {held.with_it:.4g} with it, "
            f"{held.without:.4g} without",
            markup=False,
        )
    for line in (*result.notes, *(line for way in order for line in result.ways[way].notes)):
        note(line)
    for line in result.doubts:
        warning(f"doubt: {line}")
    if not result.determined:
        problem(
            "the mass of the payload is not determined",
            "See the doubts above."
            if result.doubts
            else "Hold and swing it in many poses, with links that gravity acts on, and record FREE and LOADED alike.",
        )
    elif not result.weighed.carries:
        out.print("these recordings agree with no payload", markup=False)
    elif not result.doubts:
        out.print("nothing speaks against it", markup=False)


def _mass(own: Weighed) -> str:
    low, high = own.interval_kg
    return f"{own.mass_kg:.4g} kg [{low:.4g}, {high:.4g}]"


def _center(own: Weighed) -> str:
    """Millimeters are what matters."""
    parts = [
        f"{axis} {at:.3f} [{low:.3f}, {high:.3f}] m" if seen else f"{axis} not determined"
        for axis, at, (low, high), seen in zip("xyz", own.center_m, own.center_interval_m, own.center_seen, strict=True)
    ]
    return ", ".join(parts)
