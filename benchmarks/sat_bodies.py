"""Rigid bodies of a virtual KickBotA: how much of their error networks for bodies take away (SAT, VI-B and Fig. 8).

Seven bodies carry markers. Networks are trained on random fields and looked at on motions from point to point and on
sums of sines, of the same unit. Records, replays and trains what is missing under runs/sat_bodies (about half an hour
on one core) and writes `benchmarks/results/sat_bodies.json`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from trueup.augment import AugmentConfig, preset
from trueup.augment.config import LossConfig, NetworkConfig, OptimizerConfig, WindowConfig
from trueup.augment.networks.sat import SatConfig
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
from trueup.record import MotionGroup, PlanSetSpec, RecordSettings
from trueup.record.references import ReferenceSettings
from trueup.robots import RobotSpec, load_robot
from trueup.stages import LabRig, record, replay

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
    """The networks: small ones at half the rate, so that one core trains them."""
    bodies = replace(preset("sat-bodies").data, rate_hz=RATE_HZ / 2)
    lstm = AugmentConfig(
        "lstm-bodies",
        NetworkConfig("lstm", (32, 32)),
        data=bodies,
        window=WindowConfig("fixed", samples=125, draws=1),
        loss=LossConfig(kind="absolute"),
        optimizer=OptimizerConfig(rate=5e-3),
        epochs=20,
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
        SatConfig(hidden=(32,), heads=4, history=64),
        data=bodies,
        window=WindowConfig("fixed", samples=128, draws=1),
        loss=LossConfig(kind="absolute"),
        optimizer=OptimizerConfig(rate=3e-3),
        epochs=8,
    )
    return {"lstm-whole": whole, "lstm-bodies": lstm, "sat-bodies": sat}


def train(dataset: Dataset, name: str) -> Path:
    """The folder of a network, trained unless it is there."""
    folder = FOLDER / "models" / name
    augment([dataset], folder, run=STOCK, config=configs()[name], name=name, jobs=1, resume=True)
    return folder
