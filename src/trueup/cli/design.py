"""`trueup design`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from trueup.cli import options
from trueup.cli.console import answer, begins, note, out
from trueup.errors import ConfigError

if TYPE_CHECKING:
    from trueup.robots import RobotSpec
    from trueup.stages import Designed, Foreseen


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("design")(design)


def design(
    robot: options.Robot,
    count: Annotated[int, typer.Option("--count", min=1, help="Number of motions.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the plan set.")],
    config: Annotated[
        Path | None, typer.Option("--config", help="YAML that says what will be fitted; see docs/identification.md.")
    ] = None,
    fit: Annotated[
        Path | None, typer.Option("--fit", help="fit.json of an earlier fit: design for what it leaves unsure.")
    ] = None,
    model: Annotated[Path | None, typer.Option("--model", help="MJCF or URDF, if it is elsewhere.")] = None,
    workspace: Annotated[
        str | None, typer.Option("--workspace", help="floor, empty, cell, or a YAML with floor_m and boxes.")
    ] = None,
    duration_s: Annotated[float, typer.Option("--duration", help="Length of a motion without rest [s].")] = 10.0,
    evaluations: Annotated[int, typer.Option("--evaluations", help="Motions that are tried for each.")] = 300,
    velocity_limit: Annotated[
        list[str] | None,
        typer.Option("--velocity-limit", help="NUMBER or JOINT=NUMBER [rad/s, m/s]; repeatable."),
    ] = None,
    acceleration_limit: Annotated[
        list[str] | None,
        typer.Option("--acceleration-limit", help="NUMBER or JOINT=NUMBER [rad/s^2, m/s^2]; repeatable."),
    ] = None,
    noise: Annotated[
        float | None, typer.Option("--noise", help="Standard deviation of a measured position [rad or m].")
    ] = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Design the motions that tell the parameters of a fit best.

    Says beforehand how well they will be told.
    """
    from trueup.core.fit_result import FitResult
    from trueup.identify import IdentifyConfig
    from trueup.record import DesignSettings, load_workspace
    from trueup.stages import design as run

    spec = options.robot_of(robot)
    designed = run(
        spec,
        out_dir,
        count=count,
        config=IdentifyConfig.load(config) if config else None,
        fit=FitResult.load(fit) if fit else None,
        model=model,
        workspace=None if workspace is None else load_workspace(workspace),
        velocity_limits=_limits(spec, velocity_limit, "--velocity-limit"),
        acceleration_limits=_limits(spec, acceleration_limit, "--acceleration-limit"),
        noise=noise,
        settings=DesignSettings(duration_s=duration_s, harmonics=max(1, round(duration_s)), evaluations=evaluations),
        seed=seed,
        jobs=jobs,
        overwrite=overwrite,
        progress=lambda done, total, _: begins(f"designed: {done}/{total}"),
    )
    show(designed, out_dir)
    return 0


def show(designed: Designed, out_dir: Path) -> None:
    """What each parameter's standard deviation will be, and where the motions are."""
    from trueup.core.design_result import DESIGN_NAME, DesignResult

    answer(DesignResult.load(out_dir / DESIGN_NAME))
    out.print(table_of(designed))
    for line in designed.notes:
        note(line)
    if designed.gain is None:
        note("there is no room for random motions to compare with")
    else:
        out.print(f"standard deviations after random motions are {designed.gain:.2f} times as large (geometric mean)")
    out.print(f"plan set: {out_dir}", markup=False)


def table_of(designed: Designed) -> Table:
    """One row per parameter."""
    table = Table(
        title=f"predicted standard deviation after {len(designed.plans)} motions of {designed.plans[0].duration_s:g} s",
        title_justify="left",
    )
    table.add_column("parameter")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for name in ("before", "random", "designed"):
        table.add_column(name, justify="right")
    for item in designed.parameters:
        cells = [_deviation(item, own) for own in (item.before, item.random, item.designed)]
        table.add_row(escape(item.name), f"{item.value:.4g}", item.unit, *cells)
    return table


def _deviation(item: Foreseen, std: float | None) -> str:
    if std is None:
        return ""
    if item.transform == "linear":
        return f"{std:.2g}"
    # Beyond that a share would be no measure of a factor.
    return f"{100 * std:.2g} %" if std < 0.5 else f"factor {min(2.718281828**std, 1e9):.2g}"


def _limits(robot: RobotSpec, items: list[str] | None, option: str) -> dict[str, float]:
    """Joint -> limit; a bare number is for all joints that are not named.

    Raises:
        ConfigError: no number.
    """
    limits: dict[str, float] = {}
    for item in sorted(items or [], key=lambda text: "=" in text):
        joint, _, text = item.rpartition("=")
        try:
            number = float(text)
        except ValueError:
            raise ConfigError(option, got=item, expected="NUMBER or JOINT=NUMBER, e.g. 2.5 or elbow=1.5") from None
        limits |= {joint: number} if joint else dict.fromkeys(robot.joint_names, number)
    return limits
