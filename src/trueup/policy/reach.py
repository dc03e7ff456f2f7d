"""Reaching a goal by torques: what a policy sees, what it may do, and what that is worth (ES thesis, 2.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError

# ES thesis, Table 2.2 [Nm].
THESIS_TORQUES = (2.0, 3.0, 2.5, 4.0, 2.0, 1.0, 1.0)


@dataclass(frozen=True)
class Reward:
    """What a control step is worth (ES thesis, 2.1.3); never more than 0.

    With d the distance as it is seen over the distance at the start, A and S the sums over joints of
    tanh(|acceleration| / 100) and tanh(|velocity|):

        r = -distance d - jolt_near A / (0.15 + d) - jolt_far A / |1.15 - min(1, d)| - speed S

    The thesis calls the second term one of the start and the third one of the goal; by its formula, which this is, it
    is the other way round.

    Attributes:
        distance: what the distance costs.
        jolt_near: what accelerations cost near the goal.
        jolt_far: what they cost as far from it as at the start.
        speed: what velocities cost.
    """

    distance: float = 2.0
    jolt_near: float = 0.03
    jolt_far: float = 0.05
    speed: float = 0.03

    @property
    def costs(self) -> Float64[np.ndarray, "4"]:
        """As `looking` takes them."""
        return np.array([self.distance, self.jolt_near, self.jolt_far, self.speed])


@dataclass(frozen=True)
class ReachConfig:
    """An episode of reaching.

    Attributes:
        torque_nm: largest torque of each joint besides what carries the weight, (J,) [Nm].
        control_hz: rate at which the policy acts [Hz].
        episode_s: how long an episode is [s].
        site: of the model, what is to reach the goal.
        nearest_m: goals are at least this far from where episodes begin [m].
        farthest_m: and at most this far [m].
        lowest_m: and at least this high [m].
        reward: what a control step is worth.

    Raises:
        ConfigError: numbers that make no episode.
    """

    torque_nm: tuple[float, ...] = THESIS_TORQUES
    control_hz: float = 50.0
    episode_s: float = 4.0
    site: str = "end_effector"
    nearest_m: float = 0.1
    farthest_m: float = 0.6
    lowest_m: float = 0.1
    reward: Reward = Reward()

    def __post_init__(self) -> None:
        """Refuse what makes no episode."""
        positive = {"control_hz": self.control_hz, "episode_s": self.episode_s, "farthest_m": self.farthest_m}
        positive |= {f"torque_nm[{joint}]": torque for joint, torque in enumerate(self.torque_nm)}
        for name, value in positive.items():
            if not 0 < value < np.inf:
                raise ConfigError(f"reach: {name}", got=value, expected="a positive number")
        if self.steps < 1 or not 0 <= self.nearest_m < self.farthest_m:
            raise ConfigError(
                "reach: no episode",
                got=f"{self.episode_s:g} s, goals {self.nearest_m:g} to {self.farthest_m:g} m away",
            )

    @property
    def control_s(self) -> float:
        """Control step [s]."""
        return 1.0 / self.control_hz

    @property
    def steps(self) -> int:
        """Control steps of an episode."""
        return round(self.episode_s * self.control_hz)
