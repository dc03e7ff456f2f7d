"""Samples of a motion before it is a plan: smoothed, and with rest before and after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError
from trueup.record.limits import JointLimits


@dataclass(frozen=True)
class ClockSettings:
    """How plans are sampled.

    Attributes:
        rate_hz: samples per second, the rate of the robot's controller [Hz].
        rest_s: rest before and after the motion [s]; the start of a motion is found from it.
        smoothing_s: accelerations change over this time instead of at once [s]; 0 lets them jump. The jerk is at most
            twice the acceleration limit over this. It lengthens the motion by as much.

    Raises:
        ConfigError: a rate that is not positive, or a negative time.
    """

    rate_hz: float = 1000.0
    rest_s: float = 0.5
    smoothing_s: float = 0.02

    def __post_init__(self) -> None:
        """Refuse clocks that do not run."""
        if not (self.rate_hz > 0 and np.isfinite(self.rate_hz)):
            raise ConfigError("rate_hz must be positive", got=self.rate_hz)
        for name in ("rest_s", "smoothing_s"):
            if not (getattr(self, name) >= 0 and np.isfinite(getattr(self, name))):
                raise ConfigError(f"{name} must not be negative", got=getattr(self, name))

    @property
    def timestep_s(self) -> float:
        """Step of the clock [s]."""
        return 1.0 / self.rate_hz


@dataclass(frozen=True, eq=False)
class Profile:
    """N samples of J joints at even steps, at rest at both ends.

    Attributes:
        position: (N, J).
        velocity: (N, J).
        acceleration: (N, J).
    """

    position: Float64[np.ndarray, "N J"]
    velocity: Float64[np.ndarray, "N J"]
    acceleration: Float64[np.ndarray, "N J"]

    def largest(self, timestep_s: float) -> tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "J"]]:
        """The largest speed and acceleration of each joint, (J,).

        Those that positions have from sample to sample count, too: the peak may lie between two samples.
        """
        speed = np.abs(np.diff(self.position, axis=0)).max(axis=0, initial=0) / timestep_s
        thrust = np.abs(np.diff(self.position, n=2, axis=0)).max(axis=0, initial=0) / timestep_s**2
        return (
            np.maximum(speed, np.abs(self.velocity).max(axis=0)),
            np.maximum(thrust, np.abs(self.acceleration).max(axis=0)),
        )

    def usage(self, limits: JointLimits, timestep_s: float) -> float:
        """The largest share of a velocity limit, or root of a share of an acceleration limit, that is used.

        It is the factor by which the motion must be slowed down to keep the limits, where it is above one.
        """
        speed, thrust = self.largest(timestep_s)
        return float(max((speed / limits.velocity).max(), np.sqrt(thrust / limits.acceleration).max()))

    def with_rest(self, samples: int) -> Profile:
        """The same with so many samples of rest before and after."""
        return Profile(
            np.pad(self.position, ((samples, samples), (0, 0)), mode="edge"),
            np.pad(self.velocity, ((samples, samples), (0, 0))),
            np.pad(self.acceleration, ((samples, samples), (0, 0))),
        )


def averaged(profile: Profile, steps: int, timestep_s: float) -> Profile:
    """The moving average of a motion over `steps` steps; the motion becomes longer by as many.

    An average of positions on a straight line is on the line, and averages exceed no limit. Velocities and
    accelerations of the average are exact: differences of positions and velocities over the window.

    Args:
        profile: N samples; accelerations may jump. Velocities may jump, too, as long as positions do not.
        steps: length of the window; 0 changes nothing.
        timestep_s: step of the clock [s].
    """
    if steps == 0:
        return profile
    position = np.pad(profile.position, ((steps, steps), (0, 0)), mode="edge")
    velocity = np.pad(profile.velocity, ((steps, steps), (0, 0)))
    # Trapezoids: the sum over the window, with half of its two ends.
    total = np.concatenate([np.zeros((1, position.shape[1])), np.cumsum(position - position[0], axis=0)])
    inner = total[steps + 1 :] - total[: -steps - 1] - (position[steps:] + position[:-steps] - 2 * position[0]) / 2
    window_s = steps * timestep_s
    average = position[0] + inner / steps
    # Joints that do not move do not move by rounding either; the ends are met exactly.
    average[:, np.ptp(profile.position, axis=0) == 0] = position[0, np.ptp(profile.position, axis=0) == 0]
    average[-1] = position[-1]
    return Profile(
        average,
        (position[steps:] - position[:-steps]) / window_s,
        (velocity[steps:] - velocity[:-steps]) / window_s,
    )
