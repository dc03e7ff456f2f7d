"""Topics of a bag, read in one pass: joint states, trajectories, and arrays whose joints the user states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from trueup.core.episode import Flag
from trueup.dataset.importers.bagfile import ARRAY, JOINT_STATE, Bag, Topic
from trueup.dataset.importers.jointstate import JointStateDecoder
from trueup.dataset.importers.samples import NS_PER_S, Collector, Samples, stamp_ns
from trueup.dataset.importers.stated import Stated
from trueup.errors import ConfigError


def read_topics(bag: Bag, topics: Sequence[Topic], stated: Stated) -> tuple[list[list[Samples]], tuple[Flag, ...]]:
    """The samples of the measured topic and of the command's, if there is one, in one pass over the bag.

    Raises:
        ConfigError: arrays carry no joint names and the user stated none, or another number of them.
        DataError: a message is ragged.
    """
    finish: list[Callable[[], list[Samples]]] = []
    push: dict[str, Callable[[int, bytes], None]] = {}
    flags: list[Flag] = []
    for topic, series in zip(topics, ("measured", "command"), strict=False):
        source = f"{bag.source}, {topic.name}"
        joints = stated.joints.get("", ())
        if series == "command":
            joints = stated.command_joints or joints
        deserialize = bag.deserializer(topic.type)
        if topic.type == JOINT_STATE:
            decoder = JointStateDecoder(deserialize, source, ros1=bag.ros1, joints=joints)
            push[topic.name] = decoder.push
            finish.append(decoder.samples)
        else:
            messages: list[tuple[int, Any]] = []
            push[topic.name] = partial(_keep_message, messages, deserialize)
            if topic.type == ARRAY:
                signal = stated.command_signal or _signal(topic)
                finish.append(partial(_array_samples, messages, source, joints, signal))
                detail = f"the arrays of {topic.name} are taken as {signal} of {', '.join(joints)}"
                flags.append(Flag(kind="array", series=series, detail=detail, severity="note"))
            else:
                finish.append(partial(_trajectory_samples, messages, source))
                detail = "trajectory points as sent; between them a controller interpolates, it does not hold"
                flags.append(Flag(kind="trajectory", series=series, detail=detail, severity="note"))
        publishers = bag.publishers(topic)
        if len(publishers) > 1:
            detail = f"{topic.name} was published by {', '.join(publishers)}"
            flags.append(Flag(kind="publishers", series=series, detail=detail, severity="note"))
    for name, log_ns, raw in bag.messages(topics):
        push[name](log_ns, raw)
    return [done() for done in finish], tuple(flags)


def _keep_message(
    messages: list[tuple[int, Any]], deserialize: Callable[[bytes], Any], log_ns: int, raw: bytes
) -> None:
    messages.append((log_ns, deserialize(raw)))


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
        raise ConfigError(
            f"{source} does not fit the stated joints" if joints else f"{source} carries no joint names",
            got=f"{len(messages)} arrays of {' or '.join(map(str, widths))} values",
            expected=f"{len(joints)} values for {list(joints)}" if joints else None,
            hint=f"State them, in the array's order, in the file given with --mapping: `command_joints: [{example}]`.",
        )
    if not messages:
        return []
    log_ns = np.array([log for log, _ in messages], dtype=np.int64)
    values = np.array([message.data for _, message in messages], dtype=np.float64)
    return [Samples(tuple(joints), np.arange(log_ns.size), np.zeros_like(log_ns), log_ns, {signal: values})]


def _trajectory_samples(messages: Sequence[tuple[int, Any]], source: str) -> list[Samples]:
    """The points of trajectories, each at its own time; a trajectory replaces what was planned after its start."""
    planned: list[tuple[int, int, Sequence[str], Any]] = []
    for log_ns, message in messages:
        start = stamp_ns(message.header) or log_ns  # a stamp of zero means "now"
        while planned and planned[-1][0] >= start:
            planned.pop()
        for point in message.points:
            delay_ns = int(point.time_from_start.sec) * NS_PER_S + int(point.time_from_start.nanosec)
            planned.append((start + delay_ns, log_ns + delay_ns, tuple(message.joint_names), point))
    collector = Collector(source)
    for number, (stamp, log_ns, names, point) in enumerate(planned):
        fields = {
            "position": point.positions,
            "velocity": point.velocities,
            "acceleration": point.accelerations,
            "torque": point.effort,
        }
        arrays = {signal: np.asarray(values, dtype=np.float64)[np.newaxis] for signal, values in fields.items()}
        collector.keep(names, arrays, np.array([number]), np.array([stamp]), np.array([log_ns]))
    return collector.samples()
