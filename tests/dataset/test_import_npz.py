import io
import os
import pickle
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dataset.store_cases import write_npz
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries
from trueup.dataset.importers import npz
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import DataError, FormatError, NameMismatch, TrueupError, UnitError
from trueup.stages import plan_import

GOOD = {
    "measured.time_s": np.array([5.0, 5.1]),
    "measured.position": np.array([[1.0, 2.0], [3.0, np.nan]]),
    "command.time_s": np.array([4, 5, 6]),
    "command.torque": np.zeros((3, 2), dtype=np.float32),
    "joints": np.array(["a", "b"]),
}


def load(path, **options):
    (source,) = npz.scan(path, ImportOptions(**options)).episodes
    return source.load()


def test_arrays_become_an_episode_on_its_own_clock(tmp_path):
    np.savez(tmp_path / "run 1.npz", **GOOD, **{"measured.position.unit": np.array(["deg", "1"])})
    episode = load(tmp_path, robot="arm", units={"torque.b": "mNm"})
    assert episode.id == "run_1"
    assert episode.meta.robot == "arm"
    assert episode.meta.source == "run 1.npz"
    np.testing.assert_array_equal(episode.measured.time_s, [5.0, 5.1])
    np.testing.assert_array_equal(episode.command.time_s, [4.0, 5.0, 6.0])
    np.testing.assert_array_equal(episode.measured["position"], GOOD["measured.position"])
    assert episode.measured.units == {"position": ("deg", "1")}
    assert episode.command.units == {"torque": ("Nm", "mNm")}
    assert episode.command["torque"].dtype == np.float32


def test_a_folder_of_files_with_splits(tmp_path):
    for name in ("a", "sub/b", "c"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        np.savez(tmp_path / f"{name}.npz", **GOOD)
    (tmp_path / "split.json").write_text('{"train": ["a.npz", "c"], "val": ["sub/b.npz"]}')
    plan = npz.scan(tmp_path, ImportOptions())
    assert plan.splits == {"a": "train", "sub/b": "val", "c": "train"}
    assert [source.load().id for source in plan.episodes] == ["a", "c", "sub/b"]


def test_repeated_stamps_are_dropped_and_flagged(tmp_path):
    np.savez(tmp_path / "x.npz", **{**GOOD, "command.time_s": np.array([1.0, 1.0, 2.0])})
    episode = load(tmp_path)
    assert len(episode.command) == 2
    (flag,) = episode.meta.flags
    assert (flag.kind, flag.series) == ("repeated_stamps", "command")


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"measured.time_s": None}, DataError, "keys of an episode"),
        ({"joints": None}, DataError, "no joints"),
        ({"measured.position": None}, DataError, "no signal"),
        ({"measured.pose": np.zeros((2, 2))}, DataError, "keys of an episode.*measured.pose.*position"),
        ({"observed.time_s": np.zeros(2)}, DataError, "keys of an episode.*observed"),
        ({"measured.position": np.zeros((2, 3))}, DataError, r"wrong shape.*\(2, 3\).*\(2, 2\)"),
        ({"measured.position": np.zeros(2)}, DataError, "measured.position.*2 dimensions"),
        ({"measured.position": np.array([["x", "y"]] * 2)}, DataError, "measured.position"),
        ({"measured.position": np.zeros((2, 2), dtype=complex)}, DataError, "measured.position"),
        ({"measured.position": np.full((2, 2), np.inf)}, DataError, "infinite"),
        ({"measured.time_s": np.array([1.0, 0.5])}, DataError, "x.npz, measured runs backwards"),
        ({"measured.time_s": np.array([1.0, np.nan])}, DataError, "not finite"),
        ({"measured.time_s": np.zeros(0), "measured.position": np.zeros((0, 2))}, DataError, "no samples"),
        ({"joints": np.array(["a", "a"])}, NameMismatch, "twice"),
        ({"joints": np.array([1, 2])}, DataError, "joints is not text"),
        ({"measured.position.unit": np.array("yards")}, UnitError, "measured.position.unit"),
        ({"measured.position.unit": np.array(["rad", "rad", "rad"])}, UnitError, "measured.position.unit"),
        ({"payload_kg": np.array("heavy")}, DataError, "payload_kg"),
        ({"kp_setting": np.array(-1.0)}, DataError, r"kp_setting is no setting of a gain: got -1.0; expected a finite"),
        ({"robot": np.array(3.0)}, DataError, "robot is not text"),
    ],
)
def test_wrong_arrays_are_named(tmp_path, change, error, words):
    content = {key: value for key, value in {**GOOD, **change}.items() if value is not None}
    np.savez(tmp_path / "x.npz", **content)
    with pytest.raises(error, match="(?s)x.npz.*" + words if "x.npz" not in words else words):
        load(tmp_path)


class Bomb:
    def __reduce__(self):
        return (os.mkdir, ("exploded",))


