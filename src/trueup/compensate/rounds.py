"""A training in rounds: after each, val says how good the network is, and a checkpoint is written."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from trueup.augment.checkpoint import Checkpoint, Epoch, read_checkpoint, save_checkpoint
from trueup.augment.corrector import Corrector
from trueup.compensate.training import Teacher
from trueup.errors import ConfigError

# How good a network is: less is better.
Judge = Callable[[Corrector], float]


@dataclass(frozen=True)
class Learned:
    """What a training did.

    Attributes:
        history: its rounds; `val` is what the judge says.
        best: number of the round whose weights are kept.
        seconds: of all rounds, those before a resume included [s].
        cpu_seconds: of this call, all threads together [s].
    """

    history: tuple[Epoch, ...]
    best: int
    seconds: float
    cpu_seconds: float


def learn(
    corrector: Corrector,
    teacher: Teacher,
    judge: Judge,
    *,
    seed: int,
    checkpoint: Path,
    inputs: str,
    resume: bool = False,
    on_round: Callable[[Epoch, int], None] = lambda *_: None,
) -> Learned:
    """Train in place; in the end the network has the weights of the best round on val.

    Round n draws from a generator seeded with (seed, n): a training that was interrupted and resumed ends with the same
    weights as one that was not.

    Args:
        corrector: with its initial weights.
        teacher: what it learns from.
        judge: of the val motions.
        seed: of all draws.
        checkpoint: file that is written after each round.
        inputs: hash of everything that decides about the training; a checkpoint with another one is refused.
        resume: go on from the checkpoint, if there is one.
        on_round: called after each round with what it did and the number of rounds.

    Raises:
        ConfigError: the training diverges before the end of a round.
        OutputExists: the checkpoint is of another training.
    """
    optimizer = torch.optim.Adam(corrector.parameters(), teacher.config.training.rate)
    updates = teacher.config.training.updates
    rounds = min(teacher.config.training.rounds, updates)
    history: list[Epoch] = []
    best: dict[str, Tensor] = {}
    best_number, cpu = 0, time.process_time()
    if resume and checkpoint.is_file():
        state, best = read_checkpoint(checkpoint, inputs, corrector.network, optimizer)
        history, best_number = list(state.history), state.best
    while len(history) < rounds:
        number, began = len(history) + 1, time.perf_counter()
        done, end = (updates * part // rounds for part in (number - 1, number))
        train = teacher.train(corrector, optimizer, done=done, count=end - done, seed=(seed, number))
        val = judge(corrector)
        if not math.isfinite(train):
            break
        if val < min((item.val for item in history), default=math.inf):
            best_number = number
            best = {name: value.detach().clone() for name, value in corrector.network.state_dict().items()}
        rate = float(optimizer.param_groups[0]["lr"])
        history.append(Epoch(number, train, val, rate, time.perf_counter() - began))
        save_checkpoint(checkpoint, Checkpoint(inputs, tuple(history), best_number), corrector.network, optimizer, best)
        on_round(history[-1], rounds)
    if not best:
        raise ConfigError(
            "training diverged in its first round",
            got=f"learning rate {teacher.config.training.rate:g}",
            hint="Lower training.rate.",
        )
    corrector.network.load_state_dict(best)
    corrector.eval()
    return Learned(tuple(history), best_number, sum(item.seconds for item in history), time.process_time() - cpu)
