"""Logs as the usual loggers of robots write them, read by the mappings that ship with trueup."""

import json

import numpy as np
import pytest

from trueup.core.units import si_factor
from trueup.dataset.importers import table
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.detect import find_importer
from trueup.dataset.importers.mapping_file import shipped
from trueup.errors import ConfigError, FormatError, NameMismatch, TrueupError

ROWS = 40
TIME_S = np.round(np.arange(ROWS) * 0.008, 6)


def numbers(width, phase=0.0, size=1.0):
    """Values (T, width) that differ from column to column, written and read back without loss."""
    return np.round(size * np.sin(np.add.outer(5.0 * TIME_S, np.arange(width) + phase)), 6)


def listed(name, count, first=0):
    return [f"{name}_{i}" for i in range(first, first + count)]


def read(folder):
    """The only episode of a folder, found without any hint, and the notes of its plan."""
    plan = find_importer(folder).scan(folder, ImportOptions())
    (source,) = plan.episodes
    return source.load(), " ".join(plan.notes)


def write(path, header, columns, *, delimiter, end="\r\n", blank=""):
    """A table as these loggers write it: the shortest digits that are the number."""
    rows = np.column_stack(columns)
    lines = [f"{delimiter}{blank}".join(header), *(delimiter.join(f"{value:.6f}" for value in row) for row in rows)]
    path.write_text(end.join(lines) + end)


# Universal Robots: the outputs that record_configuration.xml of their client asks for, vectors of six but for the last.
UR_VECTORS = [
    *("target_q", "target_qd", "target_qdd", "target_current", "target_moment", "actual_q", "actual_qd"),
    *("actual_current", "joint_control_output", "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force"),
    *("target_TCP_pose", "target_TCP_speed"),
]
UR_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


@pytest.mark.parametrize("delimiter", [" ", ","], ids=["record.py", "ur_rtde"])
def test_universal_robots(tmp_path, delimiter):
    values = {name: numbers(6, place) for place, name in enumerate(UR_VECTORS)}
    header = ["timestamp", *(name for vector in UR_VECTORS for name in listed(vector, 6))]
    header += ["actual_digital_input_bits", *listed("joint_temperatures", 6), "robot_mode"]
    warm = np.round(30.0 + numbers(6), 6)
    columns = [TIME_S + 5000.0, *values.values(), np.zeros(ROWS), warm, np.full(ROWS, 7)]
    write(tmp_path / "robot_data.csv", header, columns, delimiter=delimiter)
    episode, notes = read(tmp_path)
    assert "as ur_rtde says" in notes
    assert episode.measured.joints == episode.command.joints == UR_JOINTS
    np.testing.assert_allclose(episode.measured.time_s, TIME_S, atol=1e-9)
    np.testing.assert_array_equal(episode.measured["position"], values["actual_q"])
    np.testing.assert_array_equal(episode.measured["velocity"], values["actual_qd"])
    np.testing.assert_array_equal(episode.measured["current"], values["actual_current"])
    np.testing.assert_array_equal(episode.measured["temperature"], warm)
    np.testing.assert_array_equal(episode.command["position"], values["target_q"])
    np.testing.assert_array_equal(episode.command["velocity"], values["target_qd"])
    assert "torque" not in episode.measured  # target_moment is computed


def test_universal_robots_with_few_outputs(tmp_path):
    header = ["timestamp", *listed("target_q", 6), *listed("actual_q", 6)]
    write(tmp_path / "x.csv", header, [TIME_S, numbers(6), numbers(6, 1)], delimiter=" ")
    episode, _ = read(tmp_path)
    assert list(episode.measured.signals) == list(episode.command.signals) == ["position"]


