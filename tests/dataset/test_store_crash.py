"""Killed writers, cut journals, full disks: what was finished is there, what was not is not."""

import contextlib
import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dataset.store_cases import INFO, make_episode, same_episode
from trueup.dataset import Dataset, DatasetWriter, RunWriter, append, journal, shards
from trueup.errors import DataError

EPISODES = 7


def assert_prefix(path, count):
    dataset = Dataset(path)
    assert dataset.ids == tuple(make_episode(number).id for number in range(count))
    assert all(same_episode(episode, make_episode(number)) for number, episode in enumerate(dataset))


def complete(path, total):
    """Resume and write what is missing, as an import does; the result is that of an uninterrupted one."""
    with DatasetWriter.resume(path, INFO) as writer:
        for number in range(total):
            if make_episode(number).id not in writer.ids:
                writer.append(make_episode(number))
    assert_prefix(path, total)
    assert not (path / "journal.bin").exists()
    assert not list(path.rglob("*.tmp"))


class Killed(BaseException):
    """Stands for a kill at a chosen point: nothing of ours catches it."""


def die_writing(path, episodes=EPISODES):
    """Write and die with all episodes in the journal."""
    writer = DatasetWriter.create(path, INFO)
    for number in range(episodes):
        writer.append(make_episode(number))
    writer._store._lock.release()  # what the system does for a dead process
    return (path / "journal.bin").read_bytes()


@pytest.fixture(scope="module")
def whole_journal(tmp_path_factory):
    return die_writing(tmp_path_factory.mktemp("journal") / "d")


def frame_ends(data):
    """Byte after each frame, from the format's description alone."""
    ends, position = [], 8
    while position < len(data):
        position += 20 + int.from_bytes(data[position + 4 : position + 12], "little")
        ends.append(position)
    return ends


def dead_dataset(path, data):
    DatasetWriter.create(path, INFO).close()
    (path / "journal.bin").write_bytes(data)
    return path


def test_a_reader_sees_what_a_dead_writer_finished(tmp_path, whole_journal):
    path = dead_dataset(tmp_path / "d", whole_journal)
    assert not list((path / "measured").iterdir())
    assert_prefix(path, EPISODES)
    Dataset(path).set_splits({"e000": "test"})
    assert Dataset(path).splits == {"e000": "test"}
    assert len(Dataset(path)) == EPISODES


@settings(max_examples=25)
@given(st.data())
def test_any_cut_of_the_journal_leaves_the_finished_prefix(tmp_path_factory, whole_journal, data):
    ends = frame_ends(whole_journal)
    assert ends[-1] == len(whole_journal)
    near = st.sampled_from([8, *ends]).flatmap(lambda end: st.integers(max(0, end - 21), min(end + 21, ends[-1])))
    cut = data.draw(st.one_of(st.integers(0, len(whole_journal)), near))
    # A power cut may also leave zeros or rubbish where the last frame should be.
    tail = data.draw(st.sampled_from([b"", b"\0" * 100, b"\xabEPI" * 30]))
    finished = sum(end <= cut for end in ends)
    kept = whole_journal[:cut]
    path = dead_dataset(tmp_path_factory.mktemp("cut") / "d", kept + tail if cut >= 8 and cut < ends[-1] else kept)
    assert_prefix(path, finished)
    complete(path, EPISODES)


def test_half_written_files_of_the_dead_are_cleared_away(tmp_path):
    path = tmp_path / "d"
    with DatasetWriter.create(path, INFO) as writer:
        writer.append(make_episode(0))
    for left in (".dataset.json.ab12.tmp", ".episodes.parquet.ab12.tmp", "measured/.00001.parquet.ab12.tmp"):
        (path / left).write_text("half")
    complete(path, 2)


def test_damage_in_the_middle_is_said_and_stepped_over(tmp_path, whole_journal, caplog):
    ends = frame_ends(whole_journal)
    for position in (ends[1] + 2, ends[1] + 6, ends[1] + 300, 3):
        data = bytearray(whole_journal)
        data[position] ^= 0x10
        path = dead_dataset(tmp_path / str(position), bytes(data))
        with pytest.raises(DataError, match=r"journal\.bin is damaged") as caught:
            Dataset(path)
        assert "--resume" in str(caught.value)
        lost = set() if position == 3 else {"e002"}
        with DatasetWriter.resume(path, INFO) as writer:
            assert writer.ids == {f"e{number:03d}" for number in range(EPISODES)} - lost
            for missing in lost:
                writer.append(make_episode(int(missing[1:])))
        dataset = Dataset(path)
        assert len(dataset) == EPISODES
        assert all(same_episode(dataset[make_episode(number).id], make_episode(number)) for number in range(EPISODES))
    assert "stepped over damage" in caplog.text


