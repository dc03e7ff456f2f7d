"""How a policy is trained: algorithm, its numbers, the task, friction and randomization."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Literal

import numpy as np

from trueup.core.config import build
from trueup.core.policy_card import PolicyCard
from trueup.errors import ConfigError
from trueup.policy.randomization import RandomizationConfig
from trueup.policy.reach import ReachConfig

Algorithm = Literal["ddpg", "sac", "td3", "tqc"]
ALGORITHMS: tuple[Algorithm, ...] = ("ddpg", "sac", "td3", "tqc")


@dataclass(frozen=True)
class LearnerConfig:
    """The numbers of an algorithm that learns from a replay buffer.

    Attributes:
        rate: learning rate of all networks; above 0.005 hardly anything converges (ES thesis, 2.3.1).
        last_rate: that of the last round, to which it falls from round to round; stays if None.
        gamma: discount of what is worth something a control step later.
        tau: how far target networks follow at each update; 1 copies.
        batch: control steps of an update.
        buffer: control steps that are remembered.
        starts: control steps with random torques before the first update.
        every: control steps of each arm between updates.
        updates: how many follow each other then.
        n_steps: rewards of a replay that are counted before the critic's own estimate takes over; 1 in the papers.
        noise: of actions, while learning: `none`, `normal` (each control step by itself), `ou` (Ornstein-Uhlenbeck,
            which lasts).
        sigma: its standard deviation, in shares of the largest torque.
        layers: widths of the hidden layers of all networks.
        goal_scale: of the way from the goal to the end of the arm, as networks are given it: 5 cm are little beside
            sines and cosines, and what is little is learned late; 1 in the thesis.
    """

    rate: float = 1e-3
    last_rate: float | None = None
    gamma: float = 0.97
    tau: float = 0.01
    batch: int = 256
    buffer: int = 500_000
    starts: int = 5_000
    every: int = 1
    updates: int = 8
    n_steps: int = 1
    noise: Literal["none", "normal", "ou"] = "none"
    sigma: float = 0.1
    layers: tuple[int, ...] = (256, 256)
    goal_scale: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what learns nothing."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, int | float) and not 0 < value < np.inf:
                raise ConfigError(f"learner: {entry.name}", got=value, expected="a positive number")
        for name in ("gamma", "tau"):
            if getattr(self, name) > 1:
                raise ConfigError(f"learner: {name}", got=getattr(self, name), expected="at most 1")


@dataclass(frozen=True)
class PolicyConfig:
    """A training.

    Attributes:
        algorithm: `ddpg`, `sac`, `td3` (Stable-Baselines3) or `tqc` (sb3-contrib).
        learner: its numbers.
        reach: the task.
        friction: `simulator`: as the robot's description has it; `thesis`: none there, and that of `ThesisFriction` in
            what becomes of actions.
        randomization: what is drawn anew for each episode.
        network: folder of a network that corrects what is read of the simulator (`trueup augment train`); none if
            empty.
        start: folder of a policy whose networks, those of the critics too, the training begins with; fresh ones if
            empty. It acts for the first `learner.starts` control steps, which nothing is learned from before.
        arms: simulated side by side.
        steps: control steps of all arms together.
        rounds: parts of the training; after each, it is judged and can be resumed.
    """

    algorithm: Algorithm = "tqc"
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    reach: ReachConfig = field(default_factory=ReachConfig)
    friction: Literal["simulator", "thesis"] = "simulator"
    randomization: RandomizationConfig = field(default_factory=RandomizationConfig)
    network: str = ""
    start: str = ""
    arms: int = 16
    steps: int = 400_000
    rounds: int = 20

    def __post_init__(self) -> None:
        """Refuse trainings that do not begin."""
        for name in ("arms", "steps", "rounds"):
            if getattr(self, name) < 1:
                raise ConfigError(f"policy: {name}", got=getattr(self, name), expected="at least 1")
        if self.steps < self.rounds * self.arms:
            raise ConfigError(
                "policy: a round has a control step of each arm at least",
                got=f"{self.steps} steps in {self.rounds} rounds of {self.arms} arms",
            )


# ES thesis, 2.3: what all share, and 2.3.2, what was best for each.
_THESIS = LearnerConfig(
    batch=2048, buffer=1_000_000, starts=5_000, every=500, updates=50, noise="normal", sigma=0.1, layers=(512, 512, 512)
)
PAPER: Mapping[Algorithm, LearnerConfig] = {
    "ddpg": replace(_THESIS, rate=0.002, gamma=0.95, tau=0.01, sigma=0.1),
    "sac": replace(_THESIS, rate=0.002, gamma=0.99, tau=0.01, sigma=0.2),
    "td3": replace(_THESIS, rate=0.002, gamma=0.99, tau=0.01, sigma=0.2),
    "tqc": replace(_THESIS, rate=0.001, gamma=0.95, tau=0.9, noise="none"),
}

# One arm: learning begins after every so many control steps of it.
PAPER_ARMS = 1
# Policies that draw nothing need noise to explore, and with rewards of several control steps, which are those of other
# policies by then, they learned nothing here.
DETERMINISTIC: tuple[Algorithm, ...] = ("ddpg", "td3")

# Two cores without a GPU: small networks, a low control rate, and rewards counted over three control steps.
LAPTOP = PolicyConfig(
    algorithm="sac",
    learner=LearnerConfig(
        rate=2e-3,
        last_rate=1e-4,
        gamma=0.95,
        tau=0.02,
        buffer=200_000,
        updates=8,
        n_steps=3,
        layers=(128, 128),
        goal_scale=20.0,
    ),
    reach=ReachConfig(control_hz=25.0),
    arms=32,
    steps=400_000,
    rounds=20,
)


def laptop(algorithm: Algorithm = "sac") -> PolicyConfig:
    """`LAPTOP` for an algorithm: those that draw nothing explore by normal noise, and count one reward at a time."""
    if algorithm not in DETERMINISTIC:
        return replace(LAPTOP, algorithm=algorithm)
    return replace(LAPTOP, algorithm=algorithm, learner=replace(LAPTOP.learner, n_steps=1, noise="normal"))


def task_of(card: PolicyCard) -> PolicyConfig:
    """The task and the friction that a policy was trained with, by its card; all else as by default.

    Raises:
        ConfigError: the card says of its task what makes none.
    """
    said = card.provenance.get("config", {})
    reach = said.get("reach", {}) if isinstance(said, dict) else None
    if not isinstance(reach, dict):
        raise ConfigError(
            f"policy {card.name!r}, `config` of its provenance", got=said, expected="what it was trained with"
        )
    own = {"torque_nm": list(card.torque_nm), "control_hz": card.rate_hz, "site": card.site}
    tree = {"reach": {**reach, **own}, "friction": said.get("friction", "simulator")}
    return build(PolicyConfig, tree, f"policy {card.name!r}")