def test_a_pickle_inside_is_never_opened(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez(tmp_path / "x.npz", **{**GOOD, "joints": np.array([Bomb()], dtype=object)})
    with pytest.raises(DataError, match=r"x.npz holds a pickle in 'joints.npy'"):
        load(tmp_path)
    (tmp_path / "x.npz").write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(DataError, match=r"x.npz is not an npz file: got a pickle"):
        load(tmp_path)
    assert not (tmp_path / "exploded").exists()


def entry(header, body=b""):
    file = io.BytesIO()
    text = header.encode() + b"\n"
    file.write(b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + body)
    return file.getvalue()


@pytest.mark.parametrize(
    "npy",
    [
        entry("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}"),
        entry("{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999999999999999,)}"),
        entry("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}", b"12345678"),
        entry("{'descr': '<f8', 'fortran_order': False, 'shape': (2,)}", b"12345678"),
        entry("[" * 9000),
        entry("__import__('os')"),
        b"",
        b"\x93NUMPY",
        b"not an array",
    ],
)
def test_damaged_arrays(tmp_path, npy):
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("measured.time_s.npy", npy)
    with pytest.raises(DataError, match=r"x.npz"):
        load(tmp_path)


def test_a_truncated_file(tmp_path):
    np.savez_compressed(tmp_path / "x.npz", **GOOD)
    whole = (tmp_path / "x.npz").read_bytes()
    for size in (0, 1, 10, 100, len(whole) - 30, len(whole) - 1):
        (tmp_path / "x.npz").write_bytes(whole[:size])
        with pytest.raises(DataError, match=r"x.npz"):
            load(tmp_path)


def test_no_file_is_another_format(tmp_path):
    assert not npz.detects(tmp_path)
    with pytest.raises(FormatError, match="no npz file"):
        npz.scan(tmp_path, ImportOptions())
    (tmp_path / "x.npz").mkdir()
    assert not npz.detects(tmp_path)


def test_links_out_of_the_folder_are_refused(tmp_path):
    np.savez(tmp_path / "secret.npz", **GOOD)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "x.npz").symlink_to(tmp_path / "secret.npz")
    with pytest.raises(TrueupError, match="leads out of the folder"):
        npz.scan(tmp_path / "logs", ImportOptions())


@st.composite
def made(draw):
    joints = tuple(
        draw(
            st.lists(
                st.text(min_size=1, max_size=4).filter(lambda t: "\0" not in t), min_size=1, max_size=3, unique=True
            )
        )
    )
    size = draw(st.integers(1, 4))

    def one(dtype):
        return TimeSeries(
            time_s=np.cumsum(draw(arrays(np.float64, size, elements=st.floats(1e-3, 10)))),
            joints=joints,
            signals={
                "position": draw(
                    arrays(dtype, (size, len(joints)), elements=st.floats(width=32, allow_infinity=False))
                ),
                "body.position": draw(arrays(np.float64, (size, 1, 3), elements=st.floats(-9, 9))),
            },
            units={"position": tuple(draw(st.sampled_from(["rad", "1"])) for _ in joints), "body.position": ("mm",)},
            bodies=("tip",),
        )

    return Episode(
        EpisodeMeta(
            id="run",
            robot=draw(st.sampled_from(["", "arm"])),
            payload_kg=draw(st.none() | st.floats(0, 9)),
            kp_setting=draw(st.none() | st.floats(1, 900)),
        ),
        one(np.float64),
        draw(st.none() | st.just(one(np.float32))),
        {"mujoco/fitted+x": one(np.float32)},
    )


@settings(max_examples=25)
@given(made())
def test_writing_and_reading_give_the_same_episode(episode):
    with tempfile.TemporaryDirectory() as folder:
        write_npz(episode, Path(folder) / "run.npz")
        again = load(Path(folder))
    assert again.id == "run"
    for key in ("robot", "payload_kg", "kp_setting"):
        assert getattr(again.meta, key) == getattr(episode.meta, key)
    assert (again.command is None) == (episode.command is None)
    pairs = [(episode.measured, again.measured), (episode.run("mujoco/fitted+x"), again.run("mujoco/fitted+x"))]
    if episode.command is not None:
        pairs.append((episode.command, again.command))
    for left, right in pairs:
        np.testing.assert_array_equal(left.time_s, right.time_s)
        assert (left.joints, left.bodies, dict(left.units)) == (right.joints, right.bodies, dict(right.units))
        assert set(left.signals) == set(right.signals)
        for signal, values in left.signals.items():
            assert values.dtype == right[signal].dtype
            np.testing.assert_array_equal(values, right[signal])


def test_arrays_of_another_program_are_answered_with_a_mapping_that_reads_them(tmp_path):
    q = np.column_stack([np.sin(np.arange(50.0)), np.cos(np.arange(50.0))])
    np.savez(tmp_path / "x.npz", dof_pos=q, dof_pos_target=q + 0.1, dt=0.02)
    (source,) = npz.scan(tmp_path, ImportOptions()).episodes
    with pytest.raises(DataError, match="keys of an episode") as caught:
        source.load()
    (tmp_path / "mapping.yaml").write_text(caught.value.hint.partition("\n")[2])
    episode = plan_import(tmp_path).episodes[0].load()
    np.testing.assert_array_equal(episode.measured["position"], q)
    np.testing.assert_allclose(np.diff(episode.measured.time_s), 0.02)
