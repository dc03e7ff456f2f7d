"""Tables and arrays as pandas, polars, pyarrow, Excel, MATLAB, HDF5 and robots' own loggers write them."""

import csv
import gzip
import importlib
import json
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
from pyarrow import feather, parquet
from scipy.io import savemat

from benchmarks.recorded import START_S, Kind, Recorded

_UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
_HALF = 2.0  # motions of files that hold two end here [s]


def _other(name: str) -> Any:
    """A package that nothing else here needs."""
    return importlib.import_module(name)


def _columns(
    truth: Recorded, done: str = "{}_pos", told: str = "{}_cmd", by: float = 1.0, places: int | None = None
) -> dict[str, np.ndarray]:
    """Names -> values of all joints."""
    names = range(1, 1 + len(truth.joints)) if "#" in done else truth.joints
    done, told = done.replace("#", "{}"), told.replace("#", "{}")
    found = {}
    for word, values in ((done, truth.done), (told, truth.told)):
        found |= {word.format(name): values[:, joint] * by for joint, name in enumerate(names)}
    return found if places is None else {name: np.round(values, places) for name, values in found.items()}


def _frame(truth: Recorded, **words: Any) -> Any:
    time = words.pop("time", "time")
    return _other("pandas").DataFrame({time: truth.time_s, **_columns(truth, **words)})


def _csv(
    folder: Path, truth: Recorded, *, name: str = "run.csv", words: dict[str, Any] | None = None, **how: Any
) -> None:
    how.setdefault("index", False)
    _frame(truth, **(words or {})).to_csv(folder / name, **how)


def _table(name: str = "run.csv", words: dict[str, Any] | None = None, **how: Any) -> Callable[[Path, Recorded], None]:
    return lambda folder, truth: _csv(folder, truth, name=name, words=words, **how)


def _time_as(change: Callable[[np.ndarray], np.ndarray], name: str) -> Callable[[Path, Recorded], None]:
    def write(folder: Path, truth: Recorded) -> None:
        frame = _other("pandas").DataFrame({name: change(truth.time_s), **_columns(truth)})
        frame.to_csv(folder / "run.csv", index=False)

    return write


def dates(folder: Path, truth: Recorded) -> None:
    """Stamps as pandas writes dates."""
    pandas = _other("pandas")
    index = pandas.DatetimeIndex(pandas.to_datetime(truth.time_ns), name="timestamp")
    pandas.DataFrame(_columns(truth), index=index).to_csv(folder / "run.csv")


