"""One ROS bag: open it, list its topics, read messages; every failure of the bag library becomes a DataError."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2

from trueup.core.atomic import regular
from trueup.dataset.importers import bag_unpacking, bagjson
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
    TRAJECTORY,
    other_fields,
    store_for,
)
from trueup.dataset.importers.files import inside
from trueup.errors import ConfigError, DataError, FormatError, TrueupError

# What holds both what a controller was told and what it saw.
_BOTH = (CONTROLLER_STATE, *FEEDBACKS)
_MEASURED = (JOINT_STATE, DYNAMIC_STATE, *LOW_STATES, *_BOTH)
_STREAMS = (JOINT_STATE, ARRAY, TRAJECTORY, *LOW_COMMANDS)
_COMMANDS = (*_STREAMS, NUMBER, *_BOTH, GOAL)
_BY_LAST_NAME = {
    kind.rpartition("/")[2]: kind for kind in (*_STREAMS, DYNAMIC_STATE, NUMBER, CONTROLLER_STATE, IMU)[::-1]
}
_LOW_STATE_NAMES = ("/lowstate", "rt/lowstate", "/rt/lowstate")
FILE_SUFFIXES = (".bag", ".mcap", ".db3")
_METADATA, _BEGIN = "metadata.yaml", b"#ROSBAG V"
bag_unpacking.guard()
_REPAIR = {
    ".bag": "Repair it with `rosbag reindex FILE`, then import it again.",
    ".mcap": "Recover what is readable with `mcap recover FILE -o FIXED.mcap`, then import that.",
    ".db3": "Recover what is readable with `sqlite3 FILE .recover | sqlite3 FIXED.db3`, then import that.",
    "": "Rebuild its metadata with `ros2 bag reindex FOLDER`, then import it again.",
}


@dataclass(frozen=True)
class Topic:
    """A topic of a bag; several publishers give several connections."""

    name: str
    type: str
    count: int

    def __str__(self) -> str:
        """For lists in error messages."""
        return f"{self.name} ({self.type.replace('/msg/', '/')}, {self.count} messages)"


class Bag:
    """An open bag. Made by `open_bag`."""

    def __init__(self, reader: Reader1 | Reader2, source: str, packed: int) -> None:
        self._reader, self._packed = reader, packed
        self.source = source
        self.ros1 = isinstance(reader, Reader1)
        self._all = [bagjson.named_in_full(connection, _BY_LAST_NAME) for connection in reader.connections]
        self.types, self._wrong = store_for(self._all, ros1=self.ros1, source=source)
        by_topic: dict[tuple[str, str], int] = {}
        for connection in self._all:
            key = (connection.topic, connection.msgtype)
            by_topic[key] = by_topic.get(key, 0) + connection.msgcount
        self.topics = tuple(Topic(name, kind, count) for (name, kind), count in sorted(by_topic.items()))

    def deserializer(self, kind: str) -> Callable[[bytes], Any]:
        """The function that turns the bytes of one message of this type into an object.

        Raises:
            FormatError: the bag has another type of this name, or does not say which version it has.
        """
        if kind in self._wrong:
            raise self._wrong[kind]
        if self.ros1:
            return lambda raw: self.types.deserialize_ros1(raw, kind)
        # The other encoding begins with a zero.
        return lambda raw: (
            bagjson.message(raw, kind, self.types) if raw[:1] == b"{" else self.types.deserialize_cdr(raw, kind)
        )

    def sensors(self) -> tuple[Topic, ...]:
        """Topics of inertial sensors, as far as their type is that of ROS."""
        found = [topic for topic in self.topics if topic.type == IMU and topic.count]
        return tuple(
            topic
            for topic in found
            if all(other_fields(connection, self.types) is None for connection in self._connections([topic]))
        )

    def publishers(self, topic: Topic) -> tuple[str, ...]:
        """Who published the topic, as far as the bag knows (ROS 1 only)."""
        callers = (getattr(connection.ext, "callerid", None) for connection in self._connections([topic]))
        return tuple(sorted({str(caller) for caller in callers if caller}))

    def messages(self, topics: Sequence[Topic]) -> Iterator[tuple[str, int, bytes]]:
        """Topic name, time of recording [ns] and bytes of every message, in the order of recording.

        Raises:
            FormatError: a type of these topics is not the one of that name in ROS.
            DataError: they are far more than the bag's bytes.
        """
        connections, unpacked = self._connections(topics), 0
        for connection in connections:
            self._check_definition(connection)
        for connection, log_ns, raw in self._reader.messages(connections=connections):
            unpacked += len(raw)
            bag_unpacking.refuse_more(unpacked, self._packed)
            yield connection.topic, log_ns, raw

    def _connections(self, topics: Sequence[Topic]) -> list[Connection]:
        wanted = {(topic.name, topic.type) for topic in topics}
        return [item for item in self._all if (item.topic, item.msgtype) in wanted]

    def _check_definition(self, connection: Connection) -> None:
        other = other_fields(connection, self.types)
        if other is not None:
            raise FormatError(
                f"{self.source}: {connection.topic} has a type of its own called {connection.msgtype}",
                got=other[0],
                expected=other[1],
            )


@contextlib.contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a `.bag`, `.mcap` or `.db3` file, or a rosbag2 folder, for reading.

    Raises:
        DataError: the bag is empty, truncated or corrupt, also while it is read inside the `with` block.
    """
    try:
        _refuse_other_bytes(path)
        with Reader1(path) if path.suffix == ".bag" else Reader2(path) as reader:
            yield Bag(reader, path.name, sum(file.stat().st_size for file in bag_files(path)))
    except TrueupError:
        raise
    except Exception as error:  # the reader lets errors of many kinds through when bytes are damaged
        suffix = path.suffix if path.is_file() else ""
        raise DataError(
            f"{path} cannot be read as a bag", got=str(error) or type(error).__name__, hint=_REPAIR[suffix]
        ) from error