STEPS = [
    ("shard", append, "write_shard", 0),
    ("second shard", append, "write_shard", 1),
    ("index", append, "write_index", 0),
    ("journal removal", journal.Journal, "remove", 0),
    ("second flush", append, "write_shard", 3),
    ("second index", append, "write_index", 1),
    ("second removal", journal.Journal, "remove", 1),
]


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize(("name", "owner", "function", "nth"), STEPS, ids=[step[0] for step in STEPS])
def test_dying_between_any_two_steps_loses_and_doubles_nothing(
    tmp_path, monkeypatch, name, owner, function, nth, before
):
    monkeypatch.setattr(shards, "MAX_EPISODES", 3)
    monkeypatch.setattr(append, "MAX_PENDING", 3)
    original, calls = getattr(owner, function), []

    def dying(*arguments):
        calls.append(name)
        if len(calls) != nth + 1:
            return original(*arguments)
        if not before:
            original(*arguments)
        raise Killed

    path = tmp_path / "d"
    writer = DatasetWriter.create(path, INFO)
    finished = 0
    with monkeypatch.context() as patch:
        patch.setattr(owner, function, dying)
        with contextlib.suppress(Killed):
            for number in range(EPISODES):
                finished = number + 1  # a killed append has its frame in the journal
                writer.append(make_episode(number))
        assert len(calls) == nth + 1
    writer._store._lock.release()
    assert_prefix(path, finished)
    complete(path, EPISODES)


def test_dying_while_a_small_shard_is_merged(tmp_path, monkeypatch):
    for function in ("write_shard", "write_index"):
        path = tmp_path / function
        with DatasetWriter.create(path, INFO) as writer:
            writer.append(make_episode(0))
        original = getattr(append, function)

        def dying(*arguments, original=original):
            original(*arguments)
            raise Killed

        writer = DatasetWriter.resume(path)
        writer.append(make_episode(1))
        with monkeypatch.context() as patch:
            patch.setattr(append, function, dying)
            with pytest.raises(Killed):
                writer.close()
        assert_prefix(path, 2)
        complete(path, 3)
        assert len(list((path / "measured").iterdir())) == 1


WRITE_FOREVER = """
import sys
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from dataset.store_cases import INFO, make_episode
from trueup.dataset import DatasetWriter, append
append.MAX_PENDING = 20
with DatasetWriter.resume(Path(sys.argv[1]), INFO) as writer:
    for number in range(len(writer.ids), 100_000):
        writer.append(make_episode(number))
        print(number, flush=True)
"""


@pytest.mark.long
def test_kill_9(tmp_path):
    """A real kill, again and again, at moments that no test chose; the lock of the dead blocks nobody."""
    path = tmp_path / "d"
    command = [sys.executable, "-c", WRITE_FOREVER, str(path), str(Path(__file__).parent.parent)]
    finished = 0
    for delay_s in (0.05, 0.15):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        process.stdout.readline()
        with pytest.raises(DataError, match="another process"):
            DatasetWriter.resume(path)
        time.sleep(delay_s)
        process.send_signal(signal.SIGKILL)
        said = process.communicate()[0].split()
        finished = max([finished, *(int(number) + 1 for number in said)])
        dataset = Dataset(path)
        # The one in progress may have been finished just before its number was printed.
        assert finished <= len(dataset) <= finished + 1
        finished = len(dataset)
        assert_prefix(path, finished)
    assert finished > 20
    complete(path, finished + 5)


FILL = """
import resource, sys
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from dataset.store_cases import INFO, make_episode
from trueup.dataset import DatasetWriter
from trueup.errors import DataError
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), int(sys.argv[3])))
try:
    with DatasetWriter.resume(Path(sys.argv[1]), INFO) as writer:
        for number in range(1000):
            writer.append(make_episode(number))
            print(number, flush=True)
except DataError as error:
    print(str(error).replace("\\n", " "), file=sys.stderr)
    sys.exit(error.exit_code)
"""


