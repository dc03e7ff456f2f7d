"""What a network says to messages, one by one; nothing here knows how they came."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from trueup.deploy import Compensator, Status, Stream
from trueup.deploy.compensator import calls_per_step
from trueup.errors import ConfigError, MissingSignal
from trueup.ros2.joints import FIELDS, JointColumns
from trueup.ros2.messages import NS_PER_S, Float64MultiArray, JointState

Command = JointState | Float64MultiArray

# Messages that are passed on as they came.
UNTOUCHED = "not of these joints"
# Where a stamp lies this share of a message's period before it is due, it is the one that is due.
_EARLY = 0.5
# A rate says nothing of times in which nothing was to come [s].
_PAUSE_S = 1.0
# Where sensors have said nothing for so long, nobody knows where the robot is [s].
STALE_S = 0.1


@runtime_checkable
class Answer(Protocol):
    """Messages in, messages out.

    Attributes:
        counts: status -> messages answered with it, and `UNTOUCHED`.
        flags: `Why` of the network's step, as a plain number -> messages answered by it; those without one are not
            counted.
    """

    counts: Counter[str]
    flags: Counter[int]

    @property
    def others(self) -> tuple[str, ...]:
        """Joints of the last message that was not of the network's."""
        ...

    @property
    def rate_hz(self) -> float:
        """How often messages of the network's joints come, by their stamps [Hz]; NaN if nobody knows yet."""
        ...

    def to(self, message: JointState) -> Command | None:
        """What is published, None if nothing is."""
        ...


class _Stamps:
    """Seconds since the first message, by the stamps of messages, or by when they come where they have none.

    Stamps are counted in whole nanoseconds: seconds since 1970 as a float are 0.2 us apart.
    """

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._since_s = self._last_s = 0.0
        self._count = 0

    def of(self, message: JointState) -> float:
        """The time of a message [s]."""
        stamp_ns = message.header.stamp.ns or time.monotonic_ns()
        if self._first_ns is None:
            self._first_ns = stamp_ns
        time_s = (stamp_ns - self._first_ns) / NS_PER_S
        if not 0.0 <= time_s - self._last_s <= _PAUSE_S:  # a clock that was set back, or somebody who had left
            self._since_s, self._count = time_s, 0
        self._last_s = time_s
        self._count += 1
        return time_s

    @property
    def rate_hz(self) -> float:
        """Messages per second of their own time; NaN as long as there are none [Hz]."""
        seconds = self._last_s - self._since_s
        return (self._count - 1) / seconds if seconds > 0.0 else math.nan


class Heard:
    """What another topic said last of these joints.

    Args:
        joints: of the robot, in its order.
        signals: that a network reads.
        stale_s: what came longer ago is not known any more [s]; commands hold until there is another.

    Attributes:
        heard: messages of these joints that came.
        ignored: others, which say nothing of this robot.
    """

    def __init__(self, joints: Sequence[str], signals: Sequence[str], *, stale_s: float = np.inf) -> None:
        self._columns = JointColumns(joints)
        self._unknown = {signal: np.full(len(joints), np.nan) for signal in signals}
        self._values = dict(self._unknown)
        self._came_s, self._stale_s = -np.inf, stale_s
        self.heard = self.ignored = 0

    def hear(self, message: JointState) -> None:
        """Keep what it says of all joints; messages of others are none of this robot."""
        if read := self._columns.read(message):
            self._values, self._came_s = {**self._values, **read}, time.monotonic()
            self.heard += 1
        else:
            self.ignored += 1

    @property
    def others(self) -> tuple[str, ...]:
        """Joints of the last message that was of others."""
        return self._columns.others

    @property
    def values(self) -> dict[str, Float64[np.ndarray, "J"]]:
        """Signal -> values; NaN of what nobody has said."""
        known = self._stale_s == np.inf or time.monotonic() - self._came_s <= self._stale_s
        return self._values if known else self._unknown


