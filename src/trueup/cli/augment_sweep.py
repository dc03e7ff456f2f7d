"""`trueup augment sweep`."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from trueup.augment.networks import METHODS
from trueup.cli import augment_config as trained
from trueup.cli import options
from trueup.cli.console import answer, out, status_line, warning
from trueup.errors import ConfigError

if TYPE_CHECKING:
    from trueup.augment import AugmentConfig
    from trueup.core.sweep_result import SweepResult


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("sweep")(sweep)


def sweep(
    datasets: trained.Datasets,
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for sweep.json and the models.")],
    methods: Annotated[
        list[str] | None, typer.Option("--method", help=f"One of {', '.join(METHODS)}; repeatable.")
    ] = None,
    configs: Annotated[
        list[Path] | None,
        typer.Option("--config", help="YAML file of another network, called like the file; repeatable."),
    ] = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Trainings of each network, from --seed on.")] = 3,
    by: Annotated[
        str | None,
        typer.Option("--by", help="Signal whose error on val decides; torque if all correct it, else the first."),
    ] = None,
    run: trained.Run = "mujoco/stock",
    signals: trained.Signals = None,
    command: trained.Command = None,
    epochs: trained.Epochs = None,
    robot: trained.Robot = None,
    device: trained.Device = "cpu",
    drop_flagged: options.TrainFlagged = None,
    train_motions: trained.TrainMotions = None,
    seed: options.Seed = 0,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs", min=1, help="Trainings at a time, of one thread each; the number of cores if not given."
        ),
    ] = None,
    ray: options.Ray = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Train several networks, and say which is best on val.

    With several seeds each, beside each other.

    Never reads test: judge the chosen one with `trueup augment eval`.
    """
    from trueup.robots import load_robot
    from trueup.stages import sweep as train_all

    with status_line() as line:
        found = train_all(
            datasets,
            out_dir,
            run=run,
            candidates=_candidates(methods or [], configs or [], signals, command, epochs),
            seeds=range(seed, seed + seeds),
            by=by,
            robot=load_robot(robot) if robot else None,
            drop_flagged=drop_flagged,
            train_motions=train_motions,
            jobs=jobs,
            ray=ray,
            device=device,
            overwrite=overwrite,
            resume=resume,
            on_training=_standing(line),
        )
    show(found, out_dir)
    out.print(f"next: trueup augment eval {datasets[0]} --model {out_dir / found.chosen} --out RUNS", markup=False)
    return 0


def _candidates(
    methods: list[str],
    configs: list[Path],
    signals: list[str] | None,
    command: list[str] | None,
    epochs: int | None,
) -> dict[str, AugmentConfig]:
    """Name -> configuration, methods first.

    Raises:
        ConfigError: there is none, two have one name, or one cannot be read.
    """
    if not methods and not configs:
        raise ConfigError("a sweep needs networks to train", expected="--method or --config, each once or more")
    named: list[tuple[str, str | None, str | None]] = [(name, name, None) for name in methods]
    named += [(path.stem, None, str(path)) for path in configs]
    made: dict[str, AugmentConfig] = {}
    for name, method, path in named:
        if name in made:
            raise ConfigError(f"two networks of the sweep are called {name!r}", hint="Rename a file, or leave one out.")
        made[name] = trained.configured(method, path, signals, command, epochs)
    return made


def _standing(line: Callable[[str], None]) -> Callable[[SweepResult], None]:
    """Says how far the sweep is; the time that is left is that of trainings since the command was given."""
    began = time.monotonic()

    def show(found: SweepResult) -> None:
        count = len(found.trainings)
        done = sum(training.state != "open" for training in found.trainings)
        text = f"sweep: {done}/{count} trainings"
        if found.ranking:
            best = found.ranking[0]
            text += f", best {best.candidate} {best.mean:.4g} {best.unit}"
        if 0 < done < count:
            text += f", {(count - done) * (time.monotonic() - began) / done:.0f} s left"
        line(text)

    return show


def show(found: SweepResult, out_dir: Path) -> None:
    """The ranking, what has failed, and where everything is."""
    from trueup.core.sweep_result import SWEEP_NAME

    answer(found)
    out.print(_table(found))
    failed = [training for training in found.trainings if training.state == "failed"]
    if failed:
        first = failed[0]
        warning(
            f"{len(failed)} of {len(found.trainings)} trainings failed, {first.candidate} with seed {first.seed} "
            f"because: {first.reason}",
            f"All reasons are in {SWEEP_NAME}; --resume tries them again.",
        )
    out.print(f"all of it: {out_dir / SWEEP_NAME}; chosen on val: {out_dir / found.chosen}", markup=False)


def _table(found: SweepResult) -> Table:
    table = Table(title=escape(f"{found.signal} on val over seeds, RMSE"))
    table.add_column("network")
    for heading in ("trainings", "unit", "simulated", "mean", "lowest", "highest", "left", "seconds"):
        table.add_column(heading, justify="right")
    for row in found.ranking:
        left = f"{100 * row.mean / row.simulated:.0f} %" if row.simulated > 0 else ""
        table.add_row(
            escape(row.candidate) + (" *" if row.best == found.chosen else ""),
            f"{row.complete}/{row.complete + row.failed}",
            row.unit,
            *(f"{value:.4g}" for value in (row.simulated, row.mean, row.low, row.high)),
            left,
            f"{row.seconds:.1f}",
        )
    return table
