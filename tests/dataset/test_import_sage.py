import csv
import hashlib
import json

import numpy as np
import pytest

from trueup.dataset.importers import sage
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import ConfigError, DataError, FormatError, NameMismatch, UnitError

JOINTS = ("Pan", "Lift", "Jaw")


def vector(values):
    return '"' + json.dumps(list(values)) + '"'


def control_rows(stamps):
    return [f"CONTROL,{stamp},{vector([k, k + 0.5, -k])}" for k, stamp in enumerate(stamps)]


def state_rows(stamps):
    return [
        f"STATE_MOTOR,{stamp},{vector([k, 2 * k, 3 * k])},{vector([k, 0.0, 1e-3])},{vector([0.1, 0.2, k])}"
        for k, stamp in enumerate(stamps)
    ]


def write_motion(folder, stamps=(1e6, 1.02e6, 1.04e6), command_stamps=None, joints=JOINTS):
    folder.mkdir(parents=True)
    control = ["type,timestamp,positions", *control_rows(command_stamps or stamps)]
    state = ["type,timestamp,positions,velocities,torques", *state_rows(stamps)]
    (folder / "control.csv").write_text("\n".join(control) + "\n")
    (folder / "state_motor.csv").write_text("\n".join(state) + "\n")
    (folder / "joint_list.txt").write_text("\n".join(joints) + "\n")
    return folder


def load(path, **options):
    (source,) = sage.scan(path, ImportOptions(**options)).episodes
    return source.load()


def test_a_motion_has_the_samples_of_its_files(tmp_path):
    folder = write_motion(tmp_path / "wave", stamps=(2e6, 2.02e6, 2.05e6), command_stamps=(1.99e6, 2.01e6))
    episode = load(tmp_path, robot="arm")
    assert episode.id == "wave"
    assert episode.meta.robot == "arm"
    assert episode.measured.joints == JOINTS
    np.testing.assert_allclose(episode.command.time_s, [0.0, 0.02], atol=1e-12)
    np.testing.assert_allclose(episode.measured.time_s, [0.01, 0.03, 0.06], atol=1e-12)
    np.testing.assert_array_equal(episode.measured["position"], [[0, 0, 0], [1, 2, 3], [2, 4, 6]])
    np.testing.assert_array_equal(episode.measured["velocity"], [[0, 0, 1e-3], [1, 0, 1e-3], [2, 0, 1e-3]])
    np.testing.assert_array_equal(episode.measured["torque"], [[0.1, 0.2, 0], [0.1, 0.2, 1], [0.1, 0.2, 2]])
    np.testing.assert_array_equal(episode.command["position"], [[0, 0.5, 0], [1, 1.5, -1]])
    assert episode.measured.units["torque"] == ("Nm",) * 3
    content = b"".join((folder / name).read_bytes() for name in ("control.csv", "state_motor.csv", "joint_list.txt"))
    assert episode.meta.source_hash == hashlib.sha256(content).hexdigest()
    assert episode.meta.source == "wave"
    assert episode.meta.flags == ()


def test_what_lies_beside_the_motions_is_found(tmp_path):
    for name in ("b", "a", "c"):
        write_motion(tmp_path / name)
    (tmp_path / "notes").mkdir()
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "arm.xml").write_text("<mujoco/>")
    (tmp_path / "LICENSE").write_text("\n   Some License\n   Version 2.0, May 1999\n")
    (tmp_path / "split.json").write_text('{"train": ["a"], "test": ["b", "gone"]}')
    plan = sage.scan(tmp_path, ImportOptions())
    assert [source.id for source in plan.episodes] == ["a", "b", "c"]
    assert plan.splits == {"a": "train", "b": "test"}
    assert plan.model_dir == tmp_path / "model"
    assert plan.licence == "Some License Version 2.0, May 1999"
    assert any("notes" in note for note in plan.notes)
    assert not any("model" in note for note in plan.notes)
    assert any("gone" in note for note in plan.notes)
    assert plan.episodes[0].bytes == sum(path.stat().st_size for path in (tmp_path / "a").iterdir())


def test_one_motion_is_imported_by_its_folder_with_the_split_beside_it(tmp_path):
    for name in ("a", "b"):
        write_motion(tmp_path / name)
    (tmp_path / "split.json").write_text('{"train": ["a"], "val": ["b"]}')
    plan = sage.scan(tmp_path / "b", ImportOptions())
    assert [source.id for source in plan.episodes] == ["b"]
    assert plan.splits == {"b": "val"}
    assert not any("split" in note for note in plan.notes)


