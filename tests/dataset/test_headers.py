"""Names of columns suggest a mapping, which reads the file as it was meant."""

import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from trueup.cli.main import main
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.headers import column_of, suggest
from trueup.dataset.importers.mapping_file import parse_mapping
from trueup.dataset.importers.table import suggested
from trueup.dataset.importers.tables import ArrayTable
from trueup.errors import DataError, FormatError
from trueup.stages import plan_import

T = np.arange(0.0, 5.0, 0.01)


def table(names, *, clock="t", stamps=T, size=1.0, **more):
    arrays = {clock: stamps, **{name: size * np.sin(T + number) for number, name in enumerate(names)}, **more}
    return ArrayTable(Path("x.npz"), list(arrays), arrays.__getitem__)


def each(template, count=3, first=0):
    return [template.format(number) for number in range(first, first + count)]


UR = [
    name for side in ("target", "actual") for kind in ("q", "qd", "current") for name in each(f"{side}_{kind}_{{}}", 6)
]


# Names as drivers and people write them: which columns are measured and commanded positions, the unit, the joints.
@pytest.mark.parametrize(
    ("names", "measured", "command", "unit", "joints"),
    [
        (["yaw [deg]", "lift [deg]", "yaw_cmd [deg]", "lift_cmd [deg]"], 0, 2, "deg", ["yaw", "lift"]),
        (["yaw Ist [deg]", "lift Ist [deg]", "yaw Soll [deg]", "lift Soll [deg]"], 0, 2, "deg", ["yaw", "lift"]),
        (["yaw", "lift", "yaw_cmd", "lift_cmd"], 0, 2, "rad", ["yaw", "lift"]),
        (UR, 18, 0, "rad", each("joint_{}", 6)),
        (
            [*each("q_{}", 7), *each("q_d_{}", 7), *each("dq_{}", 7), *each("tau_J_{}", 7)],
            0,
            7,
            "rad",
            each("joint_{}", 7),
        ),
        (
            [*each("present_position_{}", 3, 1), *each("goal_position_{}", 3, 1), *each("present_current_{}", 3, 1)],
            0,
            3,
            "rad",
            each("joint_{}", 3, 1),
        ),
        (
            ["/joint_states/yaw/position", "/joint_states/lift/position", "/cmd/yaw", "/cmd/lift"],
            0,
            2,
            "rad",
            ["yaw", "lift"],
        ),
        ([*each("motor_state_{}_q"), *each("motor_cmd_{}_q")], 0, 3, "rad", each("joint_{}")),
        (["leftKneePos", "leftHipPos", "leftKneePosRef", "leftHipPosRef"], 0, 2, "rad", ["knee", "hip"]),
        (["a_angle_deg", "b_angle_deg", "a_target_deg", "b_target_deg", "status", "battery"], 0, 2, "deg", ["a", "b"]),
        (
            ["observation.state.a.pos", "observation.state.b.pos", "action.a.pos", "action.b.pos"],
            0,
            2,
            "rad",
            ["a", "b"],
        ),
    ],
)
def test_names_of_columns(names, measured, command, unit, joints):
    found = suggest(table(names))
    series, count = found.tree["series"], len(joints)
    assert found.tree["joints"] == joints
    assert series["measured"]["signals"]["position"] == {"columns": names[measured : measured + count], "unit": unit}
    assert series["command"]["signals"]["position"] == {"columns": names[command : command + count], "unit": unit}
    assert parse_mapping(found.text, name="suggested").joints == tuple(joints)


@pytest.mark.parametrize(
    ("clock", "stamps", "wanted"),
    [
        ("t", T, {"column": "t", "unit": "s"}),
        ("t [ms]", 1000 * T, {"column": "t [ms]", "unit": "ms"}),
        ("timestamp", 1.7e9 + T, {"column": "timestamp", "unit": "s"}),
        ("timestamp", 1.7e12 + 1e3 * T, {"column": "timestamp", "unit": "ms"}),
        (
            "field.header.stamp",
            1691406519400223701 + (1e9 * T).astype(np.int64),
            {"column": "field.header.stamp", "unit": "ns"},
        ),
        ("time_us", 1e6 * T, {"column": "time_us", "unit": "us"}),
        ("Zeit", 10.0 * np.arange(T.size), {"column": "Zeit", "unit": "ms"}),
    ],
)
def test_clocks(clock, stamps, wanted):
    found = suggest(table(["a", "b", "a_cmd", "b_cmd"], clock=clock, stamps=stamps))
    assert found.tree["series"]["measured"]["time"] == wanted


