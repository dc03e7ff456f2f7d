"""An accelerometer on the base of a virtual robot, which says how the base moves."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.lab.spec import Inertial
from trueup.sim.moving_base import SPECIFIC_FORCE, base_axes


class Accelerometer:
    """Says the specific force of the base in its own axes: its acceleration minus gravity.

    Args:
        model: of the robot as it is.
        spec: where it is, and its errors.

    Raises:
        ConfigError: there is no such body, or it moves with the robot.
    """

    def __init__(self, model: mujoco.MjModel, spec: Inertial) -> None:
        self.bodies: tuple[str, ...] = (spec.body,) if spec.body else ()
        self._spec = spec
        self._rng, self._bias = np.random.default_rng(), np.zeros(3)
        self._axes = base_axes(model, spec.body, "lab: inertial") if spec.body else np.eye(3)

    def restart(self, rng: np.random.Generator) -> None:
        """Begin a recording, in which the bias is one number per axis."""
        self._rng = rng
        self._bias = self._spec.bias_m_s2 * rng.standard_normal(3)

    def draw(self, rows: int) -> Float64[np.ndarray, "N 3"]:
        """What makes the noise of so many readings: the same draws for many at once and one after the other."""
        return self._rng.standard_normal((rows if self.bodies else 0, 3))

    def felt(
        self, pull: Float64[np.ndarray, "N 3"], drawn: Float64[np.ndarray, "N 3"]
    ) -> tuple[dict[str, Float64[np.ndarray, "N 1 3"]], dict[str, Float64[np.ndarray, "N 1 3"]]]:
        """`body.specific_force` as it is read, and as it is.

        Args:
            pull: gravity in the axes of the model's world, which moves with the base [m/s2].
            drawn: of `draw`.
        """
        true = -pull @ self._axes
        read = true + self._bias + self._spec.noise_m_s2 * drawn
        return {SPECIFIC_FORCE: read[:, None]}, {SPECIFIC_FORCE: true[:, None]}
