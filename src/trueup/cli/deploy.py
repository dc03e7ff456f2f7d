"""`trueup deploy`: what was trained, in a robot's control loop."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.table import Table

from trueup.cli import options, ros2
from trueup.cli.console import answer, out, problem, status_line
from trueup.errors import ConfigError

if TYPE_CHECKING:
    from trueup.deploy.policy_loop import PolicyRun

app = typer.Typer(help="What was trained, in a robot's control loop.", no_args_is_help=True, rich_markup_mode=None)
# So near is there [m].
_NEAR_M = 0.05


def register(parent: typer.Typer) -> None:
    """Add the group of commands."""
    app.callback()(_deploy)
    app.command("run")(run)
    ros2.register(app)
    parent.add_typer(app, name="deploy")


def _deploy() -> None:
    """What was trained, in a robot's control loop."""


def run(
    policy: Annotated[Path, typer.Argument(help="Folder of a policy, or zoo:NAME.")],
    robot: options.Robot = "panda_torque",
    goal: Annotated[
        tuple[float, float, float] | None, typer.Option("--goal", help="Where to go: x y z [m].", metavar="X Y Z")
    ] = None,
    goals: Annotated[int | None, typer.Option("--goals", min=1, help="So many goals, drawn; 5 without --goal.")] = None,
    unit: Annotated[int, typer.Option("--unit", min=0, help="Individual of the virtual hardware.")] = 1,
    payload_kg: Annotated[float, typer.Option("--payload-kg", help="What it carries [kg].")] = 0.0,
    seconds: Annotated[float, typer.Option("--seconds", help="For each goal [s].")] = 4.0,
    rate_hz: Annotated[float, typer.Option("--hz", help="Ticks of the control loop per second.")] = 1000.0,
    real_time: Annotated[bool, typer.Option("--real-time", help="The robot takes as long as a real one.")] = False,
    workspace: Annotated[
        tuple[float, float, float, float, float, float] | None,
        typer.Option("--workspace", help="Where the end of the arm must stay [m].", metavar="X0 X1 Y0 Y1 Z0 Z1"),
    ] = None,
    torque_rate: Annotated[
        float | None, typer.Option("--torque-rate", help="Fastest change of a torque [Nm/s]; the model's if not given.")
    ] = None,
    late_ms: Annotated[
        float, typer.Option("--late-ms", help="With --real-time: a tick that is so much too late stops the arm.")
    ] = 20.0,
    priority: options.Priority = None,
    cpu: options.Cpu = None,
    model: options.Model = None,
    seed: options.Seed = 0,
    out_dir: Annotated[Path | None, typer.Option("--out", help="Dataset of what was measured and sent.")] = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Drive virtual hardware by a policy, within limits.

    At the rate of its control loop, with an emergency stop.
    """
    import trueup.zoo
    from trueup.deploy.policy_loop import DONE
    from trueup.deploy.realtime import RealTimeSettings
    from trueup.robots import load_robot
    from trueup.stages.policy_driving import drive

    if goal is not None and goals is not None:
        raise ConfigError("--goal and --goals", got="both", expected="one of them")
    RealTimeSettings(priority, None if cpu is None else tuple(cpu), lock_memory=priority is not None).apply()
    with status_line() as line:
        runs = drive(
            trueup.zoo.folder_of(policy),
            load_robot(robot),
            (goals or 5) if goal is None else np.array([goal]),
            unit=unit,
            payload_kg=payload_kg,
            seconds=seconds,
            rate_hz=rate_hz,
            real_time=real_time,
            workspace_m=None if workspace is None else (workspace[::2], workspace[1::2]),
            torque_rate=torque_rate,
            late_s=late_ms / 1e3,
            model=model,
            seed=seed,
            out=out_dir,
            overwrite=overwrite,
            on_run=lambda done, count: line(f"{100 * done.final_m:.1f} cm from the goal, of {count} goals"),
        )
    answer([_in_short(run) for run in runs])
    out.print(_table(runs))
    if real_time:
        out.print(_punctual(runs), markup=False)
    if out_dir is not None:
        out.print(f"{len(runs)} episodes -> {out_dir}", markup=False)
    last = runs[-1]
    if last.reason != DONE:
        problem(
            f"stopped: {last.reason}; the arm {'stands' if last.phase == 'stopped' else 'did not come to rest'}", ""
        )
        return 2
    return 0


def _in_short(run: PolicyRun) -> dict[str, Any]:
    return {
        "goal_m": run.goal.tolist(),
        "distance_m": float(run.final_m),
        "within_5_cm_after_s": run.within_s(_NEAR_M),
        "limited": {name: float(share) for name, share in run.shares.items()},
        "end": run.reason,
    }


def _table(runs: tuple[PolicyRun, ...]) -> Table:
    from trueup.deploy.policy_loop import DONE

    table = Table(title="goals")
    for heading in (
        "goal [m]",
        "distance [cm]",
        "within 5 cm after [s]",
        "limited: torque, rate, position, velocity [%]",
        "end",
    ):
        table.add_column(heading, justify="right")
    for one in runs:
        first = one.within_s(_NEAR_M)
        table.add_row(
            ", ".join(f"{value:.2f}" for value in one.goal),
            f"{100 * one.final_m:.1f}",
            "" if first is None else f"{first:.2f}",
            ", ".join(f"{100 * share:.1f}" for share in one.shares.values()),
            "done" if one.reason == DONE else "stopped",
        )
    return table


def _punctual(runs: tuple[PolicyRun, ...]) -> str:
    from trueup.deploy.latency import Latency

    step, wakeup = Latency(), Latency()
    for one in runs:
        step.add(one.report.step)
        wakeup.add(one.report.wakeup)
    cycles = sum(one.report.cycles for one in runs)
    late = sum(one.report.overruns for one in runs)
    return (
        f"{cycles} ticks, {late} not in time; a tick takes {step.percentile_us(50.0):.0f} us "
        f"(99 % within {step.percentile_us(99.0):.0f}), and 99 % begin within {wakeup.percentile_us(99.0):.0f} us"
    )
