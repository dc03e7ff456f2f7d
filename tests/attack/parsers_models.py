"""Trained networks, their training, and the runs that they correct."""

from __future__ import annotations

import functools
import hashlib
import json
import random
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from attack.harness import Parser, Unsound
from attack.mutations import VALUES, change, edit_tree, mutate
from augment.augment_cases import RUN, make_dataset
from trueup.core.atomic import json_hash
from trueup.core.model_card import CARD_NAME, ONNX_NAME, WEIGHTS_NAME, ModelCard
from trueup.deploy import Predictor, Stream, StreamSettings
from trueup.errors import ConfigError
from trueup.stages.correcting import correct_unless_same
from trueup.stages.model_folder import ModelFolder

STEPS = 12


@functools.cache
def _scratch() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="attack")


@functools.cache
def _data() -> Path:
    """Made-up motions with a run."""
    folder = Path(_scratch().name) / "data"
    make_dataset(folder, counts=(4, 2, 2), samples=(40, 50))
    return folder


@functools.cache
def _model() -> Path:
    """A small network, and the checkpoint of its training beside it."""
    from trueup.augment import AugmentConfig
    from trueup.augment.config import CHECKPOINT_NAME, NetworkConfig, WindowConfig
    from trueup.dataset import Dataset
    from trueup.stages import augment

    folder = Path(_scratch().name) / "model"
    config = AugmentConfig(
        network=NetworkConfig("lstm", (4, 3)), window=WindowConfig("fixed", samples=20, draws=1), batch=4, epochs=2
    )
    kept = folder.with_name("kept")

    def keep(_: Any) -> None:
        if (folder / CHECKPOINT_NAME).is_file():
            shutil.copy(folder / CHECKPOINT_NAME, kept)

    augment([Dataset(_data())], folder, run=RUN, config=config, jobs=1, on_progress=keep)
    kept.rename(folder / CHECKPOINT_NAME)
    return folder


@functools.cache
def _card() -> ModelCard:
    return ModelCard.load(_model())


