"""Motions of two arms, twelve seconds each, made by hand: what a person does with things in its hands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import PchipInterpolator

from trueup.robots import load_robot
from trueup.whole_body.driving import TARGET_S

SECONDS = 12.0
# The accelerations of keyframes jump.
_SMOOTHED_S = 0.3
_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist")
# Keyframes of one arm: time [s], then the five joints [rad]; rolls and yaws are those of the left arm.
Keys = Sequence[tuple[float, float, float, float, float, float]]
HOME = (0.0, 0.15, 0.0, -0.6, 0.0)


def _at(time_s: float, *joints: float) -> tuple[float, float, float, float, float, float]:
    pitch, roll, yaw, elbow, wrist = joints
    return time_s, pitch, roll, yaw, elbow, wrist


_REACH = (-1.3, 0.1, 0.0, -0.25, 0.0)
_CARRY = (-0.35, 0.1, 0.0, -1.35, 0.2)
_UP = (-2.3, 0.3, 0.0, -0.4, 0.0)
_SIDE = (-0.1, 1.45, 0.0, -0.2, 0.0)
_CHEST = (-0.7, 0.2, 0.3, -1.9, 0.4)
_SWING_FRONT, _SWING_BACK = (-0.7, 0.12, 0.0, -0.7, 0.0), (0.5, 0.12, 0.0, -0.3, 0.0)

# Name -> keyframes of the left and of the right arm; both begin and end at home.
MOTIONS: Mapping[str, tuple[Keys, Keys]] = {
    "reach": (
        [_at(1.8, *_REACH), _at(4.0, *_REACH), _at(6.0, *HOME), _at(8.0, *_REACH), _at(9.8, *_REACH)],
        [_at(1.8, *_REACH), _at(4.0, *_REACH), _at(6.0, *HOME), _at(8.0, *_REACH), _at(9.8, *_REACH)],
    ),
    "carry": (
        [_at(1.5, *_CARRY), _at(10.5, *_CARRY)],
        [_at(1.5, *_CARRY), _at(10.5, *_CARRY)],
    ),
    "lift": (
        [_at(1.5, *_CARRY), _at(3.5, *_UP), _at(5.5, *_UP), _at(7.5, *_CARRY), _at(9.5, *_UP)],
        [_at(1.5, *_CARRY), _at(3.5, *_UP), _at(5.5, *_UP), _at(7.5, *_CARRY), _at(9.5, *_UP)],
    ),
    "swing": (
        [_at(0.8 + 0.9 * number, *(_SWING_FRONT if number % 2 else _SWING_BACK)) for number in range(12)],
        [_at(0.8 + 0.9 * number, *(_SWING_BACK if number % 2 else _SWING_FRONT)) for number in range(12)],
    ),
    "spread": (
        [_at(2.0, *_SIDE), _at(4.0, *_SIDE), _at(6.0, *HOME), _at(8.0, *_SIDE), _at(10.0, *_SIDE)],
        [_at(2.0, *_SIDE), _at(4.0, *_SIDE), _at(6.0, *HOME), _at(8.0, *_SIDE), _at(10.0, *_SIDE)],
    ),
    "one hand": (
        [],
        [_at(1.6, *_REACH), _at(3.6, *_UP), _at(5.2, *_SIDE), _at(7.2, *_REACH), _at(9.5, *_CARRY)],
    ),
    "put down": (
        [
            _at(1.5, *_CHEST),
            _at(3.5, *_REACH),
            _at(5.0, *_CHEST),
            _at(7.0, -1.0, 0.6, 0.4, -0.3, 0.3),
            _at(9.0, *_CHEST),
        ],
        [
            _at(1.5, *_CHEST),
            _at(3.5, *_REACH),
            _at(5.0, *_CHEST),
            _at(7.0, -0.9, 0.0, -0.6, -0.5, 0.3),
            _at(9.0, *_CHEST),
        ],
    ),
    "push": (
        [_at(1.0 + 0.8 * number, *(_CHEST if number % 2 else _REACH)) for number in range(12)],
        [_at(1.0 + 0.8 * number, *(_CHEST if number % 2 else _REACH)) for number in range(12)],
    ),
    "wave": (
        [_at(1.5, *_CARRY), _at(10.5, *_CARRY)],
        [
            _at(1.8, -0.2, 1.7, 0.3, -1.2, 0.0),
            *(
                _at(2.5 + 0.6 * number, -0.2, 1.7, 0.3, -0.7 if number % 2 else -1.5, 0.3 if number % 2 else -0.3)
                for number in range(12)
            ),
            _at(10.0, -0.2, 1.5, 0.3, -1.2, 0.0),
        ],
    ),
    "turn": (
        [
            _at(1.5, -0.8, 0.4, 0.8, -1.2, 0.4),
            _at(4.0, -0.8, 0.4, -0.8, -1.2, -0.4),
            _at(7.0, -1.2, 0.4, 0.8, -0.8, 0.4),
        ],
        [
            _at(1.5, -0.8, 0.4, -0.8, -1.2, 0.4),
            _at(4.0, -0.8, 0.4, 0.8, -1.2, -0.4),
            _at(7.0, -1.2, 0.4, -0.8, -0.8, 0.4),
        ],
    ),
}


def targets_of(name: str) -> Float64[np.ndarray, "T J"]:
    """The targets of a motion, one every 20 ms, in the order of the robot's joints: monotone from key to key."""
    clock = TARGET_S * np.arange(round(SECONDS / TARGET_S))
    columns = {}
    for side, keys in zip(("left", "right"), MOTIONS[name], strict=True):
        frames = np.array([_at(0.0, *HOME), *keys, _at(SECONDS - 0.5, *HOME)])
        way = PchipInterpolator(frames[:, 0], frames[:, 1:], extrapolate=False)(np.minimum(clock, frames[-1, 0]))
        for column, joint in enumerate(_ARM):
            mirrored = side == "right" and joint in ("shoulder_roll", "shoulder_yaw")
            columns[f"{side}_{joint}"] = -way[:, column] if mirrored else way[:, column]
    ways = np.column_stack([columns[joint] for joint in load_robot("upper_body").joint_names])
    weights = np.hanning(round(_SMOOTHED_S / TARGET_S) + 2)[1:-1]
    around = np.pad(ways, ((len(weights) // 2, len(weights) - 1 - len(weights) // 2), (0, 0)), mode="edge")
    return np.stack([np.convolve(own, weights / weights.sum(), mode="valid") for own in around.T], axis=1)
