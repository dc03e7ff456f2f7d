"""Topics of a bag, read in one pass: joint states, trajectories, motors, and arrays whose joints the user states."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trueup.core.episode import Flag
from trueup.dataset.importers.bagfile import Bag, Topic
from trueup.dataset.importers.bagtypes import (
    ARRAY,
    CONTROLLER_STATE,
    DYNAMIC_STATE,
    FEEDBACKS,
    GOAL,
    IMU,
    JOINT_STATE,
    LOW_COMMANDS,
    LOW_STATES,
    NUMBER,
)
from trueup.dataset.importers.imu import Readings, readings
from trueup.dataset.importers.jointstate import JointStateDecoder
from trueup.dataset.importers.samples import NS_PER_S, Collector, Samples, stamp_ns
from trueup.dataset.importers.stated import Stated, UnnamedCommand
from trueup.dataset.importers.unitree import MotorDecoder
from trueup.errors import ConfigError


@dataclass(frozen=True, eq=False)
class TopicsRead:
    """What was read.

    Attributes:
        groups: the samples of the measured topic and, if there is one, of the command's.
        flags: what was noticed.
        kp_setting: of the drives' position gain, if the messages say one for all joints.
        sensors: what inertial sensors read.
    """

    groups: list[list[Samples]]
    flags: tuple[Flag, ...]
    kp_setting: float | None
    sensors: tuple[Readings, ...] = ()


def read_topics(bag: Bag, measured: Topic, commands: Sequence[Topic], stated: Stated) -> TopicsRead:
    """The samples of the measured topic, of the command's, if there is one, and of inertial sensors, in one pass.

    Raises:
        ConfigError: arrays carry no joint names and the user stated none, or another number of them.
        DataError: a message is ragged.
    """
    readers: dict[str, list[_Reader]] = {}
    for topic, side in ((measured, "measured"), *((topic, "command") for topic in commands)):
        readers.setdefault(topic.name, []).append(_Reader(bag, topic, side, stated))
    sensed, imu = bag.sensors(), bag.deserializer(IMU)
    sensors: dict[str, list[tuple[int, Any]]] = {topic.name: [] for topic in sensed}
    for name, log_ns, raw in bag.messages(list(dict.fromkeys((measured, *commands, *sensed)))):
        for reader in readers.get(name, ()):
            reader.push(log_ns, raw)
        if name in sensors:
            sensors[name].append((log_ns, imu(raw)))
    every = [reader for own in readers.values() for reader in own]
    first = next(reader for reader in every if reader.side == "measured").samples(())
    groups, names = [first], tuple(dict.fromkeys(name for samples in first for name in samples.joints))
    if commands:
        told = [samples for reader in every if reader.side == "command" for samples in reader.samples(names)]
        groups.append(_together(told) if len(commands) > 1 else told)
    return TopicsRead(
        groups,
        tuple(flag for reader in every for flag in reader.flags),
        next((reader.kp_setting for reader in every if reader.kp_setting is not None), None),
        tuple(own for name, messages in sensors.items() if (own := readings(name, messages)) is not None),
    )


def _together(each: Sequence[Samples]) -> list[Samples]:
    """Joints that are told by messages of their own, as rows of all: each when the last of them arrives."""
    if len(each) < 2 or len({tuple(samples.signals) for samples in each}) > 1:
        return list(each)
    last = max(each, key=lambda samples: (samples.log_ns.size, int(samples.log_ns[0])))
    rows = [np.searchsorted(samples.log_ns, last.log_ns, side="right") - 1 for samples in each]
    told = np.all([own >= 0 for own in rows], axis=0)
    signals = {
        signal: np.concatenate(
            [samples.signals[signal][own[told]] for samples, own in zip(each, rows, strict=True)], axis=1
        )
        for signal in last.signals
    }
    joints = tuple(name for samples in each for name in samples.joints)
    return [Samples(joints, last.index[told], last.stamp_ns[told], last.log_ns[told], signals)]


class _Reader:
    """One topic, for one series."""

    def __init__(self, bag: Bag, topic: Topic, side: str, stated: Stated) -> None:
        self.side, self._topic, self._stated = side, topic, stated
        self._source = f"{bag.source}, {topic.name}"
        self._joints = stated.joints.get("", ())
        if side == "command":
            self._joints = stated.command_joints or self._joints
        self._deserialize = bag.deserializer(topic.type)
        self._messages: list[tuple[int, Any]] = []
        self._decoder: JointStateDecoder | MotorDecoder | None = None
        if topic.type == JOINT_STATE:
            self._decoder = JointStateDecoder(self._deserialize, self._source, ros1=bag.ros1, joints=self._joints)
        if topic.type in (*LOW_STATES, *LOW_COMMANDS):
            self._decoder = MotorDecoder(bag.types, topic.type, self._source, ros1=bag.ros1, joints=self._joints)
        self.flags: list[Flag] = []
        self.kp_setting: float | None = None
        publishers = bag.publishers(topic)
        if len(publishers) > 1:
            self.flags.append(
                Flag(
                    kind="publishers",
                    series=self.side,
                    detail=f"{topic.name} was published by {', '.join(publishers)}",
                    severity="note",
                )
            )

    def push(self, log_ns: int, raw: bytes) -> None:
        """Add one message."""
        if self._decoder is not None:
            self._decoder.push(log_ns, raw)
        else:
            self._messages.append((log_ns, self._deserialize(raw)))

    def samples(self, names: Sequence[str]) -> list[Samples]:
        """All messages.

        Args:
            names: of the measured joints, for topics that are called as one of them.

        Raises:
            ConfigError: nothing says which joints they are about.
            DataError: a message is ragged.
        """
        if isinstance(self._decoder, MotorDecoder):
            motors = self._decoder.samples(names)
            self.flags += motors.flags
            self.kp_setting = motors.kp_setting
            return motors.samples
        if self._decoder is not None:
            return self._decoder.samples()
        if self._topic.type == ARRAY:
            signal = self._stated.command_signal or _signal(self._topic)
            found = _array_samples(self._messages, self._source, self._joints, signal)
            self.flags.append(
                Flag(
                    kind="array",
                    series=self.side,
                    detail=f"the arrays of {self._topic.name} are taken as {signal} of {', '.join(self._joints)}",
                    severity="note",
                )
            )
            return found
        if self._topic.type == NUMBER:
            signal = self._stated.command_signal or _signal(self._topic)
            joint = _joint_of(self._topic.name, names, self._source)
            self.flags.append(
                Flag(
                    kind="array",
                    series=self.side,
                    detail=f"the numbers of {self._topic.name} are taken as {signal} of {joint}",
                    severity="note",
                )
            )
            return _array_samples(
                [(log, _Numbers([message.data])) for log, message in self._messages], self._source, [joint], signal
            )
        if self._topic.type == CONTROLLER_STATE:
            return _controller_samples(self._messages, self._source, self.side)
        if self._topic.type in FEEDBACKS:
            feedback = [(log_ns, message.feedback) for log_ns, message in self._messages]
            return _controller_samples(feedback, self._source, self.side)
        if self._topic.type == DYNAMIC_STATE:
            return _dynamic_samples(self._messages, self._source)
        # A trajectory's stamp of zero means "now": when its goal was sent, as far as the bag knows.
        if self._topic.type == GOAL:
            sent = [
                (log_ns, stamp_ns(message.header) or log_ns, message.goal.trajectory)
                for log_ns, message in self._messages
            ]
        else:
            sent = [(log_ns, log_ns, message) for log_ns, message in self._messages]
        found, detail = _trajectory_samples(sent, self._source)
        self.flags.append(Flag(kind="trajectory", series=self.side, detail=detail, severity="note"))
        return found


@dataclass(frozen=True)
class _Numbers:
    """As a message with an array."""

    data: Sequence[float]


def _joint_of(topic: str, names: Sequence[str], source: str) -> str:
    """The joint whose name stands in that of a topic, the longest if there are several.

    Raises:
        ConfigError: there is none.
    """
    parts = f"/{topic.strip('/').lower()}/"
    found = [name for name in names if re.search(rf"[/_]{re.escape(name.lower())}[/_]", parts)]
    if not found:
        raise ConfigError(
            f"{source}: no joint's name stands in that of the topic",
            available=names,
            hint="Record the joint states or the state of the controller beside it, or name another --command-topic.",
        )
    return max(found, key=len)


def _controller_samples(messages: Sequence[tuple[int, Any]], source: str, side: str) -> list[Samples]:
    """What a controller was told, or what it saw; both stand in one message."""
    collector = Collector(source)
    for number, (log_ns, message) in enumerate(messages):
        old, new = ("desired", "reference") if side == "command" else ("actual", "feedback")
        points = [getattr(message, field) for field in (new, old) if hasattr(message, field)]
        point = next(
            (own for own in points if len(own.positions) or len(own.velocities)), points[0] if points else None
        )
        if point is not None:
            _keep_point(collector, message.joint_names, point, number, stamp_ns(message.header), log_ns)
    return collector.samples()


_INTERFACES = {"position": "position", "velocity": "velocity", "effort": "torque", "acceleration": "acceleration"}


def _dynamic_samples(messages: Sequence[tuple[int, Any]], source: str) -> list[Samples]:
    """The interfaces of joints that are signals; a joint without one has NaN there."""
    collector = Collector(source)
    for number, (log_ns, message) in enumerate(messages):
        found: dict[str, list[float]] = {}
        rows = [dict(zip(own.interface_names, own.values, strict=False)) for own in message.interface_values]
        for interface, signal in _INTERFACES.items():
            if any(interface in row for row in rows):
                found[signal] = [float(row.get(interface, math.nan)) for row in rows]
        arrays = {signal: np.array([values]) for signal, values in found.items()}
        stamp = np.array([stamp_ns(message.header)])
        collector.keep(tuple(message.joint_names), arrays, np.array([number]), stamp, np.array([log_ns]))
    return collector.samples()


def _signal(topic: Topic) -> str:
    """What an array without names commands, from its topic's name."""
    name = topic.name.lower()
    if "effort" in name or "torque" in name:
        return "torque"
    return "velocity" if "velocity" in name else "position"