def test_what_is_not_said_is_unsure():
    degrees = suggest(table(["a", "b", "a_cmd", "b_cmd"], size=90.0))
    assert degrees.tree["series"]["measured"]["signals"]["position"]["unit"] == "deg"
    assert any("degrees" in line for line in degrees.unsure)
    alone = suggest(table(["a_pos", "b_pos"]))
    assert any("command" in line for line in alone.unsure)
    arrays = {"q": np.ones((5, 2)), "q_des": np.ones((5, 2))}
    timeless = suggest(ArrayTable(Path("x.npz"), list(arrays), arrays.__getitem__))
    assert timeless.tree["series"]["measured"]["time"] == {"rate_hz": 100.0}
    assert any("clock" in line for line in timeless.unsure)
    assert timeless.tree["series"]["command"]["signals"]["position"]["columns"] == "q_des"


def test_arrays_of_learning_say_their_step_and_joints():
    """As legged gyms and GapONet's release write them."""
    q, u = (np.column_stack([np.sin(T + shift), np.cos(T + shift)]) for shift in (0.0, 0.1))
    gym = {"dof_pos": q, "dof_vel": q, "dof_pos_target": u, "torques": q, "dt": np.array(0.02)}
    found = suggest(ArrayTable(Path("x.npz"), list(gym), gym.__getitem__))
    assert found.tree["series"]["measured"]["time"] == {"period": "dt"}
    assert found.tree["series"]["measured"]["signals"]["torque"]["columns"] == "torques"
    names = np.array(["hip", "knee"])
    gap = {"real_dof_positions": q, "real_dof_positions_cmd": u, "joint_sequence": names, "fps": np.array(50)}
    found = suggest(ArrayTable(Path("x.npz"), list(gap), gap.__getitem__))
    assert found.tree["joints"] == ["hip", "knee"]
    assert found.tree["series"]["command"]["time"] == {"rate_hz": 50.0}
    assert found.tree["series"]["command"]["signals"]["position"]["columns"] == "real_dof_positions_cmd"


def test_nothing_is_made_of_names_that_say_nothing():
    assert suggest(table(["status_temp", "battery_voltage"])) is None
    assert suggest(ArrayTable(Path("x"), ["t"], lambda _: T)) is None


def test_units_stand_in_brackets_or_at_the_end():
    assert column_of("elbow (deg/s)").unit == "deg/s"
    assert column_of("elbow_torque_Nm").unit == "Nm"
    assert column_of("current_position").signal == "position"
    assert column_of("motor 3 current [mA]").signal == "current"
    assert column_of("position[3]").words == ("3",)


def test_a_folder_with_two_files_is_a_motion(tmp_path):
    for motion in ("one", "two"):
        (tmp_path / motion).mkdir()
        rows = np.column_stack([T, np.sin(T), np.cos(T)])
        np.savetxt(tmp_path / motion / "state.csv", rows, delimiter=",", header="t,q1,q2", comments="")
        np.savetxt(tmp_path / motion / "command.csv", rows[::2], delimiter=",", header="t,u1,u2", comments="")
    (tmp_path / "mapping.yaml").write_text(suggested(tmp_path).text)
    first, second = (source.load() for source in plan_import(tmp_path).episodes)
    assert (first.id, second.id) == ("one", "two")
    np.testing.assert_allclose(first.measured["position"], np.column_stack([np.sin(T), np.cos(T)]))
    np.testing.assert_allclose(first.command.time_s, T[::2])


def test_files_of_learning_are_understood(tmp_path):
    """Layouts of ALOHA and robomimic."""
    q, u = (np.column_stack([np.sin(T + shift + k) for k in range(7)]) for shift in (0.0, 0.1))
    with h5py.File(tmp_path / "aloha.hdf5", "w") as file:
        file["action"], file["observations/qpos"], file["observations/qvel"] = u, q, q
        file["observations/images/top"] = np.zeros((T.size, 2, 2, 3), np.uint8)
    with h5py.File(tmp_path / "robomimic.hdf5", "w") as file:
        for number in range(3):
            file[f"data/demo_{number}/actions"] = u
            file[f"data/demo_{number}/obs/robot0_joint_pos"] = q
            file[f"data/demo_{number}/obs/robot0_joint_vel"] = q
    for name, count in (("aloha", 1), ("robomimic", 3)):
        found = suggested(tmp_path / f"{name}.hdf5")
        (tmp_path / "m.yaml").write_text(found.text)
        options = ImportOptions(mapping=tmp_path / "m.yaml")
        episodes = [source.load() for source in plan_import(tmp_path / f"{name}.hdf5", options=options).episodes]
        assert len(episodes) == count
        np.testing.assert_array_equal(episodes[0].measured["position"], q)
        np.testing.assert_array_equal(episodes[0].command["position"], u)


