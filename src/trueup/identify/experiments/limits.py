"""What keeps an experiment safe, and how it is driven and recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from trueup.core.protocols import RobotIO
from trueup.errors import ConfigError, NameMismatch


@dataclass(frozen=True)
class Limits:
    """What must not be exceeded; joints that are not named are not limited.

    Attributes:
        torque_nm: joint -> largest commanded torque. A ramp ends there, a larger constant torque is refused.
        position_rad: joint -> lowest and highest position; beyond, the episode is stopped. Leave room for braking:
            stopping means zero torque.
        velocity_rad_s: joint -> largest speed; beyond, the episode is stopped.

    Raises:
        ConfigError: a limit that is not positive, or a range without room.
    """

    torque_nm: Mapping[str, float]
    position_rad: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    velocity_rad_s: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse limits that limit nothing."""
        for name, values in (("torque_nm", self.torque_nm), ("velocity_rad_s", self.velocity_rad_s)):
            for joint, value in values.items():
                if not value > 0:
                    raise ConfigError(f"{name} of {joint!r} must be positive", got=value)
        for joint, (low, high) in self.position_rad.items():
            if not low < high:
                raise ConfigError(f"position_rad of {joint!r} has no room", got=(low, high))


@dataclass(frozen=True)
class PoseHold:
    """A PD law that keeps the joints that are not excited in place, and brings the excited one back.

    Attributes:
        kp: joint -> stiffness [Nm/rad]; joints that are not named get no torque. Too high for the robot's delay
            oscillates; with `kp * tolerance_rad` below the static friction the joint stays where it is.
        kd: joint -> damping [Nm s/rad].
        tolerance_rad: how close to its start a joint must come.
        timeout_s: how long it may take [s].
    """

    kp: Mapping[str, float]
    kd: Mapping[str, float]
    tolerance_rad: float = 0.01
    timeout_s: float = 5.0


@dataclass(frozen=True)
class RunSettings:
    """How an experiment is driven and recorded.

    Attributes:
        rate_hz: of reading, commanding and recording.
        hold: what holds the other joints and returns the excited one to its start after each episode; None leaves
            the others at zero torque and every episode begins where the last one ended.
        silent_s: an excited robot that repeats all of its readings bit for bit for this long [s] has gone silent;
            None for a robot without noise. Not applied to robots that report nothing but a position: an encoder
            may rightly repeat.
    """

    rate_hz: float = 1000.0
    hold: PoseHold | None = None
    silent_s: float | None = 1.0

    def __post_init__(self) -> None:
        """Refuse a rate that is none."""
        if not 0 < self.rate_hz < np.inf:
            raise ConfigError("rate_hz must be positive", got=self.rate_hz)


def check_joints(robot: RobotIO, joints: tuple[str, ...], limits: Limits, settings: RunSettings) -> None:
    """Refuse names that are not the robot's, and joints that would be excited without a limit.

    Raises:
        NameMismatch: a joint is not the robot's.
        ConfigError: a joint to excite has no torque limit.
    """
    hold = () if settings.hold is None else (*settings.hold.kp, *settings.hold.kd)
    named = (*joints, *limits.torque_nm, *limits.position_rad, *limits.velocity_rad_s, *hold)
    if not set(named) <= set(robot.joints):
        raise NameMismatch(
            "the experiment names joints that the robot lacks",
            left=dict.fromkeys(named),
            right=robot.joints,
            left_name="named",
            right_name="robot has",
        )
    free = [joint for joint in joints if joint not in limits.torque_nm]
    if free:
        raise ConfigError(f"no torque limit for {free}", available=limits.torque_nm, hint="State limits.torque_nm.")