def _refuse_other_bytes(path: Path) -> None:
    """The library takes the first line of a `.bag` into memory, which of other files can be all of it.

    Raises:
        ValueError: the file does not begin as a bag does.
    """
    if path.suffix == ".bag":
        with path.open("rb") as file:
            begin = file.read(len(_BEGIN))
        if begin and begin != _BEGIN:
            raise ValueError("other bytes where a bag begins")


def is_bag(path: Path) -> bool:
    """Whether the path is a bag file, or a folder with a rosbag2 metadata file."""
    if path.is_dir():
        return (path / _METADATA).is_file()
    return path.suffix in FILE_SUFFIXES and path.is_file()


def find_bags(path: Path) -> tuple[Path, ...]:
    """All bags at or below a path, in a stable order; a rosbag2 folder is one bag.

    Raises:
        DataError: a folder cannot be read, or a link leads out of it.
    """
    if is_bag(path):
        return (path,)
    if not path.is_dir():
        return ()
    found: list[Path] = []
    try:
        for child in sorted(path.iterdir()):
            if not child.name.startswith(".") and (child.is_dir() or child.suffix in FILE_SUFFIXES):
                found += find_bags(inside(path, child))
    except OSError as error:
        raise DataError(f"cannot read the folder {path}", got=error.strerror or str(error)) from error
    return tuple(found)


def bag_files(path: Path) -> tuple[Path, ...]:
    """The files that make up a bag.

    Raises:
        DataError: a link leads out of the bag's folder; a pipe or a device.
    """
    if not path.is_dir():
        return (path,)
    return tuple(
        inside(path, regular(child)) for child in sorted(path.iterdir()) if child.exists() and not child.is_dir()
    )


