"""What arms see and what that is worth, compiled: numpy's calls would take longer than the physics of one arm.

Everything here is ES thesis, 2.1.3.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from trueup.deploy.machine_code import machine_code


@cache
def compiled() -> tuple[Any, Any, Any, Any]:
    """`places`, `look`, `sound` and `within`, compiled; see there."""
    return machine_code(_places), machine_code(_look), machine_code(_sound), machine_code(_within)


def _places(position, columns, axes, hinges, turns, shifts, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Where the end of a chain is, for N arms.

    Args:
        position: (N, J).
        columns: which joint moves part k of K, (K,).
        axes: its axis, (K, 3).
        hinges: whether it turns, (K,).
        turns: what is fixed before each part and after the last one, rotations, (K + 1, 3, 3).
        shifts: likewise, (K + 1, 3).
        out: (N, 3).
    """
    turn, other = np.empty((3, 3)), np.empty((3, 3))
    for row in range(position.shape[0]):
        turn[:] = turns[0]
        x, y, z = shifts[0]
        for part in range(columns.size):
            value = position[row, columns[part]]
            a, b, c = axes[part]
            if hinges[part]:
                s, v = np.sin(value), 1.0 - np.cos(value)
                w = 1.0 - v
                for k in range(3):
                    p, q, r = turn[k, 0], turn[k, 1], turn[k, 2]
                    other[k, 0] = p * (w + a * a * v) + q * (a * b * v + c * s) + r * (a * c * v - b * s)
                    other[k, 1] = p * (a * b * v - c * s) + q * (w + b * b * v) + r * (b * c * v + a * s)
                    other[k, 2] = p * (a * c * v + b * s) + q * (b * c * v - a * s) + r * (w + c * c * v)
                turn[:] = other
            else:
                x += value * (turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c)
                y += value * (turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c)
                z += value * (turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c)
            a, b, c = shifts[part + 1]
            x += turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c
            y += turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c
            z += turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c
            fixed = turns[part + 1]
            for k in range(3):
                p, q, r = turn[k, 0], turn[k, 1], turn[k, 2]
                for m in range(3):
                    other[k, m] = p * fixed[0, m] + q * fixed[1, m] + r * fixed[2, m]
            turn[:] = other
        out[row, 0], out[row, 1], out[row, 2] = x, y, z


def _look(position, velocity, before, place, goal, start, control_s, costs, seen, reward, distance_m):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """What N arms see, and what the control step was worth.

    Args:
        position: as it is seen, (N, J) [rad].
        velocity: likewise [rad/s].
        before: velocities a control step ago.
        place: of the ends, (N, 3) [m].
        goal: (N, 3) [m].
        start: length of the last three numbers of `seen` at the start, (N,): what the distance is divided by.
        control_s: control step [s].
        costs: of distance, of accelerations near the goal and far from it, and of speed, (4,).
        seen: sin q, cos q, tanh dq and tanh of the way from the goal to the end, written, (N, 3J + 3).
        reward: written, (N,).
        distance_m: written, (N,) [m].
    """
    joints = position.shape[1]
    for row in range(position.shape[0]):
        jolt = pace = 0.0
        for j in range(joints):
            q, dq = position[row, j], velocity[row, j]
            seen[row, j], seen[row, joints + j], seen[row, 2 * joints + j] = np.sin(q), np.cos(q), np.tanh(dq)
            jolt += np.tanh(abs(dq - before[row, j]) / control_s / 100.0)
            pace += np.tanh(abs(dq))
        near = away = 0.0
        for k in range(3):
            off = place[row, k] - goal[row, k]
            shown = np.tanh(off)
            seen[row, 3 * joints + k] = shown
            near += shown * shown
            away += off * off
        d = np.sqrt(near) / start[row]
        distance_m[row] = np.sqrt(away)
        reward[row] = (
            -costs[0] * d - costs[1] * jolt / (0.15 + d) - costs[2] * jolt / abs(1.15 - min(1.0, d)) - costs[3] * pace
        )


def _sound(position, velocity, fastest, lost):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether what is read of N arms can be true.

    Args:
        position: (N, J).
        velocity: (N, J).
        fastest: what no joint of a sound simulation exceeds [rad/s].
        lost: whether a position or velocity is no number, or a velocity beyond that, written, (N,).

    Returns:
        Whether none is lost.
    """
    well = True
    for row in range(position.shape[0]):
        lost[row] = False
        for j in range(position.shape[1]):
            if not (np.isfinite(position[row, j]) and abs(velocity[row, j]) <= fastest):
                lost[row], well = True, False
    return well


def _within(action, most, torque, mad):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Torques within the largest; those of an arm with one that is no number move nothing.

    Args:
        action: (N, J) [Nm].
        most: (J,) [Nm].
        torque: written, (N, J) [Nm].
        mad: whether one is no number, written, (N,).

    Returns:
        Whether none is.
    """
    well = True
    for row in range(action.shape[0]):
        mad[row] = False
        for j in range(action.shape[1]):
            value = action[row, j]
            if not np.isfinite(value):
                mad[row], well = True, False
            torque[row, j] = min(max(value, -most[j]), most[j])
        if mad[row]:
            torque[row] = 0.0
    return well
