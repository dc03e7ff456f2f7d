"""Trained networks, their training, and the runs that they correct."""

from __future__ import annotations

import copy
import functools
import hashlib
import json
import random
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from attack.harness import Parser, Unsound
from attack.mutations import VALUES, change, edit_tree, mutate
from augment.augment_cases import JOINTS, RUN, make_dataset
from augment.evaluation_cases import card_of, shift_folder
from trueup import zoo
from trueup.augment.config import CHECKPOINT_NAME, AugmentConfig
from trueup.core.atomic import json_hash, regular
from trueup.core.model_card import CARD_NAME, ONNX_NAME, WEIGHTS_NAME, ModelCard
from trueup.dataset import Dataset
from trueup.deploy import Predictor, Status, Stream, StreamSettings
from trueup.errors import ConfigError
from trueup.stages.correcting import correct_unless_same
from trueup.stages.model_folder import ModelFolder

if TYPE_CHECKING:
    from torch import nn
    from torch.optim import Optimizer

    from trueup.augment import Augmentation

STEPS = 12


def _copies(*names: str) -> Callable[[Path], None]:
    """Files of a network of the zoo."""

    def make(folder: Path) -> None:
        for name in names:
            shutil.copy(zoo.folder(zoo.names()[0]) / name, folder / name)

    return make


@functools.cache
def _card() -> ModelCard:
    return ModelCard.load(zoo.folder(zoo.names()[0]))


def seal(folder: Path, card_name: str = CARD_NAME, files: Sequence[str] = (ONNX_NAME, WEIGHTS_NAME)) -> None:
    """Hashes in a card as if whoever changed the files had written them."""
    if not (folder / card_name).is_file():
        return  # a pipe, or nothing
    try:
        card = json.loads((folder / card_name).read_bytes())
        card["files"] = {
            name: hashlib.sha256((folder / name).read_bytes()).hexdigest()
            for name in files
            if (folder / name).is_file()
        }
        card["sha256"] = json_hash({key: value for key, value in card.items() if key != "sha256"})
        (folder / card_name).write_text(json.dumps(card))
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return  # changed beyond a hash


def change_sealed(folder: Path, rng: random.Random) -> str:
    """What lies behind the hashes."""
    said = mutate(folder, rng)
    seal(folder)
    return f"{said}, hashes made anew"


def read_card(folder: Path) -> Iterator[Exception]:
    """There and back."""
    card = ModelCard.load(folder)
    if ModelCard.from_json(card.to_json()) != card:
        raise Unsound("what was written again is not what was read")
    yield from ()


def read_network(folder: Path) -> Iterator[Exception]:
    """In a loop and on a whole motion."""
    card = card_of()
    stream = Stream.load(folder, rate_hz=card.rate_hz, joints=card.joints)
    rng = np.random.default_rng(0)
    for number in range(STEPS):
        answer = stream.step_vector(rng.normal(size=len(stream.card.inputs)), time_s=number / card.rate_hz)
        if answer.status is Status.OK and not np.isfinite(answer.values).all():
            raise Unsound("an answer that is not finite is called good")
    Predictor.load(folder).run(rng.normal(size=(STEPS, 2, len(stream.card.inputs))))
    yield from ()


@functools.cache
def _trained() -> Augmentation:
    """A small network that has learned nothing."""
    from augment.test_networks import corrector_of
    from trueup.augment import Augmentation, AugmentConfig
    from trueup.augment.config import NetworkConfig

    config = AugmentConfig(network=NetworkConfig("lstm", (4, 3)))
    corrector = corrector_of(config.network, np.random.default_rng(0), inputs=4, base=(0, 1, 2, 3))
    card = replace(card_of(), states=corrector.states, provenance={"config": config.to_json()})
    return Augmentation(card, corrector, config)


def make_weights(folder: Path) -> None:
    """A model folder with its weights."""
    _trained().save(folder)


def read_weights(folder: Path) -> Iterator[Exception]:
    """In torch."""
    import torch

    from trueup.augment import Augmentation

    loaded = Augmentation.load(folder)
    with torch.no_grad():
        loaded.corrector(torch.zeros((STEPS, 1, len(loaded.card.inputs))))
    yield from ()


def _optimizer() -> tuple[nn.Module, Optimizer]:
    """A network and an optimizer that has made a step."""
    import torch

    from trueup.augment import training

    network = copy.deepcopy(_trained().corrector.network)
    optimizer = training._optimizer(list(network.parameters()), _trained().config.optimizer)
    for parameter in network.parameters():
        parameter.grad = torch.ones_like(parameter)
    optimizer.step()
    return network, optimizer


def make_checkpoint(folder: Path) -> None:
    """After two epochs."""
    from trueup.augment.checkpoint import Checkpoint, Epoch, save_checkpoint

    network, optimizer = _optimizer()
    history = tuple(Epoch(number, 0.1, 0.2, 0.001, 3.0) for number in (1, 2))
    save_checkpoint(
        folder / CHECKPOINT_NAME,
        Checkpoint("asked", history, 1),
        network,
        optimizer,
        copy.deepcopy(network.state_dict()),
    )


