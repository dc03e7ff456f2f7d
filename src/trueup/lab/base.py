"""A base that moves as prescribed under the robot: standing, squatting, walking on the spot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from trueup.lab.spec import Base

# Axes of a base's motion: x forward, y left, z up [m], then its tilt about x and about y [rad].
_FORWARD, _LEFT, _UP, _ROLL, _PITCH = range(5)
# A step is half a stride; feet strike with its second harmonic.
_STRIDE, _STEP, _STRIKE = 1, 2, 4


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """A periodic motion of the base: `mean` and, along axis a, the sum over k of size[k, a] sin(w_k t + phase[k, a]).

    In the frame of the base, a motion along a line is exactly a change of the gravity vector, to g - a_base. A tilted
    base has its gravity turned. What turning adds besides is left out: the centrifugal, Coriolis and Euler forces of
    the tilt's rate, which are of the size of the tilt's acceleration times the distance from the tilt's axis.

    Attributes:
        omega: angular frequencies, (K,) [rad/s].
        size: of each harmonic along each of the five axes: x forward, y left, z up [m], roll, pitch [rad], (K, 5).
        phase: likewise [rad].
        mean: place and tilt around which it moves, (5,) [m, rad].
    """

    omega: Float64[np.ndarray, "K"]
    size: Float64[np.ndarray, "K 5"]
    phase: Float64[np.ndarray, "K 5"]
    mean: Float64[np.ndarray, "5"]

    def pose(self, time_s: Float64[np.ndarray, "T"]) -> Float64[np.ndarray, "T 5"]:
        """Place [m] and tilt [rad] of the base."""
        return np.asarray(self.mean + self._sum(time_s, self.size))

    def acceleration(self, time_s: Float64[np.ndarray, "T"]) -> Float64[np.ndarray, "T 3"]:
        """Of the base's place, in the axes of the world [m/s^2]."""
        return self._sum(time_s, -(self.omega[:, None] ** 2) * self.size)[:, :_ROLL]

    def gravity(
        self, time_s: Float64[np.ndarray, "T"], standing: Float64[np.ndarray, "3"]
    ) -> Float64[np.ndarray, "T 3"]:
        """What pulls on the robot, in the frame of its base [m/s^2].

        Args:
            time_s: on the robot's clock, (T,).
            standing: gravity in the frame of a base at rest.
        """
        x, y, z = (standing - self.acceleration(time_s)).T
        tilt = self.pose(time_s)
        sine, cosine = np.sin(tilt[:, _PITCH]), np.cos(tilt[:, _PITCH])
        x, z = cosine * x - sine * z, sine * x + cosine * z
        sine, cosine = np.sin(tilt[:, _ROLL]), np.cos(tilt[:, _ROLL])
        return np.stack([x, cosine * y + sine * z, cosine * z - sine * y], axis=1)

    def _sum(self, time_s: Float64[np.ndarray, "T"], size: Float64[np.ndarray, "K 5"]) -> Float64[np.ndarray, "T 5"]:
        angle = self.omega[:, None] * time_s[:, None, None] + self.phase
        return np.asarray((size * np.sin(angle)).sum(axis=1))


def draw_base(spec: Base, rng: np.random.Generator) -> BaseMotion | None:
    """How the base moves in one recording; None where it does not.

    Args:
        spec: its condition and sizes.
        rng: of the draws: where in its period it begins, how fast and how large it is this time.
    """
    if not spec.enabled or spec.condition not in ("squat", "gait"):
        return None
    rate, scale = np.exp(spec.spread * rng.standard_normal(2))
    begin = float(rng.uniform(0, 2 * np.pi))
    quarter = np.pi / 2
    mean = np.zeros(5)
    if spec.condition == "squat":
        size, phase = np.zeros((1, 5)), np.full((1, 5), begin + quarter)
        # Half of the way down on average, and as far up and down from there.
        mean[[_UP, _PITCH]] = -0.5 * spec.squat_m, 0.5 * spec.squat_lean_rad
        size[0] = -mean
        return BaseMotion(np.array([2 * np.pi * spec.squat_hz * rate]), scale * size, phase, scale * mean)
    harmonic = np.array([_STRIDE, _STEP, _STRIKE])
    size, phase = np.zeros((3, 5)), np.outer(harmonic * begin, np.ones(5))
    size[0, [_LEFT, _ROLL]] = spec.sway_m, spec.sway_rad
    size[1, [_FORWARD, _UP, _PITCH]] = spec.surge_m, spec.bob_m, spec.nod_rad
    size[2, _FORWARD] = spec.strike_m
    # The trunk is lowest when both feet stand, a quarter of a step from where it goes forward fastest.
    phase[1, _UP] += quarter
    mean[_PITCH] = spec.gait_lean_rad
    omega = harmonic * np.pi * spec.step_hz * rate
    return BaseMotion(omega, scale * size, phase, mean)
