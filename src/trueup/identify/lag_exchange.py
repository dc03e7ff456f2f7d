"""Delays that have taken a part of the drives' lag, or have been taken for it.

A position servo with I q'' + d q' = kp (u - q), d = kv + damping, lags by a = d / kp, and in slow motions a lag is a
lag: a search that made up for a delay with damping stands in a long valley, whose bottom it does not see.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64

from trueup.identify.problem import Problem
from trueup.identify.solution import Solution

# Shares of a drive's lag that its delay may have been taken for, or has taken.
_SHARES = (-1.0, -0.5, -0.1, -0.03, 0.03, 0.1, 0.3, 0.6, 0.8, 0.9)
# Of an armature, the share that is left at least.
_LEAST_KEPT = 0.2
# A share of a lag that becomes delay, and whether the inertia that belongs to it changes with it.
_Way = tuple[float, bool]


def exchanged(problem: Problem, found: Solution, *, worth: float) -> Float64[np.ndarray, "P"] | None:
    """A better place of a fit, in z, at which parts of lags are delays; None if there is none.

    To the second order in frequency, exp(-t s) / (1 + a' s + b' s^2) is 1 / (1 + a s + b s^2) for a' = a - t and
    b' = b - a t + t^2 / 2, with b = I / kp. So part of a lag is tried as delay, with the inertia that belongs to it and
    with the present one, and each joint takes what is best for it.

    Args:
        problem: the fit.
        found: where it ended.
        worth: share of the sum of squares that has to go.
    """
    lags = _lags(problem, found)
    if not lags:
        return None
    ways: list[_Way] = [(0.0, False), *((share, inertia) for share in _SHARES for inertia in (True, False))]
    tried = problem.residuals(np.array([_placed(found, lags, dict.fromkeys(lags, way)) for way in ways]))
    squares = np.nan_to_num([problem.squares(row) for row in tried], nan=np.inf)
    names = [problem.nominal.robot.joint_names[column] for column in problem.columns]
    chosen = {
        name: ways[number]
        for name, number in zip(names, np.argmin(squares, axis=0), strict=True)
        if name in lags and number
    }
    z = _placed(found, lags, chosen)
    better = bool(chosen) and float(np.sum(problem.residuals(z[None]) ** 2)) < (1.0 - worth) * found.rms**2
    return z if better else None


def _lags(problem: Problem, found: Solution) -> dict[str, float]:
    """Joint -> lag of its drive [s], where the delay is free."""
    free, values, lags = {item.name for item in found.parameters.free}, found.values, {}
    for joint in problem.nominal.robot.joint_names:
        stiffness = values.get(f"kp[{joint}]", 0.0)
        damping = sum(values.get(f"{name}[{joint}]", 0.0) for name in ("kv", "damping"))
        if f"delay_s[{joint}]" in free and stiffness > 0.0 and damping > 0.0:
            lags[joint] = damping / stiffness
    return lags


def _placed(found: Solution, lags: Mapping[str, float], ways: Mapping[str, _Way]) -> Float64[np.ndarray, "P"]:
    """The place of a fit, in z, with some joints' lags exchanged."""
    values = found.values
    other = dict(values)
    for joint, (share, inertia) in ways.items():
        late = share * lags[joint]
        other[f"delay_s[{joint}]"] += late
        for name in (f"kv[{joint}]", f"damping[{joint}]"):
            other[name] = (1.0 - share) * values.get(name, 0.0)
        name = f"armature[{joint}]"
        if inertia and name in values:
            change = values[f"kp[{joint}]"] * (0.5 * late**2 - lags[joint] * late)
            other[name] = max(values[name] + change, _LEAST_KEPT * values[name])
    free = found.parameters.free
    return found.parameters.at(
        {item.name: float(np.clip(other[item.name], item.low, item.high)) for item in free}
    ).start
