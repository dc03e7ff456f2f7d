"""A policy in a robot's control loop: asked at its own rate, its torques guarded at every tick."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.protocols import Hardware
from trueup.deploy.clock import RealTimeClock
from trueup.deploy.guard import Guard, GuardSettings, Phase
from trueup.deploy.loop import LoopReport, run_loop
from trueup.deploy.policy import Policy
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, RobotStopped

# Why a run ends where nothing went wrong.
DONE = "done"
# An arm that does not stand after this long is stopped by its own brakes, if it has any [s].
_STANDS_S = 2.0
_WHOLE = 1e-6


@dataclass(frozen=True, eq=False)
class PolicyRun:
    """What happened on the way to a goal.

    Attributes:
        goal: (3,) [m].
        time_s: of each tick, since the first, (T,).
        position: measured, (T, J) [rad].
        velocity: measured, (T, J) [rad/s].
        said: torques of the policy, (T, J) [Nm].
        sent: torques that the robot was sent, (T, J) [Nm].
        distance_m: of the end of the arm from the goal, (T,) [m].
        braked_from: tick with which the stop began, T if none did.
        reason: why it ended: `done`, or what went wrong.
        phase: of the guard at the end: `stopped` where the arm stands.
        shares: limit -> share of the ticks in which it changed a torque.
        report: how punctual the loop was.
    """

    goal: Float64[np.ndarray, "3"]
    time_s: Float64[np.ndarray, "T"]
    position: Float64[np.ndarray, "T J"]
    velocity: Float64[np.ndarray, "T J"]
    said: Float64[np.ndarray, "T J"]
    sent: Float64[np.ndarray, "T J"]
    distance_m: Float64[np.ndarray, "T"]
    braked_from: int
    reason: str
    phase: Phase
    shares: dict[str, float]
    report: LoopReport

    @property
    def final_m(self) -> float:
        """Distance from the goal when the stop began [m]; infinity if there was no tick."""
        return float(self.distance_m[max(self.braked_from - 1, 0)]) if self.time_s.size else np.inf

    def within_s(self, near_m: float) -> float | None:
        """When the end of the arm came this near for the first time [s]; None if it did not."""
        near = np.flatnonzero(self.distance_m <= near_m)
        return float(self.time_s[near[0]]) if near.size else None


class PolicyLoop:
    """Drives a robot that takes torques, and carries its own weight, by a policy.

    Args:
        robot: measures positions and velocities.
        policy: of a robot with these joints.
        settings: limits.
        rate_hz: ticks per second, a whole multiple of the policy's rate.
        real_time: ticks are timed by this computer's clock; by the robot's, which may stand still meanwhile, if not.
        offset_nm: added to what the policy says, before the limits, (J,) [Nm]: what the robot's own compensation of
            gravity gets wrong (ES thesis, Table 3.1); nothing if None.

    Raises:
        ConfigError: the robot takes no torques, or the rates do not fit.
        NameMismatch: robot and policy do not have the same joints.
        MissingSignal: the robot does not say where it is, or how fast.
    """

    def __init__(
        self,
        robot: Hardware,
        policy: Policy,
        settings: GuardSettings,
        *,
        rate_hz: float = 1000.0,
        real_time: bool = False,
        offset_nm: Float[np.ndarray, "J"] | None = None,
    ) -> None:
        card = policy.card
        if "torque" not in robot.command_signals:
            raise ConfigError("the robot takes no torques", got=list(robot.command_signals), expected="torque")
        if tuple(robot.joints) != card.joints:
            raise NameMismatch(
                f"the policy {card.name!r} is of another robot",
                left=card.joints,
                right=robot.joints,
                left_name="it has",
                right_name="robot has",
            )
        every = rate_hz / card.rate_hz
        if round(every) < 1 or abs(every - round(every)) > _WHOLE * every:
            raise ConfigError(
                "the control rate must be a whole multiple of the policy's",
                got=f"{rate_hz:g} Hz",
                expected=f"a multiple of {card.rate_hz:g} Hz",
            )
        if len(settings.torque_nm) != len(card.joints):
            raise ConfigError("the guard is of another robot", got=len(settings.torque_nm), expected=len(card.joints))
        if missing := {"position", "velocity"} - set(robot.read()):
            raise MissingSignal(f"a policy needs {sorted(missing)}", available=robot.read())
        self.robot, self.policy, self.settings, self.rate_hz = robot, policy, settings, rate_hz
        self.real_time = real_time
        self.offset_nm = np.zeros(len(card.joints)) if offset_nm is None else np.asarray(offset_nm, np.float64)
        self._every = round(every)

    def run(self, goal: Float[np.ndarray, "3"], seconds: float) -> PolicyRun:
        """Go for a goal for so long, and stop; Ctrl-C stops at once.

        What was measured until then is returned whatever ends the run, a robot that stops by itself, too.

        Args:
            goal: [m].
            seconds: until the stop begins [s].

        Raises:
            ConfigError: no time.
            DataError: a goal that is no place.
        """
        goal = np.asarray(goal, np.float64)
        if not np.isfinite(goal).all():
            raise DataError("a goal is a place", got=goal)
        if not 0 < seconds < np.inf:
            raise ConfigError("a run needs some seconds", got=seconds)
        drive = _Drive(self, goal, seconds, self._every)
        with _asked_to_stop(drive.guard):
            report = drive.go()
        return drive.found(report)


class _Paced:
    """This computer's clock, beside a robot that keeps time by itself."""

    def __init__(self, robot: Hardware) -> None:
        self._robot, self._began_s = robot, robot.now_s()
        self._clock = RealTimeClock()

    def now_s(self) -> float:
        """Seconds since it was made."""
        return self._clock.now_s()

    def wait_until_s(self, time_s: float) -> None:
        """Let the robot wait until then."""
        self._robot.wait_until_s(self._began_s + time_s)


