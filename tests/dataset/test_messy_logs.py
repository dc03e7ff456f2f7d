"""Logs as people leave them: what stands above the samples, in other orders, in several clocks and under plain numbers.

Each is written by hand or by the library that others use, and what is suggested for it has to read it as it was meant.
"""

import json
import os

import h5py
import numpy as np
import openpyxl
import pytest
import scipy.io

from trueup.align import JointMap
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.table import suggested
from trueup.dataset.importers.text_table import Head, dates, head_of
from trueup.errors import DataError, FormatError
from trueup.stages import draft, plan_import

T = np.arange(0.0, 4.0, 0.01)
JOINTS = ("yaw", "wrist_1", "wrist_2")
DONE = np.column_stack([np.sin((1.0 + 0.3 * k) * T + k) for k in range(3)])
TOLD = np.column_stack([np.sin((1.0 + 0.3 * k) * (T + 0.03) + k) for k in range(3)])
NAMES = [*(f"{joint}.position" for joint in JOINTS), *(f"{joint}.command" for joint in JOINTS)]
ROWS = np.column_stack([T, DONE, TOLD])


def text_of(rows, sep=","):
    return "\n".join(sep.join(map(str, row)) for row in rows) + "\n"


def read(folder):
    """What the suggestion for these logs reads."""
    found = suggested(folder)
    assert found is not None
    path = folder.parent / "mapping.yaml"
    path.write_text(found.text)
    plan = plan_import(folder, options=ImportOptions(mapping=path))
    return found, [source.load() for source in plan.episodes]


def right(motion, *, joints=JOINTS, done=DONE, told=TOLD):
    assert motion.measured.joints == joints
    np.testing.assert_allclose(motion.measured["position"], done, atol=1e-9)
    np.testing.assert_allclose(motion.measured.time_s - motion.measured.time_s[0], T[: len(done)], atol=1e-6)
    np.testing.assert_allclose(motion.command["position"], told, atol=1e-9)


@pytest.fixture
def logs(tmp_path):
    (tmp_path / "logs").mkdir()
    return tmp_path / "logs"


HEADS = {
    "comments": (f"# robot: arm\n# operator: J. Doe, lab 2\n{','.join(['time', *NAMES])}\n", ",", 2, 1),
    "a header that is a comment": (f"# made by a script\n# {' '.join(['time', *NAMES])}\n", " ", 1, 1),
    "a block": (f"Name;Scope\nStart;2026-11-02 10:11:12\n\n{';'.join(['time', *NAMES])}\n", ";", 3, 1),
    "two rows": (
        f",{','.join(JOINTS * 2)}\n,{','.join(['position'] * 3 + ['command'] * 3)}\ntime,,,,,,\n",
        ",",
        0,
        3,
    ),
}


@pytest.mark.parametrize("name", HEADS)
def test_what_stands_above_the_samples(logs, name):
    head, sep, skip, rows = HEADS[name]
    (logs / "run.csv").write_text(head + text_of(ROWS, sep))
    assert (
        head_of((logs / "run.csv").read_bytes()).skip_lines,
        head_of((logs / "run.csv").read_bytes()).header_rows,
    ) == (
        skip,
        rows,
    )
    _, (motion,) = read(logs)
    right(motion)


@pytest.mark.parametrize(
    "text",
    ["", "t,a\n", "t,a\n1,2\n", "1,2\n" * 9, "words of a letter\n" * 20, "a,b\nc,d\n" * 9, '"open,1\n' * 9],
)
def test_where_nothing_says_so_the_header_is_the_first_line(text):
    assert head_of(text.encode()) == Head()


