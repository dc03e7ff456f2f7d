"""The humanoids of `benchmarks.sat`: their recordings, replayed, and the networks that are trained on one of them.

Everything is kept under runs/sat and made once.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from trueup.augment import AugmentConfig
from trueup.augment.config import DataConfig, LossConfig, NetworkConfig, OptimizerConfig, WindowConfig
from trueup.augment.networks.sat import SatConfig
from trueup.dataset import Dataset
from trueup.lab import load_lab
from trueup.record import PlanSetSpec, RecordSettings, load_plans
from trueup.record.keyframes import Animation
from trueup.robots import RobotSpec, load_robot
from trueup.stages import LabRig, augment, record, replay

FOLDER = Path("runs") / "sat"
RUN = "mujoco/stock"
LAB = "xm430"
TRAINED_ON = "kickbot_a"
# Data set -> robot and plan set. What is trained on are random B-splines, tests are animations.
DATA: Mapping[str, tuple[str, str]] = {
    "train": (TRAINED_ON, "kickbot-splines"),
    **{name: (name, f"{name}-animations") for name in (TRAINED_ON, "kickbot_b", "dancebot")},
}
TESTS = tuple(name for name in DATA if name != "train")
# Which individual: the KickBots are the same one, held elsewhere; DanceBot's servos are others.
UNITS = {"dancebot": 2}
# Of each test, played in turn.
ANIMATIONS = 4
# All animations of a robot that is not trained on, one after the other, in as many orders: half a minute and more each.
LONG, LONG_OF, ORDERS = "long", "kickbot_b", 12
# Servos hold softly, and 250 commands per second are what their bus takes (SAT, VI).
SETTINGS = RecordSettings(control_hz=250.0, record_hz=250.0, tolerance_rad=0.15, path_tolerance_rad=0.5)
# Of the train motions: a network then takes minutes on one core.
TRAIN_MOTIONS = 40


def data_of(name: str, *, jobs: int = 1) -> Dataset:
    """A recording of virtual hardware with its replay, made if it is not there."""
    robot, plans = _planned(name)
    folder = FOLDER / name
    rig = LabRig(load_lab(LAB, robot=robot.name), UNITS.get(name, 1), plans.seed)
    record(folder, robot, rig, plans, settings=SETTINGS, jobs=jobs, resume=True)
    data = Dataset(folder)
    if RUN not in data.runs:
        replay(data, robot, jobs=jobs)
    return Dataset(folder)


def _planned(name: str) -> tuple[RobotSpec, PlanSetSpec]:
    if name != LONG:
        robot, plans = DATA[name]
        return load_robot(robot), load_plans(plans)
    plans = load_plans(DATA[LONG_OF][1])
    orders = [*itertools.permutations(plans.animations.values())][::2][:ORDERS]
    chained = {f"order{number}": _chained(order) for number, order in enumerate(orders)}
    groups = tuple(replace(group, count=ORDERS, speed=(1.0, 1.0)) for group in plans.groups)
    return load_robot(LONG_OF), replace(plans, name=LONG, groups=groups, animations=chained)


def _chained(parts: Sequence[Animation]) -> Animation:
    joints: dict[str, list[tuple[float, float]]] = {}
    start_s = 0.0
    for part in parts:
        for name, frames in part.joints.items():
            joints.setdefault(name, []).extend((start_s + time_s, value) for time_s, value in frames)
        start_s += part.duration_s
    return Animation(start_s, {name: tuple(frames) for name, frames in joints.items()})


def _sat(**options: object) -> SatConfig:
    return replace(SatConfig(hidden=(32,), history=64, feedback="zero", dropout=0.0), **options)  # type: ignore[arg-type]


# What a network reads was chosen on KickBotA's val motions and on KickBotA in fourfold gravity.
_DATA = DataConfig(
    signals=("position", "velocity"), command=(), stops=False, modular=True, blind=("position",), mirrored=True
)
_BASE = AugmentConfig(
    "sat",
    _sat(),
    data=_DATA,
    window=WindowConfig("fixed", samples=256, draws=1),
    loss=LossConfig(kind="absolute", consistency=0.5),
    optimizer=OptimizerConfig(rate=3e-3),
    epochs=2,
    stop_after=0,
)
_ABSOLUTE = LossConfig(kind="absolute")
# The architectures of Table I, a network of the whole robot, the losses of Fig. 12, and one for the current (Fig. 6).
MODELS: Mapping[str, AugmentConfig] = {
    "sat": _BASE,
    "lstm": replace(_BASE, network=_sat(attention=False)),
    "attention": replace(_BASE, network=_sat(backbone="none")),
    "attention-dense": replace(_BASE, network=_sat(backbone="dense")),
    "whole": replace(_BASE, data=replace(_DATA, modular=False, blind=(), mirrored=False), epochs=24),
    "recurrent": replace(_BASE, network=NetworkConfig("lstm", (32,)), optimizer=OptimizerConfig(rate=5e-3), epochs=4),
    "sat-current": replace(
        _BASE,
        data=replace(_DATA, signals=("current",), reads=("velocity", "load"), command=("position",), blind=()),
        loss=_ABSOLUTE,
    ),
}
ABOUT: Mapping[str, str] = {
    "sat": "SAT: LSTM encoder and decoder, attention",
    "lstm": "LSTM encoder and decoder, no attention",
    "attention": "attention alone",
    "attention-dense": "attention, two dense layers",
    "whole": "SAT of the whole robot, not modular",
    "recurrent": "one LSTM layer, nothing else",
    "sat-current": "SAT for the current",
}


def folder_of(name: str, seed: int = 0) -> Path:
    """Where a trained network is kept."""
    return FOLDER / "models" / (f"{name}-{seed}" if seed else name)


def train(name: str, *, seed: int = 0, jobs: int = 1) -> Path:
    """Train a network, or find it trained, or go on where it was interrupted; returns its folder."""
    folder = folder_of(name, seed)
    augment(
        [data_of("train")],
        folder,
        run=RUN,
        config=MODELS[name],
        name=name,
        train_motions=TRAIN_MOTIONS,
        seed=seed,
        jobs=jobs,
        resume=True,
    )
    return folder
