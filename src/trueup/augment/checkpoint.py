"""Where training stands after an epoch, in one file that is there whole or not at all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.optim import Optimizer

from trueup.core.atomic import regular, replacing
from trueup.errors import DataError, OutputExists


@dataclass(frozen=True)
class Epoch:
    """One line of the history.

    Attributes:
        number: from 1.
        train: mean loss of its batches.
        val: loss on the whole motions of val.
        rate: learning rate at its end.
        seconds: what it took [s].
    """

    number: int
    train: float
    val: float
    rate: float
    seconds: float


_ANEW = "Give --overwrite to begin anew."


@dataclass(frozen=True)
class Checkpoint:
    """What is needed to go on; draws of an epoch depend on seed and number of the epoch alone.

    Attributes:
        inputs: hash of everything that decides about the training.
        history: epochs that are done.
        best: number of the epoch with the lowest val loss; 0 if there is none.
    """

    inputs: str
    history: tuple[Epoch, ...]
    best: int


def save_checkpoint(
    path: Path, state: Checkpoint, network: nn.Module, optimizer: Optimizer, best: Mapping[str, Tensor]
) -> None:
    """Write the file atomically."""
    tensors = {f"network.{name}": value for name, value in network.state_dict().items()}
    tensors |= {f"best.{name}": value for name, value in best.items()}
    steps = optimizer.state_dict()
    for number, slots in steps["state"].items():
        tensors |= {f"optimizer.{number}.{name}": torch.as_tensor(value) for name, value in slots.items()}
    tensors = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    said, groups = json.dumps(asdict(state)), json.dumps(steps["param_groups"])
    metadata = {"state": said, "groups": groups, "sha256": digest_of(tensors, said, groups)}
    with replacing(path) as temporary:
        save_file(tensors, temporary, metadata)


def digest_of(tensors: Mapping[str, Tensor], *texts: str) -> str:
    """SHA-256 of all that a checkpoint holds: a training that went on from other weights would not be told from one."""
    digest = hashlib.sha256(json.dumps(texts).encode())
    for name in sorted(tensors):
        digest.update(f"{name} {tensors[name].dtype} {tuple(tensors[name].shape)}".encode())
        digest.update(tensors[name].contiguous().numpy().tobytes())
    return digest.hexdigest()


def read_checkpoint(
    path: Path, inputs: str, network: nn.Module, optimizer: Optimizer
) -> tuple[Checkpoint, dict[str, Tensor]]:
    """Put network and optimizer where they were; returns the history and the best weights so far.

    Raises:
        OutputExists: the checkpoint belongs to another training.
        DataError: the file is broken.
    """
    try:
        with safe_open(regular(path), framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # it has no __iter__
        tree = json.loads(metadata["state"])
        groups = json.loads(metadata["groups"])
        asked = tree["inputs"]
        if metadata["sha256"] != digest_of(tensors, metadata["state"], metadata["groups"]):
            raise ValueError("its content is not what was written")
    except (SafetensorError, OSError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise DataError(f"{path} is no checkpoint", got=error, hint=_ANEW) from error
    if asked != inputs:
        raise OutputExists(
            f"{path.parent} holds the training of another configuration, seed or data",
            hint="Give --overwrite to begin anew, or choose another --out.",
        )
    try:
        history = tuple(Epoch(**item) for item in tree["history"])
        network.load_state_dict(_part(tensors, "network."))
        optimizer.load_state_dict({"state": _slots(tensors), "param_groups": groups})
        return Checkpoint(inputs, history, tree["best"]), _part(tensors, "best.")
    except (KeyError, TypeError, ValueError, RuntimeError) as error:  # RuntimeError is what torch raises for shapes
        raise DataError(
            f"{path} was written by another version of trueup or torch", got=str(error).split("\n")[0], hint=_ANEW
        ) from error


def _part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _slots(tensors: Mapping[str, Tensor]) -> dict[int, dict[str, Tensor]]:
    slots: dict[int, dict[str, Tensor]] = {}
    for name, value in _part(tensors, "optimizer.").items():
        number, slot = name.split(".", 1)
        slots.setdefault(int(number), {})[slot] = value
    return slots


def losses(history: Sequence[Epoch]) -> list[dict[str, Any]]:
    """The history as JSON."""
    return [asdict(epoch) for epoch in history]