def test_first_rows_without_numbers_are_samples_all_the_same(logs):
    """A table that pandas has merged: nothing is known of the first rows but their time."""
    stamps = [f"0 days 00:00:0{int(t)}.{round(t % 1 * 1e6):06d}" for t in T]
    body = [
        (stamp, *([""] * 6 if k < 3 else row)) for k, (stamp, row) in enumerate(zip(stamps, ROWS[:, 1:], strict=True))
    ]
    (logs / "run.csv").write_text(text_of([("elapsed", *NAMES), *body]))
    found, (motion,) = read(logs)
    assert "header_rows" not in found.tree
    np.testing.assert_allclose(motion.measured["position"][3:], DONE[3:], atol=1e-9)
    assert np.isnan(motion.measured["position"][:3]).all()
    np.testing.assert_allclose(np.diff(motion.measured.time_s), 0.01, atol=1e-9)


@pytest.mark.parametrize(
    ("words", "seconds"),
    [
        (["13:59:59.500", "14:00:01,25"], [50399.5, 50401.25]),
        (["0 days 00:00:00", "1 day 00:00:01.000000001"], [0.0, 86401.000000001]),
        (["1970-01-01 00:00:01.5", "1970-01-01T01:00:03+01:00"], [1.5, 3.0]),
    ],
)
def test_times_of_day_and_times_since_are_stamps(words, seconds):
    assert dates(words, "here").tolist() == [round(value * 1e9) for value in seconds]


def frame(orient):
    """A data frame in pandas' layouts of JSON."""
    names = ["time", *NAMES]
    rows = ROWS.tolist()
    return {
        "split": {"columns": names, "index": list(range(len(rows))), "data": rows},
        "columns": {name: {str(k): row[at] for k, row in enumerate(rows)} for at, name in enumerate(names)},
        "index": {str(k): dict(zip(names, row, strict=True)) for k, row in enumerate(rows)},
        "dates": {
            name: {str(1_795_000_000_000 + 10 * k): row[at + 1] for k, row in enumerate(rows)}
            for at, name in enumerate(NAMES)
        },
    }[orient]


@pytest.mark.parametrize("orient", ["split", "columns", "index", "dates"])
def test_a_data_frame_in_json(logs, orient):
    (logs / "run.json").write_text(json.dumps(frame(orient)))
    _, (motion,) = read(logs)
    right(motion)


def test_rows_that_are_longer_than_their_names_are_refused(logs):
    tree = frame("split")
    tree["data"][7].append(1.0)
    (logs / "run.json").write_text(json.dumps(tree))
    with pytest.raises(DataError, match="rows of other lengths than its names"):
        suggested(logs)


@pytest.mark.parametrize("stem", ["wrist_", "joint_", "motor", "axis"])
def test_numbered_joints_are_no_motions(logs, stem):
    joints = tuple(f"{stem}{k}" for k in (1, 2, 3))
    arrays = {f"{joint}.pos": DONE[:, k] for k, joint in enumerate(joints)}
    np.savez(logs / "run.npz", time=T, **arrays, **{f"{joint}.goal": TOLD[:, k] for k, joint in enumerate(joints)})
    found, motions = read(logs)
    assert "group" not in found.tree
    assert len(motions) == 1
    np.testing.assert_array_equal(motions[0].measured["position"], DONE)


def test_joints_beside_numbered_ones_say_that_these_are_joints(logs):
    """Nothing but the number tells `part_1` and `part_2` apart, but `lift` has the same signals."""
    joints = ("lift", "part_1", "part_2")
    arrays = {f"{joint}.pos": DONE[:, k] for k, joint in enumerate(joints)}
    np.savez(logs / "run.npz", time=T, **arrays, **{f"{joint}.goal": TOLD[:, k] for k, joint in enumerate(joints)})
    _, (motion,) = read(logs)
    right(motion, joints=joints)


