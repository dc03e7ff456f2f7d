"""Where a training by reinforcement stands, in one file that is there whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.optim import Optimizer

from trueup.augment.checkpoint import digest_of
from trueup.core.atomic import regular, replacing
from trueup.core.config import build
from trueup.core.effort import Effort
from trueup.errors import ConfigError, DataError, OutputExists

_ANEW = "Give --overwrite to begin anew."


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
    for number, slots in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{number}.{name}": torch.as_tensor(value) for name, value in slots.items()}
    tensors |= {f"memory.{name}": torch.from_numpy(np.ascontiguousarray(value)) for name, value in memory.items()}
    # Weights that two modules share are one tensor to torch, which safetensors does not write.
    tensors = {name: value.detach().cpu().clone().contiguous() for name, value in tensors.items()}
    said = json.dumps(asdict(state))
    with replacing(path) as temporary:
        save_file(tensors, temporary, {"state": said, "sha256": digest_of(tensors, said)})


def read_checkpoint(
    path: Path, inputs: str, policy: nn.Module, optimizer: Optimizer
) -> tuple[tuple[Iteration, ...], dict[str, np.ndarray]]:
    """Put policy and optimizer where they were; returns the history and the environment's memory.

    Raises:
        OutputExists: the checkpoint belongs to another training.
        DataError: the file is broken.
    """
    try:
        with safe_open(regular(path), framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # it has no __iter__
        tree = json.loads(metadata["state"])
        whole = metadata["sha256"] == digest_of(tensors, metadata["state"])
        state = build(Stand, tree, str(path))
    except (SafetensorError, OSError, KeyError, TypeError, ValueError, RecursionError, ConfigError) as error:
        raise DataError(f"{path} is no checkpoint", got=str(error).split("\n")[0], hint=_ANEW) from error
    if not whole:
        raise DataError(f"{path} was changed after it was written (its hash differs)", hint=_ANEW)
    if state.inputs != inputs:
        raise OutputExists(
            f"{path.parent} holds the training of another configuration, seed or data",
            hint="Give --overwrite to begin anew, or choose another --out.",
        )
    try:
        policy.load_state_dict(_part(tensors, "policy."))
        slots: dict[int, dict[str, Tensor]] = {}
        for name, value in _part(tensors, "optimizer.").items():
            number, slot = name.split(".", 1)
            slots.setdefault(int(number), {})[slot] = value
        groups = optimizer.state_dict()["param_groups"]
        optimizer.load_state_dict({"state": slots, "param_groups": groups})
    except (IndexError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise DataError(
            f"{path} was written by another version of trueup or torch", got=str(error).split("\n")[0], hint=_ANEW
        ) from error
    return state.history, {name: value.numpy() for name, value in _part(tensors, "memory.").items()}


def _part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
