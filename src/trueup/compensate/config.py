"""What to train and how: `CompensateConfig`, from YAML, as a method's default, or as the paper has it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

from trueup.augment.config import NetworkConfig
from trueup.compensate.ppo_config import PAPER, PpoConfig
from trueup.core.config import build, read_yaml
from trueup.errors import ConfigError, needing

with needing("training", "learn"):
    from trueup.augment.networks.operator import OperatorConfig

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    _Numbers = TypeVar("_Numbers", Tensor, np.ndarray)

Way = Literal["direct", "delta", "ppo"]


@dataclass(frozen=True)
class LossConfig:
    """What counts.

    Attributes:
        position_rad: an error of position that costs as much as
        velocity_rad_s: one of velocity [rad/s].
        torque_nm: of robots that take torques, a delta action that costs as much as `position_rad` does of others.
        linear_from: errors of so many times these sizes and more cost in proportion, not by their squares.
        smoothness: cost of changes of the delta action from step to step, as a share of what the same change of the
            error costs (GapONet, A.7: 0.01).
        size: likewise, of delta actions themselves.
        sensors: of errors of the sensor predictor, in units of their spread (GapONet, eq. 7).
    """

    position_rad: float = 0.01
    velocity_rad_s: float = 2.0
    torque_nm: float = 0.5
    linear_from: float = 4.0
    smoothness: float = 0.01
    size: float = 1e-3
    sensors: float = 0.1

    def action(self, signal: str) -> float:
        """What a delta action is measured by: of positions `position_rad`, of torques `torque_nm`."""
        return self.torque_nm if signal == "torque" else self.position_rad

    def cost(self, squares: _Numbers) -> _Numbers:
        """Of errors whose squares, in units of `linear_from` times their sizes, are these.

        Squares near zero, straight lines far away: no motion in which a joint hits something decides for all others.
        This is 2 linear_from^2 (sqrt(1 + squares) - 1), without the difference of numbers that are nearly the same.
        """
        return 2 * self.linear_from**2 * squares / (1 + (1 + squares) ** 0.5)

    def __post_init__(self) -> None:
        """Refuse costs that are none."""
        for name in ("position_rad", "velocity_rad_s", "torque_nm", "linear_from"):
            if not 0 < getattr(self, name) < math.inf:
                raise ConfigError(f"loss: {name}", got=getattr(self, name), expected="a positive number")
        for name in ("smoothness", "size", "sensors"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ConfigError(f"loss: {name}", got=getattr(self, name), expected=">= 0")


@dataclass(frozen=True)
class TrainConfig:
    """How the network learns.

    Attributes:
        way: `direct`: the error of many control steps in the linear model of the simulator, differentiated; `delta`:
            each delta action by itself; `ppo`: by reinforcement, as in the paper.
        updates: number of steps of the optimizer.
        rounds: parts of the training; after each, val motions say how good the network is.
        batch: windows in each.
        horizon: control steps of a window, at the end of the training; windows begin short and grow.
        rate: largest learning rate; it rises over the first hundredth and falls to nothing (cosine).
        jolt: how far from the measured state windows begin, as a share of the sizes in `loss`.
        damping: of delta actions, `delta` only [1/rad^2].
    """

    way: Way = "direct"
    updates: int = 600
    rounds: int = 20
    batch: int = 96
    horizon: int = 30
    rate: float = 2e-3
    jolt: float = 0.5
    damping: float = 1e-2

    def __post_init__(self) -> None:
        """Refuse what trains nothing."""
        if min(self.updates, self.rounds, self.batch, self.horizon) < 1 or not (0 < self.rate < 1 and self.jolt >= 0):
            raise ConfigError(
                "training: updates, rounds, batch, horizon, rate, jolt",
                got=(self.updates, self.rounds, self.batch, self.horizon, self.rate, self.jolt),
                expected="positive numbers",
            )


@dataclass(frozen=True)
class CompensateConfig:
    """The whole configuration.

    Attributes:
        method: for people.
        network: its kind and sizes.
        loss: what counts.
        training: how it learns.
        ppo: and by reinforcement, where that is its way.
        relative: whether commanded positions are read as how far they are from the position; else as they are. Torques
            are always read as they are.
    """

    method: str = "operator"
    network: NetworkConfig = field(default_factory=OperatorConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    training: TrainConfig = field(default_factory=TrainConfig)
    ppo: PpoConfig = field(default_factory=PpoConfig)
    relative: bool = True

    @staticmethod
    def load(path: Path) -> CompensateConfig:
        """From YAML.

        Raises:
            ConfigError: unreadable, or a key or value that is none.
        """
        return build(CompensateConfig, read_yaml(path), str(path))


# A network for the robot feeds its own corrections back through friction and a delay: with the steps and windows that a
# simulator's network takes, its training runs away, and with the paper's cost of changes it shakes the robot.
_CAREFUL = TrainConfig(updates=300, horizon=20, rate=7e-4)
_STEADY = LossConfig(smoothness=1.0)
METHODS: Mapping[str, CompensateConfig] = {
    "operator": CompensateConfig(),
    "operator-robot": CompensateConfig(loss=_STEADY, training=_CAREFUL),
    "mlp-robot": CompensateConfig("mlp", NetworkConfig("mlp", (256, 256), history=1), loss=_STEADY, training=_CAREFUL),
    "transformer-robot": CompensateConfig(
        "transformer", NetworkConfig("transformer", (64, 64), history=5), loss=_STEADY, training=_CAREFUL
    ),
    # GapONet, A.7: the sizes that agree with each other (p = 160 per joint); ELU; 4 earlier steps.
    "operator-paper": CompensateConfig(
        "operator-paper",
        OperatorConfig(hidden=(256, 256, 256), features=160, trunk=(128, 128), predictor=(256,), current=("position",)),
        relative=False,
        training=TrainConfig("ppo"),
        ppo=PAPER,
    ),
    # For robots that take torques; sensors need commands that a simulator can be asked about, which torques are not.
    "torques": CompensateConfig(
        "mlp", NetworkConfig("mlp", (128, 128), history=4), training=TrainConfig(horizon=20), relative=False
    ),
    # What the paper compares with: an MLP of the present state and action (ASAP), and a transformer with a history.
    "mlp": CompensateConfig("mlp", NetworkConfig("mlp", (256, 256), history=1)),
    "transformer": CompensateConfig("transformer", NetworkConfig("transformer", (64, 64), history=5)),
}
