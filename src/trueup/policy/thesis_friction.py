"""Friction as the ES thesis has it: in what becomes of actions, not in the simulator (2.4.2, 3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

# ES thesis, Table 2.3: phi_1 [Nm], phi_2 [s/rad], phi_3 [rad/s] of each joint.
PUBLISHED = (
    (0.5462, 5.1181, 0.0395),
    (0.8722, 9.0657, 0.0259),
    (0.6407, 10.1360, -0.0461),
    (1.2794, 5.5903, 0.0362),
    (0.8390, 8.3469, 0.0262),
    (0.3030, 17.1330, -0.0210),
    (0.5649, 10.3360, 0.0036),
)
# Table 3.2 [Nm], Table 3.1 [Nm], and the velocity below which a joint stands (3.1.2) [rad/s].
BREAKAWAY_POSITIVE = (0.65, 0.88, 0.51, 0.61, 0.44, 0.40, 0.32)
BREAKAWAY_NEGATIVE = (-0.62, -0.81, -0.42, -0.51, -0.67, -0.23, -0.35)
OFFSET = (-0.127, -0.725, 0.027, 0.53, 0.0, -0.06, 0.0)
STANDS = 0.03


@dataclass(frozen=True)
class ThesisFriction:
    """What becomes of an action in a simulation whose joints have no friction of their own.

    Attributes:
        numbers: phi_1 [Nm], phi_2 [s/rad], phi_3 [rad/s] of eq. 2.1, one row per joint.
        positive: torques that break joints away [Nm].
        negative: likewise, the other way round [Nm].
        stands: joints slower than this stand [rad/s].
    """

    numbers: tuple[tuple[float, float, float], ...] = PUBLISHED
    positive: tuple[float, ...] = BREAKAWAY_POSITIVE
    negative: tuple[float, ...] = BREAKAWAY_NEGATIVE
    stands: float = STANDS

    def applied(
        self,
        action: Float[np.ndarray, "N J"],
        velocity: Float[np.ndarray, "N J"],
        scale: Float[np.ndarray, "N J 5"] | None = None,
    ) -> Float64[np.ndarray, "N J"]:
        """The torque that is left of an action [Nm]: none where it does not break a standing joint away.

        Args:
            action: torques of the policy [Nm].
            velocity: of the joints [rad/s].
            scale: factors of each arm's own phi_1, phi_2, phi_3 and thresholds, the positive one first; 1 if None.
        """
        negative, positive = np.array(self.negative), np.array(self.positive)
        if scale is not None:
            positive, negative = positive * scale[..., 3], negative * scale[..., 4]
        held = (np.abs(velocity) < self.stands) & (action > negative) & (action < positive)
        return np.where(held, 0.0, action - self.dynamic(velocity, scale))

    def dynamic(
        self, velocity: Float[np.ndarray, "N J"], scale: Float[np.ndarray, "N J 5"] | None = None
    ) -> Float64[np.ndarray, "N J"]:
        """Sigmoid friction (eq. 2.1) [Nm]."""
        numbers = np.array(self.numbers, np.float64)
        level, slope, shift = np.moveaxis(numbers if scale is None else numbers * scale[..., :3], -1, 0)
        # Of a logistic curve, half a tanh of half its argument, which cannot overflow.
        rise = np.tanh(0.5 * slope * (velocity + shift)) - np.tanh(0.5 * slope * shift)
        return np.asarray(0.5 * level * rise, np.float64)
