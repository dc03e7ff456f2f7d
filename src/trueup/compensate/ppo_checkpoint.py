"""Where a training by reinforcement stands, in one file that is there whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.optim import Optimizer

from trueup.augment.checkpoint import of_this_version, part_of, read_tensors, restore, slots_of, write_tensors
from trueup.core.config import build
from trueup.core.effort import Effort


@dataclass(frozen=True)
class Iteration:
    """One line of the history.

    Attributes:
        number: from 1.
        samples: control steps of all robots so far.
        reward: mean of a control step.
        error: mean distance of a joint from the measured position, while actions are drawn [rad or m].
        noise: mean standard deviation of delta actions [rad or m].
        left: episodes that ended because the simulator had left the motion.
        lost: and because it diverged.
        effort: of this iteration.
    """

    number: int
    samples: int
    reward: float
    error: float
    noise: float
    left: int
    lost: int
    effort: Effort


@dataclass(frozen=True)
class Stand:
    """What a file says besides its tensors.

    Attributes:
        inputs: hash of everything that decides about the training.
        history: iterations that are done.
    """

    inputs: str
    history: tuple[Iteration, ...]


def save_checkpoint(
    path: Path, state: Stand, policy: nn.Module, optimizer: Optimizer, memory: Mapping[str, np.ndarray]
) -> None:
    """Write the file atomically; `memory` is that of the environment."""
    tensors = {f"policy.{name}": value for name, value in policy.state_dict().items()}
    tensors |= {f"memory.{name}": torch.from_numpy(np.ascontiguousarray(value)) for name, value in memory.items()}
    write_tensors(path, tensors | slots_of(optimizer), asdict(state))


def read_checkpoint(
    path: Path, inputs: str, policy: nn.Module, optimizer: Optimizer
) -> tuple[tuple[Iteration, ...], dict[str, np.ndarray]]:
    """Put policy and optimizer where they were; returns the history and the environment's memory.

    Raises:
        OutputExists: the checkpoint belongs to another training.
        DataError: the file is broken.
    """
    tensors, tree = read_tensors(path, inputs)
    with of_this_version(path):
        state = build(Stand, tree, str(path))
        policy.load_state_dict(part_of(tensors, "policy."))
        restore(optimizer, tensors)
    return state.history, {name: value.numpy() for name, value in part_of(tensors, "memory.").items()}
