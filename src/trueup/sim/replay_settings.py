"""How a log is replayed."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from trueup.errors import ConfigError
from trueup.robots import CommandTiming, RobotSpec


@dataclass(frozen=True)
class ReplaySettings:
    """How a log is replayed.

    Attributes:
        window_s: restart from the measured state this often [s]; None replays whole motions.
        initial_velocity: `zero`, or the `measured` one (its derivative of position where there is no channel);
            None takes the measured one at the start of windows and zero at that of a whole motion.
        settle_s: a whole motion begins after its first command was held for this long [s]; windows need none.
        delay_s: the command acts this much later than its stamp says [s], one number for all joints, or one per joint;
            negative where the stamps are late.
        base_sensor: the body that the robot stands on, whose specific force takes the place of gravity; a base at rest
            if empty.
        command: whether a command is `held` until the next one, or moves `linear`ly to it.
    """

    window_s: float | None = None
    initial_velocity: Literal["zero", "measured"] | None = None
    delay_s: float | tuple[float, ...] = 0.0
    settle_s: float = 0.0
    base_sensor: str = ""
    command: CommandTiming = "held"

    def __post_init__(self) -> None:
        """Refuse what cannot be replayed."""
        if self.window_s is not None and not 0 < self.window_s < np.inf:
            raise ConfigError("window_s must be positive", got=self.window_s)
        if not np.isfinite(self.delay_s).all():
            raise ConfigError("delay_s must be finite", got=self.delay_s)
        if not 0 <= self.settle_s < np.inf:
            raise ConfigError("settle_s must be >= 0", got=self.settle_s)

    @property
    def starts_moving(self) -> bool:
        """Whether a simulation starts with the measured velocity."""
        return self.initial_velocity == "measured" or (self.initial_velocity is None and self.window_s is not None)

    def to_dict(self) -> dict[str, Any]:
        """JSON types only; without a moving base and commands between stamps as it was before there were any."""
        absent = [name for name, plain in (("base_sensor", ""), ("command", "held")) if getattr(self, name) == plain]
        return {key: value for key, value in asdict(self).items() if key not in absent}

    @staticmethod
    def of(robot: RobotSpec) -> ReplaySettings:
        """What the robot description asks for."""
        replay = robot.replay
        return ReplaySettings(
            replay.window_s,
            replay.initial_velocity,
            robot.replay_delay_s,
            replay.settle_s,
            robot.simulation.base_sensor,
            replay.command,
        )
