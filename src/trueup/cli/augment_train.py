"""`trueup augment train`."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from trueup.augment.networks import METHODS
from trueup.cli import augment_config as trained
from trueup.cli import options
from trueup.cli.console import answer, note, out, status_line, track
from trueup.errors import needing

if TYPE_CHECKING:
    from trueup.augment import Progress
    from trueup.core.model_card import ModelCard


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("train")(train)


def train(
    datasets: trained.Datasets,
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the model.")],
    method: Annotated[
        str | None,
        typer.Option("--method", help=f"One of {', '.join(METHODS)}; realeasy-rt if not given."),
    ] = None,
    config: Annotated[
        str | None, typer.Option("--config", help="paper, default, or a YAML file; see docs/augmentation.md.")
    ] = None,
    run: trained.Run = "mujoco/stock",
    signals: trained.Signals = None,
    command: trained.Command = None,
    epochs: trained.Epochs = None,
    robot: trained.Robot = None,
    name: Annotated[str, typer.Option("--name", help="Name of the model; the method if not given.")] = "",
    device: trained.Device = "cpu",
    tensorboard: Annotated[
        Path | None, typer.Option("--tensorboard", help="Folder for curves that TensorBoard shows.")
    ] = None,
    drop_flagged: options.TrainFlagged = None,
    train_motions: trained.TrainMotions = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Train a network that corrects simulated runs.

    It turns them into what the robot would have measured.

    Fits on train, chooses on val, never reads test: judge the result with `trueup augment eval`.
    """
    from trueup.dataset import Dataset
    from trueup.robots import load_robot
    from trueup.stages import augment

    chosen = trained.configured(method, config, signals, command, epochs)
    with _watching(tensorboard) as on_progress:
        made = augment(
            [Dataset(path) for path in datasets],
            out_dir,
            run=run,
            config=chosen,
            robot=load_robot(robot) if robot else None,
            name=name,
            drop_flagged=drop_flagged,
            train_motions=train_motions,
            seed=seed,
            jobs=jobs,
            device=device,
            overwrite=overwrite,
            resume=resume,
            track=track,
            on_progress=on_progress,
        )
    card = made.augmentation.card
    answer(card.to_json())
    out.print(_table(card))
    for line in made.notes:
        note(line)
    training = card.provenance["training"]
    if training["history"]:
        out.print(
            f"{training['status']} after {len(training['history'])} epochs in {training['seconds']:.0f} s, "
            f"best: {training['best_epoch']}",
            markup=False,
        )
    out.print(f"model: {made.folder}", markup=False)
    out.print(f"next: trueup augment eval {datasets[0]} --model {made.folder} --out RUNS", markup=False)
    return 0


@contextmanager
def _watching(folder: Path | None) -> Iterator[Callable[[Progress], None]]:
    """Shows where training stands, here and, if there is a folder, in TensorBoard."""
    with contextlib.ExitStack() as stack:
        board = stack.enter_context(_board(folder)) if folder else None
        line = stack.enter_context(status_line())

        def show(progress: Progress) -> None:
            if board and progress.epoch:
                for name in ("train", "val", "rate"):
                    board.add_scalar(
                        f"loss/{name}" if name != "rate" else name, getattr(progress.epoch, name), progress.number
                    )
            line(progress_line(progress))

        yield show


@contextmanager
def _board(folder: Path) -> Iterator[Any]:
    with needing("--tensorboard", "tensorboard"):
        from torch.utils.tensorboard import SummaryWriter
    with SummaryWriter(str(folder)) as writer:
        yield writer


def progress_line(progress: Progress) -> str:
    """Where a training stands."""
    if progress.judging:
        return "train: done; val motions tell which outputs help, and how far to trust them"
    where = f"epoch {progress.number}/{progress.epochs}"
    left = "" if progress.left_s is None else f", {_duration(progress.left_s)} left at most"
    if progress.epoch is None:
        return f"train: {where}, batch {progress.batch}/{progress.batches}{left}"
    return f"train: {where}, loss {progress.epoch.train:.4g}, val {progress.epoch.val:.4g}{left}"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _table(card: ModelCard) -> Table:
    """RMSE on val before and after, signal by signal and joint by joint."""
    table = Table(title=f"{card.name}: RMSE on val, simulator -> corrected")
    table.add_column("signal")
    for joint in card.joints:
        table.add_column(joint, justify="right")
    units = {output.signal: output.unit for output in card.outputs}
    for signal, joints in card.metrics["val"].items():
        cells = [joints.get(joint) for joint in card.joints]
        shown = [f"{cell['simulated']:.3g} -> {cell['corrected']:.3g}" if cell else "" for cell in cells]
        table.add_row(escape(f"{signal} [{units[signal]}]"), *shown)
    return table
