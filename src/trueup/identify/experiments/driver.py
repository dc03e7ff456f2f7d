"""Drives one joint of a robot with a torque program on a clock, safely, and records what happens."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.protocols import Clock, RobotIO
from trueup.identify.experiments.limits import Limits, PoseHold, RunSettings
from trueup.identify.experiments.onset import STILL_SPEED
from trueup.identify.experiments.tape import Tape

# elapsed time [s], position and velocity of the excited joint -> its torque, or None to end the episode
Program = Callable[[float, float, float], float | None]

_STAND_S = 0.2  # a joint that has not moved for this long stands
_STAND_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class Driver:
    """Drives single joints of a robot with torque programs.

    Attributes:
        robot: commanded by `torque`.
        clock: the robot's.
        limits: what must not be exceeded.
        settings: rate, hold and return.
    """

    robot: RobotIO
    clock: Clock
    limits: Limits
    settings: RunSettings

    def drive(self, joint: str, program: Program, meta: EpisodeMeta) -> Episode:
        """Run one torque program on one joint and record it.

        Row k holds the state that was read at a tick and the torque that was commanded right after it. Whatever
        happens, also on Ctrl-C, the last thing that is written is zero torque.

        Returns:
            Command (`torque`) and all measured joint signals, from time 0. It is flagged `safety_stop` where a limit
            ended it, `robot_failed` where the robot or the clock raised, went silent, sent values that are not finite
            or would have been sent some (the samples until then are kept; a single row of NaN if there are none),
            `late_ticks` where the loop could not keep the rate.

        Raises:
            MissingSignal: the robot reports no position.
        """
        tape = Tape(self.robot.joints)
        flags: list[Flag] = []
        try:
            flags += self._loop(joint, program, tape)
        finally:
            flags += self._release(tape)
        return tape.episode(replace(meta, flags=(*meta.flags, *flags)))

    def drive_and_return(self, joint: str, program: Program, meta: EpisodeMeta) -> Episode:
        """As `drive`, then bring the joint back to where it was, or wait until it stands if nothing holds it.

        Returns:
            The episode of `drive`, with a note `not_returned` if the joint did not come back, or did not come to rest.
        """
        episode = self.drive(joint, program, meta)
        start = float(episode.measured["position"][0, self.robot.joints.index(joint)])
        missed = self._bring_back(joint, start)
        return replace(episode, meta=replace(episode.meta, flags=(*episode.meta.flags, *missed)))

    def _bring_back(self, joint: str, start: float) -> tuple[Flag, ...]:
        """Nothing of the way back is recorded; where the start was never read, there is none."""
        if not np.isfinite(start):
            return (_not_returned(joint, "where it started was not read"),)
        returning = _Returning(joint, start, self.limits, self.settings.hold)
        moved = self.drive(joint, returning, EpisodeMeta(f"{joint}_return"))
        serious = [flag.detail for flag in moved.meta.flags if flag.severity == "warning"]
        if returning.done and not serious:
            return ()
        why = "; ".join(serious) or f"still {returning.missed:.3g} rad from its start after {returning.timeout_s:g} s"
        return (_not_returned(joint, why),)

    def _loop(self, joint: str, program: Program, tape: Tape) -> list[Flag]:
        """Tick until the program ends or something stops it; the flags that say why."""
        column, period = self.robot.joints.index(joint), 1.0 / self.settings.rate_hz
        begin: float | None = None
        tick, changed_s = 0, 0.0
        while True:
            try:
                begin = self.clock.now_s() if begin is None else begin
                self.clock.wait_until_s(begin + tick * period)
                reading = self.robot.read()
                now = self.clock.now_s() - begin
            except Exception as error:  # whatever a driver raises must not lose what was recorded
                return [_failure(f"{type(error).__name__}: {error}", tape)]
            wrong = tape.read(now, reading)
            if wrong:
                return [_failure(wrong, tape)]
            velocity = tape.velocity()
            position = tape.rows["position"][-1]
            stop = self._exceeded(position, velocity)
            wanted = None if stop else program(now, float(position[column]), float(velocity[column]))
            if not tape.repeats() or not wanted:
                changed_s = now
            if self.settings.silent_s is not None and now - changed_s > self.settings.silent_s:
                return [_failure(f"the robot went silent: the same readings for {now - changed_s:.2g} s", tape)]
            torque = np.zeros(len(self.robot.joints)) if stop else self._holding(tape, velocity)
            torque[column] = wanted or 0.0
            if not np.isfinite(torque).all():
                bad = [name for name, value in zip(self.robot.joints, torque, strict=True) if not np.isfinite(value)]
                return [_failure(f"the torque to command is not finite for {', '.join(bad)}: nothing was sent", tape)]
            try:
                self.robot.write({"torque": torque})
            except Exception as error:
                return [_failure(f"{type(error).__name__}: {error}", tape)]
            tape.torque.append(torque)
            if stop:
                return [Flag("safety_stop", joint=stop[0], detail=stop[1], start_s=now)]
            if wanted is None:
                return []
            # The next tick is counted from the start, so that lateness does not add up.
            due = max(tick + 1, int(np.floor(now / period + 1e-6)) + 1)
            tape.late += due - tick - 1
            tick = due

    def _release(self, tape: Tape) -> list[Flag]:
        """Zero torque, whatever happened."""
        try:
            self.robot.write({"torque": np.zeros(len(self.robot.joints))})
        except Exception as error:
            detail = f"zero torque could not be sent at the end: {type(error).__name__}: {error}"
            return [Flag("not_released", detail=detail, start_s=tape.last_s)]
        return []

    def _exceeded(
        self, position: Float64[np.ndarray, "J"], velocity: Float64[np.ndarray, "J"]
    ) -> tuple[str, str] | None:
        """The joint that is beyond a limit, and a sentence about it."""
        limits = self.limits
        for joint, at, speed in zip(self.robot.joints, position, velocity, strict=True):
            if joint in limits.position_rad:
                low, high = limits.position_rad[joint]
                if not low <= at <= high:
                    return joint, f"stopped: {joint} at {at:.4g} rad, allowed {low:.4g} to {high:.4g}"
            if joint in limits.velocity_rad_s and abs(speed) > limits.velocity_rad_s[joint]:
                return joint, f"stopped: {joint} at {speed:.4g} rad/s, allowed {limits.velocity_rad_s[joint]:.4g}"
        return None

    def _holding(self, tape: Tape, velocity: Float64[np.ndarray, "J"]) -> Float64[np.ndarray, "J"]:
        """Torques of the pose hold about the pose of the first row."""
        hold, torque = self.settings.hold, np.zeros(len(self.robot.joints))
        if hold is None:
            return torque
        away = tape.rows["position"][0] - tape.rows["position"][-1]
        for column, joint in enumerate(self.robot.joints):
            if joint in hold.kp:
                wanted = hold.kp[joint] * away[column] - hold.kd.get(joint, 0.0) * velocity[column]
                torque[column] = _clipped(float(wanted), joint, self.limits)
        return torque


def _not_returned(joint: str, why: str) -> Flag:
    return Flag("not_returned", joint=joint, detail=f"the joint did not come back to rest: {why}", severity="note")


class _Returning:
    """The program of the way back: PD towards the start, or no torque; until the joint stands."""

    def __init__(self, joint: str, start: float, limits: Limits, hold: PoseHold | None) -> None:
        self.hold = hold if hold is not None and joint in hold.kp else None
        self.joint = joint
        self.start = start
        self.limits = limits
        self.timeout_s = _STAND_TIMEOUT_S if self.hold is None else self.hold.timeout_s
        self.recent: deque[tuple[float, float]] = deque()
        self.missed = np.inf
        self.done = False

    def __call__(self, elapsed_s: float, position: float, velocity: float) -> float | None:
        self.missed = abs(self.start - position)
        # Positions a while apart tell rest from motion also where the velocity is noisy.
        self.recent.append((elapsed_s, position))
        while len(self.recent) > 1 and self.recent[1][0] <= elapsed_s - _STAND_S:
            self.recent.popleft()
        span = elapsed_s - self.recent[0][0]
        stands = span >= 0.99 * _STAND_S and abs(position - self.recent[0][1]) < STILL_SPEED * span
        self.done = stands and (self.hold is None or self.missed <= self.hold.tolerance_rad)
        if self.done or elapsed_s > self.timeout_s:
            return None
        if self.hold is None:
            return 0.0
        wanted = self.hold.kp[self.joint] * (self.start - position) - self.hold.kd.get(self.joint, 0.0) * velocity
        return _clipped(wanted, self.joint, self.limits)


def _failure(detail: str, tape: Tape) -> Flag:
    return Flag("robot_failed", detail=detail, start_s=tape.last_s)


def _clipped(torque: float, joint: str, limits: Limits) -> float:
    most = limits.torque_nm.get(joint, np.inf)
    return float(np.clip(torque, -most, most))
