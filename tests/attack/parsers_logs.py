"""The importers: logs of every format, and which importer reads what."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import os
import random
import shutil
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io

from attack.harness import HERE, Parser, Unsound
from trueup.core.timeseries import TimeSeries
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.detect import FORMATS, find_importer, importer
from trueup.dataset.writer import meta_to_row
from trueup.errors import TrueupError
from trueup.stages.importing import checked, plan_import

ROWS = 12


def sound(series: TimeSeries) -> None:
    """Refuse a series that should have been refused."""
    if not np.isfinite(series.time_s).all() or not (np.diff(series.time_s) > 0).all():
        raise Unsound("a clock that does not increase")
    for name, values in series.signals.items():
        if np.isinf(values).any():
            raise Unsound(f"{name} is infinite")
    if not all(name and not set(name) & set("\x00\x1b\n\u202e\ud800") and len(name) < 300 for name in series.joints):
        raise Unsound(f"joints {series.joints!r}"[:200])


def read_logs(path: Path, format: str | None, options: ImportOptions | None = None) -> Iterator[Exception]:
    """Everything that an import reads and checks, without writing it."""
    plan = plan_import(path, format=format, options=options)
    for item in plan.episodes:
        try:
            episode = checked(item.load())
        except TrueupError as error:
            yield error
            continue
        meta_to_row(episode.meta)
        for series in (episode.measured, *([episode.command] if episode.command else []), *episode.simulated.values()):
            sound(series)


def _reader(format: str, mapping: str = "") -> Parser.read:  # type: ignore[name-defined]
    def read(folder: Path) -> Iterator[Exception]:
        options = ImportOptions(mapping=folder / mapping) if mapping else None
        yield from read_logs(folder / "in" if mapping else folder, format, options)

    return read


def _real(name: str) -> Path | None:
    # Not from conftest, which would check the types of everything that is loaded after it.
    shared = Path(os.environ.get("TRUEUP_SHARED", HERE.parent.parent.parent / "shared"))
    return shared / "data" / name if (shared / "data" / name).is_dir() else None


def _cut(source: Path, target: Path, rows: int = 30) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(b"".join(source.read_bytes().splitlines(keepends=True)[:rows]))


def make_sage(folder: Path) -> None:
    """One motion of a real arm if it is at hand, and a made one."""
    rng = np.random.default_rng(0)
    real = _real("so101_sage")
    if real:
        for name in ("control.csv", "state_motor.csv", "joint_list.txt"):
            _cut(real / "chirp_sweep" / name, folder / "chirp_sweep" / name)
    motion = folder / "one"
    motion.mkdir()
    (motion / "joint_list.txt").write_text("Pan\nLift\nJaw\n")
    control, state = ["type,timestamp,positions"], ["type,timestamp,positions,velocities,torques"]
    for row in range(ROWS):
        vectors = [json.dumps(rng.normal(size=3).tolist()) for _ in range(4)]
        control.append(f'CONTROL,{5.0 + 2e4 * row},"{vectors[0]}"')
        state.append(f'STATE_MOTOR,{5.0 + 2e4 * row},"{vectors[1]}","{vectors[2]}","{vectors[3]}"')
    (motion / "control.csv").write_text("\n".join(control) + "\n")
    (motion / "state_motor.csv").write_text("\n".join(state) + "\n")
    (folder / "split.json").write_text('{"train": ["one"], "test": ["chirp_sweep"]}')


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
_COLUMNS = (
    "time",
    "pos_meas1",
    "pos_meas2",
    "vel_meas1",
    "vel_meas2",
    "tau_con1",
    "tau_con2",
    "tau_meas1",
    "tau_meas2",
)


def make_csv(folder: Path) -> None:
    """Two files with a mapping beside them."""
    rng = np.random.default_rng(1)
    for name in ("trajectory_00", "trajectory_01"):
        rows = rng.normal(size=(ROWS, len(_COLUMNS)))
        rows[:, 0] = 0.002 * np.arange(ROWS)
        lines = [",".join(_COLUMNS), *(",".join(f"{value:.18e}" for value in row) for row in rows)]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    (folder / "mapping.yaml").write_text(MAPPING)
    (folder / "episodes.csv").write_text('id,payload_kg,condition\ntrajectory_00,1.5,"swing, up"\n')
    (folder / "split.json").write_text('{"train": ["trajectory_00.csv"], "val": ["trajectory_01.csv"]}')


_ARRAYS = """joints: [a, b]
series:
  measured: {time: t, signals: {position: {columns: q, unit: rad}}}
  command: {time: t, signals: {position: {columns: u, unit: rad}}}
