"""The training loop that every method uses: epochs, checkpoints, learning rate, early stop, divergence."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor
from torch.optim import Optimizer

from trueup.augment.checkpoint import Checkpoint, Epoch, read_checkpoint, save_checkpoint
from trueup.augment.config import AugmentConfig, OptimizerConfig
from trueup.augment.corrector import Corrector
from trueup.augment.loss import Loss, on_device
from trueup.augment.pairs import Pairs
from trueup.augment.windows import Batch, Windows, whole_motions
from trueup.core.time_limit import TimeLimit
from trueup.errors import ConfigError, MissingDependency

# A loss this many times the lowest of an earlier epoch has run away.
_DIVERGED = 20.0
_VAL_BATCH = 32

OnProgress = Callable[["Progress"], None]


@dataclass(frozen=True)
class Progress:
    """Where training stands, for those who watch.

    Attributes:
        epochs: how many there will be at most.
        number: of the current epoch, from 1.
        batch: batches of the current epoch that are done.
        batches: batches in an epoch.
        epoch: the epoch that has just ended, or None within one.
        left_s: time left if all epochs are run [s]; None before anything is known.
        judging: whether training is over, and val says which outputs help and how far to trust them.
    """

    epochs: int
    number: int
    batch: int
    batches: int
    epoch: Epoch | None
    left_s: float | None
    judging: bool = False


@dataclass(frozen=True)
class Outcome:
    """How training went.

    Attributes:
        history: epochs.
        best: number of the epoch whose weights are kept; 0 if there was nothing to train.
        status: `finished`, `stopped early` (val no longer improves), `out of time` or `diverged` (weights of the best
            epoch are kept).
        seconds: of all epochs, those before a resume included [s].
    """

    history: tuple[Epoch, ...]
    best: int
    status: str
    seconds: float


def train(
    corrector: Corrector,
    train_pairs: Pairs,
    val_pairs: Pairs,
    config: AugmentConfig,
    *,
    seed: int,
    checkpoint: Path,
    inputs: str,
    resume: bool = False,
    device: str = "cpu",
    on_progress: OnProgress | None = None,
    limit: TimeLimit | None = None,
) -> Outcome:
    """Train a corrector in place; in the end it has the weights of the best epoch on val.

    Epoch n draws from a generator seeded with (seed, n), so that a run that was interrupted and resumed ends with the
    same weights as one that was not.

    Args:
        corrector: with its initial weights.
        train_pairs: what is fitted.
        val_pairs: what chooses the epoch.
        config: optimizer, windows, epochs.
        seed: of all draws.
        checkpoint: file that is written after each epoch.
        inputs: hash of everything that decides about the training; a checkpoint with another one is refused.
        resume: go on from the checkpoint, if there is one.
        device: `cpu` or `cuda`.
        on_progress: called after every batch and epoch.
        limit: when training ends, the last epoch early; learning rates that fall by the number of epochs fall by the
            time then, if that is faster.

    Raises:
        ConfigError: no such device, mixed precision without a GPU, or training diverges before the end of an epoch.
        OutputExists: the checkpoint is of another training.
    """
    place = find_device(device, config.precision)
    corrector.to(place)
    parameters = [item for item in corrector.parameters() if item.requires_grad]
    if not parameters or config.epochs == 0:
        return Outcome((), 0, "finished", 0.0)
    optimizer = _optimizer(parameters, config.optimizer)
    windows = Windows(train_pairs, config.window, config.batch)
    history: list[Epoch] = []
    best: dict[str, Tensor] = {}
    best_number = 0
    status = "finished"
    if resume and checkpoint.is_file():
        state, best = read_checkpoint(checkpoint, inputs, corrector.network, optimizer)
        history, best_number = list(state.history), state.best
    loss = Loss(config.loss, train_pairs.outputs, train_pairs.rate_hz, config.network.quantiles)
    while len(history) < config.epochs:
        if _is_over(history, best_number, config.stop_after):
            status = "stopped early"
            break
        if limit is not None and limit.over and history:
            status = "out of time"
            break
        number = len(history) + 1
        started = time.perf_counter()
        with torch.random.fork_rng(devices=[place] if place.type == "cuda" else []):
            mean, rate = _epoch(corrector, windows, optimizer, config, history, loss, seed, on_progress, limit)
        val = float(val_loss(corrector, val_pairs, loss)) if math.isfinite(mean) else math.nan
        if _runs_away(mean, [epoch.train for epoch in history]) or _runs_away(val, [e.val for e in history]):
            status = "diverged"
            break
        improved = val < min((epoch.val for epoch in history), default=math.inf)
        history.append(Epoch(number, mean, val, rate, time.perf_counter() - started))
        if improved:
            best_number = number
            best = {name: value.detach().clone() for name, value in corrector.network.state_dict().items()}
        save_checkpoint(checkpoint, Checkpoint(inputs, tuple(history), best_number), corrector.network, optimizer, best)
        if on_progress:
            on_progress(
                Progress(config.epochs, number, len(windows), len(windows), history[-1], _left(history, config))
            )
    if not best:
        raise ConfigError(
            "training diverged in its first epoch",
            got=f"learning rate {config.optimizer.rate:g}",
            hint="Lower optimizer.rate, or set optimizer.clip.",
        )
    corrector.network.load_state_dict(best)
    corrector.eval()
    return Outcome(tuple(history), best_number, status, sum(epoch.seconds for epoch in history))


def find_device(name: str, precision: str = "full") -> torch.device:
    """The device of this name, for matrices of this precision.

    Raises:
        ConfigError: there is no such device, or it is none for mixed precision.
        MissingDependency: torch finds no GPU.
    """
    if precision == "mixed" and name == "cpu":
        # Torch has no such LSTM for many CPUs, and what it has is slower.
        raise ConfigError("precision: mixed is for GPUs", got=f"--device {name}", expected="--device cuda")
    if name == "cpu":
        return torch.device("cpu")
    if name != "cuda":
        raise ConfigError("--device", got=name, available=("cpu", "cuda"))
    if not torch.cuda.is_available():
        raise MissingDependency("--device cuda: torch finds no GPU", hint="Leave it out, or install torch for CUDA.")
    return torch.device("cuda")


def _epoch(
    corrector: Corrector,
    windows: Windows,
    optimizer: Optimizer,
    config: AugmentConfig,
    history: Sequence[Epoch],
    loss: Loss,
    seed: int,
    on_progress: OnProgress | None,
    limit: TimeLimit | None,
) -> tuple[float, float]:
    """Mean loss and last learning rate of one epoch."""
    corrector.train()
    number = len(history) + 1
    corrector.network.begin(number, config.epochs)
    torch.manual_seed(np.random.SeedSequence([seed, number]).generate_state(1, np.uint64).astype(np.int64)[0])
    total, rate = 0.0, 0.0
    started = time.perf_counter()
    for done, batch in enumerate(windows.epoch(np.random.default_rng([seed, number]))):
        if limit is not None and limit.over and done:
            return total / done, rate
        spent = 0.0 if limit is None else limit.spent
        rate = _rate(config, history, done + len(windows) * (number - 1), len(windows), spent)
        for group in optimizer.param_groups:
            group["lr"] = rate
        with torch.autocast(corrector.center.device.type, torch.bfloat16, enabled=config.precision == "mixed"):
            found = loss.of(corrector, batch)
        optimizer.zero_grad(set_to_none=True)
        found.backward()  # type: ignore[no-untyped-call]
        if config.optimizer.clip > 0:
            torch.nn.utils.clip_grad_norm_(corrector.parameters(), config.optimizer.clip)
        optimizer.step()
        total += float(found.detach())
        if not math.isfinite(total):
            return total, rate
        if on_progress:
            per_batch = (time.perf_counter() - started) / (done + 1)
            left = per_batch * ((config.epochs - number + 1) * len(windows) - done - 1)
            on_progress(Progress(config.epochs, number, done + 1, len(windows), None, left))
    return total / len(windows), rate


def side_by_side(corrector: Corrector, pairs: Pairs) -> Iterator[tuple[Int[np.ndarray, "B"], Batch]]:
    """All motions whole, as many at once as this network takes well; see `windows.whole_motions`."""
    return whole_motions(pairs, _VAL_BATCH, one_by_one=corrector.network.one_by_one)


def val_loss(corrector: Corrector, pairs: Pairs, loss: Loss) -> float:
    """The loss over all samples of whole motions, without the gate."""
    corrector.eval()
    total, count = 0.0, 0
    with torch.no_grad():
        for _, batch in side_by_side(corrector, pairs):
            total += float(loss.of(corrector, batch)) * int(batch.lengths.sum())
            count += int(batch.lengths.sum())
    return total / count


def predictions(corrector: Corrector, pairs: Pairs) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """For each motion its number, the simulated, the corrected and the measured outputs, each (T, K)."""
    corrector.eval()
    base = corrector.base.cpu().numpy()
    with torch.no_grad():
        for numbers, batch in side_by_side(corrector, pairs):
            x, _, lengths = on_device(corrector, batch)
            y = corrector(x, lengths).cpu().numpy()
            for place, number in enumerate(numbers):
                rows = batch.lengths[place]
                yield int(number), batch.x[:rows, place][:, base], y[:rows, place], batch.y[:rows, place]


def _optimizer(parameters: list[torch.nn.Parameter], config: OptimizerConfig) -> Optimizer:
    if config.name == "rmsprop":
        # Keras' forgetting factor and epsilon, with which the papers were made.
        return torch.optim.RMSprop(parameters, lr=config.rate, alpha=0.9, eps=1e-7)
    return torch.optim.AdamW(parameters, lr=config.rate, weight_decay=config.weight_decay)


def _rate(config: AugmentConfig, history: Sequence[Epoch], step: int, batches: int, spent: float) -> float:
    optimizer = config.optimizer
    if optimizer.schedule == "cosine":
        total = config.epochs * batches
        rise = min(1.0, (step + 1) / max(1, min(optimizer.warmup_steps, total // 10)))
        return optimizer.rate * rise * 0.5 * (1 + math.cos(math.pi * max(step / total, spent)))
    rate, lowest, waited = optimizer.rate, math.inf, 0
    for epoch in history:
        if epoch.val < lowest:
            lowest, waited = epoch.val, 0
        else:
            waited += 1
        if waited >= optimizer.patience:
            rate, waited = rate * optimizer.factor, 0
    return rate


def _is_over(history: Sequence[Epoch], best: int, stop_after: int) -> bool:
    return stop_after > 0 and len(history) - best >= stop_after and bool(history)


def _runs_away(loss: float, earlier: Sequence[float]) -> bool:
    return not math.isfinite(loss) or (bool(earlier) and loss > _DIVERGED * min(earlier))


def _left(history: Sequence[Epoch], config: AugmentConfig) -> float:
    recent = [epoch.seconds for epoch in history[-5:]]
    return sum(recent) / len(recent) * (config.epochs - len(history))
