"""`trueup fleet`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.markup import escape
from rich.table import Table

from trueup.cli import options
from trueup.cli.console import answer, note, out, problem, track

if TYPE_CHECKING:
    from trueup.core.fleet_result import FleetResult, FleetUnit

# Names of units in a cell.
_SHOWN = 4


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("fleet")(fleet)


def fleet(
    datasets: Annotated[list[Path], typer.Argument(help="Datasets, of one unit or several each.")],
    robot: options.Robot,
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the results, one below it for each unit.")],
    until: Annotated[
        Literal["gap", "explain", "identify", "augment"], typer.Option("--until", help="The last step for each unit.")
    ] = "identify",
    budget: Annotated[
        str, typer.Option("--budget", help="Time for each unit, e.g. 90s, 10m, 1h; `none` for no limit.")
    ] = "none",
    config: Annotated[
        Path | None, typer.Option("--config", help="YAML that says what to fit; see docs/identification.md.")
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option("--method", help="With --until augment: network to try; repeatable; three if not given."),
    ] = None,
    model: options.Model = None,
    seed: options.Seed = 0,
    jobs: Annotated[
        int | None, typer.Option("--jobs", min=1, help="Units at a time; the number of cores if not given.")
    ] = None,
    ray: options.Ray = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Identify many robots of one kind, and compare them.

    Each by itself: how they differ, and which is unlike the others.
    """
    from trueup.identify import IdentifyConfig
    from trueup.robots import load_robot
    from trueup.stages.close_networks import METHODS
    from trueup.stages.fleet import fleet as run

    found = run(
        datasets,
        load_robot(robot),
        out_dir,
        model=model,
        config=IdentifyConfig.load(config) if config else None,
        until=until,
        budget_s=options.budget_s(budget),
        methods=tuple(method or METHODS),
        seed=seed,
        jobs=jobs,
        ray=ray,
        overwrite=overwrite,
        resume=resume,
        track=track,
    )
    show(found, out_dir)
    return 2 if any(unit.status == "failed" for unit in found.units) else 0


def show(found: FleetResult, out_dir: Path) -> None:
    """All units, then all parameters, then what must be said."""
    from trueup.core.fleet_result import FLEET_NAME

    answer(found)
    out.print(_units(found))
    if found.parameters:
        out.print(_parameters(found))
        note("spread: how units differ beyond what each is uncertain by; % of values that cannot be negative")
    for unit in found.units:
        if unit.status == "failed":
            problem(f"{unit.name}: {unit.reason}", "")
    out.print(f"all of it: {out_dir / FLEET_NAME}", markup=False)


def _units(found: FleetResult) -> Table:
    rungs = list(dict.fromkeys(rung for unit in found.units for rung in unit.errors))
    split = "test" if any("test" in errors for unit in found.units for errors in unit.errors.values()) else "train"
    table = Table(title=escape(f"RMSE of {found.signal}, {split}"))
    table.add_column("unit")
    table.add_column("motions", justify="right")
    for rung in rungs:
        table.add_column(escape(rung), justify="right")
    table.add_column("fit")
    table.add_column("seconds", justify="right")
    for unit in found.units:
        cells = [_error(unit, rung, split) for rung in rungs]
        table.add_row(escape(unit.name), str(unit.motions), *cells, unit.status, f"{unit.seconds:.1f}")
    return table


def _error(unit: FleetUnit, rung: str, split: str) -> str:
    value = unit.errors.get(rung, {}).get(split)
    return "" if value is None else f"{value:.4g}"


def _parameters(found: FleetResult) -> Table:
    table = Table(title="parameters over the units whose data determine them")
    table.add_column("parameter")
    for heading in ("unit", "model", "mean [95 % interval]", "spread", "uncertain by", "units"):
        table.add_column(escape(heading), justify="right")
    table.add_column("not like the others")
    for row in found.parameters:
        scale, sign = (100.0, " %") if row.relative else (1.0, "")
        names = [*row.apart[:_SHOWN], *(["…"] if len(row.apart) > _SHOWN else [])]
        table.add_row(
            escape(row.name),
            escape(row.unit),
            "" if row.nominal is None else f"{row.nominal:.4g}",
            escape(f"{row.mean:.4g} [{row.low:.4g}, {row.high:.4g}]"),
            f"{scale * row.spread:.2g}{sign}",
            f"{scale * row.uncertainty:.2g}{sign}",
            str(row.units),
            escape(", ".join(names)),
        )
    return table