def _copies(*names: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        for name in names:
            shutil.copy(_model() / name, folder / name)

    return make


def seal(folder: Path) -> None:
    """Hashes as if whoever changed the files had written them."""
    try:
        card = json.loads((folder / CARD_NAME).read_bytes())
        card["files"] = {
            name: hashlib.sha256((folder / name).read_bytes()).hexdigest()
            for name in (ONNX_NAME, WEIGHTS_NAME)
            if (folder / name).is_file()
        }
        card["sha256"] = json_hash({key: value for key, value in card.items() if key != "sha256"})
        (folder / CARD_NAME).write_text(json.dumps(card))
    except (OSError, ValueError, TypeError, AttributeError):
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
    card = _card()
    stream = Stream.load(folder, rate_hz=card.rate_hz, joints=card.joints)
    rng = np.random.default_rng(0)
    for number in range(STEPS):
        answer = stream.step_vector(rng.normal(size=len(stream.card.inputs)), time_s=number / card.rate_hz)
        if answer.is_ok and not np.isfinite(answer.values).all():
            raise Unsound("an answer that is not finite is called good")
    Predictor.load(folder).run(rng.normal(size=(STEPS, 2, len(stream.card.inputs))))
    yield from ()


def read_weights(folder: Path) -> Iterator[Exception]:
    """In torch."""
    import torch

    from trueup.augment import Augmentation

    loaded = Augmentation.load(folder)
    with torch.no_grad():
        loaded.corrector(torch.zeros((STEPS, 1, len(loaded.card.inputs))))
    yield from ()


def make_checkpoint(folder: Path) -> None:
    """After the last epoch but one."""
    from trueup.augment.config import CHECKPOINT_NAME

    shutil.copy(_model() / CHECKPOINT_NAME, folder / CHECKPOINT_NAME)


@functools.cache
def _trained() -> tuple[str, int]:
    """The hash in the checkpoint of `_model`, and its number of epochs."""
    from safetensors import safe_open

    from trueup.augment.config import CHECKPOINT_NAME

    with safe_open(_model() / CHECKPOINT_NAME, framework="pt") as file:
        state = json.loads(file.metadata()["state"])
    return state["inputs"], len(state["history"])


def read_checkpoint(folder: Path) -> Iterator[Exception]:
    """As far as the next step of the optimizer."""
    import torch

    from trueup.augment import Augmentation
    from trueup.augment.checkpoint import read_checkpoint as read
    from trueup.augment.config import CHECKPOINT_NAME
    from trueup.augment.training import _optimizer

    model = Augmentation.load(_model())
    network = model.corrector.network
    optimizer = _optimizer(list(network.parameters()), model.config.optimizer)
    inputs, epochs = _trained()
    found, best = read(folder / CHECKPOINT_NAME, inputs, network, optimizer)
    if len(found.history) > epochs or not 0 <= found.best <= len(found.history):
        raise Unsound(f"epoch {found.best} of {len(found.history)}")
    network.load_state_dict(best)
    for parameter in network.parameters():
        parameter.grad = torch.zeros_like(parameter)
    optimizer.step()
    yield from ()


def change_checkpoint(folder: Path, rng: random.Random) -> str:
    """Its text or its tensors, and a hash that fits."""
    from safetensors import safe_open
    from safetensors.torch import save_file

    from trueup.augment.checkpoint import digest_of
    from trueup.augment.config import CHECKPOINT_NAME

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
        key = rng.choice(("state", "groups"))
        metadata[key] = json.dumps(edit_tree(json.loads(metadata[key]), rng))
        name = key
    metadata["sha256"] = digest_of(tensors, metadata["state"], metadata["groups"])
    save_file(tensors, path, {key: str(value) for key, value in metadata.items()})
    return f"{name} changed, hash made anew"


def make_folder(folder: Path) -> None:
    """A model that is being replaced."""
    _copies(CARD_NAME, ONNX_NAME, WEIGHTS_NAME)(folder)
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
    from trueup.augment import AugmentConfig

    tree = {"base": "paper", **json.loads(json.dumps(AugmentConfig().to_json()))}
    (folder / "augment.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))


def read_config(folder: Path) -> Iterator[Exception]:
    """There and back."""
    from trueup.augment import AugmentConfig

    config = AugmentConfig.load(folder / "augment.yaml")
    json.dumps(config.to_json(), allow_nan=False)
    yield from ()


def make_settings(folder: Path) -> None:
    """The numbers of a stream."""
    (folder / "settings.json").write_text(json.dumps(asdict(StreamSettings())))


def read_settings(folder: Path) -> Iterator[Exception]:
    """As far as a few samples."""
    try:
        tree = json.loads((folder / "settings.json").read_bytes())
        values = {field.name: tree[field.name] for field in fields(StreamSettings)}
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise ConfigError("not the settings of a stream") from error
    card = _card()
    stream = Stream.load(_model(), rate_hz=card.rate_hz, joints=card.joints, settings=StreamSettings(**values))
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


@functools.cache
def _corrected() -> Path:
    from trueup.dataset import Dataset

    folder = Path(_scratch().name) / "corrected"
    shutil.copytree(_data(), folder)
    data = Dataset(folder)
    correct_unless_same(data, Predictor.load(_model()), run=RUN, ids=list(data.ids)[:-1])
    return folder


def make_corrected(folder: Path) -> None:
    """A dataset with a run, and its correction of all motions but one."""
    shutil.copytree(_corrected(), folder, dirs_exist_ok=True)


def read_corrected(folder: Path) -> Iterator[Exception]:
    """The correction is completed, and then there."""
    from trueup.dataset import Dataset

    data = Dataset(folder)
    done = correct_unless_same(data, Predictor.load(_model()), run=RUN, ids=data.ids)
    yield from done.failed.values()
    if set(data.run_ids(done.label)) != set(data.ids) - set(done.failed):
        raise Unsound("a motion was lost")


def change_run(folder: Path, rng: random.Random) -> str:
    """What a run says of itself."""
    path = rng.choice(sorted(folder.rglob("run.json")))
    path.write_bytes(change(path.read_bytes(), path.suffix, rng))
    return f"changed {path.relative_to(folder)}"


PARSERS = [
    Parser("model card", _copies(CARD_NAME), read_card, change_sealed),
    Parser("network", _copies(CARD_NAME, ONNX_NAME), read_network, change_sealed),
    Parser("weights", _copies(CARD_NAME, WEIGHTS_NAME), read_weights, change_sealed),
    Parser("training checkpoint", make_checkpoint, read_checkpoint, change_checkpoint),
    Parser("training folder", make_folder, read_folder),
    Parser("augment config", make_config, read_config),
    Parser("stream settings", make_settings, read_settings, change_settings),
    Parser("corrected run", make_corrected, read_corrected, change_run),
]