def _array_samples(
    messages: Sequence[tuple[int, Any]], source: str, joints: Sequence[str], signal: str
) -> list[Samples]:
    """Rows of a Float64MultiArray, whose joints only the user knows."""
    widths = sorted({len(message.data) for _, message in messages})
    if widths and widths != [len(joints)]:
        example = ", ".join(f"name{number}" for number in range(1, widths[-1] + 1))
        error = (ConfigError if joints or len(widths) > 1 else UnnamedCommand)(
            f"{source} does not fit the stated joints" if joints else f"{source} carries no joint names",
            got=f"{len(messages)} arrays of {' or '.join(map(str, widths))} values",
            expected=f"{len(joints)} values for {list(joints)}" if joints else None,
            hint=f"State them, in the array's order, in the file given with --mapping: `command_joints: [{example}]`.",
        )
        if isinstance(error, UnnamedCommand):
            error.count = widths[0]
        raise error
    if not messages:
        return []
    log_ns = np.array([log for log, _ in messages], dtype=np.int64)
    values = np.array([message.data for _, message in messages], dtype=np.float64)
    return [Samples(tuple(joints), np.arange(log_ns.size), np.zeros_like(log_ns), log_ns, {signal: values})]


# Messages of one point each that come about as fast as their points are due are set points of a controller that is
# served all the time.
_SERVED = 1.5


