"""Delta actions: what commands would have had to be for the simulator to move as the robot did (ASAP; GapONet, 4.2)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from trueup.sim.transitions import Transitions

# Errors of position and of velocity after a control step that count alike [rad and rad/s].
WEIGHT = (0.02, 0.4)


def weights(joints: int, size: tuple[float, float] = WEIGHT) -> Float64[np.ndarray, "S"]:
    """Of the errors of positions and velocities, in that order, (2J,)."""
    each: Float64[np.ndarray, "S"] = np.repeat(1.0 / np.asarray(size), joints) / np.sqrt(2 * joints)
    return each


def delta_actions(
    transitions: Transitions,
    state: Float[np.ndarray, "B S"],
    before: Float[np.ndarray, "B J"],
    command: Float[np.ndarray, "B J"],
    after: Float[np.ndarray, "B S"],
    *,
    damping: float = 1e-2,
    iterations: int = 1,
) -> Float64[np.ndarray, "B J"]:
    """What to add to each command so that the simulator arrives where the robot did.

    The least of |W (next(state, command + d) - after)|^2 + damping |d|^2, by Gauss-Newton steps from d = 0.

    Args:
        transitions: the simulator.
        state: of the robot, (B, 2J).
        before: commands one control step ago, as the simulator is to get them, (B, J).
        command: commands, (B, J).
        after: states of the robot one control step later, (B, 2J).
        damping: what a delta action costs [1/rad^2 or 1/m^2]; with 0, commands that move nothing make it fail.
        iterations: steps; one is enough where the simulator is nearly linear in its commands.

    Returns:
        (B, J) [rad or m].
    """
    weight = weights(command.shape[1])
    delta = np.zeros(command.shape)
    for _ in range(iterations):
        slopes = transitions.slopes(state, before, command + delta)
        error = transitions.next(state, before, command + delta) - after
        delta = regularized(weight[:, None] * slopes.command, weight * error, delta, damping)
    return delta


def regularized(
    slope: Float[np.ndarray, "B S J"], error: Float[np.ndarray, "B S"], delta: Float[np.ndarray, "B J"], damping: float
) -> Float64[np.ndarray, "B J"]:
    """One Gauss-Newton step of |error|^2 + damping |delta|^2, from `delta`, (B, J)."""
    turned = slope.transpose(0, 2, 1)
    normal = turned @ slope + damping * np.eye(slope.shape[2])
    gradient = turned @ error[:, :, None] + damping * delta[:, :, None]
    found: Float64[np.ndarray, "B J"] = delta - np.linalg.solve(normal, gradient)[:, :, 0]
    return found