def test_an_import_without_a_mapping_prints_one_that_works(tmp_path, capsys):
    (tmp_path / "logs").mkdir()
    rows = np.column_stack([T, np.sin(T), np.cos(T), np.sin(T + 0.1), np.cos(T + 0.1)])
    np.savetxt(tmp_path / "logs" / "x.csv", rows, delimiter=";", header="t;a;b;a_cmd;b_cmd", comments="")
    with pytest.raises(FormatError, match="no mapping says") as caught:
        plan_import(tmp_path / "logs")
    (tmp_path / "m.yaml").write_text(caught.value.hint.partition("\n")[2])
    with pytest.raises(SystemExit) as left:
        main(["import", str(tmp_path / "logs"), "--out", str(tmp_path / "data"), "--mapping", str(tmp_path / "m.yaml")])
    assert left.value.code == 0, capsys.readouterr().err


@pytest.mark.long
def test_thousands_of_columns_take_seconds(tmp_path):
    """Each column used to be a walk through all of the file."""
    joints = [f"joint_{number}" for number in range(3000)]
    names = [f"{joint}.{kind}" for kind in ("position", "command") for joint in joints]
    rows = "".join(",".join([str(0.01 * k)] + [str(k)] * len(names)) + "\n" for k in range(4))
    (tmp_path / "x.csv").write_text(",".join(["t", *names]) + "\n" + rows)
    begin = time.perf_counter()
    found = suggested(tmp_path / "x.csv")
    assert found is not None
    assert len(found.tree["joints"]) == 3000
    assert time.perf_counter() - begin < 20.0


def test_hundreds_of_thousands_of_columns_take_seconds(tmp_path):
    names = ",".join(f"c{number:x}" for number in range(150_000))
    (tmp_path / "x.csv").write_text(f"{names}\n1\n")
    begin = time.perf_counter()
    assert suggested(tmp_path / "x.csv") is None
    assert time.perf_counter() - begin < 20.0


def lines(folder, rows, name="run.csv"):
    (folder / "logs").mkdir()
    (folder / "logs" / name).write_text("\n".join(",".join(map(str, row)) for row in rows) + "\n")
    return folder / "logs"


def read_as_suggested(logs):
    """The suggestion, and the motions that it reads."""
    found = suggested(logs)
    path = logs.parent / "mapping.yaml"
    path.write_text(found.text)
    plan = plan_import(logs, options=ImportOptions(mapping=path))
    return found, [source.load() for source in plan.episodes]


def waves(count=2):
    return np.column_stack([np.sin(T + number) for number in range(count)])


def test_rows_of_one_joint_each(tmp_path):
    rows = [
        (T[k], name, waves()[k, j], 2 * waves()[k, j]) for k in range(T.size) for j, name in enumerate(("yaw", "lift"))
    ]
    found, (motion,) = read_as_suggested(lines(tmp_path, [("time", "joint", "position", "command"), *rows]))
    assert motion.measured.joints == ("yaw", "lift")
    np.testing.assert_array_equal(motion.measured["position"], waves())
    np.testing.assert_array_equal(motion.command["position"], 2 * waves())
    assert any("rows of joint: yaw, lift" in line for line in found.taken)


def test_a_column_of_names_that_are_no_joints_of_rows_is_none(tmp_path):
    rows = [(t, "reach" if t < 2 else "wave", *q, *q) for t, q in zip(T, waves(), strict=True)]
    found, (motion,) = read_as_suggested(lines(tmp_path, [("time", "name", "a", "b", "a_cmd", "b_cmd"), *rows]))
    assert motion.measured.joints == ("a", "b")
    assert "joint_column" not in found.text


def test_a_row_of_units_says_them(tmp_path):
    head = [("t", "a", "b", "a_cmd", "b_cmd"), ("ms", *["deg"] * 4)]
    rows = [(1000 * t, *np.degrees(q), *np.degrees(q)) for t, q in zip(T, waves(), strict=True)]
    _, (motion,) = read_as_suggested(lines(tmp_path, [*head, *rows]))
    assert motion.measured.units["position"] == ("deg", "deg")
    np.testing.assert_allclose(motion.measured["position"], np.degrees(waves()), atol=1e-12)
    np.testing.assert_allclose(motion.measured.time_s, T, atol=1e-9)


