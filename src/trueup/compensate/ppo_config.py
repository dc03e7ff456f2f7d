"""What training by reinforcement takes: `PpoConfig`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from trueup.errors import ConfigError

# What is matched. `change`: that of the state within a control step (GapONet, eq. 9); `state`: the next state;
# `position`: the next positions (GapONet, A.7).
Reward = Literal["change", "state", "position"]


@dataclass(frozen=True)
class PpoConfig:
    """Robots side by side, and proximal policy optimization (Schulman et al., 2017).

    Attributes:
        samples: control steps of all robots together.
        robots: simulated side by side.
        steps: of each robot between updates of the network.
        batch: control steps in each step of the optimizer.
        epochs: how often each is used.
        rate: learning rate.
        decays: whether it falls to nothing by the end.
        clip: how far the odds of an action may move in an update.
        gamma: what the next reward counts.
        trace: of generalized advantages, lambda.
        noise: standard deviation of actions at the beginning, in typical delta actions.
        critic: units of its layers.
        episode: control steps after which a robot begins elsewhere, at the latest.
        leave_rad: a joint that is so far from the measured motion ends the episode, too [rad or m].
        largest_rad: delta actions are no larger [rad or m].
        reward: what is matched.
        weight: of an error of `position_rad` in one joint, w of eq. 9.
        position_rad: an error of position that costs as much as
        velocity_rad_s: one of velocity [rad/s].
        smoothness: of changes of the delta action from step to step, as a share of what the same error costs.
    """

    samples: int = 1_000_000
    robots: int = 128
    steps: int = 32
    batch: int = 512
    epochs: int = 5
    rate: float = 1e-3
    decays: bool = True
    clip: float = 0.2
    gamma: float = 0.9
    trace: float = 0.95
    noise: float = 0.5
    critic: tuple[int, ...] = (128, 128)
    episode: int = 300
    leave_rad: float = 1.0
    largest_rad: float = 0.5
    reward: Reward = "state"
    weight: float = 0.01
    position_rad: float = 0.02
    velocity_rad_s: float = 2.0
    smoothness: float = 0.01

    def __post_init__(self) -> None:
        """Refuse what trains nothing."""
        for name in ("samples", "robots", "steps", "epochs", "episode"):
            if getattr(self, name) < 1:
                raise ConfigError(f"ppo: {name}", got=getattr(self, name), expected=">= 1")
        for name in ("rate", "clip", "noise", "leave_rad", "largest_rad", "weight", "position_rad", "velocity_rad_s"):
            if not 0 < getattr(self, name) < math.inf:
                raise ConfigError(f"ppo: {name}", got=getattr(self, name), expected="a positive number")
        for name in ("gamma", "trace"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"ppo: {name}", got=getattr(self, name), expected="0 to 1")
        if not 0 <= self.smoothness < math.inf:
            raise ConfigError("ppo: smoothness", got=self.smoothness, expected=">= 0")
        if self.batch < 2 or (self.robots * self.steps) % self.batch:
            raise ConfigError(
                "ppo: robots times steps must be a number of batches",
                got=f"{self.robots} x {self.steps} and batch {self.batch}",
            )


# GapONet, A.7 and Tables 3 and 4: 131072 control steps of 4096 robots between updates. A.7 has batches of 4096 and a
# learning rate of 1e-4, the tables 16384 and 2e-5; how long it trained is given as an hour of a GPU only.
PAPER = PpoConfig(
    samples=100 * 131072,
    robots=4096,
    batch=4096,
    rate=1e-4,
    decays=False,
    gamma=0.99,
    reward="change",
)