class _Drive:
    """One run while it goes on."""

    def __init__(self, loop: PolicyLoop, goal: Float64[np.ndarray, "3"], seconds: float, every: int) -> None:
        self._robot, self._policy, self._every, self._rate_hz = loop.robot, loop.policy, every, loop.rate_hz
        self.guard, self._real_time = Guard(loop.settings, 1.0 / loop.rate_hz), loop.real_time
        self._goal, self._offset = goal, loop.offset_nm
        self._seconds, self._tick_s = seconds, 1.0 / loop.rate_hz
        ticks, joints = round((seconds + _STANDS_S) * loop.rate_hz), len(loop.robot.joints)
        self._time = np.zeros(ticks)
        self._rows = np.zeros((4, ticks, joints))
        self._distance = np.zeros(ticks)
        self._tick, self._braked_from = 0, ticks
        self._said, self._sound = np.zeros(joints), True
        self._start_s = self._before_s = 0.0

    def go(self) -> LoopReport:
        """All ticks, until the arm stands."""
        clock = _Paced(self._robot) if self._real_time else self._robot
        self._start_s = clock.now_s()
        report = LoopReport(self._rate_hz)
        try:
            report = run_loop(
                self._step, rate_hz=self._rate_hz, duration_s=len(self._time) / self._rate_hz, clock=clock
            )
        except RobotStopped as error:
            self.guard.stop(f"the robot has stopped: {error.what}")
        except OSError as error:
            self.guard.stop(f"the robot does not answer: {error}")
        finally:  # Ctrl-C once more, or a mistake in a driver: no arm is left to its last torque
            if self.guard.phase != "stopped":
                self._let_go()
        return report

    def _let_go(self) -> None:
        """Leave the arm to its own brakes, or without torque if it has none."""
        brakes = getattr(self._robot, "stop", None)
        with contextlib.suppress(RobotStopped, OSError):
            if brakes is not None:
                brakes()
            else:
                self._robot.write({"torque": np.zeros_like(self._said)})

    def _step(self, now_s: float) -> bool:
        tick, guard = self._tick, self.guard
        reading = self._robot.read()
        position = np.asarray(reading["position"], np.float64)
        velocity = np.asarray(reading["velocity"], np.float64)
        since_s = now_s - self._start_s
        if since_s > self._seconds - 0.5 * self._tick_s:
            guard.stop(DONE)
        if guard.phase == "running" and tick % self._every == 0:
            self._ask(position, velocity)
        place = self._policy.place(position)
        # Behind the tick before: a loop that was late once goes on from there.
        late_s = since_s - self._before_s - self._tick_s if tick else 0.0
        self._before_s = since_s
        sent = guard.tick(self._said, position, velocity, place, sound=self._sound, late_s=late_s).copy()
        self._time[tick], self._distance[tick] = since_s, np.linalg.norm(place - self._goal)
        for row, values in zip(self._rows, (position, velocity, self._said, sent), strict=True):
            row[tick] = values
        if guard.phase != "running":
            self._braked_from = min(self._braked_from, tick)
        self._tick = tick + 1
        self._robot.write({"torque": sent})
        # An arm that stands is left without torque, not with the last one.
        return (guard.phase != "stopped" or bool(sent.any())) and self._tick < len(self._time)

    def _ask(self, position: Float64[np.ndarray, "J"], velocity: Float64[np.ndarray, "J"]) -> None:
        """What the policy says now; one that fails is no reason not to brake."""
        try:
            answer = self._policy.step(position, velocity, self._goal)
        except Exception as error:  # the arm moves: whatever it is, it is stopped, and the run says why
            self.guard.stop(f"the policy has failed: {type(error).__name__}: {error}")
        else:
            self._said, self._sound = answer.torque + self._offset, answer.sound

    def found(self, report: LoopReport) -> PolicyRun:
        """What was recorded."""
        done = self._tick
        position, velocity, said, sent = (row[:done] for row in self._rows)
        guard = self.guard
        return PolicyRun(
            self._goal,
            self._time[:done],
            position,
            velocity,
            said,
            sent,
            self._distance[:done],
            min(self._braked_from, done),
            guard.reason,
            guard.phase,
            guard.shares,
            report,
        )


@contextlib.contextmanager
def _asked_to_stop(guard: Guard) -> Iterator[None]:
    """Ctrl-C, once, brakes the arm instead of leaving it to its last torque."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def asked(*_: object) -> None:
        if guard.phase != "running":  # once more: whoever asks means it
            raise KeyboardInterrupt
        guard.stop("asked to stop")

    before = signal.signal(signal.SIGINT, asked)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
