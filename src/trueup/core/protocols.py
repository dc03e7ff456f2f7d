"""What the parts of trueup expect of one another, as Protocols with real signatures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from trueup.core.timeseries import TimeSeries


@dataclass(frozen=True, eq=False)
class RolloutRequest:
    """B motions of equal length whose commands are known beforehand.

    Attributes:
        position: initial joint positions, (B, J) [rad or m].
        velocity: initial joint velocities, (B, J) [rad/s or m/s].
        command: command signal -> (B, N, J), one row per simulation step, already delayed and held. A position
            servo needs `position`, a torque-driven robot `torque`, PD control may add `velocity`.
        gravity: what pulls on all bodies in each simulation step, in the axes of the base that the robot stands on,
            (B, N, 3) [m/s2]; None for a base at rest.
    """

    position: Float[np.ndarray, "B J"]
    velocity: Float[np.ndarray, "B J"]
    command: dict[str, Float[np.ndarray, "B N J"]]
    gravity: Float[np.ndarray, "B N 3"] | None = None


@dataclass(frozen=True, eq=False)
class RolloutResult:
    """What the simulator did: row k is the state at `k * timestep_s`, row 0 the initial state.

    Attributes:
        position: (B, N + 1, J) [rad or m].
        velocity: (B, N + 1, J) [rad/s or m/s].
        torque: joint torque of the actuators, (B, N + 1, J) [Nm or N]; row k acts from k to k + 1, and the last
            row repeats the one before.
        further: other signals of the joints, rows as those of `torque`: `current` [A] and `voltage` [V] of a robot
            whose motor is known, `load` [Nm or N] where the robot's description asks for it.
        bodies: signals of M bodies where the description asks for them, rows likewise: `body.position`
            (B, N + 1, M, 3), `body.rotation` (B, N + 1, M, 3, 3) and others.
        body_names: of the M bodies.
    """

    position: Float[np.ndarray, "B N1 J"]
    velocity: Float[np.ndarray, "B N1 J"]
    torque: Float[np.ndarray, "B N1 J"]
    further: Mapping[str, Float[np.ndarray, "B N1 J"]] = field(default_factory=dict)
    bodies: Mapping[str, Float[np.ndarray, "B N1 M ..."]] = field(default_factory=dict)
    body_names: tuple[str, ...] = ()


@runtime_checkable
class Simulator(Protocol):
    """A physics engine with one robot in it, ready to be commanded.

    Two faces: `rollout` for replay and identification (many motions at once, no Python in the loop), and
    batched `reset` and `step` for control loops and learning. Both run the same controllers.
    """

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J controlled joints."""
        ...

    @property
    def timestep_s(self) -> float:
        """Physics step [s]."""
        ...

    @property
    def command_signals(self) -> tuple[str, ...]:
        """Command signals that the controller follows; the first is required."""
        ...

    def rollout(self, request: RolloutRequest) -> RolloutResult:
        """Simulate B motions."""
        ...

    def reset(self, position: Float[np.ndarray, "B J"], velocity: Float[np.ndarray, "B J"]) -> None:
        """Put B independent copies of the robot into these states, at time 0."""
        ...

    def step(self, command: dict[str, Float[np.ndarray, "B J"]]) -> dict[str, Float[np.ndarray, "B J"]]:
        """Advance every copy by one physics step; returns `position`, `velocity` after it and `torque` in it."""
        ...


@runtime_checkable
class RobotIO(Protocol):
    """A robot, real or virtual, that takes commands and reports its state."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints."""
        ...

    def read(self) -> dict[str, Float[np.ndarray, "J"]]:
        """The latest measured signals, SI."""
        ...

    def write(self, command: dict[str, Float[np.ndarray, "J"]]) -> None:
        """Send a command, SI."""
        ...


@runtime_checkable
class Clock(Protocol):
    """Time for loops: real, or as fast as possible."""

    def now_s(self) -> float:
        """Seconds since the clock was started."""
        ...

    def wait_until_s(self, time_s: float) -> None:
        """Return at `time_s`; at once if it has passed."""
        ...


@runtime_checkable
class Hardware(RobotIO, Clock, Protocol):
    """A robot on its clock, as a recorder drives it. It holds the command that was written last.

    After a stop it refuses commands with `RobotStopped`; a driver without an answer raises an `OSError`.
    """

    @property
    def command_signals(self) -> tuple[str, ...]:
        """Signals that its controller follows; the first is required."""
        ...

    def recover(self) -> None:
        """Make it take commands again after a stop; nothing happens if it does."""
        ...


@runtime_checkable
class Executed(Protocol):
    """What came of a trajectory."""

    @property
    def measured(self) -> TimeSeries:
        """On the robot's clock: a row from before the first command, then every so many control steps."""
        ...

    @property
    def stopped_s(self) -> float | None:
        """When the robot stopped on its way, on its clock [s]; None if it arrived."""
        ...


@runtime_checkable
class TrajectoryIO(Hardware, Protocol):
    """A robot that also takes whole trajectories, and follows them at its own rate."""

    @property
    def control_step_s(self) -> float:
        """Its control step [s]."""
        ...

    def execute(self, command: dict[str, Float[np.ndarray, "N J"]], *, every: int = 1) -> Executed:
        """Follow one row per control step; the same motion as writing the rows one by one."""
        ...
