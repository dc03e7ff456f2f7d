"""What a network must read to help a servo that it never saw: one of three joints is left out at a time.

Trains on two of the joints of `benchmarks.sat_so101`, on 24 of the train motions, and judges the third joint on the 9
others and on the val motions; the wrist, and test, are not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from trueup.augment import Augmentation, AugmentConfig, Task, preset
from trueup.augment.config import SIGNALS, DataConfig, LossConfig, NetworkConfig, OptimizerConfig, WindowConfig
from trueup.augment.gating import errors_of
from trueup.augment.networks.sat import SatConfig
from trueup.augment.pairs import Pairs, any_joint, channels_of, write_pairs
from trueup.core.atomic import make_folder, read_json, write_json
from trueup.core.episode import Episode
from trueup.core.model_card import ANY_JOINT
from trueup.dataset import Dataset
from trueup.measure import paired_difference
from trueup.stages import FITTED
from trueup.stages.correcting import in_run_names

SEEN = ("shoulder_pan", "shoulder_lift", "elbow_flex")
LEFT_OUT = 9
SEED = 7


def sat(joints: Sequence[str] = (), *, modular: bool = True) -> AugmentConfig:
    """A SAT that reads how far the command is from the simulator, now and in the past."""
    data = DataConfig(signals=("position",), command=("position",), joints=tuple(joints), stops=False)
    if modular:
        data = replace(data, modular=True, blind=("position",), mirrored=True)
    return replace(
        preset("sat"),
        network=SatConfig(hidden=(16,), heads=2, history=64, feedback="zero"),
        data=data,
        window=WindowConfig("fixed", samples=128, draws=1),
        loss=LossConfig(kind="absolute"),
        optimizer=OptimizerConfig(rate=2e-3, weight_decay=1e-2),
        batch=64,
        epochs=3,
        stop_after=0,
    )


def _lstm(reads: Sequence[str], command: Sequence[str], **kwargs: Any) -> AugmentConfig:
    """A small network that trains in seconds: what carries over is a matter of what is read."""
    data = DataConfig(
        signals=("position",), reads=tuple(reads), command=tuple(command), stops=False, modular=True, **kwargs
    )
    return AugmentConfig(
        "lstm",
        NetworkConfig("lstm", (24,)),
        data=data,
        window=WindowConfig("fixed", samples=150, draws=1),
        loss=LossConfig(kind="absolute"),
        optimizer=OptimizerConfig(rate=3e-3, weight_decay=1e-2),
        epochs=5,
        stop_after=0,
    )


_BLIND: Mapping[str, Any] = {"blind": ("position",)}
_ODD: Mapping[str, Any] = {**_BLIND, "mirrored": True}
CHOICES: Mapping[str, AugmentConfig] = {
    "LSTM; position, velocity, torque, command": _lstm(("velocity", "torque"), ("position",)),
    "the same, blind to position": _lstm(("velocity", "torque"), ("position",), **_BLIND),
    "the same, mirrored": _lstm(("velocity", "torque"), ("position",), **_ODD),
    "without torque": _lstm(("velocity",), ("position",), **_ODD),
    "command alone": _lstm((), ("position",), **_ODD),
}


def rows(arm: Dataset, path: Path) -> dict[str, Any]:
    """What is read -> what it brings to a joint that is not trained on; kept in a file."""
    found: dict[str, Any] = read_json(path) if path.is_file() else {}
    for name, config in CHOICES.items():
        if name not in found:
            found[name] = _judged(arm, config)
            make_folder(path.parent)
            write_json(path, found)
    return {name: found[name] for name in CHOICES}


def _judged(arm: Dataset, config: AugmentConfig) -> dict[str, Any]:
    """RMSE of each joint by a network of the two others, before and after, mean over the motions that judge [rad]."""
    fitted, val, judging = _motions(arm)
    joints, before, after = {}, [], []
    for held in SEEN:
        others = tuple(joint for joint in SEEN if joint != held)
        with TemporaryDirectory() as name:
            folder = Path(name)
            pairs = {
                "train": _pairs(arm, fitted, folder / "train.f32", config, others, mirrored=config.data.mirrored),
                "val": _pairs(arm, val, folder / "val.f32", config, others),
            }
            task = Task("x", "so101", (ANY_JOINT,), FITTED, pairs["train"].rate_hz, pairs["train"], pairs["val"], {})
            corrector = Augmentation.fit(task, config, folder=folder, threads=1).corrector
            corrector.set_gate(np.ones(1))  # what it would do to a joint that val does not show
            errors = errors_of(corrector, _pairs(arm, judging, folder / "judging.f32", config, (held,)))
        own = [np.sqrt(part[:, 0] / errors.rows) for part in (errors.simulated, errors.corrected)]
        joints[held] = [float(part.mean()) for part in own]
        before.append(own[0])
        after.append(own[1])
    difference = paired_difference(
        np.mean(after, axis=0),
        np.mean(before, axis=0),
        run="network",
        baseline=FITTED,
        split="left out",
        signal="position",
        metric="rmse",
        unit="rad",
    )
    return {"joints": joints, "difference": difference.to_json()["difference"], "verdict": difference.verdict}


def _motions(arm: Dataset) -> tuple[list[str], list[str], list[str]]:
    """Those that are fitted, those that choose the epoch, and those that judge."""
    train, val = list(arm.select(split="train")), list(arm.select(split="val"))
    left = set(np.random.default_rng(SEED).choice(train, LEFT_OUT, replace=False).tolist())
    return [name for name in train if name not in left], val, [*val, *sorted(left)]


def _pairs(
    arm: Dataset,
    names: Sequence[str],
    path: Path,
    config: AugmentConfig,
    joints: Sequence[str],
    *,
    mirrored: bool = False,
) -> Pairs:
    info = arm.run_info(FITTED)
    episodes: list[Episode] = [in_run_names(arm.episode(name, runs=[FITTED]), info) for name in names]
    data = config.data
    inputs, outputs = channels_of(
        episodes[0], FITTED, signals=data.signals, reads=data.reads, command=data.command, known=SIGNALS
    )
    return write_pairs(
        episodes,
        path,
        run=FITTED,
        inputs=any_joint(inputs),
        outputs=any_joint(outputs),
        rate_hz=float(episodes[0].run(FITTED).rate_hz),
        joints=joints,
        mirrored=mirrored,
    )
