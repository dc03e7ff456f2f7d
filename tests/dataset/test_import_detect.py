import os
import subprocess
import sys

import numpy as np
import pytest

from trueup.dataset.importers import detect
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.clock import common_origin, seconds, usable_clock
from trueup.dataset.importers.detect import FORMATS, find_importer, importer
from trueup.dataset.importers.files import episode_id, read_bytes
from trueup.errors import ConfigError, DataError, FormatError, MissingDependency, TrueupError


def sage_motion(folder):
    folder.mkdir(parents=True)
    (folder / "control.csv").write_text("type,timestamp,positions\n")
    (folder / "state_motor.csv").write_text("type,timestamp,positions,velocities,torques\n")


def test_formats_are_told_apart(tmp_path):
    sage_motion(tmp_path / "sage" / "wave")
    (tmp_path / "csv").mkdir()
    (tmp_path / "csv" / "x.csv").write_text("t,q\n")
    (tmp_path / "npz").mkdir()
    np.savez(tmp_path / "npz" / "x.npz", a=np.zeros(1))
    for name, place in (("sage", "sage"), ("table", "csv"), ("npz", "npz")):
        importer = find_importer(tmp_path / place)
        assert name == importer.NAME
    assert find_importer(tmp_path / "npz" / "x.npz").NAME == "npz"
    # A table beside recordings of another format does not make the folder a CSV recording.
    (tmp_path / "npz" / "notes.csv").write_text("a,b\n")
    assert find_importer(tmp_path / "npz").NAME == "npz"


def test_two_formats_in_one_folder_must_be_chosen_between(tmp_path):
    sage_motion(tmp_path / "wave")
    np.savez(tmp_path / "x.npz", a=np.zeros(1))
    with pytest.raises(FormatError, match=r"several formats.*available: sage, npz"):
        find_importer(tmp_path)
    assert find_importer(tmp_path, "npz").NAME == "npz"


def test_an_unknown_format_says_what_was_looked_for(tmp_path):
    (tmp_path / "notes.docx").write_text("x")
    with pytest.raises(FormatError) as caught:
        find_importer(tmp_path)
    message = str(caught.value)
    for part in ("notes.docx", *FORMATS, "docs/logs.md"):
        assert part in message
    for number in range(20):
        (tmp_path / f"{number}{'x' * 99}").write_text("x")
    with pytest.raises(FormatError) as caught:
        find_importer(tmp_path)
    lines = str(caught.value).replace(str(tmp_path), "LOGS").splitlines()
    assert len(lines) == 2
    assert max(map(len, lines)) <= 220


def test_what_is_empty_is_said_to_be(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    for name in ("folder", "file"):
        with pytest.raises(FormatError, match=rf"{name} is empty"):
            find_importer(tmp_path / name)


def test_a_named_format_wins_and_must_exist(tmp_path):
    assert find_importer(tmp_path, "csv").NAME == "table"
    with pytest.raises(ConfigError, match=r"'matlab'.*available: sage, lerobot, .*, table"):
        find_importer(tmp_path, "matlab")
    with pytest.raises(DataError, match="does not exist"):
        find_importer(tmp_path / "missing")


def test_an_importer_that_cannot_be_loaded_does_not_hurt_the_others(tmp_path, monkeypatch):
    monkeypatch.setattr(detect, "FORMATS", ("absent", "table"))
    (tmp_path / "x.csv").write_text("t\n")
    assert find_importer(tmp_path).NAME == "table"
    with pytest.raises(MissingDependency, match="absent"):
        find_importer(tmp_path, "absent")
    (tmp_path / "x.csv").rename(tmp_path / "x.docx")
    with pytest.raises(FormatError, match="absent was not tried"):
        find_importer(tmp_path)


def test_listing_the_formats_loads_none_of_them():
    code = (
        "import sys; from trueup.dataset.importers.detect import FORMATS; assert list(FORMATS); "
        "print([name for name in ('rosbags', 'h5py') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_integer_ticks_are_subtracted_as_integers():
    stamps = np.array([1_700_000_000_000_000_001, 1_700_000_000_000_000_004], dtype=np.int64)
    origin = common_origin(stamps, None, stamps[1:])
    assert origin == 1_700_000_000_000_000_001
    np.testing.assert_array_equal(seconds(stamps, origin=origin, per_second=10**9), [0.0, 3e-9])
    with pytest.raises(DataError):
        common_origin(None)


def test_the_clock_keeps_the_first_of_each_stamp():
    rows, flags = usable_clock(np.array([0.0, 0.0, 1.0, 2.0, 2.0, 2.0]), source="x", series="command")
    assert rows.tolist() == [0, 2, 3]
    assert [(flag.kind, flag.series, flag.start_s, flag.end_s) for flag in flags] == [
        ("repeated_stamps", "command", 0.0, 2.0)
    ]
    assert flags[0].detail.startswith("3 of 6")
    rows, flags = usable_clock(np.array([0.0, 1.0]), source="x")
    assert (rows.tolist(), flags) == ([0, 1], ())


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        ([], "x.csv has no samples"),
        ([0.0, np.nan], "x.csv.*not finite.*nan in row 2"),
        ([0.0, np.inf], "not finite.*row 2"),
        ([0.0, 2.0, 1.0], "x.csv runs backwards.*row 3"),
        ([0.0, 5e-324, 1e-323], "steps of 4.94e-324 s"),
        ([1.7e18, 1.8e18], "(?s)no clock shows.*unit"),
        ([-1.7e308, 1.7e308], "no clock shows"),
    ],
)
def test_unusable_clocks(stamps, words):
    with pytest.raises(DataError, match=words):
        usable_clock(np.array(stamps, dtype=np.float64), source="x.csv")


@pytest.mark.parametrize(
    ("name", "id"), [("a/b c.d", "a/b_c.d"), ("été (2)", "été_2_"), ("/a//b/", "a/b"), ("a-b_c", "a-b_c")]
)
def test_names_become_ids(name, id):
    assert episode_id(name) == id


@pytest.mark.parametrize("name", ["", "/", "..", "a/../b", "./a"])
def test_names_that_cannot_be_ids(name):
    with pytest.raises(DataError):
        episode_id(name)


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match="no regular file"):
        read_bytes(tmp_path / "pipe")


@pytest.mark.parametrize("format", FORMATS)
def test_options_that_a_format_does_not_read_are_refused(tmp_path, format):
    """Whoever gives one believes that it counts."""
    options = {"mapping": tmp_path / "none.yaml", "command_topic": "/command", "measured_topic": "/state"}
    for name, value in options.items():
        reads = (name == "mapping" and format not in ("sage", "npz")) or format == "rosbag"
        with pytest.raises(TrueupError) as error:
            importer(format).scan(tmp_path, ImportOptions(**{name: value}))
        assert ("are read without --" in str(error.value)) != reads