@pytest.mark.parametrize("blank", ["", " "], ids=["today", "before"])
def test_franka(tmp_path, blank):
    vectors = {
        "state.q": 7,
        "state.q_d": 7,
        "state.dq": 7,
        "state.dq_d": 7,
        "state.tau_J": 7,
        "state.tau_ext_hat_filtered": 7,
        "cmd.q_d": 7,
        "cmd.dq_d": 7,
        "cmd.O_T_EE_d": 16,
        "cmd.O_dP_EE_d": 6,
        "cmd.tau_J_d": 7,
    }
    names = [f",{blank}".join(f"{name}[{i}]" for i in range(width)) for name, width in vectors.items()]
    values = {name: numbers(width, place) for place, (name, width) in enumerate(vectors.items())}
    milliseconds = np.arange(ROWS) + 123456
    header = ",".join([f"time,{blank}success_rate", *names])
    rows = np.column_stack([np.ones(ROWS), *values.values()])
    lines = [f"{t}," + ",".join(f"{v:.6f}" for v in row) for t, row in zip(milliseconds, rows, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([header, *lines]) + "\n")
    episode, notes = read(tmp_path)
    assert "as franka says" in notes
    assert episode.measured.joints == tuple(f"joint{number}" for number in range(1, 8))
    np.testing.assert_allclose(episode.measured.time_s, np.arange(ROWS) / 1000.0, atol=1e-9)
    for signal, name in (("position", "state.q"), ("velocity", "state.dq"), ("torque", "state.tau_J")):
        np.testing.assert_array_equal(episode.measured[signal], values[name])
    np.testing.assert_array_equal(episode.command["position"], values["state.q_d"])
    np.testing.assert_array_equal(episode.command["torque"], values["cmd.tau_J_d"])


def test_kuka(tmp_path):
    tags = [f"{tag}.{axis}" for tag in ("RIst", "RSol") for axis in "XYZABC"]
    axes = [f"{tag}.A{number}" for tag in ("AIPos", "ASPos") for number in range(1, 7)]
    done, told = numbers(6, size=90.0), numbers(6, 1, size=90.0)
    write(
        tmp_path / "rsi.csv",
        [*tags, *axes, "Delay.D", "IPOC"],
        [numbers(12), done, told, np.zeros(ROWS), 4 * np.arange(ROWS) + 4208163634],
        delimiter=",",
    )
    episode, notes = read(tmp_path)
    assert "as kuka_rsi says" in notes
    assert episode.measured.joints == tuple(f"joint_a{number}" for number in range(1, 7))
    np.testing.assert_allclose(episode.measured.time_s, 0.004 * np.arange(ROWS), atol=1e-9)
    np.testing.assert_array_equal(episode.measured["position"], done)
    np.testing.assert_array_equal(episode.command["position"], told)
    assert set(episode.measured.units["position"]) == {"deg"}


def test_dynamixel_with_as_many_motors_as_there_are(tmp_path):
    ids = (11, 12, 5)
    ticks = np.round(2048 + 1024 * numbers(3))
    goal = np.round(2048 + 1024 * numbers(3, 0.2))
    speed = np.round(100 * numbers(3, 1))
    header = ["timestamp"]
    for register in ("goal_position", "present_position", "present_velocity", "present_current"):
        header += [f"{register}_{number}" for number in ids]
    write(tmp_path / "x.csv", header, [TIME_S, goal, ticks, speed, speed], delimiter=",")
    episode, notes = read(tmp_path)
    assert "as dynamixel says" in notes
    assert episode.measured.joints == ("11", "12", "5")
    factor = {unit: si_factor(unit)[1] for unit in ("rev", "rpm")}
    assert episode.measured.units["position"] == ("rev",) * 3
    np.testing.assert_allclose(episode.measured["position"] * factor["rev"], (ticks - 2048) * np.pi / 2048, atol=1e-12)
    np.testing.assert_allclose(episode.command["position"] * factor["rev"], (goal - 2048) * np.pi / 2048, atol=1e-12)
    np.testing.assert_allclose(episode.measured["velocity"] * factor["rpm"], speed * 0.229 * np.pi / 30, atol=1e-12)
    assert "current" not in episode.measured  # what a step of it is differs between motors


def bam(kp=400, trajectory="sin_sin"):
    position, goal = numbers(1)[:, 0], numbers(1, 0.1)[:, 0]
    entries = [
        {
            "position": position[row],
            "speed": 0.5 * position[row],
            "load": 65530,
            "input_volts": 7.3,
            "temp": 28 + row % 2,
            "timestamp": TIME_S[row] + 0.0035,
            "goal_position": goal[row],
            "torque_enable": True,
        }
        for row in range(ROWS)
    ]
    about = {"mass": 0.49, "length": 0.1, "kp": kp, "vin": 7.4, "motor": "xl330", "trajectory": trajectory}
    return {**about, "entries": entries}, position, goal


def test_bam(tmp_path):
    for kp, name in ((100, "a"), (400, "b")):
        tree, position, goal = bam(kp)
        (tmp_path / f"{name}.json").write_text(json.dumps(tree))
    (tmp_path / "split.json").write_text('{"train": ["a"], "test": ["b"]}')
    importer = find_importer(tmp_path)
    plan = importer.scan(tmp_path, ImportOptions())
    one, two = (source.load() for source in plan.episodes)
    assert [one.meta.kp_setting, two.meta.kp_setting] == [100.0, 400.0]
    assert (one.meta.robot, one.meta.condition, plan.robot) == ("xl330", "sin_sin", "")
    np.testing.assert_allclose(one.measured.time_s, TIME_S, atol=1e-9)
    np.testing.assert_array_equal(one.measured["position"][:, 0], position)
    np.testing.assert_array_equal(one.measured["velocity"][:, 0], 0.5 * position)
    np.testing.assert_array_equal(one.command["position"][:, 0], goal)
    np.testing.assert_array_equal(one.measured["temperature"][:2, 0], [28.0, 29.0])


def test_bam_as_it_is_published(bam_logs):
    sources = find_importer(bam_logs).scan(bam_logs, ImportOptions()).episodes
    assert len(sources) == 16
    episode = sources[4].load()
    tree = json.loads((bam_logs / f"{episode.meta.id}.json").read_text())
    assert (episode.meta.kp_setting, episode.meta.condition) == (tree["kp"], tree["trajectory"])
    for signal, name in (("position", "position"), ("velocity", "speed")):
        np.testing.assert_array_equal(episode.measured[signal][:, 0], [row[name] for row in tree["entries"]])


def test_a_gain_that_is_none_is_refused(tmp_path):
    tree, _, _ = bam(kp=0)
    (tmp_path / "a.json").write_text(json.dumps(tree))
    with pytest.raises(TrueupError, match=r"kp_setting of a\.json"):
        find_importer(tmp_path).scan(tmp_path, ImportOptions())


@pytest.mark.parametrize(
    "header",
    [
        "time,q1,q2,q1_cmd,q2_cmd",
        "timestamp," + ",".join([*listed("actual_q", 7), *listed("target_q", 5)]),
        "timestamp,present_position,goal_position",
        "timestamp,present_position_1,goal_position_2",
        "IPOC,AIPos.A1,AIPos.A2,ASPos.A1,ASPos.A2",
        "time,success_rate,state.q[0],state.q_d[0]",
    ],
)
def test_other_tables_are_not_taken_for_these(tmp_path, header):
    row = ",".join("0.5" for _ in header.split(","))
    (tmp_path / "x.csv").write_text(f"{header}\n{row}\n")
    with pytest.raises(FormatError, match="no mapping says"):
        table.scan(tmp_path, ImportOptions())


@pytest.mark.parametrize("text", ['{"a": [1, 2]}', "[]", "{", '{"entries": [{"position": 1}]}'])
def test_other_json_is_not_taken_for_logs(tmp_path, text):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(FormatError, match="of no known format"):
        find_importer(tmp_path)


def test_no_two_mappings_fit_the_same_columns():
    needed = {}
    for name, mapping in shipped().items():
        whole = mapping.of_columns(["present_position_1"]) if mapping.joint_pattern else mapping
        columns = set()
        for series, spec in whole.series.items():
            columns |= {*spec.time.names, *(c for key in spec.signals for c in whole.columns(series, key))}
        needed[name] = columns
    for name, columns in needed.items():
        assert not [other for other in needed if other != name and columns <= needed[other]]


def test_joints_that_the_columns_name(tmp_path):
    from trueup.dataset.importers.mapping_file import parse_mapping

    text = "joints: '(?P<joint>.+)_pos'\nseries: {measured: {time: t, signals: {position: {columns: '{joint}_pos', unit: deg}}}}"
    mapping = parse_mapping(text, name="m")
    assert mapping.of_columns(["t", "hip_pos", "knee_pos", "knee_vel"]).joints == ("hip", "knee")
    with pytest.raises(NameMismatch, match=r"no column says the name of a joint.*the file has \[t, hip\]"):
        mapping.of_columns(["t", "hip"])
    with pytest.raises(ConfigError, match=r"\(\?P<joint>…\)"):
        parse_mapping(text.replace("?P<joint>", ""), name="m")
    with pytest.raises(ConfigError, match="regular expression"):
        parse_mapping(text.replace(".+)", ".+"), name="m")
