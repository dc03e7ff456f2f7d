"""LeRobot v3: what is exported is read back, what others wrote is read by name, damage is refused."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries
from trueup.dataset import export_lerobot as exporter
from trueup.dataset.export_lerobot import export_lerobot
from trueup.dataset.importers import lerobot
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.lerobot_stats import RunningStats
from trueup.errors import (
    ConfigError,
    DataError,
    FormatError,
    MissingSignal,
    NameMismatch,
    OutputExists,
    UnitError,
)

FPS = 50
JOINTS = ("shoulder", "elbow.flex", "gripper")


def series(frames, signals, joints=JOINTS, seed=0, units=None):
    rng = np.random.default_rng(seed)
    values = {name: rng.normal(size=(frames, len(joints))).astype(np.float32) for name in signals}
    known = {"position": "rad", "velocity": "rad/s", "torque": "Nm", "temperature": "degC", "current": "A"}
    own = {name: (units or {}).get(name, (known[name],) * len(joints)) for name in signals}
    return TimeSeries(time_s=np.arange(frames) / FPS, joints=joints, signals=values, units=own)


def episode(number=0, frames=30, split="", command=("position",), measured=("position", "velocity", "torque"), **meta):
    units = {"position": ("rad", "deg", "1")}
    return Episode(
        meta=EpisodeMeta(id=meta.pop("id", f"run/{number}"), split=split, **meta),
        measured=series(frames, measured, seed=2 * number, units=units),
        command=series(frames, command, seed=2 * number + 1, units=units) if command else None,
    )


def export(episodes, folder, **options):
    export_lerobot(episodes, folder, fps=FPS, robot_type="so101_follower", **options)
    return folder


def load(folder, **options):
    plan = lerobot.scan(folder, ImportOptions(**options))
    return plan, [source.load() for source in plan.episodes]


def same(left, right):
    assert left.joints == right.joints
    assert left.units == right.units
    np.testing.assert_array_equal(left.time_s, right.time_s)
    assert set(left.signals) == set(right.signals)
    for name, values in left.signals.items():
        assert values.dtype == right[name].dtype == np.float32
        np.testing.assert_array_equal(values, right[name])


def test_what_is_exported_is_read_back_exactly(tmp_path):
    originals = [
        episode(0, 30, "train", unit="left", payload_kg=0.5, kp_setting=800.0, condition="fast"),
        episode(1, 1, "train"),
        episode(2, 75, "test", payload_kg=0.0),
        episode(3, 12, "val"),
        episode(4, 12, "train"),
    ]
    folder = export(iter(originals), tmp_path / "deep" / "out", task="reach the cube")
    assert lerobot.detects(folder)
    plan, copies = load(folder)
    assert plan.robot == "so101_follower"
    assert plan.splits == {item.id: item.meta.split for item in originals}
    assert not any("ASSUMED" in note for note in plan.notes)
    for original, copy in zip(originals, copies, strict=True):
        same(original.measured, copy.measured)
        same(original.commanded(), copy.commanded())
        for name in ("id", "unit", "payload_kg", "kp_setting", "condition"):
            assert getattr(original.meta, name) == getattr(copy.meta, name)
        assert [flag.detail for flag in copy.meta.flags] == ["task: reach the cube"]
        assert len(copy.meta.source_hash) == 64
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["out"]


@pytest.mark.parametrize("command", [("position", "velocity", "torque"), ("torque",), ()])
@pytest.mark.parametrize("joints", [JOINTS, ("only",)])
def test_every_kind_of_command_survives_also_for_one_joint(tmp_path, command, joints):
    original = Episode(
        meta=EpisodeMeta(id="a"),
        measured=series(20, ("position", "current", "temperature"), joints),
        command=series(20, command, joints, seed=1) if command else None,
    )
    plan, (copy,) = load(export([original], tmp_path / "out"))
    same(original.measured, copy.measured)
    if command:
        same(original.commanded(), copy.commanded())
    else:
        assert copy.command is None
        assert any("no command" in note for note in plan.notes)


def test_the_files_hold_what_lerobot_needs(tmp_path, monkeypatch):
    monkeypatch.setattr(exporter, "_FILE_MB", 0)  # every episode a file of its own
    monkeypatch.setattr(exporter, "_EPISODES_PER_FILE", 2)
    monkeypatch.setattr(exporter, "_EPISODES_PER_GROUP", 1)
    originals = [episode(number, frames) for number, frames in enumerate((40, 300, 7))]
    folder = export(originals, tmp_path / "out", task="reach")
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_episodes"], info["total_frames"]) == ("v3.0", 50, 3, 347)
    assert info["splits"] == {"train": "0:3"}
    state = info["features"]["observation.state"]
    assert (state["dtype"], state["shape"]) == ("float32", [3])
    assert state["names"] == ["shoulder.pos", "elbow.flex.pos", "gripper.pos"]
    assert set(info["features"]) == {
        "observation.state", "observation.velocity", "observation.effort", "action",
        "timestamp", "frame_index", "episode_index", "index", "task_index",
    }  # fmt: skip
    tables = [pq.read_table(folder / f"data/chunk-000/file-00{k}.parquet") for k in range(3)]
    assert tables[0].schema.field("action").type == pa.list_(pa.float32(), 3)
    assert tables[0].schema.field("timestamp").type == pa.float32()
    assert tables[0].column_names == list(info["features"])
    table = pa.concat_tables(tables)
    np.testing.assert_array_equal(table["index"], np.arange(347))
    np.testing.assert_array_equal(table["episode_index"], np.repeat([0, 1, 2], (40, 300, 7)))
    np.testing.assert_array_equal(table["frame_index"], np.concatenate([np.arange(n) for n in (40, 300, 7)]))
    rows = [pq.read_table(folder / f"meta/episodes/chunk-000/file-00{k}.parquet").to_pylist() for k in range(2)]
    assert [len(part) for part in rows] == [2, 1]
    rows = rows[0] + rows[1]
    assert [row["dataset_from_index"] for row in rows] == [0, 40, 340]
    assert [row["dataset_to_index"] for row in rows] == [40, 340, 347]
    assert [row["data/file_index"] for row in rows] == [0, 1, 2]
    assert [row["meta/episodes/file_index"] for row in rows] == [0, 0, 1]
    assert [row["length"] for row in rows] == [40, 300, 7]
    assert rows[0]["tasks"] == ["reach"]
    check_stats(folder, info, table, rows[1], originals[1])
    tasks = pq.read_table(folder / "meta/tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "task": ["reach"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]


def check_stats(folder, info, table, row, original):
    """Statistics against numpy: of one episode exactly, of all within one bin of the histogram."""
    position = original.measured["position"].astype(np.float64)
    np.testing.assert_allclose(row["stats/observation.state/q10"], np.quantile(position, 0.1, axis=0), rtol=1e-12)
    np.testing.assert_allclose(row["stats/observation.state/std"], position.std(axis=0), rtol=1e-12)
    assert row["stats/observation.state/count"] == [300]
    stats = json.loads((folder / "meta/stats.json").read_text())
    assert set(stats) == set(info["features"])
    for name, found in stats.items():
        values = np.array(table[name].to_pylist(), dtype=np.float64).reshape(347, -1)
        for key, function in (("min", np.min), ("max", np.max), ("mean", np.mean), ("std", np.std)):
            np.testing.assert_allclose(found[key], function(values, axis=0), rtol=1e-9, atol=1e-12)
        bin_width = (values.max(axis=0) - values.min(axis=0)) / 5000
        for key, share in (("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)):
            ordered = np.sort(values, axis=0)
            low, high = (ordered[int(np.clip(share * 347 + step, 0, 346))] for step in (-2, 1))
            assert np.all(np.array(found[key]) >= low - 2 * bin_width)
            assert np.all(np.array(found[key]) <= high + 2 * bin_width)
        assert found["count"] == [347]


def test_running_statistics_do_not_lose_digits_far_from_zero():
    blocks = np.random.default_rng(0).normal(size=(20, 50, 2)) + 1e8
    running = RunningStats(2)
    for block in blocks:
        running.add(block)
    flat = blocks.reshape(-1, 2)
    np.testing.assert_allclose(running.summary()["std"], flat.std(axis=0), rtol=1e-6)
    np.testing.assert_allclose(running.summary()["mean"], flat.mean(axis=0), rtol=1e-14)


def shifted(original, **clocks):
    return replace(original, **{name: replace(getattr(original, name), time_s=clock) for name, clock in clocks.items()})


def nan(original):
    values = original.measured["position"].copy()
    values[3, 1] = np.nan
    return replace(
        original, measured=replace(original.measured, signals={**original.measured.signals, "position": values})
    )


GRID = np.arange(30) / FPS
BAD = {
    "jitter": (lambda e: shifted(e, measured=GRID + 2e-4 * (np.arange(30) == 7)), "row 7 is 0.0002 s away"),
    "rate": (lambda e: shifted(e, measured=np.arange(30) / 49, command=np.arange(30) / 49), "Resample"),
    "clocks": (lambda e: shifted(e, command=GRID + 0.01), "clocks of their own"),
    "length": (lambda e: replace(e, command=e.command.rows(slice(0, 29))), "clocks of their own"),
    "nan": (nan, "position of elbow.flex, row 3"),
    "no position": (lambda e: replace(e, measured=series(30, ("velocity",))), "no measured position"),
}


@pytest.mark.parametrize("kind", BAD)
def test_episodes_that_do_not_fit_are_refused_and_leave_nothing_behind(tmp_path, kind):
    change, text = BAD[kind]
    with pytest.raises(DataError, match=text):
        export([episode(0), change(episode(1))], tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_a_clock_within_tolerance_and_with_another_origin_is_accepted(tmp_path):
    clock = GRID + 3.0 + 0.9e-4 * np.sin(np.arange(30))
    _, (copy,) = load(export([shifted(episode(), measured=clock, command=clock)], tmp_path / "out"))
    np.testing.assert_array_equal(copy.measured.time_s, GRID)


def test_other_joints_signals_or_units_than_the_first_are_refused(tmp_path):
    for other in (
        replace(episode(1), measured=series(30, ("position", "velocity", "torque"), ("a", "b", "c"))),
        episode(1, command=()),
        episode(1, measured=("position",)),
        replace(episode(1), command=series(30, ("position",))),
    ):
        with pytest.raises(NameMismatch, match="than the first"):
            export([episode(0), other], tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_export_does_not_touch_what_is_there_and_needs_episodes(tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(OutputExists):
        export([episode()], tmp_path / "out")
    with pytest.raises(DataError, match="no episodes"):
        export([], tmp_path / "new")
    with pytest.raises(ConfigError, match="fps"):
        export_lerobot([episode()], tmp_path / "new", fps=0, robot_type="x")
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="it is a file"):
        export([episode()], tmp_path / "file" / "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "out"]


def test_an_interrupted_export_leaves_no_dataset(tmp_path):
    def episodes():
        yield episode(0)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(episodes(), tmp_path / "out")
    assert not list(tmp_path.iterdir())


def foreign(folder: Path, features, frames=(20, 30), fps=30, groups=1, stamps=None, **info):
    """A dataset as others write it: features maps name -> (names, values (N, W) or None for a video)."""
    total = sum(frames)
    columns, described = {}, {}
    for name, (names, values) in features.items():
        if values is None:
            described[name] = {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"]}
            continue
        described[name] = {"dtype": "float32", "shape": [values.shape[1]], "names": names}
        columns[name] = pa.array(values.astype(np.float32).tolist(), pa.list_(pa.float32()))
    counter = np.concatenate([np.arange(n) for n in frames])
    columns["timestamp"] = pa.array((counter / fps if stamps is None else stamps).astype(np.float32))
    columns["frame_index"] = pa.array(counter)
    columns["episode_index"] = pa.array(np.repeat(np.arange(len(frames)), frames))
    columns["index"] = pa.array(np.arange(total))
    data = folder / "data/chunk-000/file-000.parquet"
    data.parent.mkdir(parents=True)
    pq.write_table(pa.table(columns), data, row_group_size=max(total // groups, 1))
    (folder / "meta/episodes/chunk-000").mkdir(parents=True)
    count = len(frames)
    table = {
        "episode_index": list(range(count)),
        "tasks": [["pick"]] * count,
        "length": list(frames),
        "data/chunk_index": [0] * count,
        "data/file_index": [0] * count,
    }
    pq.write_table(pa.table(table), folder / "meta/episodes/chunk-000/file-000.parquet")
    content = {
        "codebase_version": "v3.0",
        "robot_type": "so101_follower",
        "fps": fps,
        "splits": {"train": f"0:{count}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "features": described,
        **info,
    }
    (folder / "meta/info.json").write_text(json.dumps(content))
    return folder


def values(width, seed=0, total=50):
    return np.random.default_rng(seed).normal(size=(total, width)).astype(np.float32)


ARM = ["pan.pos", "lift.pos", "gripper.pos"]


@pytest.mark.parametrize("groups", [1, 7])
@pytest.mark.parametrize("names", [ARM, {"motors": ARM}, ["pan", "lift", "gripper"]])
def test_datasets_of_others_are_read_by_name(tmp_path, groups, names):
    state, action = values(3), values(3, 1)
    features = {
        "observation.state": (names, state),
        "action": (list(ARM[::-1]), action),
        "observation.images.front": (None, None),
    }
    plan, (first, second) = load(foreign(tmp_path / "d", features, groups=groups))
    assert [first.id, second.id] == ["episode_000000", "episode_000001"]
    assert first.measured.joints == ("pan", "lift", "gripper")
    np.testing.assert_array_equal(first.measured["position"], state[:20])
    np.testing.assert_array_equal(second.measured["position"], state[20:])
    np.testing.assert_array_equal(second.commanded().select(("gripper", "lift", "pan"))["position"], action[20:])
    np.testing.assert_array_equal(second.measured.time_s, np.arange(30) / 30)
    notes = "\n".join(plan.notes)
    assert "UNITS ARE ASSUMED" in notes
    assert "observation.images.front" in notes
    assert "no split is assigned" in notes
    assert plan.splits == {}


def test_units_are_stated_by_the_user_and_impossible_ones_are_flagged(tmp_path):
    features = {"observation.state": (ARM, values(3) * 100), "action": (ARM, values(3))}
    folder = foreign(tmp_path / "d", features)
    _, (assumed, _) = load(folder)
    flag = next(flag for flag in assumed.meta.flags if flag.kind == "unit")
    assert (flag.series, flag.signal, flag.severity) == ("measured", "position", "warning")
    plan, (stated, _) = load(folder, units={"position": "deg", "position.gripper": "%"})
    assert stated.measured.units["position"] == ("deg", "deg", "%")
    assert not any(flag.kind == "unit" for flag in stated.meta.flags)
    assert not any("ASSUMED" in note for note in plan.notes)
    with pytest.raises(UnitError):
        load(folder, units={"position": "parsec"})


def test_signals_are_told_apart_by_feature_and_ending(tmp_path):
    mixed = values(5)
    features = {
        "observation.state": (["pan.pos", "lift.pos", "pan.vel", "lift.vel", "base_x.vel"], mixed),
        "observation.effort": (["lift.pos", "pan.pos"], values(2, 3)),
        "observation.current": (None, values(7, 4)),
        "action": (["pan.pos", "lift.pos"], values(2, 1)),
    }
    plan, (first, _) = load(foreign(tmp_path / "d", features))
    assert first.measured.joints == ("pan", "lift")
    np.testing.assert_array_equal(first.measured["velocity"], mixed[:20, 2:4])
    np.testing.assert_array_equal(first.measured["torque"], values(2, 3)[:20, ::-1])
    assert set(first.measured.signals) == {"position", "velocity", "torque"}
    notes = "\n".join(plan.notes)
    assert "base_x" in notes
    assert "observation.current names no joints" in notes


def test_unnamed_features_need_stated_names(tmp_path):
    features = {"observation.state": (["dim"], values(3)), "action": (None, values(3, 1))}
    folder = foreign(tmp_path / "d", features)
    with pytest.raises(ConfigError, match=r"(?s)state does not name.*3 values.*joints: \[joint1, joint2, joint3\]"):
        load(folder)
    (tmp_path / "m.yaml").write_text("joints: [a, b, c]\n")
    _, (first, _) = load(folder, mapping=tmp_path / "m.yaml")
    assert first.measured.joints == first.commanded().joints == ("a", "b", "c")


def test_state_and_action_without_a_common_joint_are_refused(tmp_path):
    features = {"observation.state": (ARM, values(3)), "action": (["x", "y", "z"], values(3))}
    with pytest.raises(NameMismatch, match=r"observation.state \[pan, lift, gripper\], action \[x, y, z\]"):
        load(foreign(tmp_path / "d", features))
    with pytest.raises(MissingSignal, match=r"observation\.state"):
        load(foreign(tmp_path / "e", {"action": (ARM, values(3))}))


def test_splits_are_ranges_of_episodes(tmp_path):
    features = {"observation.state": (ARM, values(3, total=40))}
    frames = (10, 10, 10, 10)
    splits = {"train": "0:1,3:4", "validation": "1:2", "test": "2:3", "mine": "0:4"}
    plan, _ = load(foreign(tmp_path / "a", features, frames, splits=splits))
    assert [plan.splits[source.id] for source in plan.episodes] == ["train", "val", "test", "train"]
    assert any("'mine' is unknown" in note for note in plan.notes)
    for wrong in ({"train": "all"}, {"train": "0:2", "test": "1:3"}, {"train": 3}):
        shutil.rmtree(tmp_path / "b", ignore_errors=True)
        with pytest.raises(DataError):
            load(foreign(tmp_path / "b", features, frames, splits=wrong))


def test_stamps_off_the_grid_are_kept_as_they_are(tmp_path):
    stamps = np.concatenate([np.arange(20) * 0.034 + 1.0, np.arange(30) / 30])
    _, (first, second) = load(foreign(tmp_path / "d", {"observation.state": (ARM, values(3))}, stamps=stamps))
    np.testing.assert_allclose(first.measured.time_s, np.arange(20) * 0.034, atol=1e-6)
    np.testing.assert_array_equal(second.measured.time_s, np.arange(30) / 30)


@pytest.mark.parametrize("version", ["v1.6", "v4.0", None, 3, "latest"])
def test_other_versions_are_refused(tmp_path, version):
    folder = foreign(tmp_path / "d", {"observation.state": (ARM, values(3))}, codebase_version=version)
    with pytest.raises(FormatError) as raised:
        load(folder)
    assert str(version) in str(raised.value) or version is None
    assert "v2.1" in str(raised.value)


def second_version(folder, version, *, chunk=1):
    """The same dataset as versions 2 have it: a file for each episode, and a line of JSON about it."""
    content = json.loads((folder / "meta/info.json").read_text())
    content |= {
        "codebase_version": version,
        "chunks_size": chunk,
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    }
    whole = pq.read_table(folder / "data/chunk-000/file-000.parquet")
    lines = []
    for number in sorted(set(whole["episode_index"].to_pylist())):
        own = whole.filter(pc.equal(whole["episode_index"], number))
        path = folder / f"data/chunk-{number // chunk:03d}/episode_{number:06d}.parquet"
        path.parent.mkdir(exist_ok=True)
        pq.write_table(own, path)
        lines.append(json.dumps({"episode_index": number, "tasks": ["pick"], "length": len(own)}))
    (folder / "data/chunk-000/file-000.parquet").unlink()
    shutil.rmtree(folder / "meta/episodes")
    (folder / "meta/episodes.jsonl").write_text("\n".join(lines) + "\n")
    (folder / "meta/info.json").write_text(json.dumps(content))
    return folder


@pytest.mark.parametrize("version", ["v2.0", "v2.1"])
@pytest.mark.parametrize("chunk", [1, 1000])
def test_the_second_version_says_the_same_as_the_third(tmp_path, version, chunk):
    features = {"observation.state": (ARM, values(3)), "action": (ARM, values(3, seed=1))}
    _, third = load(foreign(tmp_path / "c", features))
    _, second = load(second_version(foreign(tmp_path / "d", features), version, chunk=chunk))
    assert [one.id for one in second] == [one.id for one in third]
    for one, other in zip(second, third, strict=True):
        np.testing.assert_array_equal(one.measured["position"], other.measured["position"])
        np.testing.assert_array_equal(one.command["position"], other.command["position"])
        np.testing.assert_array_equal(one.measured.time_s, other.measured.time_s)


@pytest.mark.parametrize("line", ["{", "[1]", '{"episode_index": 0}', '{"episode_index": -1, "length": 3}', ""])
def test_damaged_lines_about_episodes_are_refused(tmp_path, line):
    folder = second_version(foreign(tmp_path / "d", {"observation.state": (ARM, values(3))}), "v2.1")
    (folder / "meta/episodes.jsonl").write_text(line)
    with pytest.raises(DataError, match=r"episodes\.jsonl"):
        load(folder)


@pytest.mark.parametrize(
    "template",
    [
        "../{file_index}.parquet",
        "/etc/passwd",
        "data/../../x",
        "{0}",
        "{chunk_index.__class__}",
        "{chunk_index:999999999999d}",
        "",
        "data\\..\\x",
    ],
)
def test_templates_cannot_leave_the_folder_or_do_anything_else(tmp_path, template):
    folder = foreign(tmp_path / "d", {"observation.state": (ARM, values(3))}, data_path=template)
    with pytest.raises(FormatError, match="data_path"):
        load(folder)


@pytest.mark.parametrize(
    "info",
    [
        {"fps": 0}, {"fps": "fast"}, {"fps": None}, {"fps": True}, {"features": []}, {"features": {"a": 3}},
        {"data_path": None}, {"splits": [1]},
        {"features": {"observation.state": {"dtype": "float32", "shape": [4], "names": ["a", "b", "c", "d"]}}},
        {"features": {"observation.effort": {}, "observation.state": {"dtype": "float32", "shape": [3],
                                                                      "names": ["a.pos", "a", "b"]}}},
    ],
)  # fmt: skip
def test_metadata_that_make_no_sense_are_refused(tmp_path, info):
    folder = foreign(tmp_path / "d", {"observation.state": (ARM, values(3))})
    path = folder / "meta/info.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **info}))
    with pytest.raises(DataError):
        load(folder)


def test_missing_frames_and_files_are_refused(tmp_path):
    folder = foreign(tmp_path / "d", {"observation.state": (ARM, values(3))})
    episodes = folder / "meta/episodes/chunk-000/file-000.parquet"
    table = pq.read_table(episodes)
    pq.write_table(table.set_column(2, "length", pa.array([20, 31])), episodes)
    plan = lerobot.scan(folder, ImportOptions())
    assert len(plan.episodes[0].load().measured) == 20
    with pytest.raises(DataError, match=r"not complete.*30 frames; expected frames 0 to 30"):
        plan.episodes[1].load()
    pq.write_table(pa.concat_tables([table, table]), episodes)
    with pytest.raises(DataError, match="twice"):
        load(folder)
    pq.write_table(table.drop_columns(["length"]), episodes)
    with pytest.raises(DataError, match=r"no columns \['length'\]"):
        load(folder)
    pq.write_table(table, episodes)
    shutil.rmtree(folder / "data")
    with pytest.raises(DataError, match="does not exist"):
        load(folder)


def test_links_are_followed_since_the_download_cache_consists_of_them(tmp_path):
    folder = foreign(tmp_path / "d", {"observation.state": (ARM, values(3))})
    for number, path in enumerate(sorted(path for path in folder.rglob("*") if path.is_file())):
        path.rename(tmp_path / f"blob{number}")
        path.symlink_to(tmp_path / f"blob{number}")
    _, episodes = load(folder)
    assert [len(episode.measured) for episode in episodes] == [20, 30]