def choose_measured(topics: Sequence[Topic], asked: str | None, source: str) -> Topic:
    """The topic of the measured joint states.

    The one asked for; else the only joint state topic that does not sound like a command; else `/joint_states`; else
    the only one of another kind that says what was measured, `/lowstate` if there are several.

    Raises:
        ConfigError: the topic asked for is not there or of another type, or the choice is open.
    """
    if asked is not None:
        return _asked(topics, asked, _MEASURED, source)
    states = [topic for topic in topics if topic.type == JOINT_STATE]
    candidates = _with_messages([topic for topic in states if not _sounds_like_command(topic)])
    if len(candidates) != 1:
        candidates = [topic for topic in states if topic.name == "/joint_states"] or candidates
    for kinds in ((DYNAMIC_STATE,), LOW_STATES, (CONTROLLER_STATE,), FEEDBACKS):
        candidates = candidates or _with_messages([topic for topic in topics if topic.type in kinds])
    # Unitree's robots say the same once more, less often, as lf/lowstate.
    candidates = [topic for topic in candidates if topic.name in _LOW_STATE_NAMES] or candidates
    if len(candidates) != 1:
        raise ConfigError(
            f"{source}: the measured topic is not clear" if candidates else f"{source} has no joint states to import",
            available=topics,
            hint="Name a topic of joint states or of a controller's state with --measured-topic.",
        )
    return candidates[0]


def choose_command(topics: Sequence[Topic], asked: str | None, measured: Topic, source: str) -> tuple[Topic, ...]:
    """The topic of the commands, or several of one joint each; none if the bag has none.

    The one asked for; else the only one that sounds like a command, holds trajectories or is Unitree's; else all
    numbers that sound like commands; else the reference in a controller's state, or in the feedback of its action;
    else the goals of that.

    Raises:
        ConfigError: the topic asked for is not there or of another type, or the choice is open.
    """
    if asked == measured.name and measured.type not in _BOTH:
        raise ConfigError(f"{source}: {asked} cannot be both command and measured", available=topics)
    if asked is not None:
        return (_asked(topics, asked, _COMMANDS, source),)
    there = [topic for topic in topics if topic.count]
    streams = [
        topic
        for topic in there
        if topic.type in _STREAMS
        and topic != measured
        and (topic.type in (TRAJECTORY, *LOW_COMMANDS) or _sounds_like_command(topic))
    ]
    numbers = [topic for topic in there if topic.type == NUMBER and _sounds_like_command(topic)]
    if numbers and not streams:
        return tuple(numbers)
    others = [[topic for topic in there if topic.type in kinds] for kinds in ((CONTROLLER_STATE,), FEEDBACKS, (GOAL,))]
    found = next((group for group in (streams, *others) if group), [])
    if len(found) > 1:
        raise ConfigError(
            f"{source}: the command topic is not clear",
            available=[topic for group in (streams, *others) for topic in group],
            hint="Name one of them with --command-topic.",
        )
    return tuple(found)


def no_command(topics: Sequence[Topic], measured: Topic) -> str:
    """That a bag has none, with topics of other types that may be about it, and what to record."""
    words = ("action", "goal", "trajectory")
    known = (*_MEASURED, *_COMMANDS)
    others = [
        topic
        for topic in topics
        if topic.count
        and topic.type not in known
        and (_sounds_like_command(topic) or any(word in topic.name.lower() for word in words))
    ]
    told = "command: none found in the bag"
    if others:
        told += f"; of types that are not read: {', '.join(map(str, others))}"
    if measured.type in LOW_STATES:
        told += f"; record LowCmd ({measured.name.replace('state', 'cmd')}) beside {measured.name}"
    elif any("_action/" in topic.name for topic in others):
        told += "; record the action's feedback (…/_action/feedback), which says what the controller was told"
    return told


def _asked(topics: Sequence[Topic], name: str, kinds: Sequence[str], source: str) -> Topic:
    same = [topic for topic in topics if topic.name == name]
    usable = [topic for topic in same if topic.type in kinds]
    if not usable:
        what = f"topic {name} of {source} is of a type that cannot be used" if same else f"{source} has no topic {name}"
        expected = " or ".join(kind.replace("/msg/", "/") for kind in kinds)
        raise ConfigError(what, got=same[0].type if same else None, expected=expected, available=topics)
    return usable[0]


def _with_messages(topics: list[Topic]) -> list[Topic]:
    return [topic for topic in topics if topic.count] or topics


def _sounds_like_command(topic: Topic) -> bool:
    return any(word in topic.name.lower() for word in ("command", "desired", "cmd", "target", "setpoint", "reference"))