@pytest.mark.parametrize("pauses", [False, True])
def test_a_clock_that_begins_anew_begins_a_motion(tmp_path, pauses):
    stamps = np.concatenate([T[:200], T[: T.size - 200] + (0.05 if pauses else 0.0)])
    rows = [(t, *q, *q) for t, q in zip(stamps, waves(), strict=True)]
    found, motions = read_as_suggested(lines(tmp_path, [("time", "a", "b", "a_cmd", "b_cmd"), *rows]))
    assert [len(motion.measured) for motion in motions] == [200, 300]
    np.testing.assert_array_equal(motions[1].measured["position"], waves()[200:])
    assert any("begins anew 1 times" in line for line in found.unsure)


def test_stamps_that_overtake_each_other_begin_none(tmp_path):
    stamps = T.copy()
    stamps[[300, 301]] = stamps[[301, 300]]
    rows = [(t, *q, *q) for t, q in zip(stamps, waves(), strict=True)]
    logs = lines(tmp_path, [("time", "a", "b", "a_cmd", "b_cmd"), *rows])
    assert "split" not in suggested(logs).tree


@pytest.mark.parametrize(("name", "motions"), [("trial", 2), ("episode_index", 2), ("frame_index", 1), ("mode", 1)])
def test_a_column_of_trials_separates_motions(tmp_path, name, motions):
    rows = [(t, int(t >= 2.0), *q, *q) for t, q in zip(T, waves(), strict=True)]
    _, found = read_as_suggested(lines(tmp_path, [("time", name, "a", "b", "a_cmd", "b_cmd"), *rows]))
    assert len(found) == motions


def test_trials_that_come_back_are_no_motions(tmp_path):
    rows = [(t, int(t) % 2, *q, *q) for t, q in zip(T, waves(), strict=True)]
    _, found = read_as_suggested(lines(tmp_path, [("time", "trial", "a", "b", "a_cmd", "b_cmd"), *rows]))
    assert len(found) == 1


def test_a_file_without_a_header_is_told_so(tmp_path):
    logs = lines(tmp_path, [(t, *q, *q) for t, q in zip(T, waves(), strict=True)])
    with pytest.raises(DataError, match=r"has no header: its first line holds numbers") as caught:
        plan_import(logs)
    assert "header: [time" in caught.value.hint


@pytest.mark.parametrize(("told", "side"), [("far", "measured"), ("near", "command")])
def test_values_say_whether_qd_is_a_velocity(told, side):
    own = {"near": waves() + 0.01, "far": np.gradient(waves(), T, axis=0) * 3.0}[told]
    arrays = {"t": T, "q": waves(), "qd": own}
    found = suggest(ArrayTable(Path("x.npz"), list(arrays), arrays.__getitem__))
    signal = {"measured": "velocity", "command": "position"}[side]
    assert found.tree["series"][side]["signals"][signal]["columns"] == "qd"


def test_columns_named_like_joints_keep_their_names(tmp_path):
    rng, names = np.random.default_rng(0), ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint")
    head = ",".join(["t", *names, *(f"{name}_cmd" for name in names)])
    rows = np.column_stack([np.arange(50) / 100, rng.normal(size=(50, 6))])
    (tmp_path / "logs").mkdir()
    np.savetxt(tmp_path / "logs" / "run.csv", rows, delimiter=",", header=head, comments="")
    _, (motion,) = read_as_suggested(tmp_path / "logs")
    assert motion.measured.joints == motion.command.joints == names


def test_targets_of_positions_are_taken_before_actions_that_may_be_scaled(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {name: rng.normal(size=(50, 3)) for name in ("dof_pos", "dof_vel", "actions", "target_dof_pos")}
    (tmp_path / "logs").mkdir()
    np.savez(tmp_path / "logs" / "run.npz", dt=0.02, **arrays)
    _, (motion,) = read_as_suggested(tmp_path / "logs")
    np.testing.assert_array_equal(motion.command["position"], arrays["target_dof_pos"])


def test_what_a_library_keeps_for_itself_is_no_signal(tmp_path):
    table = np.zeros(
        T.size, [("index", "i8"), ("time", "f8"), *((name, "f8") for name in ("a", "b", "a_cmd", "b_cmd"))]
    )
    table["time"], table["a"], table["b_cmd"] = T, waves()[:, 0], waves()[:, 1]
    (tmp_path / "logs").mkdir()
    with h5py.File(tmp_path / "logs" / "run.h5", "w") as file:
        file["log/table"] = table
        file["log/_i_table/a/bounds"] = np.arange(5.0)
    _, (motion,) = read_as_suggested(tmp_path / "logs")
    assert motion.measured.joints == ("a", "b")
    np.testing.assert_array_equal(motion.measured["position"][:, 0], waves()[:, 0])
    np.testing.assert_array_equal(motion.command["position"][:, 1], waves()[:, 1])