def test_an_episode_in_two_splits_is_refused(tmp_path):
    write_motion(tmp_path / "a")
    (tmp_path / "split.json").write_text('{"train": ["a"], "val": ["a"]}')
    with pytest.raises(DataError, match="two splits"):
        sage.scan(tmp_path, ImportOptions())


def test_units_that_the_user_states_win(tmp_path):
    write_motion(tmp_path / "a")
    episode = load(tmp_path, units={"position.Jaw": "1", "position": "deg", "velocity.Jaw": "1/s"})
    assert episode.measured.units["position"] == ("deg", "deg", "1")
    assert episode.command.units["position"] == ("deg", "deg", "1")
    assert episode.measured.units["velocity"] == ("rad/s", "rad/s", "1/s")


@pytest.mark.parametrize(
    ("units", "error", "words"),
    [
        ({"position": "parsec"}, UnitError, "parsec"),
        ({"place": "rad"}, ConfigError, "place.*available.*position"),
        ({"position.Gripper": "1"}, NameMismatch, "Gripper.*Pan, Lift, Jaw"),
    ],
)
def test_a_wrong_unit_names_what_there_is(tmp_path, units, error, words):
    write_motion(tmp_path / "a")
    with pytest.raises(error, match=words):
        load(tmp_path, units=units)


def test_the_first_of_repeated_stamps_is_kept_and_flagged_on_the_episode_clock(tmp_path):
    write_motion(tmp_path / "a", stamps=(5e6, 5.02e6, 5.02e6, 5.02e6, 5.04e6))
    episode = load(tmp_path)
    np.testing.assert_array_equal(episode.measured["position"][:, 0], [0, 1, 4])
    flags = {flag.series: flag for flag in episode.meta.flags}
    assert set(flags) == {"measured", "command"}
    assert flags["measured"].kind == "repeated_stamps"
    assert flags["measured"].detail.startswith("2 of 5")
    assert flags["measured"].start_s == pytest.approx(0.02)


def replace_in(name, old, new, count=1):
    def change(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, count))

    return change


def write(name, content):
    return lambda folder: (folder / name).write_bytes(content)


STATE = "state_motor.csv"


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (write("control.csv", b""), r"control.csv is empty"),
        (write(STATE, b"type,timestamp,positions,velocities,torques\n"), r"state_motor.csv has a header but no rows"),
        (
            replace_in(STATE, "[1, 2, 3]", "[1, 2]"),
            r"state_motor.csv, line 3, column 'positions'.*2 values.*expected 3",
        ),
        (replace_in(STATE, "[1, 2, 3]", "[1, 2, 3, 4]"), r"state_motor.csv, line 3.*4 values"),
        (replace_in(STATE, "[1, 2, 3]", "[1, [2], 3]"), r"line 3.*'\[2\]'"),
        (replace_in(STATE, "[1, 2, 3]", "[1, , 3]"), r"line 3"),
        (replace_in(STATE, "[1, 2, 3]", "1, 2, 3"), r"line 3.*JSON list"),
        (replace_in(STATE, "[1, 2, 3]", "[1, NaN, 3]"), r"line 3, column 'positions'.*NaN.*finite"),
        (replace_in(STATE, "[1, 2, 3]", "[1, -Infinity, 3]"), r"line 3.*finite"),
        (replace_in(STATE, "[1, 2, 3]", "[1, 1e999, 3]"), r"line 3"),
        (replace_in(STATE, "[1, 2, 3]", '[1, ""x"", 3]'), r"line 3"),
        (replace_in(STATE, "[1, 2, 3]", "[" * 5000 + "]" * 5000), r"line 3"),
        (replace_in(STATE, ",1020000.0,", ",soon,"), r"line 3, column 'timestamp'.*soon"),
        (replace_in(STATE, ",1020000.0,", ",nan,"), r"state_motor.csv.*not finite.*row 2"),
        (replace_in(STATE, ",1020000.0,", ",1e30,"), r"state_motor.csv.*no clock shows"),
        (replace_in("control.csv", ",1020000.0,", ",900000.0,"), r"control.csv runs backwards.*row 2"),
        (replace_in("joint_list.txt", "Jaw\n", ""), r"3 values.*expected 2, one for each joint of joint_list.txt"),
        (write("joint_list.txt", b"\n"), r"joint_list.txt names no joint"),
        (write("joint_list.txt", b"\xff\xfe"), r"joint_list.txt is not UTF-8"),
        (lambda folder: (folder / "joint_list.txt").unlink(), r"cannot read .*joint_list.txt"),
        (lambda folder: (folder / "control.csv").unlink(), r"cannot read .*control.csv"),
        (
            lambda folder: write(STATE, (folder / STATE).read_bytes()[:-30])(folder),
            r"state_motor.csv",
        ),
        (
            lambda folder: write(STATE, (folder / STATE).read_bytes().rpartition(b',"')[0] + b"\n")(folder),
            r"wrong length in line 4.*got 4 fields; expected 5",
        ),
    ],
)
def test_damaged_files_are_named_with_the_line(tmp_path, damage, words):
    damage(write_motion(tmp_path / "a"))
    with pytest.raises(DataError, match="(?s)" + words):
        load(tmp_path)


