"""Bags that would unpack to far more than samples are refused before memory or disk is taken."""

import bz2
import resource

import lz4.frame
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from dataset.test_import_rosbag import ARRAY, ROS1, ROS2, START_NS, STEP_NS, array, fill
from trueup.dataset.importers import bag_unpacking, bagfile
from trueup.errors import DataError

PACK = {
    # The library's own, whoever has loaded the importer before.
    "zstd": (vars(bag_unpacking)["_ZSTD"].compress, bag_unpacking.unpack_zstd),
    "lz4": (lz4.frame.compress, bag_unpacking.unpack_lz4),
    "bz2": (bz2.compress, bag_unpacking.unpack_bz2),
}


@given(data=st.binary(max_size=2000), times=st.integers(1, 3), kind=st.sampled_from(sorted(PACK)))
def test_what_was_packed_comes_out(data, times, kind):
    pack, unpack = PACK[kind]
    assert unpack(pack(data) * times) == data * times


@pytest.mark.parametrize("kind", sorted(PACK))
def test_packed_data_that_end_too_soon_are_an_error(kind):
    pack, unpack = PACK[kind]
    with pytest.raises(ValueError, match="end too soon"):
        unpack(pack(bytes(range(256)) * 1000)[:-12])


@pytest.mark.parametrize("kind", ["zstd", "bz2"])
def test_a_bomb_takes_no_memory(kind):
    pack, unpack = PACK[kind]
    data = pack(bytes(1 << 20)) * 1000  # frames after each other: a gigabyte
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(DataError, match=r"unpack to more than 268435456: expected samples"):
        unpack(data)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 600_000  # kB


def messages(store, count, numbers):
    return [(START_NS + k * STEP_NS, array(store, np.zeros(numbers))) for k in range(count)]


def mcap(path, mode, storage, items):
    writer = Writer2(path, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        fill(writer, {"/command": (ARRAY, items)}, ROS2)
    return path


def bag_of(path, kind, count, numbers):
    if kind.startswith("ros1"):
        writer = Writer1(path)
        writer.set_compression(Writer1.CompressionFormat[kind.partition(" ")[2]])
        with writer:
            fill(writer, {"/command": (ARRAY, messages(ROS1, count, numbers))}, ROS1)
        return path
    mode, storage = {
        "chunks": (CompressionMode.STORAGE, StoragePlugin.MCAP),
        "messages": (CompressionMode.MESSAGE, StoragePlugin.SQLITE3),
        "files": (CompressionMode.FILE, StoragePlugin.SQLITE3),
    }[kind]
    return mcap(path, mode, storage, messages(ROS2, count, numbers))


@pytest.mark.parametrize("kind", ["chunks", "messages", "files", "ros1 BZ2", "ros1 LZ4"])
@pytest.mark.parametrize(("count", "numbers"), [(1, 500_000), (8, 100_000)], ids=["one message", "many"])
def test_bags_of_every_kind_are_refused(tmp_path, monkeypatch, kind, count, numbers):
    """One message of 4 MB of zeros, or eight of less than a megabyte each, where a megabyte is the limit."""
    path = bag_of(tmp_path / ("x.bag" if kind.startswith("ros1") else "x"), kind, count, numbers)
    with bagfile.open_bag(path) as bag:
        assert sum(len(raw) for _, _, raw in bag.messages(bag.topics)) > 4_000_000
    monkeypatch.setattr("trueup.core.unpacking.FEW_BYTES", 1 << 20)
    monkeypatch.setattr("trueup.core.unpacking.EXPANSION", 10)
    with (
        pytest.raises(DataError, match=r"unpack to more than .*expected samples, not one byte repeated"),
        bagfile.open_bag(path) as bag,
    ):
        for _ in bag.messages(bag.topics):
            pass