class Augmented:
    """Joint states of a simulator, as the robot would have measured them (Realeasy, Fig. 1).

    Messages may come a whole number of times as often as the network was trained for: it sees every so many of them,
    by their stamps, and its correction is held in between. Those of other joints are passed on as they are, and so
    are these until there is a first answer: a subscriber finds on the one topic all that it found on the other.

    Args:
        stream: of a network that corrects joint states.
        message_hz: messages per second [Hz]; the network's rate if None.

    Attributes:
        counts: see `Answer`.
        flags: see `Answer`.
        command: what was commanded, for networks that read it.
        measured: what the robot's sensors say, likewise.

    Raises:
        ConfigError: the network corrects no joint states, or such a rate is no multiple of its own.
    """

    def __init__(self, stream: Stream, *, message_hz: float | None = None) -> None:
        card = stream.card
        corrected = dict.fromkeys((output.series, output.signal) for output in card.outputs)
        if other := [f"{series}.{name}" for series, name in corrected if series == "command" or name not in FIELDS]:
            raise ConfigError(f"model {card.name!r} corrects no joint states", got=other, expected=list(FIELDS))
        rate_hz = card.rate_hz if message_hz is None else message_hz
        every = calls_per_step(card, rate_hz)
        self._stream, self._columns = stream, JointColumns(card.joints)
        self._rows = {
            name: [card.joints.index(output.joint) for output in card.outputs if output.signal == name]
            for _, name in corrected
        }
        for name, rows in self._rows.items():  # a stream gives them in the robot's order of joints
            self._rows[name] = sorted(rows)
        of = {series: signals_read(stream, series) for series in ("simulated", "command", "measured")}
        self._reads = {*of["simulated"], *self._rows}
        self.command = Heard(card.joints, of["command"])
        self.measured = Heard(card.joints, of["measured"], stale_s=STALE_S)
        self.counts: Counter[str] = Counter()
        self.flags: Counter[int] = Counter()
        self._stamps = _Stamps()
        self._period_s, self._early_s = every / rate_hz, _EARLY / rate_hz
        self._all = every == 1
        self._due_s = self._before_s = -np.inf
        self._answered: dict[str, Float64[np.ndarray, "K"]] = {}
        self._correction: dict[str, Float64[np.ndarray, "K"]] | None = None

    def to(self, message: JointState) -> JointState:
        """The message that is published.

        Raises:
            MissingSignal: the first message with these joints lacks a signal that the network reads.
        """
        read = self._columns.read(message)
        if read is None or not self._reads <= read.keys():
            if read is not None and self.counts.total() == self.counts[UNTOUCHED]:
                raise MissingSignal(
                    f"model {self._stream.card.name!r} reads {sorted(self._reads - read.keys())} of joint states",
                    available=read,
                )
            self.counts[UNTOUCHED] += 1
            return message
        time_s = self._stamps.of(message)
        asked = self._is_due(time_s)
        if asked:
            self._ask(read, time_s)
        latest = self._stream.latest
        self.counts[latest.status.value] += 1
        if latest.flags:
            self.flags[latest.flags] += 1
        for name, rows in self._rows.items():
            if asked or self._correction is None:
                read[name][rows] = self._answered[name]
            else:
                read[name][rows] += self._correction[name]
        return self._columns.written(message, {name: read[name] for name in self._rows})

    @property
    def others(self) -> tuple[str, ...]:
        """See `Answer`."""
        return self._columns.others

    @property
    def rate_hz(self) -> float:
        """See `Answer`."""
        return self._stamps.rate_hz

    def _is_due(self, time_s: float) -> bool:
        """Whether the network sees this message: one per period of its own, wherever the first of them was."""
        before, self._before_s = self._before_s, time_s
        # A clock that was set back, or a gap: periods are counted from here.
        if self._all or time_s < before or time_s - self._due_s > self._period_s:
            self._due_s = time_s
        if time_s < self._due_s - self._early_s:
            return False
        self._due_s += self._period_s
        return True

    def _ask(self, read: dict[str, Float64[np.ndarray, "J"]], time_s: float) -> None:
        step = self._stream.step(read, self.command.values, self.measured.values, time_s=time_s)
        own = {name: read[name][rows] for name, rows in self._rows.items()}
        if math.isinf(step.age_s):  # nothing has ever been answered that could be held
            self._answered, self._correction = own, {name: np.zeros_like(values) for name, values in own.items()}
            return
        self._answered = {name: step[name].copy() for name in self._rows}
        # What is held is older than this message: nothing of it is to be added to one that comes until the next step.
        held = step.status is Status.HELD
        self._correction = None if held else {name: self._answered[name] - values for name, values in own.items()}


class Compensated:
    """Targets of a robot's joints, corrected by what the robot lacks (GapONet), within its limits.

    Where nobody has said for a while where the robot is, the correction fades out and the targets go on alone.

    Args:
        compensator: for these joints.
        form: of what is published: a `JointState` with positions, or a `Float64MultiArray` of them, in the joints'
            order, as the forward command controllers of ros2_control take it.

    Attributes:
        counts: see `Answer`.
        flags: see `Answer`.
        states: what the robot's sensors say.
    """

    def __init__(self, compensator: Compensator, *, form: type[Command] = JointState) -> None:
        joints = compensator.card.joints
        self._compensator, self._form = compensator, form
        self._targets = JointColumns(joints)
        self.states = Heard(joints, ("position", "velocity"), stale_s=STALE_S)
        self.counts: Counter[str] = Counter()
        self.flags: Counter[int] = Counter()
        self._stamps = _Stamps()

    def to(self, message: JointState) -> Command | None:
        """The command for a target; none for a message of other joints."""
        read = self._targets.read(message)
        if read is None or "position" not in read:
            self.counts[UNTOUCHED] += 1
            return None
        known = self.states.values
        answer = self._compensator.step(
            known["position"], known["velocity"], read["position"], time_s=self._stamps.of(message)
        )
        if answer.flags:
            self.flags[answer.flags] += 1
        if not np.isfinite(answer.target).all():
            self.counts[Status.HELD.value] += 1
            return None  # no joint may be commanded a number that nobody has ever said
        self.counts[answer.status.value] += 1
        if self._form is Float64MultiArray:
            return Float64MultiArray(data=answer.target.tolist())
        return self._targets.written(message, {"position": answer.target})

    @property
    def others(self) -> tuple[str, ...]:
        """See `Answer`."""
        return self._targets.others

    @property
    def rate_hz(self) -> float:
        """See `Answer`."""
        return self._stamps.rate_hz


def signals_read(stream: Stream | Compensator, series: str) -> list[str]:
    """Signals of a series that a network reads."""
    return list(dict.fromkeys(channel.signal for channel in stream.card.inputs if channel.series == series))
