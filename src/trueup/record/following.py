"""A robot follows commands, and what it says meanwhile is kept: step by step, or as a whole where it can do that."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from trueup.core.protocols import Hardware, TrajectoryIO
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.core.units import SI_UNIT
from trueup.errors import ConfigError, DataError, RobotStopped, TrueupError
from trueup.record.servoing import TorqueServo

# A robot whose command went this far and whose readings did not change at all says nothing any more [rad or m].
_UNANSWERED = 0.01
# Rates that should be multiples of one another may miss by this share.
_WHOLE = 1e-6


@dataclass(frozen=True)
class Trouble:
    """What ended a motion early.

    Attributes:
        kind: `stopped` (the robot took no more commands), `silent` (its readings stood still while its command
            moved), `failed` (its driver raised an error).
        time_s: when, from the first command on [s].
        detail: for people.
    """

    kind: Literal["stopped", "silent", "failed"]
    time_s: float
    detail: str


@dataclass(frozen=True, eq=False)
class Followed:
    """What was commanded and measured, both from the first command on.

    Attributes:
        measured: every so many steps, from before the first command on; None if nothing was read.
        command: what was sent at the same times, or all of it where readings are more frequent than commands; None if
            nothing was.
        trouble: what ended it early, None if nothing did.
        late: steps that began more than one step too late.
        latest_s: the largest such lateness [s].
    """

    measured: TimeSeries | None
    command: TimeSeries | None
    trouble: Trouble | None
    late: int = 0
    latest_s: float = 0.0


def follow(
    robot: Hardware,
    command: Mapping[str, Float64[np.ndarray, "N J"]],
    *,
    step_s: float,
    every: int,
    silent_s: float,
    hold: int = 1,
) -> Followed:
    """Send one row of the command after the other; the series have the units of hinges.

    Args:
        robot: that is where the command begins.
        command: signals that the robot follows, (N, J).
        step_s: from one row to the next, or, where rows are held, from one reading to the next [s].
        every: keep every so many steps of what is read.
        silent_s: readings that have not changed for longer than this, while the command moved, mean that nobody is
            there [s].
        hold: steps from one row to the next; if more than one, `every` is 1.

    Raises:
        ConfigError: the step is not a whole number of the robot's own.
    """
    if isinstance(robot, TrajectoryIO):
        return _execute(robot, command, step_s, every, silent_s, hold)
    return _drive(robot, command, step_s, every, silent_s, hold)


def own_steps(robot: TrajectoryIO, step_s: float) -> int:
    """How many of the robot's own control steps one of the recorder's lasts.

    Raises:
        ConfigError: not a whole number of them.
    """
    steps = round(step_s / robot.control_step_s)
    if steps < 1 or abs(steps * robot.control_step_s / step_s - 1) > _WHOLE:
        raise ConfigError(
            "the control step must be a whole number of the robot's own",
            got=f"{step_s:g} s",
            expected=f"a multiple of {robot.control_step_s:g} s",
        )
    return steps


class _Silence:
    """Notices that readings stand still while the command moves."""

    def __init__(self, silent_s: float) -> None:
        self._silent_s = silent_s
        self._reading: Mapping[str, np.ndarray] | None = None
        self._since_s = 0.0
        self._from: np.ndarray | None = None

    def noticed(self, time_s: float, reading: Mapping[str, np.ndarray], command: np.ndarray) -> bool:
        """Whether this reading (of joints, by signal) at this command (of joints) is one too many."""
        before = self._reading
        if before is None or any(not np.array_equal(reading[name], before[name]) for name in reading):
            self._reading, self._since_s, self._from = reading, time_s, command
            return False
        moved = float(np.abs(command - self._from).max(initial=0.0))
        return time_s - self._since_s > self._silent_s and moved > _UNANSWERED

    def trouble(self, time_s: float) -> Trouble:
        """What it is called."""
        return Trouble("silent", time_s, f"its readings have not changed since {self._since_s:.3f} s")


def _drive(
    robot: Hardware, command: Mapping[str, np.ndarray], step_s: float, every: int, silent_s: float, hold: int
) -> Followed:
    first = next(iter(command.values()))
    silence = _Silence(silent_s)
    start, now = robot.now_s(), 0.0
    stamps: list[float] = []
    sent: list[tuple[float, int]] = []
    torques: list[np.ndarray] = []
    readings: list[Mapping[str, np.ndarray]] = []
    trouble, late, latest_s = None, 0, 0.0
    for tick in range(len(first) * hold + 1):
        try:
            if tick:
                robot.wait_until_s(start + tick * step_s)
            now = float(robot.now_s() - start)
            behind = now - tick * step_s
            late, latest_s = late + int(behind > step_s), max(latest_s, behind)
            # A clock with few ticks may say the same twice; a row more would not be one.
            kept = tick % every == 0 and not (stamps and now <= stamps[-1])
            if kept:
                reading = _reading(robot, like=readings[0] if readings else None)
                stamps.append(now)
                readings.append(reading)
                if silence.noticed(now, reading, first[min(tick // hold, len(first) - 1)]):
                    trouble = silence.trouble(now)
                    break
            row, held = divmod(tick, hold)
            if row < len(first) and not held:
                robot.write({name: values[row] for name, values in command.items()})
                if kept:
                    sent.append((now, row))
                    if isinstance(robot, TorqueServo):
                        torques.append(robot.sent)
        except RobotStopped as error:
            trouble = Trouble("stopped", now, error.what)
            break
        except (TrueupError, OSError) as error:  # of a driver: lost connection, no answer
            trouble = Trouble("failed", now, " ".join(str(error).split()))
            break
        except BaseException:  # Ctrl-C
            _hold(robot, command, math.ceil(tick / hold))
            raise
    if trouble is not None and trouble.kind != "stopped":
        _hold(robot, command, math.ceil(tick / hold))
    measured = {name: np.array([reading[name] for reading in readings]) for name in (readings[0] if readings else {})}
    asked = {name: values[[row for _, row in sent]] for name, values in command.items()}
    if torques:
        asked["torque"] = np.array(torques)
    return Followed(
        _series(robot, stamps, measured),
        _series(robot, [stamp for stamp, _ in sent], asked),
        trouble,
        late,
        latest_s if late else 0.0,
    )


def _hold(robot: Hardware, command: Mapping[str, np.ndarray], sent: int) -> None:
    """Stay at the last position: the speed of a command that is broken off must not be followed any further."""
    last = {name: values[max(min(sent, len(values)) - 1, 0)] for name, values in command.items()}
    with contextlib.suppress(TrueupError, OSError):
        robot.write({name: values if name == "position" else np.zeros_like(values) for name, values in last.items()})


def _reading(robot: Hardware, like: Mapping[str, np.ndarray] | None) -> Mapping[str, np.ndarray]:
    """A reading to keep: a driver may fill the same arrays anew each time.

    Raises:
        DataError: not one value per joint, or other signals than before.
    """
    reading = {name: np.array(values, np.float64) for name, values in robot.read().items()}
    if like is not None and reading.keys() != like.keys():
        raise DataError("the robot reads other signals than before", got=list(reading), expected=list(like))
    for name, values in reading.items():
        if values.shape != (len(robot.joints),):
            raise DataError(f"a reading of {name!r} needs one value per joint", got=values, expected=robot.joints)
    return reading


def _execute(
    robot: TrajectoryIO, command: Mapping[str, np.ndarray], step_s: float, every: int, silent_s: float, hold: int
) -> Followed:
    repeat = own_steps(robot, step_s)
    first, start = next(iter(command.values())), robot.now_s()
    try:
        done = robot.execute(
            {name: np.repeat(values, hold * repeat, axis=0) for name, values in command.items()}, every=every * repeat
        )
    except RobotStopped as error:
        return Followed(None, None, Trouble("stopped", 0.0, error.what))
    except (TrueupError, OSError) as error:
        return Followed(None, None, Trouble("failed", 0.0, " ".join(str(error).split())))
    stamps = (done.measured.time_s - start).tolist()
    trouble, end = None, len(stamps)
    if done.stopped_s is not None:
        trouble = Trouble("stopped", done.stopped_s - start, "the robot has stopped")
    silence = _Silence(silent_s)
    for row, stamp in enumerate(stamps):
        # Cameras go on seeing a robot that says nothing.
        reading = {name: values[row] for name, values in done.measured.signals.items() if not _of_bodies(name)}
        if silence.noticed(stamp, reading, first[min(row * every // hold, len(first) - 1)]):
            trouble, end = silence.trouble(stamp), row + 1
            break
    # What was written at the very end of a motion that was broken off did not reach the robot.
    last = len(first) if trouble is None else int(np.ceil(trouble.time_s / (hold * step_s) - _WHOLE))
    rows = np.arange(0, min(last, len(first)), every)
    measured = {name: values[:end] for name, values in done.measured.signals.items()}
    return Followed(
        _series(robot, stamps[:end], measured, done.measured.bodies),
        _series(robot, (rows * hold * step_s).tolist(), {name: values[rows] for name, values in command.items()}),
        trouble,
    )


def _of_bodies(signal: str) -> bool:
    return signal.startswith(BODY_PREFIX)


def _series(
    robot: Hardware, stamps: list[float], signals: Mapping[str, np.ndarray], bodies: tuple[str, ...] = ()
) -> TimeSeries | None:
    """The series, its clock rounded to the nanosecond: differences of clocks carry rounding errors."""
    if not stamps:
        return None
    unknown = [name for name in signals if name not in SI_UNIT]
    if unknown:
        raise DataError(f"the robot reads signals of unknown unit: {unknown}", hint=f"Known are {list(SI_UNIT)}.")
    units = {name: (SI_UNIT[name],) * len(bodies if _of_bodies(name) else robot.joints) for name in signals}
    return TimeSeries(np.round(stamps, 9), robot.joints, dict(signals), units, bodies)
