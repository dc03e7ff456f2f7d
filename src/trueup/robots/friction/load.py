"""Friction that grows with the torque that a transmission carries."""

from __future__ import annotations

import numpy as np

from trueup.core.parameters import SearchRange
from trueup.robots.friction.law import Law, Number, Numbers, Value

_EXCITE = "move {target} in both directions in poses with large and with small gravity load"


def brake(_v: Value, g: Value, _q: Value, n: Numbers) -> Value:
    """A share of the transmitted torque."""
    return n[0] * np.abs(g)


LAW = Law(
    (
        Number(
            "load",
            "1",
            "friction per transmitted torque",
            _EXCITE,
            SearchRange(low=0.0, high=5.0, scale=0.2),
            brakes=True,
        ),
    ),
    formula="load * |g|",
    source="friction grows with the transmitted torque",
    brake=brake,
    tried=True,
)
