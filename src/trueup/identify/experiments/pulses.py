"""Torque pulses: constant torques of both signs (ES thesis 3.1.1), and excite and coast (3.2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.protocols import Clock, RobotIO
from trueup.errors import ConfigError
from trueup.identify.experiments.driver import Driver
from trueup.identify.experiments.limits import Limits, RunSettings, check_joints

# ES thesis, Table 3.3: the 28 trajectories of a Franka Emika Panda, joint -> torques [Nm].
PANDA_TORQUES_NM: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "joint1": (-2.0, -1.0, 1.0, 2.0),
        "joint2": (-1.5, -1.0, 1.5),
        "joint3": (-1.5, -1.0, 1.0, 1.5),
        "joint4": (-1.5, -1.0, 1.0, 1.5),
        "joint5": (-1.3, -1.0, 1.0, 1.3),
        "joint6": (-0.6, -0.5, 0.5, 0.6),
        "joint7": (-0.6, -0.5, 0.4, 0.5, 0.65),
    }
)

_INSTANT_S = 1e-9


@dataclass(frozen=True)
class PulsePlan:
    """The course of one torque pulse; the defaults at 1 kHz are the 1500 + 500 steps of ES thesis 3.2.

    Attributes:
        rest_s: zero torque before [s].
        excite_s: constant torque [s].
        coast_s: zero torque after it [s].
        max_travel_rad: the torque ends early when the joint has come this far from its start; None never.
        repetitions: how often each torque is applied.

    Raises:
        ConfigError: a time or number that makes no sense.
    """

    rest_s: float = 0.0
    excite_s: float = 1.5
    coast_s: float = 0.5
    max_travel_rad: float | None = None
    repetitions: int = 1

    def __post_init__(self) -> None:
        """Refuse a plan without excitation."""
        if not (self.excite_s > 0 and self.rest_s >= 0 and self.coast_s >= 0 and self.repetitions > 0):
            raise ConfigError("a torque pulse needs a duration, and no negative times", got=self)
        if self.max_travel_rad is not None and not self.max_travel_rad > 0:
            raise ConfigError("max_travel_rad must be positive", got=self.max_travel_rad)


def run_constant_torque(
    robot: RobotIO,
    clock: Clock,
    torques_nm: Mapping[str, Sequence[float]],
    *,
    limits: Limits,
    plan: PulsePlan | None = None,
    settings: RunSettings | None = None,
) -> Iterator[Episode]:
    """Apply constant torques of both signs to joints one after the other, with a short coast after each.

    Two sizes per sign, or the coast, let the estimator find the effective inertia; both directions are needed for an
    offset. Small travel keeps gravity out of it: the plan's default ends a pulse after 0.3 rad. The signs take turns,
    the smallest torques first.

    Args:
        robot: commanded by `torque`; must report `position`.
        clock: the robot's.
        torques_nm: joint -> torques.
        limits: a torque beyond `torque_nm` is refused.
        plan: durations and travel.
        settings: rate, hold and return.

    Yields:
        Episodes `JOINT_torque1.5`, …, repetitions with `_02`, … at the end.

    Raises:
        NameMismatch: a joint is not the robot's.
        ConfigError: no torque limit for a joint, or a torque that is zero or beyond it.
        MissingSignal: the robot reports no position.
    """
    plan = plan or PulsePlan(rest_s=0.2, max_travel_rad=0.3)
    ordered = {joint: tuple(sorted(values, key=lambda tau: (abs(tau), -tau))) for joint, values in torques_nm.items()}
    return _pulses(Driver(robot, clock, limits, settings or RunSettings()), ordered, plan, "constant_torque")


def run_coast(
    robot: RobotIO,
    clock: Clock,
    torques_nm: Mapping[str, Sequence[float]],
    *,
    limits: Limits,
    plan: PulsePlan | None = None,
    settings: RunSettings | None = None,
) -> Iterator[Episode]:
    """Excite joints one after the other with constant torques, and let them coast (ES thesis 3.2 and Table 3.3).

    `PANDA_TORQUES_NM` holds the torques of the thesis. The episodes are what a fit of friction and inertia needs:
    the command torque, the motion under it, and the motion without it. Arguments, ids and errors as in
    `run_constant_torque`, the torques in the order in which they are given.
    """
    ordered = {joint: tuple(values) for joint, values in torques_nm.items()}
    return _pulses(Driver(robot, clock, limits, settings or RunSettings()), ordered, plan or PulsePlan(), "coast")


def _pulses(
    driver: Driver, torques_nm: Mapping[str, tuple[float, ...]], plan: PulsePlan, condition: str
) -> Iterator[Episode]:
    """Refuse at once what cannot be run; the pulses come as they are asked for."""
    check_joints(driver.robot, tuple(torques_nm), driver.limits, driver.settings)
    for joint, values in torques_nm.items():
        most = driver.limits.torque_nm[joint]
        wrong = [torque for torque in values if not 0.0 < abs(torque) <= most]
        if wrong:
            raise ConfigError(
                f"torques of {joint!r} that are zero or beyond the limit", got=wrong, expected=f"up to {most:g} in size"
            )
    return _recorded_pulses(driver, torques_nm, plan, condition)


def _recorded_pulses(
    driver: Driver, torques_nm: Mapping[str, tuple[float, ...]], plan: PulsePlan, condition: str
) -> Iterator[Episode]:
    for joint, values in torques_nm.items():
        for repetition in range(plan.repetitions):
            for torque in values:
                name = f"{joint}_torque{float(torque)}" + (f"_{repetition + 1:02d}" if repetition else "")
                yield driver.drive_and_return(joint, _Pulse(plan, torque), EpisodeMeta(name, condition=condition))


class _Pulse:
    """The torque program: rest, torque, coast."""

    def __init__(self, plan: PulsePlan, torque: float) -> None:
        self.plan = plan
        self.torque = torque
        self.start: float | None = None
        self.release_s = plan.rest_s + plan.excite_s

    def __call__(self, elapsed_s: float, position: float, velocity: float) -> float | None:  # noqa: ARG002
        self.start = position if self.start is None else self.start
        now = elapsed_s + _INSTANT_S
        if now < self.plan.rest_s:
            return 0.0
        far = self.plan.max_travel_rad is not None and abs(position - self.start) >= self.plan.max_travel_rad
        if far and now < self.release_s:
            self.release_s = elapsed_s
        if now < self.release_s:
            return self.torque
        return 0.0 if now < self.release_s + self.plan.coast_s else None