def _trajectory_samples(messages: Sequence[tuple[int, int, Any]], source: str) -> tuple[list[Samples], str]:
    """The points of trajectories, and how they are read.

    A trajectory replaces what was planned after its start. Points that are sent one at a time, as servoing nodes do,
    are set points from their arrival.

    Args:
        messages: time of recording [ns], time at which it was sent [ns], trajectory.
        source: file and topic, for error messages.
    """
    starts = [stamp_ns(message.header) or sent_ns for _, sent_ns, message in messages]
    single = [message.points[0] for _, _, message in messages if len(message.points) == 1]
    due = [_delay_ns(point) for point in single]
    apart = float(np.median(np.diff(starts))) if len(starts) > 2 else math.inf
    served = len(single) == len(messages) > 2 and (max(due) == 0 or apart <= _SERVED * float(np.median(due)))
    planned: list[tuple[int, int, Sequence[str], Any]] = []
    superseded = 0
    for start, (log_ns, _, message) in zip(starts, messages, strict=True):
        while not served and planned and planned[-1][0] >= start:
            planned.pop()
            superseded += 1
        for point in message.points:
            delay_ns = 0 if served else _delay_ns(point)
            planned.append((start + delay_ns, log_ns + delay_ns, tuple(message.joint_names), point))
    collector = Collector(source)
    for number, (stamp, log_ns, names, point) in enumerate(planned):
        _keep_point(collector, names, point, number, stamp, log_ns)
    detail = "trajectory points as sent; between them a controller interpolates, it does not hold"
    if served:
        detail = "points that were sent one at a time are set points from their arrival"
    if superseded:
        detail += f"; {superseded} points were superseded before they were due"
    return collector.samples(), detail


def _delay_ns(point: Any) -> int:
    return int(point.time_from_start.sec) * NS_PER_S + int(point.time_from_start.nanosec)


def _keep_point(collector: Collector, names: Sequence[str], point: Any, number: int, stamp: int, log_ns: int) -> None:
    fields = {
        "position": point.positions,
        "velocity": point.velocities,
        "acceleration": point.accelerations,
        "torque": point.effort,
    }
    arrays = {signal: np.asarray(values, dtype=np.float64)[np.newaxis] for signal, values in fields.items()}
    collector.keep(tuple(names), arrays, np.array([number]), np.array([stamp]), np.array([log_ns]))
