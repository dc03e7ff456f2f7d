"""Damaged folders of text files and npz files: every failure is an error of trueup.errors, and it comes soon."""

import contextlib
import json
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueup.core.episode import Episode
from trueup.dataset.importers import csv, npz, sage
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.mapping_file import parse_mapping
from trueup.errors import TrueupError

ROWS = 12
SECONDS = 20.0  # for one damaged folder; a whole one takes milliseconds on an idle machine

HOSTILE = [
    b"", b"\x00", b"\n", b"\r", b"\r\n\r\n", b",", b'"', b'""', b"'", b"[", b"]", b"[[[[", b"{", b"}", b":", b"- ",
    b"nan", b"NaN", b"inf", b"-Infinity", b"null", b"true", b"1e999", b"-1e308", b"1e308", b"9" * 400, b"0x1p3",
    b"1_000", b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", "é".encode("latin-1"), "٣".encode(), "\u2028".encode(),
    b"[" * 3000, b'{"a":' * 3000, b"!!python/object/apply:os.getcwd []", b"!!binary x", b"!!int x", b"&a [*a]",
    b"*a", b"<<: 1", b"2001-99-99", b"../../etc/passwd", b"%", b"{n}", b"{", b"(?P<a>", b"(a+)+$",
]  # fmt: skip


def write_sage(folder):
    rng = np.random.default_rng(0)
    for name in ("one", "two"):
        motion = folder / name
        motion.mkdir(parents=True)
        (motion / "joint_list.txt").write_text("Pan\nLift\nJaw\n")
        control, state = ["type,timestamp,positions"], ["type,timestamp,positions,velocities,torques"]
        for row in range(ROWS):
            vectors = [json.dumps(rng.normal(size=3).tolist()) for _ in range(4)]
            control.append(f'CONTROL,{5.0 + 2e4 * row},"{vectors[0]}"')
            state.append(f'STATE_MOTOR,{5.0 + 2e4 * row},"{vectors[1]}","{vectors[2]}","{vectors[3]}"')
        (motion / "control.csv").write_text("\n".join(control) + "\n")
        (motion / "state_motor.csv").write_text("\n".join(state) + "\n")
    (folder / "split.json").write_text('{"train": ["one"], "test": ["two"]}')


MAPPING = r"""
robot: pendulum
joints: [joint1, joint2]
episodes: '(?P<name>trajectory_\d+)\.csv'
id: '{name}'
unit: A0
metadata: episodes.csv
licence: none
series:
  measured:
    time: {column: time, unit: s}
    signals:
      position: {columns: "pos_meas{n}", unit: rad}
      velocity: {columns: [vel_meas1, vel_meas2], unit: [rad/s, deg/s], optional: true}
  command:
    time: time
    signals:
      torque: {columns: "tau_con{n}", unit: Nm}
"""


def write_csv(folder):
    rng = np.random.default_rng(1)
    folder.mkdir(parents=True)
    columns = [
        "time",
        "pos_meas1",
        "pos_meas2",
        "vel_meas1",
        "vel_meas2",
        "tau_con1",
        "tau_con2",
        "tau_meas1",
        "tau_meas2",
    ]
    for name in ("trajectory_00", "trajectory_01"):
        rows = rng.normal(size=(ROWS, len(columns)))
        rows[:, 0] = 0.002 * np.arange(ROWS)
        lines = [",".join(columns), *(",".join(f"{value:.18e}" for value in row) for row in rows)]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    (folder / "mapping.yaml").write_text(MAPPING)
    (folder / "episodes.csv").write_text('id,payload_kg,condition\ntrajectory_00,1.5,"swing, up"\n')
    (folder / "split.json").write_text('{"train": ["trajectory_00.csv"], "val": ["trajectory_01.csv"]}')


def write_npz(folder):
    rng = np.random.default_rng(2)
    folder.mkdir(parents=True)
    content = {
        "joints": np.array(["a", "b"]),
        "measured.time_s": np.arange(ROWS) * 0.1,
        "measured.position": rng.normal(size=(ROWS, 2)),
        "measured.position.unit": np.array("rad"),
        "command.time_s": np.arange(ROWS) * 0.1,
        "command.torque": rng.normal(size=(ROWS, 2)).astype(np.float32),
        "payload_kg": np.array(0.5),
    }
    np.savez(folder / "plain.npz", **content)
    np.savez_compressed(folder / "packed.npz", **content)


