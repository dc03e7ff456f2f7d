"""Sigmoid friction of the ES thesis, eq. 2.1; the numbers are its phi_1, phi_2, phi_3."""

from __future__ import annotations

import numpy as np

from trueup.core.parameters import SearchRange
from trueup.robots.friction.law import FAST, SLOW, Law, Number, Numbers, Value

_TURN = "let {target} move slowly in both directions"
_LEVEL = SearchRange("log", start=0.1, low=1e-4)
_SLOPE = SearchRange("log", low=0.1, high=1000.0, prior_std=1.5)
_SHIFT = SearchRange(low=-1.0, high=1.0, scale=0.05)


def brake(v: Value, _g: Value, _q: Value, n: Numbers) -> Value:
    """The difference of two logistic curves; one of them is half a tanh of half its argument, which cannot overflow."""
    level, slope, shift = n[0], n[1], n[2]
    rise = np.tanh(0.5 * slope * (v + shift)) - np.tanh(0.5 * slope * shift)
    return 0.5 * np.sign(v) * level * rise


LAW = Law(
    (
        Number("sigmoid_level", "Nm", "sigmoid friction, level (phi_1)", FAST, _LEVEL, domain="signed", brakes=True),
        Number("sigmoid_slope", "s/rad", "sigmoid friction, slope (phi_2)", SLOW, _SLOPE, 10.0),
        Number("sigmoid_shift", "rad/s", "sigmoid friction, shift (phi_3)", _TURN, _SHIFT, domain="signed"),
    ),
    formula="sigmoid_level * sign(v) * (1 / (1 + exp(-s (v + v0))) - 1 / (1 + exp(-s v0))), "
    "s = sigmoid_slope, v0 = sigmoid_shift",
    source="ES thesis, eq. 2.1",
    brake=brake,
)