def two_stamps(folder: Path, truth: Recorded) -> None:
    """Seconds and nanoseconds apart, as ROS does."""
    stamps = {"sec": truth.time_ns // 10**9, "nanosec": truth.time_ns % 10**9}
    _other("pandas").DataFrame({**stamps, **_columns(truth)}).to_csv(folder / "run.csv", index=False)


def units_row(folder: Path, truth: Recorded) -> None:
    """A second line with units."""
    columns = {"t": truth.time_s * 1000, **_columns(truth, by=180 / np.pi)}
    with (folder / "run.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerow(["ms", *["deg"] * (len(columns) - 1)])
        writer.writerows(zip(*columns.values(), strict=True))


def commented(folder: Path, truth: Recorded) -> None:
    """Numpy's header, behind a #."""
    columns = {"time": truth.time_s, **_columns(truth)}
    np.savetxt(folder / "run.csv", np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns))


def bare(folder: Path, truth: Recorded) -> None:
    """Numpy without a header."""
    np.savetxt(folder / "run.csv", np.hstack([truth.time_s[:, None], truth.done, truth.told]), delimiter=",")


def clockless(folder: Path, truth: Recorded) -> None:
    """No stamps."""
    _other("pandas").DataFrame(_columns(truth)).to_csv(folder / "run.csv", index=False)


def cut(folder: Path, truth: Recorded) -> None:
    """A logger that was killed in a line."""
    _csv(folder, truth)
    path = folder / "run.csv"
    path.write_bytes(path.read_bytes()[:-40])


def long(folder: Path, truth: Recorded) -> None:
    """A row for each joint and stamp."""
    pandas = _other("pandas")
    parts = [
        pandas.DataFrame({"time": truth.time_s, "joint": joint, "position": done, "command": told})
        for joint, done, told in zip(truth.joints, truth.done.T, truth.told.T, strict=True)
    ]
    pandas.concat(parts).sort_values(["time", "joint"]).to_csv(folder / "run.csv", index=False)


def vectors(folder: Path, truth: Recorded) -> None:
    """Lists in cells."""
    frame = {"t": truth.time_s, "q": truth.done.tolist(), "q_des": truth.told.tolist()}
    _other("pandas").DataFrame(frame).to_csv(folder / "run.csv")


def two_rates(folder: Path, truth: Recorded) -> None:
    """Two topics in one table, as PlotJuggler exports them."""
    pandas, time = _other("pandas"), START_S + truth.time_s
    states = {f"/joint_states/{name}/position": values for name, values in zip(truth.joints, truth.done.T, strict=True)}
    told = {f"/command/{name}": values for name, values in zip(truth.joints, truth.told[::4].T, strict=True)}
    one = pandas.DataFrame({"__time": time, **states})
    two = pandas.DataFrame({"__time": time[::4] + 0.002, **told})
    pandas.concat([one, two]).sort_values("__time").to_csv(folder / "run.csv", index=False)


def apart(folder: Path, truth: Recorded) -> None:
    """A file for each signal."""
    for name, values in (("position", truth.done), ("command", truth.told)):
        frame = {"time": truth.time_s, **dict(zip(truth.joints, values.T, strict=True))}
        _other("pandas").DataFrame(frame).to_csv(folder / f"{name}.csv", index=False)


def rostopic(folder: Path, truth: Recorded) -> None:
    """`rostopic echo -p`, a file for each topic."""
    for topic, values in (("joint_states", truth.done), ("joint_command", truth.told)):
        frame = {
            "%time": truth.time_ns,
            "field.header.seq": np.arange(len(truth.time_ns)),
            "field.header.stamp": truth.time_ns,
            "field.header.frame_id": "",
            **{f"field.name{number}": name for number, name in enumerate(truth.joints)},
            **{f"field.position{number}": values[:, number] for number in range(len(truth.joints))},
        }
        _other("pandas").DataFrame(frame).to_csv(folder / f"{topic}.csv", index=False)


def two_in_one(folder: Path, truth: Recorded) -> None:
    """Two motions in a file; the clock begins anew."""
    frame = _frame(truth)
    frame.loc[frame["time"] >= _HALF, "time"] -= _HALF
    frame.to_csv(folder / "run.csv", index=False)


def by_trial(folder: Path, truth: Recorded) -> None:
    """Two motions in a file, told by a column."""
    frame = _frame(truth)
    frame.insert(0, "trial", (frame["time"] >= _HALF).astype(int))
    frame.to_csv(folder / "run.csv", index=False)


def _half(truth: Recorded, number: int) -> slice:
    first = int(np.searchsorted(truth.time_s, _HALF - 1e-12))
    return slice(first, len(truth.time_s)) if number else slice(0, first)


def polars_lists(folder: Path, truth: Recorded) -> None:
    """Lists in a column."""
    frame = {"timestamp": truth.time_s, "observation.state": truth.done.tolist(), "action": truth.told.tolist()}
    _other("polars").DataFrame(frame).write_parquet(folder / "run.parquet")


def arrow_float32(folder: Path, truth: Recorded) -> None:
    """Single precision."""
    columns = {name: values.astype(np.float32) for name, values in _columns(truth, "q#", "q#_des").items()}
    parquet.write_table(pa.table({"t": truth.time_s, **columns}), folder / "run.parquet")


def arrow_feather(folder: Path, truth: Recorded) -> None:
    """Feather, which is Arrow's IPC file."""
    feather.write_feather(pa.table({"time": truth.time_s, **_columns(truth)}), folder / "run.feather")


def json_columns(folder: Path, truth: Recorded) -> None:
    """A list for each column."""
    columns = {"time": truth.time_s, **_columns(truth)}
    (folder / "run.json").write_text(json.dumps({name: values.tolist() for name, values in columns.items()}))


def json_steps(folder: Path, truth: Recorded) -> None:
    """A record for each step, with vectors."""
    steps = [
        {"t": time_s, "q": done, "q_des": told}
        for time_s, done, told in zip(truth.time_s.tolist(), truth.done.tolist(), truth.told.tolist(), strict=True)
    ]
    (folder / "run.json").write_text(json.dumps({"robot": "ur5e", "steps": steps}))


def json_lines(folder: Path, truth: Recorded) -> None:
    """A record for each line."""
    _frame(truth).to_json(folder / "run.jsonl", orient="records", lines=True, double_precision=12)


def json_named(folder: Path, truth: Recorded) -> None:
    """A line for each step, with a mapping of joints."""
    with (folder / "run.jsonl").open("w") as file:
        for time_s, done, told in zip(truth.time_s.tolist(), truth.done.tolist(), truth.told.tolist(), strict=True):
            sides = {"position": done, "command": told}
            named = {side: dict(zip(truth.joints, values, strict=True)) for side, values in sides.items()}
            file.write(json.dumps({"timestamp": START_S + time_s, **named}) + "\n")


def json_frame(orient: str) -> Callable[[Path, Recorded], None]:
    """A data frame of pandas, whose rows or columns come first."""
    return lambda folder, truth: _frame(truth).to_json(folder / "run.json", orient=orient, double_precision=12)


def json_lines_packed(folder: Path, truth: Recorded) -> None:
    """A telemetry stream, packed."""
    with gzip.open(folder / "telemetry.jsonl.gz", "wt") as file:
        for time_s, done, told in zip(truth.time_s.tolist(), truth.done.tolist(), truth.told.tolist(), strict=True):
            pairs = zip(truth.joints, done, told, strict=True)
            row = {
                f"{joint}.{what}": value
                for joint, *both in pairs
                for what, value in zip(("pos", "goal"), both, strict=False)
            }
            file.write(json.dumps({"ts": time_s, **row}) + "\n")


def json_nested(folder: Path, truth: Recorded) -> None:
    """A record for each step and joint, below each other."""
    with (folder / "run.json").open("w") as file:
        steps = zip(truth.time_s.tolist(), truth.done.tolist(), truth.told.tolist(), strict=True)
        rows = [
            {
                "time": time_s,
                "joints": {
                    joint: {"position": q, "target": u} for joint, q, u in zip(truth.joints, *both, strict=False)
                },
            }
            for time_s, *both in steps
        ]
        json.dump(rows, file)


def two_header_rows(folder: Path, truth: Recorded) -> None:
    """Columns of two levels."""
    pandas = _other("pandas")
    columns = {(joint, "position"): truth.done[:, place] for place, joint in enumerate(truth.joints)}
    columns |= {(joint, "command"): truth.told[:, place] for place, joint in enumerate(truth.joints)}
    pandas.DataFrame(columns, index=pandas.Index(truth.time_s, name="time")).to_csv(folder / "run.csv")


def notes_above(folder: Path, truth: Recorded) -> None:
    """Comments in front of the header."""
    _csv(folder, truth)
    text = (folder / "run.csv").read_text()
    (folder / "run.csv").write_text(f"# robot: UR5e\n# operator: J. Doe, lab 2\n# rate: 100 Hz\n{text}")


def head_block(folder: Path, truth: Recorded) -> None:
    """A block about the recording in front of the header, as scopes write it."""
    columns = {"Time [s]": truth.time_s, **_columns(truth, done="{}.ActPos", told="{}.SetPos")}
    with (folder / "scope.csv").open("w") as file:
        file.write("Name;Scope Project\nFile;C:\\scope.svdx\nStart;2026-11-02 10:11:12\n\n")
        file.write(";".join(columns) + "\n")
        file.writelines(";".join(map(repr, map(float, row))) + "\n" for row in zip(*columns.values(), strict=True))


def npz_plain(folder: Path, truth: Recorded) -> None:
    """Arrays under short names."""
    np.savez(folder / "run.npz", time=truth.time_s, q=truth.done, dq=truth.speed, q_des=truth.told)


def npz_gym(folder: Path, truth: Recorded) -> None:
    """As legged gyms and ASAP call them, with the step."""
    step = truth.time_s[1] - truth.time_s[0]
    np.savez_compressed(folder / "run.npz", dof_pos=truth.done, dof_vel=truth.speed, dof_pos_target=truth.told, dt=step)


def npz_gaponet(folder: Path, truth: Recorded) -> None:
    """GapONet's layout."""
    names = ("positions", "velocities", "positions_cmd", "torques")
    values = (truth.done, truth.speed, truth.told, 0 * truth.done)
    arrays = {f"real_dof_{name}": value for name, value in zip(names, values, strict=True)}
    np.savez(folder / "run.npz", joint_sequence=np.array(truth.joints), payloads=np.array([0.5]), **arrays)


def npy(folder: Path, truth: Recorded) -> None:
    """A structured array."""
    columns = {"time": truth.time_s, **_columns(truth)}
    array = np.zeros(len(truth.time_s), [(name, "f8") for name in columns])
    for name, values in columns.items():
        array[name] = values
    np.save(folder / "run.npy", array)


def mat_plain(folder: Path, truth: Recorded) -> None:
    """MATLAB, version 5."""
    savemat(folder / "run.mat", {"t": truth.time_s[:, None], "q": truth.done, "q_des": truth.told})


def mat_struct(folder: Path, truth: Recorded) -> None:
    """A struct in it, compressed."""
    struct = {"time": truth.time_s, "position": truth.done, "command": truth.told, "names": list(truth.joints)}
    savemat(folder / "run.mat", {"log": struct}, do_compression=True)


def mat_joints_first(folder: Path, truth: Recorded) -> None:
    """A column is a sample."""
    savemat(folder / "run.mat", {"t": truth.time_s[None], "q": truth.done.T, "qd_ref": truth.told.T})


def mat_73(folder: Path, truth: Recorded) -> None:
    """MATLAB, version 7.3."""
    arrays = {"t": truth.time_s, "q": truth.done, "q_des": truth.told}
    _other("hdf5storage").savemat(str(folder / "run.mat"), arrays, format="7.3")


def hdf5_groups(folder: Path, truth: Recorded) -> None:
    """Groups for measurement and command."""
    with h5py.File(folder / "run.h5", "w") as file:
        file["time"], file["measured/position"], file["measured/velocity"] = truth.time_s, truth.done, truth.speed
        file["command/position"] = truth.told
        file["measured/position"].attrs["units"] = "rad"


def hdf5_joints(folder: Path, truth: Recorded) -> None:
    """A group for each joint."""
    with h5py.File(folder / "run.h5", "w") as file:
        file["time"] = truth.time_s
        for place, joint in enumerate(truth.joints):
            file[f"joints/{joint}/position"], file[f"joints/{joint}/command"] = (
                truth.done[:, place],
                truth.told[:, place],
            )


def isaac_lab(folder: Path, truth: Recorded) -> None:
    """Isaac Lab's recorder."""
    with h5py.File(folder / "dataset.hdf5", "w") as file:
        for number in range(2):
            group = file.create_group(f"data/demo_{number}")
            group["states/articulation/robot/joint_position"] = truth.done
            group["states/articulation/robot/joint_velocity"] = truth.speed
            group["actions"] = truth.told


def robomimic(folder: Path, truth: Recorded) -> None:
    """robomimic: a group for each demonstration, no clock."""
    with h5py.File(folder / "demo.hdf5", "w") as file:
        for number in range(2):
            group = file.create_group(f"data/demo_{number}")
            group.attrs["num_samples"] = len(truth.time_s)
            group["actions"], group["obs/robot0_joint_pos"] = truth.told, truth.done
            group["obs/robot0_joint_vel"] = truth.speed


def aloha(folder: Path, truth: Recorded) -> None:
    """ALOHA: no clock."""
    with h5py.File(folder / "episode_0.hdf5", "w") as file:
        file.attrs["sim"] = False
        file["action"], file["observations/qpos"], file["observations/qvel"] = truth.told, truth.done, truth.speed


def pandas_hdf(**how: Any) -> Callable[[Path, Recorded], None]:
    """Pandas through PyTables."""
    return lambda folder, truth: _frame(truth).to_hdf(folder / "run.h5", key="log", **how)


def rtde(folder: Path, truth: Recorded) -> None:
    """`record.py` of Universal Robots."""
    columns = {"timestamp": truth.time_s + 4321.0}
    for word, values in (("target_q", truth.told), ("actual_q", truth.done), ("actual_qd", truth.speed)):
        columns |= {f"{word}_{number}": values[:, number] for number in range(6)}
    frame = _other("pandas").DataFrame(columns)
    frame.to_csv(folder / "robot_data.csv", sep=" ", index=False)


def ticks(folder: Path, truth: Recorded) -> None:
    """Registers of Dynamixel."""
    counts = {
        f"{word}_{number + 1}": np.round(2048 + values[:, number] * 2048 / np.pi).astype(int)
        for word, values in (("present_position", truth.done), ("goal_position", truth.told))
        for number in range(len(truth.joints))
    }
    _other("pandas").DataFrame({"timestamp": truth.time_s, **counts}).to_csv(folder / "run.csv", index=False)


def moveit(folder: Path, truth: Recorded) -> None:
    """Names of ROS with slashes."""
    _csv(folder, truth, words={"done": "{}/position", "told": "{}/position_command"})


def archive(folder: Path, truth: Recorded) -> None:
    """A folder in an archive."""
    _csv(folder, truth)
    with tarfile.open(folder / "run.tar.gz", "w:gz") as file:
        file.add(folder / "run.csv", "recordings/run.csv")
    (folder / "run.csv").unlink()


def zipped(folder: Path, truth: Recorded) -> None:
    """As it is mailed."""
    _csv(folder, truth)
    with zipfile.ZipFile(folder / "logs.zip", "w", zipfile.ZIP_DEFLATED) as file:
        file.write(folder / "run.csv", "run.csv")
    (folder / "run.csv").unlink()


def excel(folder: Path, truth: Recorded) -> None:
    """Pandas through openpyxl."""
    _frame(truth).to_excel(folder / "run.xlsx", index=False)


def excel_degrees(folder: Path, truth: Recorded) -> None:
    """XlsxWriter, with units in the names."""
    frame = _frame(truth, done="{} [deg]", told="{} cmd [deg]", by=180 / np.pi, time="t [s]")
    frame.to_excel(folder / "run.xlsx", index=False, engine="xlsxwriter", sheet_name="log")


def pickled(folder: Path, truth: Recorded) -> None:
    """A pickle, which is not opened."""
    _frame(truth).to_pickle(folder / "run.pkl")


def lerobot(version: int) -> Callable[[Path, Recorded], None]:
    """LeRobot's files, its joints as LeRobot calls them."""

    def write(folder: Path, truth: Recorded) -> None:
        names = [f"{joint}.pos" for joint in truth.joints]
        count, step = len(truth.time_s), float(truth.time_s[1] - truth.time_s[0])
        feature = {"dtype": "float32", "shape": [len(names)], "names": names}
        path = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
        if version == 3:
            path = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
        info = {
            "codebase_version": "v3.0" if version == 3 else "v2.1",
            "robot_type": "ur5e",
            "total_episodes": 1,
            "total_frames": count,
            "fps": round(1 / step),
            "chunks_size": 1000,
            "splits": {"train": "0:1"},
            "data_path": path,
            "features": {"observation.state": feature, "action": feature},
        }
        (folder / "meta").mkdir()
        (folder / "meta" / "info.json").write_text(json.dumps(info))
        data = pa.table(
            {
                "observation.state": truth.done.astype(np.float32).tolist(),
                "action": truth.told.astype(np.float32).tolist(),
                "timestamp": np.arange(count, dtype=np.float32) * np.float32(step),
                "frame_index": np.arange(count),
                "episode_index": np.zeros(count, int),
                "index": np.arange(count),
                "task_index": np.zeros(count, int),
            }
        )
        where = folder / path.format(episode_chunk=0, episode_index=0, chunk_index=0, file_index=0)
        where.parent.mkdir(parents=True)
        parquet.write_table(data, where)
        if version == 3:
            episodes = {
                "episode_index": [0],
                "data/chunk_index": [0],
                "data/file_index": [0],
                "dataset_from_index": [0],
                "dataset_to_index": [count],
                "length": [count],
                "tasks": [["move"]],
            }
            (folder / "meta/episodes/chunk-000").mkdir(parents=True)
            parquet.write_table(pa.table(episodes), folder / "meta/episodes/chunk-000/file-000.parquet")
        else:
            line = {"episode_index": 0, "tasks": ["move"], "length": count}
            (folder / "meta" / "episodes.jsonl").write_text(json.dumps(line) + "\n")
            (folder / "meta" / "tasks.jsonl").write_text(json.dumps({"task_index": 0, "task": "move"}) + "\n")

    return write


def sage(folder: Path, truth: Recorded) -> None:
    """SAGE's three files of a motion."""
    own = folder / "motion_a"
    own.mkdir()
    stamps = np.round(1e6 * truth.time_s).astype(np.int64)
    lists = {name: [json.dumps(row) for row in values.tolist()] for name, values in (
        ("told", truth.told), ("done", truth.done), ("speed", truth.speed)
    )}  # fmt: skip
    frame, kind = _other("pandas").DataFrame, "CONTROL"
    frame({"type": kind, "timestamp": stamps, "positions": lists["told"]}).to_csv(own / "control.csv", index=False)
    state = {"positions": lists["done"], "velocities": lists["speed"], "torques": lists["speed"]}
    frame({"type": "STATE_MOTOR", "timestamp": stamps, **state}).to_csv(own / "state_motor.csv", index=False)
    (own / "joint_list.txt").write_text("\n".join(truth.joints) + "\n")


_JOINTS = ", ".join(f"joint_{number}" for number in range(1, 7))
_BARE = f"""joints: [{_JOINTS}]
header: [time, q1, q2, q3, q4, q5, q6, u1, u2, u3, u4, u5, u6]
series:
  measured: {{time: time, signals: {{position: {{columns: "q{{n}}", unit: rad}}}}}}
  command: {{time: time, signals: {{position: {{columns: "u{{n}}", unit: rad}}}}}}
"""
_DEGREES = {"done": "{} [deg]", "told": "{}_cmd [deg]", "by": 180 / np.pi, "time": "t [s]"}
_GERMAN = {"done": "{} Ist [Grad]", "told": "{} Soll [Grad]", "by": 180 / np.pi, "time": "Zeit [s]"}
TABLES: dict[str, Kind] = {
    "pandas: CSV": Kind(_table()),
    "pandas: CSV with its index": Kind(_table(index=True)),
    "pandas: numbered joints": Kind(_table(words={"done": "q#", "told": "q#_des"})),
    "pandas: degrees in the names": Kind(_table(words=_DEGREES)),
    "pandas: semicolons and decimal commas": Kind(_table(words=_GERMAN, sep=";", decimal=",")),
    "pandas: tabs, UTF-16": Kind(_table(name="run.tsv", sep="\t", encoding="utf-16")),
    "pandas: byte order mark": Kind(_table(encoding="utf-8-sig")),
    "pandas: gzip": Kind(_table(name="run.csv.gz")),
    "pandas: zst": Kind(_table(name="run.csv.zst")),
    "pandas: four digits": Kind(_table(float_format="%.4f"), precision=6e-5, precision_s=6e-5),
    "pandas: milliseconds": Kind(_time_as(lambda time_s: 1000 * time_s, "timestamp_ms")),
    "pandas: nanoseconds since 1970": Kind(
        _time_as(lambda time_s: START_S * 10**9 + np.round(1e9 * time_s).astype(np.int64), "timestamp")
    ),
    "pandas: seconds since 1970": Kind(_time_as(lambda time_s: START_S + time_s, "timestamp")),
    "pandas: dates": Kind(dates),
    "pandas: sec and nanosec": Kind(two_stamps),
    "pandas: a row for each joint": Kind(long),
    "pandas: lists in cells": Kind(vectors),
    "pandas: two topics, two rates": Kind(two_rates, told_every=4),
    "pandas: a file for each signal": Kind(apart),
    "pandas: no clock": Kind(clockless),
    "pandas: slashes in the names": Kind(moveit),
    "pandas: HDF5": Kind(pandas_hdf()),
    "pandas: HDF5 of columns": Kind(pandas_hdf(format="table", data_columns=True)),
    "pandas: a pickle": Kind(pickled),
    "pandas: JSON records": Kind(
        lambda folder, truth: _frame(truth).to_json(folder / "run.json", orient="records", double_precision=12)
    ),
    "pandas: JSON lines": Kind(json_lines),
    "pandas: JSON, columns by rows": Kind(json_frame("columns")),
    "pandas: JSON, rows by labels": Kind(json_frame("index")),
    "pandas: JSON, names and rows apart": Kind(json_frame("split")),
    "pandas: JSON with its schema": Kind(json_frame("table")),
    "pandas: two header rows": Kind(two_header_rows),
    "pandas: Parquet": Kind(lambda folder, truth: _frame(truth).to_parquet(folder / "run.parquet")),
    "fastparquet: Parquet": Kind(
        lambda folder, truth: _frame(truth).to_parquet(folder / "run.parquet", engine="fastparquet")
    ),
    "csv: a row of units": Kind(units_row),
    "csv: comments above": Kind(notes_above),
    "csv: a block above": Kind(head_block),
    "csv: cut in a line": Kind(cut, lost=1),
    "csv: the clock begins anew": Kind(two_in_one, motions=2, rows=_half),
    "csv: a column of trials": Kind(by_trial, motions=2, rows=_half),
    "numpy: a header behind #": Kind(commented),
    "numpy: no header": Kind(bare, second={"mapping": _BARE}, named=("header",)),
    "numpy: npz": Kind(npz_plain),
    "numpy: npz of a gym": Kind(npz_gym),
    "numpy: npz of GapONet": Kind(npz_gaponet),
    "numpy: structured npy": Kind(npy),
    "polars: lists in Parquet": Kind(polars_lists),
    "pyarrow: float32": Kind(arrow_float32),
    "pyarrow: Feather": Kind(arrow_feather),
    "openpyxl: Excel": Kind(excel),
    "XlsxWriter: Excel in degrees": Kind(excel_degrees),
    "json: columns": Kind(json_columns),
    "json: steps with vectors": Kind(json_steps),
    "json: lines with names": Kind(json_named),
    "json: packed lines": Kind(json_lines_packed),
    "json: joints in steps": Kind(json_nested),
    "scipy: MATLAB 5": Kind(mat_plain),
    "scipy: a struct": Kind(mat_struct),
    "scipy: a column is a sample": Kind(mat_joints_first),
    "hdf5storage: MATLAB 7.3": Kind(mat_73),
    "h5py: groups": Kind(hdf5_groups),
    "h5py: a group for each joint": Kind(hdf5_joints),
    "h5py: Isaac Lab": Kind(isaac_lab, motions=2),
    "h5py: robomimic": Kind(robomimic, motions=2),
    "h5py: ALOHA": Kind(aloha),
    "tarfile: a folder": Kind(archive),
    "zipfile: as it is mailed": Kind(zipped),
    "UR: record.py": Kind(rtde),
    "Dynamixel: registers": Kind(ticks, precision=1.6e-3),
    "LeRobot 2.1": Kind(lerobot(2), precision_s=1e-4),
    "LeRobot 3": Kind(lerobot(3), precision_s=1e-4),
    "SAGE": Kind(sage),
}