def read_checkpoint(folder: Path) -> Iterator[Exception]:
    """As far as the next step of the optimizer."""
    from trueup.augment.checkpoint import losses
    from trueup.augment.checkpoint import read_checkpoint as read

    network, optimizer = _optimizer()
    found, best = read(folder / CHECKPOINT_NAME, "asked", network, optimizer)
    losses(found.history)
    network.load_state_dict(best)
    optimizer.step()
    yield from ()


def change_checkpoint(folder: Path, rng: random.Random) -> str:
    """Its text or its tensors, and a hash that fits."""
    from safetensors import safe_open
    from safetensors.torch import save_file

    from trueup.augment.checkpoint import digest_of

    path = folder / CHECKPOINT_NAME
    with safe_open(path, framework="pt") as file:
        metadata, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    name = rng.choice(list(tensors))
    what = rng.randrange(5)
    if what == 0:
        del tensors[name]
    elif what == 1:
        tensors[name] = tensors[name].reshape(-1)[:1]
    elif what == 2:
        tensors[name] = tensors[name].double()
    else:
        name, metadata["state"] = "state", json.dumps(edit_tree(json.loads(metadata["state"]), rng))
    save_file(tensors, path, {"state": metadata["state"], "sha256": digest_of(tensors, metadata["state"])})
    return f"{name} changed, hash made anew"


def make_folder(folder: Path) -> None:
    """A model that is being replaced."""
    _copies(CARD_NAME)(folder)
    ModelFolder(folder, "asked").begin_anew()


def read_folder(folder: Path) -> Iterator[Exception]:
    """As `augment train --resume` does first."""
    place = ModelFolder(folder, "asked")
    if place.is_finished():
        raise Unsound("a model that is being replaced is taken for the new one")
    place.begin_anew()
    yield from ()


def make_config(folder: Path) -> None:
    """Every key."""
    tree = {"base": "paper", **json.loads(json.dumps(AugmentConfig().to_json()))}
    (folder / "augment.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))


def read_config(folder: Path) -> Iterator[Exception]:
    """There and back."""
    config = AugmentConfig.load(folder / "augment.yaml")
    json.dumps(config.to_json(), allow_nan=False)
    yield from ()


def make_settings(folder: Path) -> None:
    """The numbers of a stream."""
    (folder / "settings.json").write_text(json.dumps(asdict(StreamSettings())))


def read_settings(folder: Path) -> Iterator[Exception]:
    """As far as a few samples."""
    try:
        tree = json.loads(regular(folder / "settings.json").read_bytes())
        values = {field.name: tree[field.name] for field in fields(StreamSettings)}
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise ConfigError("not the settings of a stream") from error
    card = _card()
    stream = Stream.load(
        zoo.folder(zoo.names()[0]), rate_hz=card.rate_hz, joints=card.joints, settings=StreamSettings(**values)
    )
    for number in range(STEPS):
        stream.step_vector(np.zeros(len(card.inputs)), time_s=number / card.rate_hz)
    yield from ()


def change_settings(folder: Path, rng: random.Random) -> str:
    """One of the numbers is another."""
    tree = json.loads((folder / "settings.json").read_bytes())
    name = rng.choice(list(tree))
    tree[name] = rng.choice((*VALUES, float("nan"), float("inf"), -float("inf"), 1.0000001, 2.5, -0.1, 0.999999))
    (folder / "settings.json").write_text(json.dumps(tree))
    return f"{name} is {str(tree[name])[:40]}"


def make_corrected(folder: Path) -> None:
    """A dataset with a run, and its correction of all motions but one."""
    data = make_dataset(folder / "data", counts=(2, 1, 1), samples=(40, 50))
    shift_folder(folder / "model", card_of(joints=JOINTS, signals=("position",)), [0.1, 0.2])
    correct_unless_same(data, Predictor.load(folder / "model"), run=RUN, ids=list(data.ids)[:-1])


def read_corrected(folder: Path) -> Iterator[Exception]:
    """The correction is completed, and then there."""
    data = Dataset(folder / "data")
    done = correct_unless_same(data, Predictor.load(folder / "model"), run=RUN, ids=list(data.ids))
    yield from done.failed.values()
    if set(data.run_ids(done.label)) < set(data.ids) - set(done.failed):
        raise Unsound("a motion was lost")


def change_run(folder: Path, rng: random.Random) -> str:
    """What a run says of itself."""
    path = rng.choice(sorted(folder.rglob("run.json")))
    path.write_bytes(change(path.read_bytes(), path.suffix, rng))
    return f"changed {path.relative_to(folder)}"


PARSERS = [
    Parser("model card", _copies(CARD_NAME), read_card, change_sealed),
    Parser("network", make_weights, read_network, change_sealed),
    Parser("weights", make_weights, read_weights, change_sealed),
    Parser("training checkpoint", make_checkpoint, read_checkpoint, change_checkpoint),
    Parser("training folder", make_folder, read_folder),
    Parser("augment config", make_config, read_config),
    Parser("stream settings", make_settings, read_settings, change_settings),
    Parser("corrected run", make_corrected, read_corrected, change_run),
]
