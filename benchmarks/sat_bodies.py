"""Rigid bodies of a virtual KickBotA: how much of their error networks for bodies take away (SAT, VI-B and Fig. 8).

Seven bodies carry markers. Networks are trained on random fields and looked at on motions from point to point and on
sums of sines, of the same unit. Records, replays and trains what is missing under runs/sat_bodies (about half an hour
on one core) and writes `benchmarks/results/sat_bodies.json`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.table import Row, at_least, shown
from trueup.augment import AugmentConfig, preset
from trueup.augment.config import LossConfig, NetworkConfig, OptimizerConfig, WindowConfig
from trueup.augment.networks.sat import SatConfig
from trueup.core.atomic import make_folder, write_json
from trueup.core.model_card import ModelCard
from trueup.core.provenance import provenance
from trueup.dataset import Dataset, is_dataset
from trueup.lab import LabSpec, Sensors
from trueup.lab.spec import (
    Controller,
    Delay,
    Elasticity,
    Friction,
    Gravity,
    Inertia,
    Markers,
    Mounting,
    Readings,
    Ripple,
    Saturation,
    Warming,
)
from trueup.measure import ratio_interval
from trueup.measure.metrics.body import position_distance, rotation_distance
from trueup.record import MotionGroup, PlanSetSpec, RecordSettings
from trueup.record.references import ReferenceSettings
from trueup.robots import RobotSpec, load_robot
from trueup.stages import STOCK, LabRig, augment, evaluate, record, replay

FOLDER = Path("runs") / "sat_bodies"
RESULT = Path(__file__).parent / "results" / "sat_bodies.json"
ROBOT = "kickbot_a"
BODIES = (
    *("left_thigh", "left_shank", "left_foot"),
    *("right_thigh", "right_shank", "right_foot"),
    "right_arm",
)
RATE_HZ = 250.0
# Paper, VI-B: from 8.72 to 1.90 mm, and the largest error from 17.5 to 5 mm.
MAE_CUT, MAX_CUT = 0.75, 0.65
KINDS = ("point-to-point", "sines")


def lab() -> LabSpec:
    """The robot as it is: servos with friction and play, printed parts that are not where the model has them."""
    return LabSpec(
        robot=ROBOT,
        inertia=Inertia(mass=0.06, com_m=0.003, shape=0.06, armature=0.2),
        friction=Friction(
            breakaway_positive=(0.16,),
            breakaway_negative=(0.15,),
            sliding=0.7,
            stribeck_velocity=0.15,
            load=0.08,
            viscous=(0.05,),
            sigmoid_level=(0.0,),
            sigmoid_slope=(1.0,),
            sigmoid_shift=(0.0,),
            motor=(0.03,),
            presliding_rad=6e-3,
            spread=0.15,
        ),
        gravity=Gravity(enabled=False),
        elasticity=Elasticity(stiffness=(60.0,), damping=(0.03,)),
        ripple=Ripple(amplitude_nm=(0.02,), periods_per_turn=50.0),
        saturation=Saturation(torque_nm=(4.1,)),
        delay=Delay(delay_s=0.004, jitter_s=0.002),
        warming=Warming(copper_w_per_nm2=(1.0,)),
        readings=Readings(
            sensors=Sensors(
                position_step_rad=2 * np.pi / 4096,
                velocity_step_rad_s=0.024,
                current_step_a=0.00269,
                voltage_step_v=0.1,
            ),
        ),
        mounting=Mounting(position_m=1.5e-3, rotation_rad=math.radians(0.75)),
        markers=Markers(BODIES, position_noise_m=2e-4, rotation_noise_rad=math.radians(0.1)),
        controller=Controller(kind="servo", stiffness=(55.2,), damping=(0.0,)),
        payload_limit_kg=0.0,
        physics_step_s=0.00025,
    )


def plans() -> PlanSetSpec:
    """Random fields to train on and to choose by; motions of two other kinds to test."""
    return PlanSetSpec(
        "sat-bodies",
        (
            MotionGroup("random-field", "random-field", 40, moving="all", split="train", velocity_share=(0.2, 0.8)),
            MotionGroup("chosen-by", "random-field", 12, moving="all", split="val", velocity_share=(0.2, 0.8)),
            MotionGroup(KINDS[0], "joint", 16, moving="multi", split="test", velocity_share=(0.2, 0.8)),
            MotionGroup(KINDS[1], "multisine", 8, moving="all", split="test", velocity_share=(0.2, 0.8)),
        ),
        reference=ReferenceSettings(duration_s=12.0),
        velocity_limits=dict.fromkeys(robot().joint_names, 3.0),
        acceleration_limits=dict.fromkeys(robot().joint_names, 30.0),
    )


def robot() -> RobotSpec:
    """The simulated robot, which says what its bodies do."""
    plain = load_robot(ROBOT)
    return replace(plain, simulation=replace(plain.simulation, bodies=BODIES))


def data() -> Dataset:
    """Recorded and replayed, with what there is kept."""
    path = FOLDER / "data"
    # Servos without an integral part stop where friction holds them.
    settings = RecordSettings(control_hz=RATE_HZ, record_hz=RATE_HZ, tolerance_rad=0.15, path_tolerance_rad=0.5)
    if not is_dataset(path) or not Dataset(path).info.provenance.get("complete"):
        record(path, robot(), LabRig(lab(), number=1), plans(), settings=settings)
    dataset = Dataset(path)
    replay(dataset, robot(), jobs=1, resume=True)
    return dataset


def configs() -> Mapping[str, AugmentConfig]:
    """The networks: small ones at a share of the rate, so that one core trains them."""
    bodies = replace(preset("sat-bodies").data, rate_hz=RATE_HZ / 2)
    lstm = AugmentConfig(
        "lstm-bodies",
        NetworkConfig("lstm", (32, 32)),
        data=bodies,
        window=WindowConfig("fixed", samples=125, draws=1),
        loss=LossConfig(kind="absolute"),
        optimizer=OptimizerConfig(rate=5e-3),
        epochs=40,
    )
    whole = replace(
        lstm,
        method="lstm-whole",
        data=replace(bodies, modular=False),
        network=NetworkConfig("lstm", (64, 64)),
        epochs=40,
    )
    sat = AugmentConfig(
        "sat-bodies",
        SatConfig(hidden=(32,), heads=4, history=64, feedback="zero", dropout=0.0),
        data=replace(bodies, rate_hz=RATE_HZ / 4),
        window=WindowConfig("fixed", samples=128, draws=1),
        loss=LossConfig(kind="absolute"),
        optimizer=OptimizerConfig(rate=3e-3),
        epochs=20,
    )
    return {"lstm-whole": whole, "lstm-bodies": lstm, "sat-bodies": sat}


def train(dataset: Dataset, name: str) -> Path:
    """The folder of a network, trained unless it is there."""
    folder = FOLDER / "models" / name
    augment([dataset], folder, run=STOCK, config=configs()[name], name=name, jobs=1, resume=True)
    return folder


def run() -> list[Row]:
    """Record, train, evaluate, write the result file."""
    dataset = data()
    folders = [train(dataset, name) for name in configs()]
    found = evaluate(dataset, folders, FOLDER / "evaluated", run=STOCK, project=True, overwrite=True)
    labels = {model.name: model.run for model in found.result.models}
    ids = sorted(found.result.conditions_of)
    errors = {label: _errors(dataset, label, ids) for label in (STOCK, *labels.values())}
    kinds = {"": ids, **{kind: [name for name in ids if name.startswith(f"{kind}/")] for kind in KINDS}}
    tests = {
        kind: {"motions": len(own), **_compared(errors, labels, [ids.index(name) for name in own])}
        for kind, own in kinds.items()
    }
    result = {
        "schema": "trueup.bodies/1",
        "robot": ROBOT,
        "bodies": list(BODIES),
        "motions": {split: list(dataset.splits.values()).count(split) for split in ("train", "val", "test")},
        "not_recorded": list(dataset.info.notes),
        "tests": tests,
        "chosen_on_val": _chosen(),
        "joint_gaps": {
            name: {kind: estimate.to_json() for kind, estimate in vars(gaps[""]).items()}
            for name, gaps in {
                "measured": found.result.measured_gaps,
                **{model.name: model.gaps for model in found.result.models},
            }.items()
        },
        "training": {name: _training(name) for name in configs()},
        "provenance": provenance(
            config={name: config.to_json() for name, config in configs().items()}, seed=0, data_hash=dataset.hash
        ),
    }
    make_folder(RESULT.parent)
    write_json(RESULT, result)
    return rows(result)


_MEASURES: Mapping[str, tuple[str, Callable[..., Any], Callable[..., Any]]] = {
    "position_mae": ("m", position_distance, np.mean),
    "position_max": ("m", position_distance, np.max),
    "rotation_mae": ("rad", rotation_distance, np.mean),
    "rotation_max": ("rad", rotation_distance, np.max),
}


def _errors(dataset: Dataset, label: str, ids: Sequence[str]) -> dict[str, list[float]]:
    """Measure -> motion by motion: over samples as it says, then the mean over bodies."""
    found: dict[str, list[float]] = {name: [] for name in _MEASURES}
    for name in ids:
        episode = dataset.episode(name, runs=[label])
        measured, series = episode.measured, episode.run(label)
        rows = np.searchsorted(series.time_s, measured.time_s - 1e-6).clip(max=len(series) - 1)
        for measure, (_, distance, over) in _MEASURES.items():
            signal = f"body.{measure.partition('_')[0]}"
            away: np.ndarray = distance(measured[signal], series[signal][rows])
            found[measure].append(float(over(away, axis=0).mean()))
    return found


def _compared(errors: Mapping[str, Any], labels: Mapping[str, str], rows: Sequence[int]) -> dict[str, Any]:
    """Measure -> the simulator's error, and of each network its error and the share that it takes away, paired."""
    found: dict[str, Any] = {}
    for measure, (unit, *_) in _MEASURES.items():
        stock = np.array(errors[STOCK][measure])[rows]
        found[measure] = {"unit": unit, "simulated": _mean(stock), "networks": {}}
        for name, label in labels.items():
            own = np.array(errors[label][measure])[rows]
            ratio = (float(end[0]) for end in ratio_interval(own[:, None], stock[:, None]))
            value, low, high = (1 - end for end in ratio)
            cut = {"value": value, "low": high, "high": low}
            found[measure]["networks"][name] = {"error": _mean(own), "cut": cut}
    return found


