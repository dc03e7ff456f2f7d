"""Coulomb friction without a step at rest."""

from __future__ import annotations

import numpy as np

from trueup.robots.friction.law import FAST, SLOW, SPEED, TORQUE, Law, Number, Numbers, Value


def brake(v: Value, _g: Value, _q: Value, n: Numbers) -> Value:
    """Zero at rest, constant at speed."""
    return n[0] * np.tanh(np.abs(v) / n[1])


LAW = Law(
    (
        Number("tanh_coulomb", "Nm", "smoothed Coulomb friction", FAST, TORQUE, brakes=True),
        Number("tanh_velocity", "rad/s", "smoothed Coulomb friction, width of the step", SLOW, SPEED, 0.05, "positive"),
    ),
    formula="tanh_coulomb * tanh(|v| / tanh_velocity)",
    source="smoothed Coulomb friction",
    brake=brake,
)
