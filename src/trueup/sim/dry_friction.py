"""How dry friction shares itself among coupled joints in one step: stick where it can hold, brake where it cannot."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

_SWEEPS = 200
# Left over of the optimality conditions, relative to the largest velocity in question.
_TOLERANCE = 1e-12


def friction_impulse(
    mobility: Float64[np.ndarray, "V V"],
    velocity: Float64[np.ndarray, "V"],
    most: Float64[np.ndarray, "V"],
    guess: Float64[np.ndarray, "V"] | None = None,
) -> Float64[np.ndarray, "V"]:
    """The impulses p of dry friction, |p| <= most: a joint rests, or p is largest and against its motion.

    These are the conditions of the least of p' mobility p / 2 + p' velocity in the box, whose gradient is the velocity
    after the step, `velocity + mobility @ p` (maximum dissipation). Sweeps over the joints find which of them rest,
    a linear solve for those that rest makes it exact.

    Args:
        mobility: inverse of the mass matrix of the step, symmetric and positive definite, (V, V).
        velocity: after the step if there were no friction, (V,) [rad/s or m/s].
        most: friction times the step, >= 0, (V,) [Nm s or N s].
        guess: where to begin, e.g. the impulses of the step before; full braking if None.
    """
    impulse = np.minimum(np.maximum(-np.sign(velocity) * most if guess is None else guess, -most), most)
    scale = _TOLERANCE * (np.abs(velocity) + np.abs(mobility) @ most).max(initial=0.0)
    for _ in range(_SWEEPS):
        after = velocity + mobility @ impulse
        if _settled(impulse, after, most, scale):
            break
        polished = _resting_solved(mobility, impulse, after, most)
        if _value(mobility, velocity, polished) < _value(mobility, velocity, impulse):
            impulse = polished
        for joint in np.flatnonzero(most > 0):
            slip = velocity[joint] + mobility[joint] @ impulse
            wanted = impulse[joint] - slip / mobility[joint, joint]
            impulse[joint] = min(max(wanted, -most[joint]), most[joint])
    return np.asarray(impulse)


def _settled(
    impulse: Float64[np.ndarray, "V"], after: Float64[np.ndarray, "V"], most: Float64[np.ndarray, "V"], scale: float
) -> bool:
    braking = np.where(after > 0, impulse <= -most, impulse >= most)
    return bool((braking | (np.abs(after) <= scale)).all())


def _resting(
    impulse: Float64[np.ndarray, "V"], after: Float64[np.ndarray, "V"], most: Float64[np.ndarray, "V"]
) -> Bool[np.ndarray, "V"]:
    """Those that are not pressed against an end of their range."""
    pressed = ((impulse <= -most) & (after > 0)) | ((impulse >= most) & (after < 0))
    return np.asarray((most > 0) & ~pressed)


def _resting_solved(
    mobility: Float64[np.ndarray, "V V"],
    impulse: Float64[np.ndarray, "V"],
    after: Float64[np.ndarray, "V"],
    most: Float64[np.ndarray, "V"],
) -> Float64[np.ndarray, "V"]:
    rest = _resting(impulse, after, most)
    result = impulse.copy()
    if rest.any():
        result[rest] -= np.linalg.solve(mobility[np.ix_(rest, rest)], after[rest])
    return np.asarray(np.clip(result, -most, most))


def _value(
    mobility: Float64[np.ndarray, "V V"], velocity: Float64[np.ndarray, "V"], impulse: Float64[np.ndarray, "V"]
) -> float:
    return float(impulse @ (velocity + 0.5 * mobility @ impulse))