@pytest.mark.parametrize("limit", [10, 50_000])
def test_no_room_for_the_journal(tmp_path, limit):
    path = tmp_path / "d"
    DatasetWriter.create(path, INFO).close()
    command = [sys.executable, "-c", FILL, str(path), str(Path(__file__).parent.parent), str(limit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert "cannot write" in done.stderr
    assert "Traceback" not in done.stderr
    finished = len(done.stdout.split())
    assert (finished > 0) == (limit == 50_000)
    assert_prefix(path, finished)
    complete(path, finished + 3)


def full_disk(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("target", ["pyarrow.parquet.ParquetWriter.write_table", "pyarrow.parquet.write_table"])
def test_no_room_for_shards_or_index(tmp_path, monkeypatch, target):
    path = tmp_path / "d"
    writer = DatasetWriter.create(path, INFO)
    for number in range(5):
        writer.append(make_episode(number))
    with monkeypatch.context() as patch:
        patch.setattr(target, full_disk)
        with pytest.raises(DataError, match="No space left"):
            writer.close()
    assert_prefix(path, 5)
    complete(path, 6)


def test_a_torn_frame_does_not_hide_later_ones(tmp_path, monkeypatch):
    """The disk was full for one episode only: the ones after it count."""
    path = tmp_path / "d"
    original = os.write
    with DatasetWriter.create(path, INFO) as writer:
        writer.append(make_episode(0))

        def half(descriptor, data):
            if len(data) > 1000:
                original(descriptor, data[:500])
                full_disk()
            return original(descriptor, data)

        with monkeypatch.context() as patch:
            patch.setattr(os, "write", half)
            with pytest.raises(DataError, match=r"cannot write.*journal\.bin.*No space left"):
                writer.append(make_episode(1))
        assert_prefix(path, 1)
        writer.append(make_episode(1))
        writer.append(make_episode(2))
        assert_prefix(path, 3)
    assert_prefix(path, 3)


def test_a_run_survives_too(tmp_path, whole_journal):
    path = dead_dataset(tmp_path / "d", whole_journal)
    run = RunWriter(path, "mujoco/stock", run_info={})
    for number in range(3):
        run.append(f"e{number:03d}", make_episode(number).measured)
    run._store._lock.release()
    journal_path = path / "simulated" / "mujoco" / "stock" / "journal.bin"
    journal_path.write_bytes(journal_path.read_bytes()[:-7])
    assert Dataset(path).run_ids("mujoco/stock") == ("e000", "e001")
    with RunWriter(path, "mujoco/stock", run_info={}, resume=True) as run:
        assert run.ids == {"e000", "e001"}
        run.append("e002", make_episode(2).measured)
    assert len(Dataset(path).run_ids("mujoco/stock")) == 3


def files_of(path):
    return {file.relative_to(path).as_posix(): file.read_bytes() for file in path.rglob("*") if file.is_file()}


@pytest.mark.parametrize("how", ["killed", "an error"])
def test_an_interrupted_dataset_becomes_the_same_files(tmp_path, monkeypatch, how):
    """Shards begin and end where they would have, wherever writing was interrupted, and however often."""
    monkeypatch.setattr(append, "MAX_PENDING", 5)
    with DatasetWriter.create(tmp_path / "whole", INFO) as writer:
        for number in range(17):
            writer.append(make_episode(number))
    assert len(list((tmp_path / "whole" / "measured").iterdir())) > 1
    for first in range(1, 17, 3):
        path = tmp_path / f"{first}"
        for stop in (first, first + 1, 17):
            with contextlib.suppress(KeyboardInterrupt), DatasetWriter.resume(path, INFO) as writer:
                for number in range(len(writer.ids), stop):
                    writer.append(make_episode(number))
                if stop < 17 and how == "an error":
                    raise KeyboardInterrupt
                if stop < 17:
                    writer.release()  # the system does so for a dead process
                    with (path / "journal.bin").open("ab") as torn:
                        torn.write(b"\xabEPI half a frame")
        assert files_of(path) == files_of(tmp_path / "whole")


@pytest.mark.parametrize("gone", ["moved", "deleted", "replaced"])
@pytest.mark.parametrize("when", ["before an episode", "before the end"])
def test_a_folder_that_goes_meanwhile_is_told(tmp_path, gone, when):
    path = tmp_path / "data"
    writer = DatasetWriter.create(path, INFO)
    writer.append(make_episode(1))
    path.rename(tmp_path / "elsewhere")
    if gone == "deleted":
        shutil.rmtree(tmp_path / "elsewhere")
    if gone == "replaced":
        with DatasetWriter.create(path, INFO) as other:
            other.append(make_episode(2))
    with pytest.raises(DataError, match="was moved or deleted"):
        writer.append(make_episode(3)) if when == "before an episode" else writer.close()
    writer.release()
    if gone == "moved":
        # Nothing that was written is lost.
        with DatasetWriter.resume(tmp_path / "elsewhere") as resumed:
            assert list(resumed.ids) == ["e001"]
    assert path.exists() == (gone == "replaced")
