"""Where the base is told to be: a phase that goes round, and a trapezoid of speed (GapONet, A.6.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError


@dataclass(frozen=True)
class BaseProfile:
    """Accelerate, cruise, decelerate, pause; forward and backward in turn, without turning.

    Attributes:
        speed_m_s: of cruising; 0 to stand [m/s].
        accelerate_s: [s].
        cruise_s: [s].
        decelerate_s: [s].
        pause_s: [s].

    Raises:
        ConfigError: a negative time or speed, or no time to accelerate in.
    """

    speed_m_s: float = 0.3
    accelerate_s: float = 1.0
    cruise_s: float = 1.0
    decelerate_s: float = 1.0
    pause_s: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what cannot be followed."""
        for name, value in vars(self).items():
            if not 0 <= value < np.inf or (value == 0 and name in ("accelerate_s", "decelerate_s")):
                raise ConfigError(f"profile: {name} is out of range", got=value)

    @property
    def round_s(self) -> float:
        """Time of one way there [s]; the way back takes as long."""
        return self.accelerate_s + self.cruise_s + self.decelerate_s + self.pause_s

    def way(self, time_s: Float64[np.ndarray, "T"]) -> tuple[Float64[np.ndarray, "T"], Float64[np.ndarray, "T"]]:
        """How far the base is along its line, and how fast, at T times; before 0 it stands [m, m/s]."""
        rounds = np.floor(np.maximum(time_s, 0.0) / self.round_s)
        within = np.maximum(time_s, 0.0) - rounds * self.round_s
        corners = np.cumsum([0.0, self.accelerate_s, self.cruise_s, self.decelerate_s, self.pause_s])
        speed = np.interp(within, corners, [0.0, self.speed_m_s, self.speed_m_s, 0.0, 0.0])
        up = np.minimum(within, corners[1])
        level = np.clip(within - corners[1], 0.0, self.cruise_s)
        down = np.clip(within - corners[2], 0.0, self.decelerate_s)
        there = self.speed_m_s * (0.5 * up**2 / self.accelerate_s + level + down - 0.5 * down**2 / self.decelerate_s)
        whole = self.speed_m_s * (0.5 * self.accelerate_s + self.cruise_s + 0.5 * self.decelerate_s)
        back = rounds % 2 == 1
        return np.where(back, whole - there, there), np.where(back, -speed, speed)
