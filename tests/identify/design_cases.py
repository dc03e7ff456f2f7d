"""A small arm that may move, and designed and random motions of it."""

from dataclasses import replace

import numpy as np

from identify.recovery_cases import JOINTS, SERVO, nominal_of
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.identify import Nominal
from trueup.record import ClockSettings, MotionSettings, ReferenceSettings, Scene, random_reference
from trueup.robots import JointSpec

SPEEDS, THRUSTS = dict.fromkeys(JOINTS, 3.0), dict.fromkeys(JOINTS, 20.0)
CLOCK = ClockSettings(rate_hz=100.0)
RATE_HZ = 100.0


def ranged(folder, controller=SERVO):
    """Robot, nominal model and scene of the arm of the recovery tests, with ranges and limits."""
    robot, nominal = nominal_of(folder, controller)
    robot = replace(robot, joints=tuple(JointSpec(name, position_limits=(-1.6, 1.2)) for name in JOINTS))
    scene = Scene(robot, model=nominal.path, velocity=SPEEDS, acceleration=THRUSTS)
    return robot, Nominal(robot, nominal.path), scene


def random_plan(scene, seed, duration_s, kind="multisine"):
    return random_reference(
        scene,
        kind,
        JOINTS,
        np.random.default_rng(seed),
        velocity_share=1.0,
        reference=ReferenceSettings(duration_s=duration_s),
        settings=MotionSettings(clock=CLOCK),
    )


def samples(plan):
    """A plan at the rate of the recording."""
    stride = round(plan.rate_hz / RATE_HZ)
    return tuple(
        np.ascontiguousarray(getattr(plan, name)[::stride]) for name in ("position", "velocity", "acceleration")
    )


def commanded(plan, settle_s=1.0):
    """Clock and commanded positions of a plan at the rate of the recording, after a time at rest."""
    position, _, _ = samples(plan)
    settle = round(settle_s * RATE_HZ)
    time_s = np.arange(-settle, len(position)) / RATE_HZ
    return time_s, np.concatenate([np.tile(position[0], (settle, 1)), position])


def episode(name, time_s, position, seen=None):
    units = same_units({"position": "rad"}, JOINTS)
    command = TimeSeries(time_s, JOINTS, {"position": position}, units)
    return Episode(EpisodeMeta(name, split="train"), seen or command, command)
