"""Breakaway by torque ramp: the torque that sets a standing joint in motion, in both directions (ES thesis 3.1.2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.protocols import Clock, RobotIO
from trueup.errors import ConfigError
from trueup.identify.experiments.driver import Driver
from trueup.identify.experiments.limits import Limits, RunSettings, check_joints
from trueup.identify.experiments.onset import PERSISTENCE, STILL_SPEED, Stillness, least_rest

_NAMES = {1: "positive", -1: "negative"}


@dataclass(frozen=True)
class RampPlan:
    """How joints are broken away.

    Attributes:
        ramp_nm_per_s: slope of the torque, for all joints or joint by joint. Slower is more precise: what the ramp
            gains between breaking away and being seen has to be corrected for.
        repetitions: ramps per direction; at least 3 for an interval that means something.
        rest_s: zero torque before each ramp [s], from which the noise is learned.
        settle_s: a joint that has stood this long after the ramp has settled [s].
        settle_timeout_s: wait no longer than this for it [s].
        still_speed: speed below which a joint stands [rad/s].

    Raises:
        ConfigError: a value that is not positive.
    """

    ramp_nm_per_s: float | Mapping[str, float] = 0.2
    repetitions: int = 5
    rest_s: float = 0.5
    settle_s: float = 0.2
    settle_timeout_s: float = 3.0
    still_speed: float = STILL_SPEED

    def __post_init__(self) -> None:
        """Refuse a plan that cannot be run."""
        slopes = self.ramp_nm_per_s.values() if isinstance(self.ramp_nm_per_s, Mapping) else [self.ramp_nm_per_s]
        for value in (*slopes, self.repetitions, self.rest_s, self.settle_timeout_s, self.still_speed):
            if not value > 0:
                raise ConfigError("a plan of torque ramps needs positive values", got=self)

    def slope(self, joint: str) -> float:
        """The slope of one joint [Nm/s].

        Raises:
            ConfigError: it is not stated for this joint.
        """
        if not isinstance(self.ramp_nm_per_s, Mapping):
            return self.ramp_nm_per_s
        if joint not in self.ramp_nm_per_s:
            raise ConfigError(f"no ramp_nm_per_s for joint {joint!r}", available=self.ramp_nm_per_s)
        return self.ramp_nm_per_s[joint]


def run_breakaway(
    robot: RobotIO,
    clock: Clock,
    *,
    limits: Limits,
    joints: Sequence[str] | None = None,
    plan: RampPlan | None = None,
    settings: RunSettings | None = None,
) -> Iterator[Episode]:
    """Break joints away, one after the other: torque ramps of both signs in turn, up to motion or the torque limit.

    Each episode is a rest, a ramp, zero torque, and the wait for standing still. With `settings.hold` the joint is
    brought back afterwards. A ramp that failed is yielded with a flag, and the next one is run.

    Args:
        robot: commanded by `torque`; must report `position`.
        clock: the robot's.
        limits: `torque_nm` of each joint is where its ramps end.
        joints: all of the robot's if None.
        plan: slope, repetitions and times.
        settings: rate and hold.

    Yields:
        Episodes `JOINT_ramp-positive-01`, `JOINT_ramp-negative-01`, …

    Raises:
        NameMismatch: a joint is not the robot's.
        ConfigError: a joint has no torque limit or no slope, or the rest is too short to learn the noise from.
        MissingSignal: the robot reports no position.
    """
    plan, settings = plan or RampPlan(), settings or RunSettings()
    names = tuple(robot.joints if joints is None else joints)
    check_joints(robot, names, limits, settings)
    slopes = {joint: plan.slope(joint) for joint in names}
    least = least_rest(np.arange(2) / settings.rate_hz) + 1
    if plan.rest_s * settings.rate_hz < least:
        raise ConfigError(
            "the rest before a ramp is too short to learn the noise from",
            got=f"{plan.rest_s:g} s",
            expected=f"at least {least / settings.rate_hz:.3g} s at {settings.rate_hz:g} Hz",
        )
    return _ramps(Driver(robot, clock, limits, settings), slopes, plan)


def _ramps(driver: Driver, slopes: Mapping[str, float], plan: RampPlan) -> Iterator[Episode]:
    for joint, slope in slopes.items():
        for repetition in range(plan.repetitions):
            # The direction that goes first changes, so that warming up does not look like an asymmetry.
            for sign in (1, -1) if repetition % 2 == 0 else (-1, 1):
                ramp = _Ramp(plan, slope, sign, driver.limits.torque_nm[joint])
                meta = EpisodeMeta(f"{joint}_ramp-{_NAMES[sign]}-{repetition + 1:02d}", condition="breakaway")
                yield driver.drive_and_return(joint, ramp, meta)


class _Ramp:
    """The torque program: rest, ramp until motion, zero until still."""

    def __init__(self, plan: RampPlan, slope: float, sign: int, limit: float) -> None:
        self.plan = plan
        self.slope = slope
        self.sign = sign
        self.limit = limit
        self.time_s: list[float] = []
        self.position: list[float] = []
        self.velocity: list[float] = []
        self.still: Stillness | None = None
        self.step = np.inf
        self.streak = 0
        self.released_s: float | None = None
        self.moved_s = 0.0

    def __call__(self, elapsed_s: float, position: float, velocity: float) -> float | None:
        if self.position and position != self.position[-1]:
            self.step = min(self.step, abs(position - self.position[-1]))
        self.time_s.append(elapsed_s)
        self.position.append(position)
        self.velocity.append(velocity)
        if elapsed_s < self.plan.rest_s:
            return 0.0
        if self.still is None:
            clock, positions, velocities = map(np.array, (self.time_s, self.position, self.velocity))
            self.still = Stillness.of_rest(clock, positions, velocities, self.plan.still_speed)
            if self.still.moving:
                return None
        if self.released_s is not None:
            return self._settle(elapsed_s)
        torque = self.slope * (elapsed_s - self.plan.rest_s)
        self.streak = self.streak + 1 if self._fast() else 0
        if self.streak >= PERSISTENCE or torque > self.limit:
            self.released_s = self.moved_s = elapsed_s
            return 0.0
        return self.sign * torque

    def _settle(self, elapsed_s: float) -> float | None:
        if self._fast():
            self.moved_s = elapsed_s
        settled = elapsed_s - self.moved_s > self.plan.settle_s
        assert self.released_s is not None
        return None if settled or elapsed_s - self.released_s > self.plan.settle_timeout_s else 0.0

    def _fast(self) -> bool:
        """Whether the window speed of the last samples is above the threshold."""
        assert self.still is not None
        rows = self.still.rows
        if self.still.channel == "position":
            speed = (self.position[-1] - self.position[-1 - rows]) / (self.time_s[-1] - self.time_s[-1 - rows])
            return abs(speed) > self.still.level(self.step if np.isfinite(self.step) else 0.0)
        return abs(sum(self.velocity[-rows:]) / rows) > self.still.threshold