def _mean(values: np.ndarray) -> dict[str, float]:
    value, low, high = (float(end[0]) for end in ratio_interval(values[:, None], np.ones((len(values), 1))))
    return {"value": value, "low": low, "high": high}


def _training(name: str) -> dict[str, Any]:
    card = ModelCard.load(FOLDER / "models" / name)
    made = card.provenance["training"]
    off = sorted({f"{item.quantity} of {item.joint}: {item.reason}" for item in card.outputs if item.gate == 0})
    return {"seconds": made["seconds"], "epochs": len(made["history"]), "best_epoch": made["best_epoch"], "off": off}


def _chosen() -> str:
    """The network that leaves least of the positions' error on val."""
    left = {}
    for name in configs():
        val = ModelCard.load(FOLDER / "models" / name).metrics["val"]
        errors = [item["corrected"] for signal, own in val.items() if "position" in signal for item in own.values()]
        left[name] = float(np.square(errors).mean())
    return min(left, key=lambda name: left[name])


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    found, chosen = [], result["chosen_on_val"]
    for kind, test in result["tests"].items():
        for measure, bar in (("position_mae", MAE_CUT), ("position_max", MAX_CUT), ("rotation_mae", None)):
            for name, network in test[measure]["networks"].items():
                what, value = f"{name}, {kind or 'all test motions'}: {measure} cut", 100 * network["cut"]["value"]
                # The bars are for the one network that val has chosen; the others are there to compare.
                held = bar is not None and not kind and name == chosen
                found.append(at_least(what, value, 100 * (bar or 0), "%") if held else shown(what, value, "%"))
    return found