def test_each_side_has_the_clock_that_stands_beside_it(logs):
    with h5py.File(logs / "run.h5", "w") as file:
        for number in (1, 2):
            for k, joint in enumerate(JOINTS):
                file[f"recording_{number}/state/{joint}/position"] = DONE[:, k]
                file[f"recording_{number}/command/{joint}/position"] = TOLD[::2, k]
            file[f"recording_{number}/state/timestamp"] = T
            file[f"recording_{number}/command/timestamp"] = T[::2]
    _, motions = read(logs)
    assert len(motions) == 2
    order = [1, 2, 0]  # HDF5 sorts names
    for motion in motions:
        right(motion, joints=tuple(JOINTS[k] for k in order), done=DONE[:, order], told=TOLD[::2, order])
        np.testing.assert_allclose(motion.command.time_s, T[::2], atol=1e-9)


def test_frames_of_pandas_in_hdf5(logs):
    """As `to_hdf` stores them unless it is told otherwise."""
    with h5py.File(logs / "run.h5", "w") as file:
        for key, values in (("state", DONE), ("cmd", TOLD[::4])):
            group = file.create_group(key)
            group["axis0"] = group["block0_items"] = np.array([f"{joint}.position" for joint in JOINTS], "S20")
            group["axis1"], group["block0_values"] = T[:: len(T) // len(values)], values
    _, (motion,) = read(logs)
    right(motion, told=TOLD[::4])


def cells(sheet, rows):
    for row in rows:
        sheet.append([value if isinstance(value, str) or value is None else float(value) for value in row])


def test_sheets_with_titles(logs):
    book = openpyxl.Workbook()
    cells(book.active, [("operator", "J. Doe"), ("date", "2026-11-02")])
    for title, values in (("Ist", DONE), ("Soll", TOLD)):
        sheet = book.create_sheet(title)
        cells(sheet, [("test 3",), ("t [s]", *JOINTS), *np.column_stack([T, values])])
    book.save(logs / "run.xlsx")
    _, (motion,) = read(logs)
    right(motion)


def test_a_name_that_spans_columns(logs):
    book = openpyxl.Workbook()
    spans = (None, "position", None, None, "command", None, None)
    cells(book.active, [spans, ("t [s]", *JOINTS, *JOINTS), *ROWS])
    book.save(logs / "run.xlsx")
    _, (motion,) = read(logs)
    right(motion)


def test_an_array_of_structs_is_a_motion_each(logs):
    runs = np.array([(T, DONE, TOLD), (T, -DONE, -TOLD)], dtype=[("t", "O"), ("q", "O"), ("qref", "O")])
    scipy.io.savemat(logs / "run.mat", {"runs": runs, "Ts": 0.01})
    _, motions = read(logs)
    for sign, motion in zip((1, -1), motions, strict=True):
        np.testing.assert_array_equal(motion.measured["position"], sign * DONE)
        np.testing.assert_array_equal(motion.command["position"], sign * TOLD)


@pytest.mark.parametrize("how", ["a list in a cell", "columns", "an array"])
def test_names_of_joints_that_stand_in_the_rows(logs, how):
    order = ("wrist_2", "yaw", "wrist_1")
    if how == "columns":
        head = [
            *(f".name[{k}]" for k in range(3)),
            *(f".position[{k}]" for k in range(3)),
            *(f".cmd[{k}]" for k in range(3)),
        ]
        body = [(t, *order, *q, *u) for t, q, u in zip(T, DONE, TOLD, strict=True)]
        (logs / "run.csv").write_text(text_of([("time", *head), *body]))
    elif how == "a list in a cell":
        body = [
            (t, f'"{list(order)}"', f'"{q.tolist()}"', f'"{u.tolist()}"') for t, q, u in zip(T, DONE, TOLD, strict=True)
        ]
        (logs / "run.csv").write_text(text_of([("time", "name", "position", "position_cmd"), *body]))
    else:
        steps = zip(T.tolist(), DONE.tolist(), TOLD.tolist(), strict=True)
        rows = [{"time": t, "names": list(order), "position": q, "target": u} for t, q, u in steps]
        (logs / "run.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    _, (motion,) = read(logs)
    right(motion, joints=order)


def test_names_that_change_from_row_to_row_name_nothing(logs):
    body = [
        (t, f'"{list(JOINTS if k % 2 else JOINTS[::-1])}"', f'"{q.tolist()}"', f'"{q.tolist()}"')
        for k, (t, q) in enumerate(zip(T, DONE, strict=True))
    ]
    (logs / "run.csv").write_text(text_of([("time", "name", "position", "position_cmd"), *body]))
    found, (motion,) = read(logs)
    assert motion.measured.joints == ("joint_1", "joint_2", "joint_3")
    assert any("only numbered" in line for line in found.unsure)


MODEL = """
<mujoco>
  <worldbody>
    <body><joint name="yaw" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
      <body><joint name="wrist_1" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
        <body><joint name="wrist_2" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="yaw" kp="50" kv="5"/><position joint="wrist_1" kp="50" kv="5"/>
    <position joint="wrist_2" kp="50" kv="5"/></actuator>
</mujoco>
"""


def test_commands_that_are_only_numbered_are_named_by_what_has_followed_them(logs):
    (logs.parent / "arm.xml").write_text(MODEL)
    order = [2, 0, 1]
    names = [f"/states/{joint}/position" for joint in JOINTS] + [f"/controller/reference[{k}]" for k in range(3)]
    (logs / "run.csv").write_text(text_of([("__time", *names), *np.column_stack([T, DONE, TOLD[:, order]])]))
    found = draft(logs.parent / "arm.xml", logs, out=logs.parent / "out")
    mapping = ImportOptions(mapping=logs.parent / "out" / "mapping.yaml")
    (motion,) = (source.load() for source in plan_import(logs, options=mapping).episodes)
    motion = JointMap.from_dict(found.robot.joint_rules()).of_episode(motion)
    right(motion)


def test_commands_that_nothing_follows_get_no_names(logs):
    (logs.parent / "arm.xml").write_text(MODEL)
    names = [f"/states/{joint}/position" for joint in JOINTS] + [f"/controller/reference[{k}]" for k in range(3)]
    same = np.column_stack([TOLD[:, 0]] * 3)
    (logs / "run.csv").write_text(text_of([("__time", *names), *np.column_stack([T, DONE, same])]))
    with pytest.raises(DataError, match="command columns are numbered"):
        draft(logs.parent / "arm.xml", logs)


def test_actions_with_a_gripper_and_observations_that_are_taken_from_a_pose(logs):
    with h5py.File(logs / "run.hdf5", "w") as file:
        for number in range(2):
            group = file.create_group(f"data/demo_{number}")
            group["actions"], group["processed_actions"] = np.full((T.size, 3), 9.0), TOLD
            group["obs/joint_pos"], group["states/robot/joint_position"] = DONE - 1.0, DONE
            group["obs/object"] = np.zeros((T.size, 10))
    _, motions = read(logs)
    assert len(motions) == 2
    for motion in motions:
        np.testing.assert_array_equal(motion.measured["position"], DONE)
        np.testing.assert_array_equal(motion.command["position"], TOLD)


def test_the_gripper_of_an_action_is_left_out(logs):
    np.savez(logs / "run.npz", t=T, joint_pos=DONE, actions=np.column_stack([TOLD, np.ones(T.size)]))
    found, (motion,) = read(logs)
    np.testing.assert_array_equal(motion.command["position"], TOLD)
    assert any("gripper" in line for line in found.unsure)


def test_what_goes_with_no_joint_is_no_position(logs):
    names = [*(f"feedback_j{k}" for k in (1, 2, 3)), *(f"planned_j{k}" for k in (1, 2, 3)), "mci_state", "error_j1"]
    body = np.column_stack([ROWS, np.ones(T.size), np.zeros(T.size)])
    (logs / "run.csv").write_text(text_of([("tm", *names), *body]))
    _, (motion,) = read(logs)
    right(motion, joints=("joint_1", "joint_2", "joint_3"))


def test_a_file_for_each_signal(logs):
    for name, values in (("measured_position", DONE), ("measured_velocity", 9 * DONE), ("commanded_position", TOLD)):
        (logs / f"{name}.csv").write_text(text_of([("t", *JOINTS), *np.column_stack([T, values])]))
    _, (motion,) = read(logs)
    right(motion)


def test_text_of_another_ending_is_a_table_if_its_lines_are_alike(logs):
    (logs / "run.txt").write_text(text_of([("time", *NAMES), *ROWS], "\t"))
    with pytest.raises(FormatError, match="no mapping says") as caught:
        plan_import(logs)
    assert "joints: [yaw, wrist_1, wrist_2]" in caught.value.hint
    _, (motion,) = read(logs)
    right(motion)


@pytest.mark.parametrize(("name", "way"), [("run.feather", "read_feather('run.feather')"), ("run.db", "-csv run.db")])
def test_what_is_not_read_says_how_to_convert_it(logs, name, way):
    (logs / name).write_bytes(b"ARROW1")
    with pytest.raises(FormatError, match="no known format") as caught:
        plan_import(logs)
    assert way in caught.value.hint


def test_headers_of_quantity_unit_and_joint(logs):
    rows = [
        ("quantity", *["position"] * 3, *["position_desired"] * 3),
        ("unit", *["deg"] * 6),
        ("joint", *JOINTS, *JOINTS),
        ("time [s]", *[""] * 6),
    ]
    (logs / "run.csv").write_text(text_of([*rows, *np.column_stack([T, np.degrees(DONE), np.degrees(TOLD)])]))
    _, (motion,) = read(logs)
    assert motion.measured.units["position"] == ("deg",) * 3
    right(motion, done=np.degrees(DONE), told=np.degrees(TOLD))


def test_a_title_is_no_header_and_units_in_brackets_are_no_samples(logs):
    book = openpyxl.Workbook()
    for number, sheet in enumerate((book.active, book.create_sheet("x")), 1):
        sheet.title = f"Messung {number}"
        names = [f"Achse {k} {side}" for side in ("Ist", "Soll") for k in (1, 2, 3)]
        degrees = np.column_stack([T * 1000, np.degrees(DONE), np.degrees(TOLD)])
        cells(sheet, [("Messung: Sinusfahrt", *[None] * 6), ("Zeit", *names), ("[ms]", *["[°]"] * 6), *degrees])
    book.save(logs / "run.xlsx")
    _, motions = read(logs)
    assert len(motions) == 2
    for motion in motions:
        right(motion, joints=("joint_1", "joint_2", "joint_3"), done=np.degrees(DONE), told=np.degrees(TOLD))


def test_letters_of_windows_and_times_of_day(logs):
    head = "Uhrzeit;" + ";".join(f"Gelenk{k} {side} [°]" for side in ("Ist", "Soll") for k in (1, 2, 3))
    body = [
        (f"10:11:{int(t):02d},{round(t % 1 * 1000):03d}", *(str(value).replace(".", ",") for value in row))
        for t, row in zip(T, np.degrees(ROWS[:, 1:]), strict=True)
    ]
    (logs / "run.csv").write_bytes((head + "\n" + text_of(body, ";")).encode("cp1252"))
    found, (motion,) = read(logs)
    assert found.tree["encoding"] == "cp1252"
    np.testing.assert_allclose(motion.command["position"], np.degrees(TOLD), atol=1e-9)
    np.testing.assert_allclose(motion.measured.time_s, T, atol=1e-6)


def test_messages_of_two_kinds_in_one_stream(logs):
    """With the same names in both, at rates of their own, and a last line that was cut."""
    lines = [{"type": "meta", "robot": "arm"}]
    for k, t in enumerate((T * 1e9).round().astype(int).tolist()):
        lines.append({"type": "state", "stamp_ns": t, "q": DONE[k].tolist()})
        if k % 4 == 0:
            lines.append({"type": "command", "stamp_ns": t, "q": TOLD[k].tolist()})
    (logs / "run.ndjson").write_text("".join(json.dumps(line) + "\n" for line in lines) + '{"type": "sta')
    _, (motion,) = read(logs)
    right(motion, joints=("joint_1", "joint_2", "joint_3"), told=TOLD[::4])
    np.testing.assert_allclose(motion.command.time_s, T[::4], atol=1e-9)
    assert [flag.kind for flag in motion.meta.flags] == ["cut_file"]


def test_a_cut_line_in_the_middle_is_an_error(logs):
    (logs / "run.jsonl").write_text('{"t": 0, "q": [1]}\n{"t": 1, "q"\n{"t": 2, "q": [1]}\n')
    with pytest.raises(DataError, match="cannot be read as JSON"):
        suggested(logs)


def test_a_long_table_of_several_motions(logs):
    rows = [
        (trial, f"{t:g}".replace(".", ","), joint, *(f"{value[k, j]:.9f}".replace(".", ",") for value in (DONE, TOLD)))
        for trial in (1, 2)
        for k, t in enumerate(T)
        for j, joint in enumerate(("Base", "Épaule", "Poignet 1"))
    ]
    head = ("essai", "temps (s)", "articulation", "position mesurée (rad)", "consigne (rad)")
    (logs / "run.csv").write_text(text_of([head, *rows], ";"))
    _, motions = read(logs)
    assert len(motions) == 2
    for motion in motions:
        assert motion.measured.joints == ("Base", "Épaule", "Poignet 1")
        np.testing.assert_allclose(motion.measured["position"], DONE, atol=1e-8)
        np.testing.assert_allclose(motion.command["position"], TOLD, atol=1e-8)


@pytest.mark.parametrize(
    ("told", "done"),
    [
        ("q_c_{}", "q_{}"),
        ("u{}", "q{}"),
        ("ASPos.A{}", "AIPos.A{}"),
        ("qRef_rad_{}", "qMeas_rad_{}"),
        ("qcmd{}", "qact{}"),
    ],
)
def test_what_controllers_call_commands(logs, told, done):
    names = [done.format(k) for k in (1, 2, 3)] + [told.format(k) for k in (1, 2, 3)]
    (logs / "run.csv").write_text(text_of([("time_s", *names), *ROWS]))
    _, (motion,) = read(logs)
    np.testing.assert_allclose(motion.measured["position"], DONE, atol=1e-9)
    np.testing.assert_allclose(motion.command["position"], TOLD, atol=1e-9)


def test_of_several_files_the_one_that_has_both_sides(logs):
    for motion in ("one", "two"):
        (logs / motion).mkdir()
        (logs / motion / "joint_states.csv").write_text(text_of([("t", *JOINTS), *ROWS[:, :4]]))
        (logs / motion / "state.csv").write_text(text_of([("t", *NAMES), *ROWS]))
    _, motions = read(logs)
    assert len(motions) == 2
    for motion in motions:
        right(motion)


def test_counts_of_unknown_size_are_no_angles(logs):
    (logs.parent / "arm.xml").write_text(MODEL)
    names = [*(f"{joint}_enc_ticks" for joint in JOINTS), *(f"{joint}_set_ticks" for joint in JOINTS)]
    counts = np.column_stack([1e6 * T, 40000 + np.round(1e4 * ROWS[:, 1:])]).astype(int)
    (logs / "run.csv").write_text(text_of([("time_us", *names), *counts]))
    with pytest.raises(DataError, match="cannot be angles") as caught:
        draft(logs.parent / "arm.xml", logs)
    assert "`factor` [rad per count]" in caught.value.hint


def test_what_is_neither_a_file_nor_a_folder_is_of_no_known_format(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FormatError, match="no known format"):
        plan_import(tmp_path / "pipe")
