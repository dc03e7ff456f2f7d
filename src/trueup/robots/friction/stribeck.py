"""Stribeck friction: more torque to start than to go on."""

from __future__ import annotations

import numpy as np

from trueup.robots.friction.law import SLOW, SPEED, TORQUE, Law, Number, Numbers, Value


def brake(v: Value, _g: Value, _q: Value, n: Numbers) -> Value:
    """What lies above Coulomb friction, and is gone at speed."""
    ratio = v / n[1]
    return n[0] * np.exp(-ratio * ratio)


LAW = Law(
    (
        Number("stribeck", "Nm", "static friction above Coulomb friction", SLOW, TORQUE),
        Number("stribeck_velocity", "rad/s", "Stribeck friction, speed at 1/e", SLOW, SPEED, 0.1, "positive"),
    ),
    formula="stribeck * exp(-(v / stribeck_velocity)^2)",
    source="Stribeck: static friction lies above Coulomb friction",
    brake=brake,
    tried=True,
)
