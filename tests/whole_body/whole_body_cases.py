"""Whole bodies and motions that several tests use."""

from dataclasses import replace
from functools import cache

import numpy as np

from trueup.lab import draw_truth, load_lab
from trueup.whole_body import BaseProfile, BaseSpec, DrivingSettings, SimulatedBody, VirtualBody, draw_base

STANDING = DrivingSettings(profile=BaseProfile(speed_m_s=0.0), settle_s=1.0)
QUICK = DrivingSettings(settle_s=0.6)


def home():
    """The pose in which the arms wait."""
    return SimulatedBody().home


def reaching(seconds=2.0, size=1.0):
    """Both arms forward and back, the right one less and to the side."""
    count = round(seconds / 0.02)
    targets, way = np.tile(home(), (count, 1)), size * 0.5 * (1 - np.cos(np.linspace(0, 2 * np.pi, count)))
    targets[:, 0] -= way
    targets[:, 5] -= 0.7 * way
    targets[:, 6] -= 0.5 * way
    return targets


@cache
def lab():
    """The lab's upper body."""
    return load_lab("upper_body")


def as_simulated(step_s):
    """Virtual hardware in which nothing differs from a simulation whose arms have no dry friction."""
    spec = lab().only("friction", "saturation")
    friction = replace(
        spec.friction,
        breakaway_positive=(0.0,),
        breakaway_negative=(0.0,),
        viscous=(0.3,),
        motor=(0.0,),
        load=0.0,
        spread=0.0,
    )
    spec = replace(spec, friction=friction, physics_step_s=step_s, control_step_s=step_s)
    return draw_truth(spec)


def individual(unit=3, payload_kg=0.0):
    """A real body with all effects."""
    return VirtualBody(draw_truth(lab(), unit=unit), draw_base(unit=unit), payload_kg=payload_kg)


def of_the_model(truth, payload_kg=0.0):
    """A real upper body on a base that is exactly that of the model."""
    return VirtualBody(truth, draw_base(BaseSpec.none()), payload_kg=payload_kg)