"""


def _table_maker(ending: str) -> Parser.make:  # type: ignore[name-defined]
    """Vectors in a file of arrays, with a mapping beside it."""

    def make(folder: Path) -> None:
        rng = np.random.default_rng(2)
        arrays = {"t": 0.01 * np.arange(ROWS), "q": rng.normal(size=(ROWS, 2)), "u": rng.normal(size=(ROWS, 2))}
        (folder / "mapping.yaml").write_text(_ARRAYS)
        match ending:
            case "parquet":
                columns = {name: list(values) if values.ndim > 1 else values for name, values in arrays.items()}
                pq.write_table(pa.table(columns), folder / "x.parquet")
            case "mat":
                beside = {"info": {"names": np.array(["a", "bc"], object), "gain": 2.0}, "note": "of today"}
                scipy.io.savemat(folder / "x.mat", {**arrays, **beside})
            case "xlsx":
                book = openpyxl.Workbook()
                names = ["t", *(f"{name}{place}" for name in "qu" for place in range(2))]
                places = _ARRAYS.replace("columns: q", "columns: [q0, q1]").replace("columns: u", "columns: [u0, u1]")
                (folder / "mapping.yaml").write_text(places)
                for row in [names, *np.column_stack(list(arrays.values())).tolist()]:
                    book.active.append(row)
                book.save(folder / "x.xlsx")
            case "json":
                (folder / "x.json").write_text(json.dumps({name: own.tolist() for name, own in arrays.items()}))
            case "hdf5":
                with h5py.File(folder / "x.hdf5", "w") as file:
                    for name, own in arrays.items():
                        file[name] = own

    return make


def make_packed(folder: Path) -> None:
    """A packed log beside another one, with their mapping."""
    make_csv(folder)
    first = min(folder.glob("*.csv"))
    first.with_name(f"{first.name}.gz").write_bytes(gzip.compress(first.read_bytes(), mtime=0))
    first.unlink()


def make_archive(folder: Path) -> None:
    """Logs and their mapping in an archive; one of a packed tar lies in it."""
    make_csv(folder)
    with zipfile.ZipFile(folder / "logs.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.iterdir()):
            if file.suffix != ".zip":
                archive.write(file, file.name)
                file.unlink()
        inner = io.BytesIO()
        with tarfile.open(fileobj=inner, mode="w:xz") as tar:
            item = tarfile.TarInfo("notes.txt")
            tar.addfile(item)
        archive.writestr("more.tar.xz", inner.getvalue())


def make_pendulums(folder: Path) -> None:
    """Real pendulums, read with a shipped mapping; made ones with its columns where those are not at hand."""
    double, simple = _real("dfki_double_pendulum_A0"), _real("dfki_simple_pendulum")
    if double and simple:
        _cut(double / "trajectory_11.csv", folder / "trajectory_11.csv")
    else:
        make_csv(folder)
        (folder / "mapping.yaml").unlink()


def make_npz(folder: Path) -> None:
    """Stored and compressed."""
    rng = np.random.default_rng(2)
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


STATED = (
    "joints: [hip, knee, ankle]\nrobot: h1\nunit: two\npayload_kg: 3\ncondition: level\n"
    "units: {position: deg, position.hip: rad}\ntime_unit: s\ncommand_signal: position\n"
)


def make_humanoid(folder: Path) -> None:
    """HDF5 with one group, names inside, compressed columns."""
    from dataset.test_import_hdf5 import LEGS, edit, write_humanoid

    write_humanoid(folder / "a.h5", rows=ROWS, names=LEGS)
    edit(folder / "a.h5", "robot/joint_velocity_list", np.ones((ROWS, 3)), compression="gzip", chunks=(5, 3))


def make_arms(folder: Path) -> None:
    """HDF5 with two groups, names stated."""
    from dataset.test_import_hdf5 import write_arms

    (folder / "in").mkdir()
    write_arms(folder / "in" / "a.h5", rows=ROWS, width=2)
    (folder / "m.yaml").write_text("joints: {robot1: [a, b], robot2: [c, d]}\nrobot: h1\npayload_kg: 3\n")


def make_stated(folder: Path) -> None:
    """HDF5 whose names are all stated."""
    from dataset.test_import_hdf5 import write_humanoid

    (folder / "in").mkdir()
    write_humanoid(folder / "in" / "a.h5", rows=ROWS)
    (folder / "m.yaml").write_text(STATED)


def _bag_maker(storage: str):
    def make(folder: Path) -> None:
        from dataset import test_import_rosbag as bags

        store = bags.ROS1 if storage == "ros1" else bags.ROS2
        values = bags.motion(rows=6)
        topics = {"/joint_states": (bags.JOINT_STATE, bags.states(store, values))}
        if storage != "ros1":
            points = [(0.0, (1, 2, 3)), (0.1, (2, 3, 4))]
            topics["/goal"] = (bags.TRAJECTORY, [(bags.START_NS, bags.trajectory(bags.START_NS, bags.JOINTS, points))])
        else:
            topics["/cmd"] = (bags.JOINT_STATE, bags.states(store, values))
        bags.write_bag(folder / ("a.bag" if storage == "ros1" else "a"), topics, storage)

    return make


def _bag_editor(storage: str):
    """Bags that are in order, of messages that are not."""

    def edit(folder: Path, rng: random.Random) -> str:
        from attack.mutations import _BYTES
        from dataset import test_import_rosbag as bags

        shutil.rmtree(folder)
        folder.mkdir()
        store = bags.ROS1 if storage == "ros1" else bags.ROS2
        extremes = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 0.0)
        topics = {}
        for name in rng.sample(("/joint_states", "/cmd", "/a", "\x1b[2J/desired"), rng.randrange(1, 4)):
            values = bags.motion(rows=5, seed=rng.randrange(9))
            if rng.random() < 0.3:
                values[rng.randrange(3), rng.randrange(5), rng.randrange(3)] = rng.choice(extremes)
            joints = rng.choice(
                (bags.JOINTS, bags.JOINTS, ("a", "a", "b"), ("", "b", "c"), ("\x1b[2J", "b\n", "c" * 9000))
            )
            start = rng.choice((bags.START_NS, bags.START_NS, 0, 1, 10**15, 2 * 10**18))
            raw = bags.states(store, values, joints, stamped=rng.random() < 0.8, start_ns=start)
            for _ in range(rng.choice((0, 1, 1, 2, 5))):
                k = rng.randrange(len(raw))
                stamp, message = raw[k]
                stamp = rng.choice((stamp, stamp, 0, stamp - 10**12, 2**62, stamp + 10**17))
                raw[k] = (stamp, rng.choice(_BYTES)(message, rng)[:100_000] if rng.random() < 0.7 else message)
            topics[name] = (rng.choice((bags.JOINT_STATE,) * 6 + (bags.ARRAY, bags.TRAJECTORY)), raw)
        with contextlib.suppress(Exception):  # what the writer itself refuses
            bags.write_bag(folder / ("a.bag" if storage == "ros1" else "a"), topics, storage)
        return "other messages"

    return edit


def make_lerobot(folder: Path) -> None:
    """Our own export of two episodes."""
    from dataset.test_import_lerobot import episode, export

    export([episode(0, 5, "train"), episode(1, 4, "test")], folder / "d")


def _read_lerobot(folder: Path) -> Iterator[Exception]:
    yield from read_logs(folder / "d", "lerobot")


def make_foreign(folder: Path) -> None:
    """What other programs write."""
    from dataset.test_import_lerobot import ARM, foreign, values

    foreign(
        folder / "d",
        {"observation.state": (ARM, values(3, total=20)), "action": (ARM, values(3, 1, total=20))},
        frames=(8, 12),
        groups=3,
    )


def make_all(folder: Path) -> None:
    """One of every format, side by side."""
    makers = {"sage": make_sage, "csv": make_csv, "npz": make_npz, "hdf5": make_humanoid, "lerobot": make_lerobot}
    for name, make in {**makers, "bag": _bag_maker("mcap"), "bag1": _bag_maker("ros1")}.items():
        (folder / name).mkdir()
        make(folder / name)


def read_detected(folder: Path) -> Iterator[Exception]:
    """Every folder and file, by whichever importer takes it."""
    for path in (folder, *sorted(folder.rglob("*"))):
        for name in FORMATS:
            importer(name).detects(path)
        try:
            plan = find_importer(path).scan(path, ImportOptions())
        except TrueupError as error:
            yield error
            continue
        if len({item.id for item in plan.episodes}) < len(plan.episodes):
            raise Unsound("two episodes of one name")


PARSERS = (
    Parser("hdf5, one group", make_humanoid, _reader("hdf5")),
    Parser("rosbag 1", _bag_maker("ros1"), _reader("rosbag"), _bag_editor("ros1")),
    Parser("rosbag 2, mcap", _bag_maker("mcap"), _reader("rosbag"), _bag_editor("mcap")),
    Parser("rosbag 2, sqlite3", _bag_maker("sqlite3"), _reader("rosbag"), _bag_editor("sqlite3")),
    Parser("lerobot, exported", make_lerobot, _read_lerobot),
    Parser("lerobot, foreign", make_foreign, _read_lerobot),
    Parser("npz", make_npz, _reader("npz")),
    Parser("sage", make_sage, _reader("sage")),
    Parser("csv, mapping beside", make_csv, _reader("csv")),
    *(Parser(f"{ending}, mapping beside", _table_maker(ending), _reader("table")) for ending in ("parquet", "mat")),
    *(
        Parser(f"{ending}, mapping beside", _table_maker(ending), _reader("table"))
        for ending in ("json", "hdf5", "xlsx")
    ),
    Parser("packed log", make_packed, _reader("table")),
    Parser("archive of logs", make_archive, _reader("table")),
    Parser("csv, shipped mapping", make_pendulums, _reader("csv")),
    Parser("hdf5, two groups", make_arms, _reader("hdf5", "m.yaml")),
    Parser("hdf5, stated names", make_stated, _reader("hdf5", "m.yaml")),
    Parser("detection", make_all, read_detected, refuses=True),
)