FORMATS = {"sage": (sage, write_sage), "csv": (csv, write_csv), "npz": (npz, write_npz)}


@pytest.fixture(scope="module")
def whole():
    """One good folder per format."""
    with tempfile.TemporaryDirectory() as name:
        for kind, (_, write) in FORMATS.items():
            write(Path(name) / kind)
        yield Path(name)


def import_all(importer, folder):
    """Scan and load everything; what is loaded is an Episode, what is refused a TrueupError."""
    start = time.monotonic()
    loaded = 0
    importer.detects(folder)
    try:
        plan = importer.scan(folder, ImportOptions())
    except TrueupError:
        return 0
    for source in plan.episodes:
        with contextlib.suppress(TrueupError):
            assert isinstance(source.load(), Episode)
            loaded += 1
    assert time.monotonic() - start < SECONDS
    return loaded


@st.composite
def damages(draw):
    """A few byte-level changes: (where, how many bytes go, what comes)."""
    where = st.floats(0, 1, exclude_max=True)
    gone = st.sampled_from([0, 0, 1, 2, 7, 40, 1 << 20])
    new = st.one_of(st.sampled_from(HOSTILE), st.binary(max_size=6))
    return draw(st.lists(st.tuples(where, gone, new), min_size=1, max_size=4))


def damage(content, changes):
    for where, gone, new in changes:
        at = int(where * (len(content) + 1))
        content = content[:at] + new + content[at + gone :]
    return content


@pytest.mark.parametrize("kind", FORMATS)
def test_the_folders_are_good_before_they_are_damaged(whole, kind):
    assert import_all(FORMATS[kind][0], whole / kind) == 2


@pytest.mark.parametrize("kind", FORMATS)
@settings(max_examples=40)
@given(data=st.data())
def test_changed_bytes(whole, kind, data):
    files = sorted(path.relative_to(whole / kind) for path in (whole / kind).rglob("*") if path.is_file())
    file = data.draw(st.sampled_from(files))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "logs"
        shutil.copytree(whole / kind, folder)
        (folder / file).write_bytes(damage((folder / file).read_bytes(), data.draw(damages())))
        import_all(FORMATS[kind][0], folder)


CELLS = st.one_of(
    st.floats().map(repr),
    st.integers().map(str),
    st.sampled_from([part.decode(errors="surrogateescape") for part in HOSTILE if len(part) < 500]),
    st.lists(st.one_of(st.floats(), st.integers(), st.none(), st.lists(st.integers(), max_size=2)), max_size=4).map(
        lambda values: '"' + json.dumps(values) + '"'
    ),
)


@settings(max_examples=50)
@given(
    control=st.lists(st.tuples(CELLS, CELLS), max_size=4),
    state=st.lists(st.lists(CELLS, max_size=5), max_size=4),
    joints=st.lists(st.text(max_size=3), max_size=4),
)
def test_sage_files_of_any_structure(control, state, joints):
    with tempfile.TemporaryDirectory() as name:
        motion = Path(name) / "motion"
        motion.mkdir()
        lines = ["type,timestamp,positions", *(f"C,{stamp},{vector}" for stamp, vector in control)]
        (motion / "control.csv").write_bytes("\n".join(lines).encode(errors="surrogateescape"))
        lines = ["type,timestamp,positions,velocities,torques", *(",".join(row) for row in state)]
        (motion / "state_motor.csv").write_bytes("\n".join(lines).encode(errors="surrogateescape"))
        (motion / "joint_list.txt").write_bytes("\n".join(joints).encode(errors="replace"))
        import_all(sage, Path(name))


SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-2, 10**20), st.floats(), st.text(max_size=5),
    st.sampled_from(["q{n}", "{n}", "{joint}", "rad", "s", "time", "a", "{name}", "../x.csv", "x.csv", ".*", "whitespace", "float32"]),
)  # fmt: skip
KEYS = st.sampled_from(
    [
        *("joints", "series", "episodes", "id", "robot", "payload_kg", "metadata", "delimiter", "header", "skip_lines"),
        *("keep_origin", "bodies", "measured", "command", "simulated/x", "time", "signals", "file", "optional"),
        *("position", "torque", "body.rotation", "columns", "unit", "dtype", "column"),
    ]
)
TREES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=5), max_leaves=12
)


