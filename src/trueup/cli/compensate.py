"""`trueup compensate`: what commands lack."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from trueup.cli import options
from trueup.cli.console import answer, note, out, problem, status_line, track
from trueup.errors import ConfigError

if TYPE_CHECKING:
    from trueup.compensate.config import CompensateConfig
    from trueup.compensate.judging import PayloadErrors
    from trueup.robots import RobotSpec

app = typer.Typer(
    help="Networks that correct commands. They say what commands lack, in the simulator or on the robot.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
# What `--config` knows besides files.
_NAMED = ("default", "paper")


def register(parent: typer.Typer) -> None:
    """Add the group of commands."""
    app.command("train")(train)
    app.command("replay")(replay)
    parent.add_typer(app, name="compensate")


def train(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset with commands.")],
    robot: options.Robot,
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the model.")],
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            help="operator, mlp or transformer; of robots that take torques, torques. The first or last if not given.",
        ),
    ] = None,
    config: Annotated[
        str | None, typer.Option("--config", help="paper, default, or a YAML file; see docs/compensation.md.")
    ] = None,
    twin: Annotated[
        Path | None,
        typer.Option("--twin", help="With --twin-robot: network that makes its simulator more like the robot."),
    ] = None,
    twin_robot: Annotated[
        str | None,
        typer.Option(
            "--twin-robot", help="Identified robot; with it, a network for the robot itself is trained on it."
        ),
    ] = None,
    empty_handed: Annotated[
        bool,
        typer.Option("--empty-handed", help="With --twin-robot: move like a simulator that carries nothing."),
    ] = False,
    control_hz: Annotated[
        float | None, typer.Option("--control-hz", help="Commands per second; those of the log if not given.")
    ] = None,
    run: Annotated[str, typer.Option("--run", help="Label of the runs of this robot's simulator.")] = "mujoco/stock",
    name: Annotated[str, typer.Option("--name", help="Name of the model; the method if not given.")] = "",
    model: options.Model = None,
    drop_flagged: options.TrainFlagged = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Train a network that says what commands lack.

    For the simulator to move like the robot, or the robot like it.

    Fits on train, chooses on val, never reads test: replay the test motions with `trueup compensate replay`, and judge
    them with `trueup gap`.
    """
    from trueup.dataset import Dataset
    from trueup.robots import load_robot
    from trueup.stages.compensating import compensate

    own = load_robot(robot)
    if twin_robot is None and (twin or empty_handed):
        raise ConfigError("--twin and --empty-handed are for networks of the robot itself", hint="Give --twin-robot.")
    with status_line() as line:
        made = compensate(
            Dataset(dataset),
            own,
            out_dir,
            config=_configured(method or _usual(own), config, "" if twin_robot is None else "-robot"),
            model=model,
            control_hz=control_hz,
            twin=None if twin_robot is None else (twin, load_robot(twin_robot)),
            empty_handed=empty_handed,
            run=run,
            name=name,
            drop_flagged=drop_flagged,
            seed=seed,
            jobs=jobs,
            overwrite=overwrite,
            resume=resume,
            track=track,
            on_round=lambda done, count: line(
                f"train: round {done.number}/{count}, loss {done.train:.4g}, val {done.val:.4g}, "
                f"{(count - done.number) * done.seconds:.0f} s left"
            ),
        )
    card = made.compensation.card
    answer(card.to_json())
    what = "simulator - robot" if made.compensation.direction == "simulator" else "robot's twin - simulator"
    out.print(_table(f"{card.name}: positions on val, {what}", made.errors))
    for text in made.notes:
        note(text)
    out.print(f"trained in {made.seconds:.0f} s; model: {made.folder}", markup=False)
    if made.compensation.direction == "simulator":
        out.print(f"next: trueup compensate replay {dataset} --robot {robot} --network {made.folder}", markup=False)
    return 0


def replay(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset with commands.")],
    robot: options.Robot,
    network: Annotated[Path, typer.Option("--network", help="Folder of a network for the simulator.")],
    label: Annotated[
        str | None, typer.Option("--label", help="Name of the run; the simulator's with the network's if not given.")
    ] = None,
    model: options.Model = None,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Replay logged commands in a compensated simulator.

    What it does is stored as a run of the dataset.
    """
    from trueup.dataset import Dataset
    from trueup.robots import load_robot
    from trueup.stages.compensated_replaying import compensated_replay

    summary = compensated_replay(
        Dataset(dataset),
        load_robot(robot),
        network,
        model=model,
        label=label,
        jobs=jobs,
        overwrite=overwrite,
        track=track,
    )
    for name, error in summary.failed.items():
        problem(f"{name} was not replayed: {error.what}: {error.details}", error.hint)
    for line in summary.notes:
        note(line)
    out.print(f"{summary.replayed} episodes replayed in {summary.seconds:.1f} s -> run {summary.label}", markup=False)
    out.print(f"next: trueup gap {dataset} --runs mujoco/stock,{summary.label} --out RESULTS", markup=False)
    return 2 if summary.failed else 0


def _usual(robot: RobotSpec) -> str:
    return "torques" if robot.controller.signal == "torque" else "operator"


def _configured(method: str, config: str | None, side: str) -> CompensateConfig:
    from trueup.compensate.config import METHODS, CompensateConfig

    if config is not None and config not in _NAMED:
        return CompensateConfig.load(Path(config))
    name = f"{method}-paper" if config == "paper" else f"{method}{side}"
    if name not in METHODS:
        raise ConfigError("there is no such method", got=name, available=METHODS)
    return METHODS[name]


def _table(title: str, errors: Sequence[PayloadErrors]) -> Table:
    table = Table(title=title)
    for heading in ("payload", "motions", "mean", "99.9 %"):
        table.add_column(heading, justify="right")
    for item in errors:
        table.add_row(
            f"{item.payload_kg:g} kg",
            str(item.motions),
            f"{item.before:.3g} -> {item.after:.3g}",
            f"{item.p999_before:.3g} -> {item.p999_after:.3g}",
        )
    return table
