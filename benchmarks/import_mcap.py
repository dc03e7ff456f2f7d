"""Import of 500,000 MCAP joint states against the bag library reading them: python -m benchmarks.import_mcap."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.table import Row, at_most, shown
from trueup.dataset.importers import rosbag
from trueup.dataset.importers.base import ImportOptions

MESSAGES = 500_000
REPEATS = 2
KIND = "sensor_msgs/msg/JointState"
START_NS = 1_700_000_000_000_000_000
STORE = get_typestore(Stores.ROS2_HUMBLE)


def write_bag(folder: Path, messages: int) -> None:
    """A topic of seven joints at 1 kHz with position, velocity and effort."""
    rng = np.random.default_rng(0)
    header, stamp, state = (STORE.types[name] for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", KIND))
    names = [f"panda_joint{number}" for number in range(1, 8)]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", KIND, typestore=STORE)
        for k in range(messages):
            now = START_NS + k * 1_000_000
            values = rng.normal(size=(3, 7))
            message = state(header(stamp(now // 10**9, now % 10**9), "base"), names, *values)
            writer.write(connection, now, STORE.serialize_cdr(message, KIND))


def iterate(folder: Path) -> None:
    """The bag library's iteration over raw messages."""
    with Reader(folder) as reader:
        for _ in reader.messages():
            pass


def iterate_and_deserialize(folder: Path) -> None:
    """The bag library's iteration with its deserializer."""
    with Reader(folder) as reader:
        for connection, _, raw in reader.messages():
            STORE.deserialize_cdr(raw, connection.msgtype)


def load(folder: Path) -> None:
    """Our import, hash and checks included."""
    episode = rosbag.scan(folder, ImportOptions()).episodes[0].load()
    assert episode.measured["torque"].shape == (MESSAGES, 7)


def run() -> list[Row]:
    """Best of alternated runs in one process, on a file that is in the page cache."""
    runs: tuple[Callable[[Path], None], ...] = (load, iterate_and_deserialize, iterate)
    best = dict.fromkeys(runs, np.inf)
    with tempfile.TemporaryDirectory() as folder:
        write_bag(Path(folder) / "bag", MESSAGES)
        for _ in range(REPEATS):
            for run in runs:
                start = time.perf_counter()
                run(Path(folder) / "bag")
                best[run] = min(best[run], time.perf_counter() - start)
    limit = best[iterate_and_deserialize]
    return [
        at_most(f"import {MESSAGES} MCAP joint states (limit: rosbags, deserialized)", best[load], limit, "s"),
        shown("  rosbags, raw iteration only", best[iterate], "s"),
    ]
