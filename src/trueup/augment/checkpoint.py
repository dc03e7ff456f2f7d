"""Where training stands after an epoch, in one file that is there whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.optim import Optimizer

from trueup.core.atomic import regular, replacing
from trueup.core.config import build
from trueup.errors import ConfigError, DataError, OutputExists


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
    write_tensors(path, tensors | slots_of(optimizer), asdict(state))


def write_tensors(path: Path, tensors: Mapping[str, Tensor], state: Mapping[str, Any]) -> None:
    """Write a file atomically: tensors, and JSON that says what they are, with a hash of both.

    Raises:
        DataError: the disk is full or not writable.
    """
    # Weights that two modules share are one tensor to torch, which safetensors does not write.
    tensors = {name: value.detach().cpu().clone().contiguous() for name, value in tensors.items()}
    said = json.dumps(state)
    with replacing(path) as temporary:
        try:
            save_file(tensors, temporary, {"state": said, "sha256": digest_of(tensors, said)})
        except SafetensorError as error:  # it has no errors of the system
            raise DataError(f"cannot write {path}", got=error) from error


def read_tensors(path: Path, inputs: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """What `write_tensors` wrote for a training that depends on these inputs.

    Raises:
        OutputExists: the file belongs to another training.
        DataError: it is broken.
    """
    try:
        with safe_open(regular(path), framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # it has no __iter__
        tree = json.loads(metadata["state"])
        asked = tree["inputs"]
        whole = metadata["sha256"] == digest_of(tensors, metadata["state"])
    except (SafetensorError, OSError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise DataError(f"{path} is no checkpoint", got=error, hint=_ANEW) from error
    if not whole:
        raise DataError(f"{path} was changed after it was written (its hash differs)", hint=_ANEW)
    if asked != inputs:
        raise OutputExists(
            f"{path.parent} holds the training of another configuration, seed or data",
            hint="Give --overwrite to begin anew, or choose another --out.",
        )
    return tensors, tree


@contextlib.contextmanager
def of_this_version(path: Path) -> Iterator[None]:
    """Tensors whose hash agrees and that do not fit were written by another program."""
    try:
        yield
    # The last is torch's, for shapes.
    except (ConfigError, IndexError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise DataError(
            f"{path} was written by another version of trueup or torch", got=str(error).split("\n")[0], hint=_ANEW
        ) from error


def digest_of(tensors: Mapping[str, Tensor], said: str) -> str:
    """SHA-256 of all that a checkpoint holds: a training that went on from other weights would not be told from one."""
    digest = hashlib.sha256(said.encode())
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
    tensors, tree = read_tensors(path, inputs)
    with of_this_version(path):
        state = _state(tree, path)
        best = part_of(tensors, "best.")
        for weights in (best, part_of(tensors, "network.")) if state.best else (part_of(tensors, "network."),):
            network.load_state_dict(weights)
        restore(optimizer, tensors)
    return state, best


def _state(tree: Any, path: Path) -> Checkpoint:
    state = build(Checkpoint, tree, str(path))
    count = len(state.history)
    if [epoch.number for epoch in state.history] != [*range(1, count + 1)] or not 0 <= state.best <= count:
        raise ValueError("epochs are missing")
    return state


def part_of(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Those whose names begin like this, by the rest of their names."""
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def slots_of(optimizer: Optimizer) -> dict[str, Tensor]:
    """What an optimizer remembers of each parameter."""
    slots = optimizer.state_dict()["state"].items()
    return {
        f"optimizer.{number}.{name}": torch.as_tensor(value) for number, own in slots for name, value in own.items()
    }


def restore(optimizer: Optimizer, tensors: Mapping[str, Tensor]) -> None:
    """Make an optimizer remember what `slots_of` said; its settings are those of the configuration.

    Raises:
        ValueError: a parameter is missing, or has another shape.
    """
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    slots: dict[int, dict[str, Tensor]] = {}
    for name, value in part_of(tensors, "optimizer.").items():
        number, slot = name.split(".", 1)
        if value.shape not in ((), parameters[int(number)].shape):
            raise ValueError(f"{name} has the shape {tuple(value.shape)}")
        slots.setdefault(int(number), {})[slot] = value
    if [*range(len(parameters))] != sorted(slots) or len({frozenset(item) for item in slots.values()}) > 1:
        raise ValueError("a parameter lacks what the optimizer knows of it")
    optimizer.load_state_dict({"state": slots, "param_groups": optimizer.state_dict()["param_groups"]})


def losses(history: Sequence[Epoch]) -> list[dict[str, Any]]:
    """The history as JSON."""
    return [asdict(epoch) for epoch in history]
