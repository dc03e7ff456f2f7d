"""The simulator along the robot's motions: where it would go from there, and how that depends on state and command.

Near a measured motion the simulator is x' = next(x) + A (x - measured) + C_before d_before + C d for delta actions d:
training looks many control steps ahead without simulating.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from trueup.compensate.delta_actions import regularized, weights
from trueup.compensate.tracks import Track
from trueup.sim.transitions import Transitions


@dataclass(frozen=True, eq=False)
class Linear:
    """One motion of T commands, and its T - 1 transitions.

    Attributes:
        track: the motion.
        error: where the simulator goes from each measured state, minus where the robot went, (T - 1, 2J).
        state: A, (T - 1, 2J, 2J).
        before: C_before, (T - 1, 2J, J).
        command: C, (T - 1, 2J, J).
    """

    track: Track
    error: Float32[np.ndarray, "N S"]
    state: Float32[np.ndarray, "N S S"]
    before: Float32[np.ndarray, "N S J"]
    command: Float32[np.ndarray, "N S J"]

    def delta(self, damping: float = 1e-2) -> Float32[np.ndarray, "N J"]:
        """The delta action of each transition by itself; see `delta_actions`."""
        weight = weights(self.command.shape[2]).astype(np.float32)
        zero = np.zeros((len(self.error), self.command.shape[2]), np.float32)
        found = regularized(weight[:, None] * self.command, weight * self.error, zero, damping)
        return np.asarray(found, np.float32)


def linear_of(
    track: Track, transitions: Transitions, *, smooth: Transitions | None = None, every: int = 10, size: float = 1e-4
) -> Linear:
    """Simulate one control step from every measured state, and differentiate at every `every`-th.

    Args:
        track: the motion.
        transitions: the simulator with the motion's payload.
        smooth: what is differentiated, if it is another one: without dry friction.
        every: slopes change slowly; those between are interpolated.
        size: of the differences [rad or m, and per second].
    """
    state, command = track.state, track.command
    before = np.concatenate([command[:1], command[:-1]])
    pull = track.gravity
    there = transitions.next(state[:-1], before[:-1], command[:-1], gravity=None if pull is None else pull[:-1])
    error = there - state[1:]
    last = len(error) - 1
    rows = np.unique(np.append(np.arange(0, last + 1, every), last))
    slopes = (smooth or transitions).slopes(
        state[rows], before[rows], command[rows], size=size, gravity=None if pull is None else pull[rows]
    )
    place = np.interp(np.arange(last + 1), rows, np.arange(rows.size))
    low = np.minimum(place.astype(int), rows.size - 1)
    high = np.minimum(low + 1, rows.size - 1)
    share = (place - low)[:, None, None]

    def between(values: np.ndarray) -> Float32[np.ndarray, "N S C"]:
        return np.asarray((1.0 - share) * values[low] + share * values[high], np.float32)

    return Linear(
        track, error.astype(np.float32), between(slopes.state), between(slopes.before), between(slopes.command)
    )