@settings(max_examples=50)
@given(
    top=st.dictionaries(KEYS, TREES, max_size=4),
    clock=st.one_of(st.just({"column": "time"}), TREES),
    signals=st.dictionaries(KEYS, st.fixed_dictionaries({"columns": TREES, "unit": TREES}) | TREES, max_size=2),
)
def test_mappings_of_any_structure(top, clock, signals):
    tree = {"joints": ["a"], "series": {"measured": {"time": clock, "signals": signals}}, **top}
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "x.csv").write_text("time,a,q1\n0,1,2\n1,2,3\n")
        (Path(name) / "mapping.yaml").write_text(json.dumps(tree))
        import_all(csv, Path(name))


@settings(max_examples=100)
@given(
    st.text(max_size=40)
    | st.lists(st.sampled_from([part.decode(errors="replace") for part in HOSTILE]), max_size=6).map("".join)
)
def test_mappings_of_any_text(text):
    with pytest.raises(TrueupError):
        parse_mapping(text, name="fuzz")


@settings(max_examples=50)
@given(
    tree=st.one_of(
        TREES,
        st.dictionaries(
            st.sampled_from(["train", "val", "test", "other"]),
            st.lists(st.sampled_from(["one", "two", "one (two)", "", "/", "..", "("]), max_size=3),
        ),
    )
)
def test_splits_of_any_structure(whole, tree):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "logs"
        shutil.copytree(whole / "sage", folder)
        (folder / "split.json").write_text(json.dumps(tree))
        import_all(sage, folder)


@pytest.mark.parametrize("kind", FORMATS)
def test_a_folder_in_place_of_a_file(whole, kind, tmp_path):
    files = sorted(path.relative_to(whole / kind) for path in (whole / kind).rglob("*") if path.is_file())
    for number, file in enumerate(files):
        folder = tmp_path / str(number)
        shutil.copytree(whole / kind, folder)
        (folder / file).unlink()
        (folder / file).mkdir()
        import_all(FORMATS[kind][0], folder)


@pytest.mark.parametrize("kind", FORMATS)
def test_a_loop_of_links_and_a_link_to_nothing(whole, kind, tmp_path):
    files = sorted(path.relative_to(whole / kind) for path in (whole / kind).rglob("*") if path.is_file())
    for target in ("self", "missing"):
        folder = tmp_path / target
        shutil.copytree(whole / kind, folder)
        for file in files:
            (folder / file).unlink()
            (folder / file).symlink_to((folder / file).name if target == "self" else "gone")
            import_all(FORMATS[kind][0], folder)


def cut(path, rows):
    return b"".join(path.read_bytes().splitlines(keepends=True)[:rows])


def real(importer, files, changes, which):
    """Import real files, cut short, of which one is damaged."""
    with tempfile.TemporaryDirectory() as name:
        for number, (relative, content) in enumerate(files):
            target = Path(name) / relative
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(damage(content, changes) if number == which % len(files) else content)
        import_all(importer, Path(name))


@settings(max_examples=25)
@given(changes=damages(), which=st.integers(0, 2))
def test_changed_bytes_of_a_real_motion(so101_logs, changes, which):
    names = ("control.csv", "state_motor.csv", "joint_list.txt")
    files = [(f"chirp_sweep/{name}", cut(so101_logs / "chirp_sweep" / name, 300)) for name in names]
    real(sage, files, changes, which)


@settings(max_examples=25)
@given(changes=damages(), which=st.integers(0, 1))
def test_changed_bytes_of_real_pendulums(double_pendulum_logs, simple_pendulum_logs, changes, which):
    real(csv, [("t.csv", cut(double_pendulum_logs / "trajectory_11.csv", 200))], changes, which)
    folder = simple_pendulum_logs / "control_method_ddp"
    files = [(f"ddp/{name}.csv", cut(folder / f"{name}.csv", 200)) for name in ("data_measured", "data_desired")]
    real(csv, files, changes, which)