def test_a_missing_column_prints_both_lists(tmp_path):
    replace_in(STATE, "velocities", "speeds")(write_motion(tmp_path / "a"))
    with pytest.raises(NameMismatch, match=r"state_motor.csv.*velocities.*timestamp, positions, speeds, torques"):
        load(tmp_path)


def test_windows_line_ends_a_byte_order_mark_and_empty_lines_do_not_matter(tmp_path):
    plain = write_motion(tmp_path / "plain")
    odd = write_motion(tmp_path / "odd")
    for name in ("control.csv", STATE, "joint_list.txt"):
        content = (plain / name).read_bytes().replace(b"\n", b"\r\n")
        (odd / name).write_bytes(b"\xef\xbb\xbf" + content + b"\r\n\r\n")
    a, b = load(plain), load(odd)
    assert a.measured.joints == b.measured.joints
    np.testing.assert_array_equal(a.measured["torque"], b.measured["torque"])
    np.testing.assert_array_equal(a.command.time_s, b.command.time_s)


def test_links_out_of_the_folder_are_refused(tmp_path):
    outside = write_motion(tmp_path / "outside")
    inner = write_motion(tmp_path / "logs" / "a")
    (inner / "control.csv").unlink()
    (inner / "control.csv").symlink_to(outside / "control.csv")
    with pytest.raises(DataError, match="leads out of the folder"):
        load(tmp_path / "logs")
    (tmp_path / "logs" / "linked").symlink_to(outside)
    with pytest.raises(DataError, match="leads out of the folder"):
        sage.scan(tmp_path / "logs", ImportOptions()).episodes[1].load()


def test_a_folder_without_motions_is_another_format(tmp_path):
    assert not sage.detects(tmp_path)
    assert not sage.detects(tmp_path / "missing")
    with pytest.raises(FormatError, match="no SAGE motion"):
        sage.scan(tmp_path, ImportOptions())


def test_the_so101_motions(so101_logs):
    assert sage.detects(so101_logs)
    plan = sage.scan(so101_logs, ImportOptions(units={"position.Jaw": "1"}))
    assert len(plan.episodes) == 43
    counts = {split: list(plan.splits.values()).count(split) for split in ("train", "val", "test")}
    assert counts == {"train": 33, "val": 4, "test": 6}
    assert plan.licence.startswith("Apache License")
    assert plan.model_dir == so101_logs / "model"
    assert not any("split.json" in note or "split '" in note for note in plan.notes)
    chirp = next(source for source in plan.episodes if source.id == "chirp_sweep").load()
    assert plan.splits["chirp_sweep"] == "test"
    assert chirp.measured.joints == ("Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll", "Jaw")
    assert chirp.measured.units["position"] == ("rad",) * 5 + ("1",)
    assert chirp.measured.rate_hz == pytest.approx(49.85, abs=0.05)
    with (so101_logs / "chirp_sweep" / "state_motor.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for column, signal in (("positions", "position"), ("velocities", "velocity"), ("torques", "torque")):
        np.testing.assert_array_equal(chirp.measured[signal], [json.loads(row[column]) for row in rows])
    stamps = np.array([float(row["timestamp"]) for row in rows]) / 1e6
    np.testing.assert_allclose(chirp.measured.time_s, stamps - stamps[0], atol=1e-9)
    assert chirp.command["position"][0].tolist() == [0.0, 0.129904, 0.629904, 0.0, -0.129904, 0.370096]


@pytest.mark.parametrize("per_second", [1, 1e6])
def test_a_simulator_counts_seconds_and_a_robot_microseconds(tmp_path, per_second):
    stamps = tuple(per_second * stamp for stamp in (0.0, 0.005, 0.01, 0.015))
    write_motion(tmp_path / "wave", stamps=stamps)
    for series in (load(tmp_path).measured, load(tmp_path).command):
        np.testing.assert_allclose(series.time_s, [0.0, 0.005, 0.01, 0.015], atol=1e-12)
