"""Bags of every kind are read by joint name, on one clock, and damaged ones are refused."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from trueup.dataset.importers import rosbag
from trueup.dataset.importers.bagfile import open_bag
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.jointstate import JointStateDecoder
from trueup.errors import ConfigError, DataError, FormatError, NameMismatch

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
ARRAY = "std_msgs/msg/Float64MultiArray"
START_NS = 1_700_000_000_123_456_789
STEP_NS = 10_000_000
LATE_NS = 2_000_000  # recorded this long after it was stamped
JOINTS = ("shoulder", "elbow", "wrist")
ALL = ("position", "velocity", "effort")
JOINT_STATE_TEXT = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""


def header(store, stamp_ns):
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    kind = store.types["std_msgs/msg/Header"]
    return kind(seq=7, stamp=time, frame_id="base") if store is ROS1 else kind(stamp=time, frame_id="base")


def state(store, stamp_ns, names, position=(), velocity=(), effort=()):
    arrays = [np.array(values, dtype=np.float64) for values in (position, velocity, effort)]
    kind = store.types[JOINT_STATE]
    message = kind(header(store, stamp_ns), list(names), *arrays)
    return serialize(store, message, JOINT_STATE)


def serialize(store, message, kind):
    return bytes(store.serialize_ros1(message, kind) if store is ROS1 else store.serialize_cdr(message, kind))


def array(store, values):
    layout = store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return serialize(store, store.types[ARRAY](layout=layout, data=np.array(values, dtype=np.float64)), ARRAY)


def trajectory(stamp_ns, names, points):
    duration = ROS2.types["builtin_interfaces/msg/Duration"]
    point = ROS2.types["trajectory_msgs/msg/JointTrajectoryPoint"]
    none = np.array([])
    made = [
        point(
            np.array(position, dtype=np.float64), none, none, none, duration(int(after_s), round((after_s % 1) * 1e9))
        )
        for after_s, position in points
    ]
    return serialize(ROS2, ROS2.types[TRAJECTORY](header(ROS2, stamp_ns), list(names), made), TRAJECTORY)


def write_bag(path: Path, topics, storage="mcap", compression=None) -> Path:
    """topics: name -> (type, [(log_ns, bytes)])."""
    if storage == "ros1":
        with Writer1(path) as writer:
            fill(writer, topics, ROS1)
        return path
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    writer = Writer2(path, version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        fill(writer, topics, ROS2)
    return path


def fill(writer, topics, store):
    connections = {name: writer.add_connection(name, kind, typestore=store) for name, (kind, _) in topics.items()}
    messages = [(log_ns, name, raw) for name, (_, items) in topics.items() for log_ns, raw in items]
    for log_ns, name, raw in sorted(messages, key=lambda item: item[0]):
        writer.write(connections[name], log_ns, raw)


def motion(rows=40, joints=3, seed=0):
    return np.random.default_rng(seed).normal(size=(3, rows, joints))


def states(store, values, names=JOINTS, stamped=True, start_ns=START_NS):
    return [
        (
            start_ns + k * STEP_NS + LATE_NS,
            state(store, start_ns + k * STEP_NS if stamped else 0, names, *(signal[k] for signal in values)),
        )
        for k in range(values.shape[1])
    ]


def load(path, **options):
    plan = rosbag.scan(path, ImportOptions(**options))
    assert len(plan.episodes) == 1
    return plan.episodes[0].load()


def flags(episode, kind):
    return [flag for flag in episode.meta.flags if flag.kind == kind]


@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_bag_of_every_kind_gives_the_values_that_were_written(tmp_path, storage):
    store = ROS1 if storage == "ros1" else ROS2
    values, command = motion(), motion(seed=1)
    topics = {
        "/joint_states": (JOINT_STATE, states(store, values)),
        "/joint_command": (JOINT_STATE, states(store, command[:1], start_ns=START_NS - STEP_NS)),
    }
    path = write_bag(tmp_path / ("arm.bag" if storage == "ros1" else "arm"), topics, storage)
    assert rosbag.detects(path)
    assert rosbag.detects(tmp_path)
    plan = rosbag.scan(path, ImportOptions(robot="arm"))
    episode = plan.episodes[0].load()
    assert (episode.id, episode.meta.robot, plan.robot) == ("arm", "arm", "arm")
    assert len(episode.meta.source_hash) == 64
    assert episode.measured.joints == JOINTS
    for signal, expected in zip(("position", "velocity", "torque"), values, strict=True):
        np.testing.assert_array_equal(episode.measured[signal], expected)
    assert episode.measured.units["torque"] == ("Nm",) * 3
    assert set(episode.commanded().signals) == {"position"}
    np.testing.assert_array_equal(episode.commanded()["position"], command[0])
    # Nanoseconds since 1970 do not fit a float; the steps must still be exact.
    np.testing.assert_allclose(episode.commanded().time_s, np.arange(40) * 0.01, atol=1e-12)
    np.testing.assert_allclose(episode.measured.time_s, 0.01 + np.arange(40) * 0.01, atol=1e-12)
    assert "header stamps" in flags(episode, "clock")[0].detail


@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE, CompressionMode.STORAGE])
def test_compressed_bags_are_read(tmp_path, mode):
    values = motion()
    path = write_bag(tmp_path / "arm", {"/joint_states": (JOINT_STATE, states(ROS2, values))}, compression=mode)
    np.testing.assert_array_equal(load(path).measured["torque"], values[2])


def test_bare_files_need_no_metadata_and_a_folder_is_many_episodes(tmp_path):
    for number, storage in enumerate(("mcap", "sqlite3")):
        values = {"/joint_states": (JOINT_STATE, states(ROS2, motion(seed=number)))}
        write_bag(tmp_path / f"run{number}", values, storage)
    (tmp_path / "run0" / "metadata.yaml").unlink()
    (tmp_path / "bare.db3").write_bytes((tmp_path / "run1" / "run1.db3").read_bytes())
    (tmp_path / "split.json").write_text('{"train": ["run1"], "test": ["bare"]}')
    plan = rosbag.scan(tmp_path, ImportOptions())
    assert [source.id for source in plan.episodes] == ["bare", "run0/run0", "run1"]
    assert plan.splits == {"run1": "train", "bare": "test"}
    loaded = [source.load() for source in plan.episodes]
    np.testing.assert_array_equal(loaded[1].measured["position"], motion(seed=0)[0])
    np.testing.assert_array_equal(loaded[0].measured["position"], loaded[2].measured["position"])
    assert all(source.bytes > 0 for source in plan.episodes)


@pytest.mark.parametrize("store", [ROS1, ROS2], ids=["ros1", "ros2"])
def test_joints_follow_the_names_of_each_message(tmp_path, store):
    values = motion(rows=60)
    order = [2, 0, 1]
    items = []
    for k, (log_ns, raw) in enumerate(states(store, values)):
        stamp_ns = START_NS + k * STEP_NS
        if k % 3 == 1:
            raw = state(store, stamp_ns, [JOINTS[j] for j in order], *(signal[k][order] for signal in values))
        if k % 3 == 2:
            raw = state(store, stamp_ns, JOINTS[:2], values[0][k][:2])
        items.append((log_ns, raw))
    path = tmp_path / "arm.bag" if store is ROS1 else tmp_path / "arm"
    measured = load(write_bag(path, {"/js": (JOINT_STATE, items)}, "ros1" if store is ROS1 else "mcap")).measured
    expected = values.copy()
    expected[0, 2::3, 2] = np.nan
    expected[1:, 2::3] = np.nan
    assert measured.joints == JOINTS
    for signal, wanted in zip(("position", "velocity", "torque"), expected, strict=True):
        np.testing.assert_array_equal(measured[signal], wanted)


def test_publishers_of_different_joints_come_onto_the_clock_of_the_larger(tmp_path):
    rows = 50
    arm = np.stack([np.sin(np.arange(rows) * 0.1 + j) for j in range(3)], axis=1)
    items = [(START_NS + k * STEP_NS, state(ROS2, START_NS + k * STEP_NS, JOINTS, arm[k])) for k in range(rows)]
    # The gripper opens linearly, at half the rate, and starts later: interpolation must be exact.
    for k in range(4, 40):
        stamp_ns = START_NS + k * STEP_NS + STEP_NS // 3
        items.append((stamp_ns, state(ROS2, stamp_ns, ["gripper"], [0.001 * (stamp_ns - START_NS) / STEP_NS])))
    episode = load(write_bag(tmp_path / "arm", {"/joint_states": (JOINT_STATE, items)}))
    measured = episode.measured
    assert measured.joints == (*JOINTS, "gripper")
    steps = np.arange(5, 40)
    np.testing.assert_allclose(measured.time_s, steps * 0.01, atol=1e-12)
    np.testing.assert_array_equal(measured["position"][:, :3], arm[5:40])
    np.testing.assert_allclose(measured["position"][:, 3], 0.001 * steps, rtol=1e-9)
    flag = flags(episode, "merged_clocks")[0]
    assert "gripper" in flag.detail
    assert flag.severity == "warning"
    assert "15 of 50" in flag.detail


def test_publishers_that_were_never_active_together_are_refused(tmp_path):
    items = states(ROS2, motion(rows=5)) + states(ROS2, motion(rows=5, joints=1), ["grip"], start_ns=START_NS + 10**10)
    path = write_bag(tmp_path / "arm", {"/joint_states": (JOINT_STATE, items)})
    with pytest.raises(DataError, match=r"do not overlap.*shoulder.*grip"):
        load(path)


def test_a_joint_that_a_command_leaves_out_keeps_its_last_value(tmp_path):
    commands = [
        (0, JOINTS[:2], [1.0, 2.0]),
        (1, ("wrist",), [3.0]),
        (1, ("shoulder",), [4.0]),
        (2, ("elbow",), [5.0]),
    ]
    items = [
        (START_NS + k * STEP_NS, state(ROS2, START_NS + k * STEP_NS, names, values)) for k, names, values in commands
    ]
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, motion())), "/desired": (JOINT_STATE, items)}
    command = load(write_bag(tmp_path / "arm", topics)).commanded()
    assert command.joints == JOINTS
    np.testing.assert_array_equal(command["position"], [[1, 2, np.nan], [4, 2, 3], [4, 5, 3]])


def test_trajectory_points_are_commands_at_their_own_time_and_a_new_one_replaces_the_rest(tmp_path):
    names = JOINTS[::-1]
    first = trajectory(START_NS, names, [(k * 0.1, [k, 10 + k, 20 + k]) for k in range(5)])
    second = trajectory(START_NS + 250_000_000, names, [(0.1, [7, 8, 9])])
    items = [(START_NS, first), (START_NS + 240_000_000, second)]
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, motion())), "/arm/joint_trajectory": (TRAJECTORY, items)}
    episode = load(write_bag(tmp_path / "arm", topics))
    command = episode.commanded().select(JOINTS)
    np.testing.assert_allclose(command.time_s, [0.0, 0.1, 0.2, 0.35], atol=1e-9)
    np.testing.assert_array_equal(command["position"][:, 2], [0, 1, 2, 7])
    np.testing.assert_array_equal(command["position"][-1], [9, 8, 7])
    assert "2 points were superseded" in flags(episode, "trajectory")[0].detail


@pytest.mark.parametrize("due_s", [0.0, 0.01, 0.05])
def test_points_that_are_sent_one_at_a_time_are_set_points_from_their_arrival(tmp_path, due_s):
    items = [
        (START_NS + k * STEP_NS, trajectory(START_NS + k * STEP_NS, JOINTS, [(due_s, [k, 1, 2])])) for k in range(40)
    ]
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, motion())), "/arm/joint_trajectory": (TRAJECTORY, items)}
    episode = load(write_bag(tmp_path / "arm", topics))
    np.testing.assert_allclose(episode.command.time_s, 0.01 * np.arange(40), atol=1e-9)
    np.testing.assert_array_equal(episode.command["position"][:, 0], np.arange(40))


def test_goals_of_one_point_that_come_slower_than_they_are_due_are_planned(tmp_path):
    items = [
        (START_NS + k * 4 * STEP_NS, trajectory(START_NS + k * 4 * STEP_NS, JOINTS, [(0.02, [k, 1, 2])]))
        for k in range(9)
    ]
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, motion())), "/arm/joint_trajectory": (TRAJECTORY, items)}
    episode = load(write_bag(tmp_path / "arm", topics))
    np.testing.assert_allclose(episode.command.time_s, 0.02 + 0.04 * np.arange(9), atol=1e-9)


NUMBER = "std_msgs/msg/Float64"


def numbers(values, late_ns):
    kind = ROS2.types[NUMBER]
    return [
        (START_NS + k * STEP_NS + late_ns, bytes(ROS2.serialize_cdr(kind(float(value)), NUMBER)))
        for k, value in enumerate(values)
    ]


def test_a_number_for_each_joint_is_a_command_of_all(tmp_path):
    topics = {
        "/joint_states": (JOINT_STATE, states(ROS2, motion())),
        **{
            f"/{joint}_effort_controller/command": (NUMBER, numbers(np.arange(40) + 100 * place, 1000 * place))
            for place, joint in enumerate(JOINTS)
        },
    }
    command = load(write_bag(tmp_path / "arm", topics)).command.select(JOINTS)
    assert set(command.signals) == {"torque"}
    np.testing.assert_array_equal(command["torque"], np.arange(40)[:, None] + [0, 100, 200])
    strange = {
        "/joint_states": (JOINT_STATE, states(ROS2, motion())),
        "/motor7/command": (NUMBER, numbers(np.arange(40), 0)),
    }
    with pytest.raises(ConfigError, match=r"no joint's name.*shoulder, elbow, wrist"):
        load(write_bag(tmp_path / "other", strange))


CONTROL = """std_msgs/Header header
string[] joint_names
"""
POINTS = "\n".join(f"trajectory_msgs/JointTrajectoryPoint {name}" for name in ("{0}", "{1}", "error"))


def control_store(text, kind):
    store = get_typestore(Stores.ROS2_HUMBLE)
    part = "control_msgs/msg/InterfaceValue"
    store.register(get_types_from_msg("string[] interface_names\nfloat64[] values", part))
    store.register(get_types_from_msg(text, kind))
    return store


@pytest.mark.parametrize(("told", "done"), [("reference", "feedback"), ("desired", "actual")])
@pytest.mark.parametrize("with_states", [True, False])
def test_the_state_of_a_controller_has_command_and_measurement_at_one_stamp(tmp_path, told, done, with_states):
    kind = "control_msgs/msg/JointTrajectoryControllerState"
    store = control_store(CONTROL + POINTS.format(told, done), kind)
    point, none = store.types["trajectory_msgs/msg/JointTrajectoryPoint"], np.array([])
    due = store.types["builtin_interfaces/msg/Duration"](0, 0)
    items = []
    for k in range(40):
        own = [point(np.array([k + shift, 1.0, 2.0]), none, none, none, due) for shift in (0.5, 0.0, 0.5)]
        head = header(store, START_NS + k * STEP_NS)
        message = store.types[kind](head, list(JOINTS), *own)
        items.append((START_NS + k * STEP_NS + LATE_NS, bytes(store.serialize_cdr(message, kind))))
    writer = Writer2(tmp_path / "arm", version=9, storage_plugin=StoragePlugin.MCAP)
    with writer:
        connection = writer.add_connection("/arm_controller/controller_state", kind, typestore=store)
        for log_ns, raw in items:
            writer.write(connection, log_ns, raw)
        if with_states:
            fill(writer, {"/joint_states": (JOINT_STATE, states(ROS2, motion()))}, ROS2)
    episode = load(tmp_path / "arm")
    np.testing.assert_array_equal(episode.command.select(JOINTS)["position"][:, 0], np.arange(40) + 0.5)
    np.testing.assert_allclose(episode.command.time_s, 0.01 * np.arange(40), atol=1e-9)
    if not with_states:
        np.testing.assert_array_equal(episode.measured.select(JOINTS)["position"][:, 0], np.arange(40))
        np.testing.assert_array_equal(episode.measured.time_s, episode.command.time_s)


def test_dynamic_joint_states_are_measured(tmp_path):
    kind = "control_msgs/msg/DynamicJointState"
    store = control_store(CONTROL + "control_msgs/InterfaceValue[] interface_values", kind)
    value = store.types["control_msgs/msg/InterfaceValue"]
    with Writer2(tmp_path / "arm", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/dynamic_joint_states", kind, typestore=store)
        for k in range(5):
            values = [
                value(["position", "effort"], np.array([k, 2.0 * k])),
                value(["position", "temperature"], np.array([k + 10.0, 40.0])),
            ]
            message = store.types[kind](header(store, START_NS + k * STEP_NS), ["a", "b"], values)
            writer.write(connection, START_NS + k * STEP_NS, bytes(store.serialize_cdr(message, kind)))
    measured = load(tmp_path / "arm").measured
    np.testing.assert_array_equal(measured["position"], np.column_stack([np.arange(5), np.arange(5) + 10]))
    np.testing.assert_array_equal(measured["torque"][:, 0], 2 * np.arange(5))
    assert np.isnan(measured["torque"][:, 1]).all()


def test_a_controller_state_with_fields_of_its_own_is_refused(tmp_path):
    kind = "control_msgs/msg/JointTrajectoryControllerState"
    with Writer2(tmp_path / "arm", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/c/controller_state", kind, msgdef="float64[] surprise", rihs01="x")
    with pytest.raises(FormatError, match=r"type of its own.*surprise"):
        load(tmp_path / "arm")


@pytest.mark.parametrize(
    ("case", "signal", "count"),
    [
        ("bags/D_vel_empty_eff_nan", "position", 400),
        ("bags/H2_js_and_controller_state", "position", 400),
        ("bags/L_float64", "position", 400),
        ("bags/T_20ms", "position", 400),
        ("bags/T_20ms_jitter", "position", 400),
        ("mcap/noprofile", "position", 400),
    ],
)
def test_cases_of_strangers(log_cases, case, signal, count):
    (source,) = rosbag.scan(log_cases / case, ImportOptions()).episodes
    episode = source.load()
    names = ("yaw", "shoulder", "elbow")
    command = episode.command.select(names)
    assert len(command) == count
    assert len(episode.measured) == 1600

    def motion_at(time_s):
        return np.column_stack([0.5 * np.sin((1 + 0.5 * i) * time_s + i) for i in range(3)])

    np.testing.assert_allclose(
        episode.measured.select(names)["position"], motion_at(episode.measured.time_s), atol=1e-6
    )
    np.testing.assert_allclose(command[signal], motion_at(command.time_s + 0.03), atol=1e-3)


def test_arrays_without_names_are_refused_until_their_joints_are_stated(tmp_path):
    values = motion()
    items = [(log_ns, array(ROS2, values[2][k])) for k, (log_ns, _) in enumerate(states(ROS2, values))]
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, values)), "/effort_controller/commands": (ARRAY, items)}
    path = write_bag(tmp_path / "arm", topics)
    with pytest.raises(ConfigError, match=r"(?s)no joint names.*40 arrays of 3 values.*command_joints: \[name1, name2"):
        load(path)
    mapping = tmp_path / "m.yaml"
    mapping.write_text("command_joints: [wrist, elbow]\n")
    with pytest.raises(ConfigError, match="does not fit"):
        load(path, mapping=mapping)
    mapping.write_text("command_joints: [wrist, elbow, shoulder]\npayload_kg: 0.5\nkp_setting: 9\nunit: left\n")
    episode = load(path, mapping=mapping)
    assert (episode.meta.payload_kg, episode.meta.unit, episode.meta.kp_setting) == (0.5, "left", 9.0)
    np.testing.assert_array_equal(episode.commanded().select(("wrist", "elbow", "shoulder"))["torque"], values[2])
    # The command has the recorder's clock, the measurement its own header: both count from the same origin.
    assert episode.commanded().time_s[0] - episode.measured.time_s[0] == pytest.approx(LATE_NS / 1e9)


def test_the_command_may_be_stated_to_be_another_signal(tmp_path):
    items = [(log_ns, array(ROS2, [1.0])) for log_ns, _ in states(ROS2, motion())]
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, motion())), "/cmd": (ARRAY, items)}
    mapping = tmp_path / "m.yaml"
    mapping.write_text("joints: [wrist]\ncommand_signal: velocity\nunits: {position.elbow: m}\n")
    episode = load(write_bag(tmp_path / "arm", topics), mapping=mapping)
    assert episode.commanded().units == {"velocity": ("rad/s",)}
    assert episode.measured.units["position"] == ("rad", "m", "rad")


def test_header_stamps_that_cannot_be_used_give_way_to_the_recorder(tmp_path):
    values = motion()
    unset = load(write_bag(tmp_path / "a", {"/joint_states": (JOINT_STATE, states(ROS2, values, stamped=False))}))
    assert "not set" in flags(unset, "clock")[0].detail
    np.testing.assert_allclose(unset.measured.time_s, np.arange(40) * 0.01, atol=1e-12)

    items = states(ROS2, values)
    jump = [(log, state(ROS2, START_NS + (k % 20) * 10**9, JOINTS, values[0][k])) for k, (log, _) in enumerate(items)]
    reset = load(write_bag(tmp_path / "b", {"/joint_states": (JOINT_STATE, jump)}))
    assert flags(reset, "clock")[0].severity == "warning"
    np.testing.assert_allclose(reset.measured.time_s, np.arange(40) * 0.01, atol=1e-12)

    simulated = [(log, state(ROS2, 10**9 + k * STEP_NS, JOINTS, values[0][k])) for k, (log, _) in enumerate(items)]
    topics = {"/joint_states": (JOINT_STATE, simulated), "/command": (JOINT_STATE, items)}
    apart = load(write_bag(tmp_path / "c", topics))
    assert "apart" in flags(apart, "clock")[0].detail
    np.testing.assert_array_equal(apart.measured.time_s, apart.commanded().time_s)


def test_messages_that_overtook_each_other_are_sorted_and_repeats_flagged(tmp_path):
    order = [0, 2, 1, 3, 3, 4]
    items = [(START_NS + k, state(ROS2, START_NS + j * STEP_NS, JOINTS, [j] * 3)) for k, j in enumerate(order)]
    episode = load(write_bag(tmp_path / "arm", {"/joint_states": (JOINT_STATE, items)}))
    np.testing.assert_array_equal(episode.measured["position"][:, 0], [0, 1, 2, 3, 4])
    assert flags(episode, "unordered_stamps")
    assert flags(episode, "repeated_stamps")


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["/joint_states", "/other"], "/joint_states"),
        (["/arm/states"], "/arm/states"),
        (["/arm/states", "/arm/target_states"], "/arm/states"),
        (["/left", "/right"], None),
    ],
)
def test_the_measured_topic_is_found_or_asked_for(tmp_path, names, expected):
    topics = {name: (JOINT_STATE, states(ROS2, motion(seed=k))) for k, name in enumerate(names)}
    path = write_bag(tmp_path / "arm", topics)
    if expected is None:
        with pytest.raises(ConfigError, match=r"not clear.*/left \(sensor_msgs/JointState, 40 messages\), /right"):
            rosbag.scan(path, ImportOptions())
        expected = "/right"
    episode = load(path, measured_topic=expected)
    np.testing.assert_array_equal(episode.measured["position"], motion(seed=names.index(expected))[0])
    if len(names) == 2 and expected == "/joint_states":
        assert episode.command is None


def test_topics_that_cannot_be_used_are_errors_that_list_what_there_is(tmp_path):
    items = states(ROS2, motion())
    arrays = [(START_NS, array(ROS2, [1.0]))]
    topics = {
        "/joint_states": (JOINT_STATE, items),
        "/a/command": (JOINT_STATE, items),
        "/b/command": (JOINT_STATE, items),
        "/x": (ARRAY, arrays),
    }
    path = write_bag(tmp_path / "arm", topics)
    with pytest.raises(ConfigError, match=r"(?s)command topic is not clear.*/a/command.*/b/command.*--command-topic"):
        load(path)
    with pytest.raises(ConfigError, match=r"no topic /no.*available: /a/command"):
        load(path, command_topic="/no")
    with pytest.raises(ConfigError, match="cannot be used"):
        load(path, measured_topic="/x", command_topic="/a/command")
    with pytest.raises(ConfigError, match="both command and measured"):
        load(path, command_topic="/joint_states")
    assert load(path, command_topic="/b/command").commanded().joints == JOINTS
    with pytest.raises(ConfigError, match="no joint states"):
        load(write_bag(tmp_path / "none", {"/x": (ARRAY, arrays)}))


@pytest.mark.parametrize(
    ("message", "error", "text"),
    [
        (state(ROS2, START_NS, JOINTS, [1.0, 2.0]), DataError, "ragged.*2 values of position for the 3 joints"),
        (state(ROS2, START_NS, ["a", "a"], [1.0, 2.0]), DataError, "names a joint twice"),
        (state(ROS2, START_NS, [], [1.0, 2.0]), ConfigError, "no joint names.*2 values"),
        (state(ROS2, START_NS, JOINTS), DataError, "no values"),
        (state(ROS2, START_NS, JOINTS, [1.0, 2.0, 3.0])[:-9], DataError, "cannot be read as a bag"),
    ],
)
@pytest.mark.parametrize("repeats", [1, 20])
def test_messages_that_make_no_sense_are_refused(tmp_path, message, error, text, repeats):
    items = [(START_NS + k, message) for k in range(repeats)]
    path = write_bag(tmp_path / "arm", {"/joint_states": (JOINT_STATE, items)})
    with pytest.raises(error, match=f"(?s){text}"):
        load(path)


def test_empty_arrays_and_nan_are_kept_as_missing(tmp_path):
    values = motion()
    values[0, 3, 1] = np.nan
    items = states(ROS2, values)
    items[5] = (items[5][0], state(ROS2, START_NS + 5 * STEP_NS, JOINTS, values[0][5]))
    items[6] = (items[6][0], state(ROS2, START_NS + 6 * STEP_NS, JOINTS))
    measured = load(write_bag(tmp_path / "arm", {"/joint_states": (JOINT_STATE, items)})).measured
    assert len(measured) == 39  # the message without any value is no sample
    assert np.argwhere(np.isnan(measured["position"])).tolist() == [[3, 1]]
    assert np.isnan(measured["velocity"][5]).all()
    np.testing.assert_array_equal(measured["torque"][6:], values[2][7:])


def test_a_foreign_type_under_a_ros_name_is_refused(tmp_path):
    with Writer2(tmp_path / "arm", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/joint_states", JOINT_STATE, msgdef="float64[] position\nstring[] name", rihs01="x")
    with pytest.raises(FormatError, match="type of its own"):
        load(tmp_path / "arm")


def test_a_bag_of_other_bytes_is_not_taken_into_memory(tmp_path):
    path = tmp_path / "zeros.bag"
    with path.open("wb") as file:
        file.truncate(1 << 42)
    with pytest.raises(DataError, match="other bytes where a bag begins"), open_bag(path):
        pass


def test_truncated_and_empty_bags_say_what_to_do(tmp_path):
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, motion(rows=300)))}
    mcap = (write_bag(tmp_path / "m", topics) / "m.mcap").read_bytes()
    db3 = (write_bag(tmp_path / "s", topics, "sqlite3") / "s.db3").read_bytes()
    topics1 = {"/joint_states": (JOINT_STATE, states(ROS1, motion(rows=300)))}
    bag = write_bag(tmp_path / "r.bag", topics1, "ros1").read_bytes()
    for data, name, hint in ((mcap, "x.mcap", "mcap recover"), (db3, "x.db3", ".recover"), (bag, "x.bag", "reindex")):
        for size in (0, 5, len(data) // 2):
            (tmp_path / name).write_bytes(data[:size])
            assert rosbag.detects(tmp_path / name)
            plan = rosbag.scan(tmp_path / name, ImportOptions())
            with pytest.raises(DataError, match=hint):
                plan.episodes[0].load()


def test_paths_without_bags_and_links_out_of_the_folder_are_refused(tmp_path):
    inner = tmp_path / "logs"
    inner.mkdir()
    assert not rosbag.detects(inner)
    assert not rosbag.detects(tmp_path / "nothing")
    with pytest.raises(FormatError, match="no bag"):
        rosbag.scan(inner, ImportOptions())
    outside = write_bag(tmp_path / "arm", {"/joint_states": (JOINT_STATE, states(ROS2, motion()))})
    (inner / "link").symlink_to(outside)
    with pytest.raises(DataError, match="out of the folder"):
        rosbag.scan(inner, ImportOptions())


@pytest.mark.parametrize(
    "text",
    [
        "joints: 3",
        "joints: [a, a]",
        "joint: [a]",
        "payload_kg: -1",
        "payload_kg: .nan",
        "kp_setting: 0",
        "kp_setting: .inf",
        "kp_setting: true",
        "- a",
        "a: [",
        "joints: !!python/name:os.system",
        "command_signal: wind",
        "time_unit: kg",
        "units: [m]",
        "unit: [m]",
        "a: !!int x",
    ],
)
def test_mapping_files_that_make_no_sense_are_refused(tmp_path, text):
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(ConfigError):
        rosbag.scan(tmp_path, ImportOptions(mapping=tmp_path / "m.yaml"))


def test_units_of_joints_that_are_not_there_are_refused(tmp_path):
    path = write_bag(tmp_path / "arm", {"/joint_states": (JOINT_STATE, states(ROS2, motion()))})
    with pytest.raises(NameMismatch, match="shoulder"):
        load(path, units={"position.knee": "m"})


names = st.lists(st.text("abcé_", min_size=1, max_size=5), min_size=0, max_size=4, unique=True)


@settings(max_examples=30)
@given(data=st.data(), ros1=st.booleans())
def test_decoding_many_at_once_equals_decoding_one_by_one(data, ros1):
    """Whatever publishers send: other names, orders, lengths, frames, missing arrays."""
    store = ROS1 if ros1 else ROS2
    layouts = data.draw(st.lists(st.tuples(names, st.tuples(*[st.booleans()] * 3)), min_size=1, max_size=3))
    which = data.draw(st.lists(st.integers(0, len(layouts) - 1), min_size=1, max_size=40))
    rng = np.random.default_rng(0)
    raws = []
    for k, choice in enumerate(which):
        joints, present = layouts[choice]
        arrays = [rng.normal(size=len(joints)) if has else () for has in present]
        raws.append(state(store, START_NS + k, joints, *arrays))

    def deserialize(raw):
        return store.deserialize_ros1(raw, JOINT_STATE) if ros1 else store.deserialize_cdr(raw, JOINT_STATE)

    decoder = JointStateDecoder(deserialize, "test", ros1=ros1)
    for k, raw in enumerate(raws):
        decoder.push(k, raw)
    found = {}
    for group in decoder.samples():
        assert np.all(np.diff(group.index) > 0)
        for row, k in enumerate(group.index):
            found[int(k)] = (group.joints, group.stamp_ns[row], {s: v[row] for s, v in group.signals.items()})
    for k, raw in enumerate(raws):
        message = deserialize(raw)
        fields = dict(zip(("position", "velocity", "torque"), (getattr(message, f) for f in ALL), strict=True))
        expected = {signal: values for signal, values in fields.items() if len(values)}
        if not expected:
            assert k not in found
            continue
        joints, stamp, signals = found[k]
        assert joints == tuple(message.name)
        assert stamp == START_NS + k
        assert set(signals) == set(expected)
        for signal, values in expected.items():
            np.testing.assert_array_equal(signals[signal], values)


def mcap(path, channels, messages):
    """An MCAP file without chunks, as its specification has it.

    channels: name -> (encoding of messages, name, encoding and text of the schema); messages: (topic, ns, bytes).
    """

    def text(value):
        return struct.pack("<I", len(value)) + (value if isinstance(value, bytes) else value.encode())

    def record(kind, data):
        return struct.pack("<BQ", kind, len(data)) + data

    magic, numbers = b"\x89MCAP0\r\n", {topic: number for number, topic in enumerate(channels, start=1)}
    parts = [record(1, text("") + text("test"))]
    for topic, (encoding, name, language, schema) in channels.items():
        own = struct.pack("<H", numbers[topic])
        parts.append(record(3, own + text(name) + text(language) + text(schema)))
        parts.append(record(4, own + own + text(topic) + text(encoding) + text(b"")))
    for topic, stamp_ns, data in messages:
        parts.append(record(5, struct.pack("<HIQQ", numbers[topic], 0, stamp_ns, stamp_ns) + data))
    path.write_bytes(magic + b"".join(parts) + record(15, bytes(4)) + record(2, bytes(20)) + magic)
    return path


def json_state(values, names=JOINTS, **more):
    return json.dumps({"name": list(names), "position": list(values), **more}).encode()


@pytest.mark.parametrize("name", ["JointState", "sensor_msgs/JointState", "sensor_msgs.msg.JointState"])
def test_messages_in_json_are_read(tmp_path, name):
    values, command = motion()[0], motion(seed=1)[0]
    channels = dict.fromkeys(("/joint_states", "/joint_command"), ("json", name, "jsonschema", "{}"))
    messages = [
        item
        for row in range(len(values))
        for item in (
            ("/joint_states", START_NS + row * STEP_NS, json_state(values[row])),
            ("/joint_command", START_NS + row * STEP_NS, json_state(command[row][::-1], JOINTS[::-1])),
        )
    ]
    episode = load(mcap(tmp_path / "run.mcap", channels, messages))
    np.testing.assert_array_equal(episode.measured["position"], values)
    np.testing.assert_array_equal(episode.command.select(JOINTS)["position"], command)
    np.testing.assert_allclose(episode.measured.time_s, 0.01 * np.arange(len(values)), atol=1e-9)


@pytest.mark.parametrize("seconds", ["sec", "nanosec"])
def test_stamps_in_json_count(tmp_path, seconds):
    parts = {"sec": ("sec", "nsec"), "nanosec": ("sec", "nanosec")}[seconds]
    messages = []
    for row in range(10):
        whole, rest = divmod(START_NS + 2 * row * STEP_NS, 10**9)
        stamp = {"stamp": dict(zip(parts, (whole, rest), strict=True))}
        messages.append(("/joint_states", START_NS + row * STEP_NS, json_state((row, 0, 0), header=stamp)))
    episode = load(mcap(tmp_path / "run.mcap", {"/joint_states": ("json", "JointState", "jsonschema", "{}")}, messages))
    np.testing.assert_allclose(episode.measured.time_s, 0.02 * np.arange(10), atol=1e-9)


def test_topics_of_other_encodings_beside_those_of_ros_are_passed_over(tmp_path):
    values = motion()
    channels = {
        "/scene": ("protobuf", "foxglove.SceneUpdate", "protobuf", b"\x0a\x00"),
        "/joint_states": ("cdr", JOINT_STATE, "ros2msg", JOINT_STATE_TEXT),
    }
    messages = [("/joint_states", log_ns, raw) for log_ns, raw in states(ROS2, values)]
    messages.insert(3, ("/scene", START_NS, b"\x0a\x00"))
    episode = load(mcap(tmp_path / "run.mcap", channels, messages))
    np.testing.assert_array_equal(episode.measured["position"], values[0])


@pytest.mark.parametrize(
    "raw",
    [
        b"{",
        b"{}x",
        b'{"name": 3}',
        b'{"position": ["a", "b", "c"]}',
        b'{"header": 7}',
        b'{"header": {"stamp": []}}',
        b"{" * 9999,
    ],
)
def test_json_that_is_no_message_is_refused(tmp_path, raw):
    path = mcap(
        tmp_path / "run.mcap",
        {"/joint_states": ("json", "JointState", "jsonschema", "{}")},
        [("/joint_states", START_NS, json_state((1, 2, 3))), ("/joint_states", START_NS + STEP_NS, raw)],
    )
    with pytest.raises(DataError, match=r"no sensor_msgs/JointState in JSON|ragged"):
        load(path)


IMU = "sensor_msgs/msg/Imu"


def imu(stamp_ns, force, turned=(0.0, 0.0, 0.0, 1.0), frame="pelvis_imu", known=(0.0, 0.0)):
    """A reading; `known` is the first number of the covariances of orientation and acceleration."""
    vector, quaternion = ROS2.types["geometry_msgs/msg/Vector3"], ROS2.types["geometry_msgs/msg/Quaternion"]
    own = header(ROS2, stamp_ns)
    own.frame_id = frame
    spread = [np.array([first, *[0.0] * 8]) for first in (known[0], 0.0, known[1])]
    kind = ROS2.types[IMU]
    message = kind(own, quaternion(*turned), spread[0], vector(0.0, 0.0, 0.0), spread[1], vector(*force), spread[2])
    return serialize(ROS2, message, IMU)


def turned_by(angle):
    return (0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2))


def imus(count, *, step_ns=STEP_NS // 2, first=0, **more):
    stamps = [START_NS + (first + k) * step_ns for k in range(count)]
    return [(ns + LATE_NS, imu(ns, (0.1 * k, 0.0, 9.81), turned_by(0.01 * k), **more)) for k, ns in enumerate(stamps)]


def test_what_an_imu_reads_is_a_signal_of_its_body(tmp_path):
    values = motion()
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, values)), "/imu/data": (IMU, imus(100))}
    episode = load(write_bag(tmp_path / "bag", topics))
    measured = episode.measured
    assert measured.bodies == ("pelvis_imu",)
    rows = np.arange(len(measured))
    # Twice as often as the joints: every second reading has the stamp of one of theirs.
    np.testing.assert_allclose(measured["body.specific_force"][:, 0, 0], 0.2 * rows, atol=1e-7)
    np.testing.assert_allclose(measured["body.specific_force"][:, 0, 2], 9.81)
    angle = np.arctan2(measured["body.rotation"][:, 0, 1, 0], measured["body.rotation"][:, 0, 0, 0])
    np.testing.assert_allclose(angle, 0.02 * rows, atol=1e-7)
    np.testing.assert_array_equal(measured["position"], values[0])
    assert "/imu/data as pelvis_imu" in flags(episode, "sensors")[0].detail


def test_between_readings_they_are_interpolated_and_beyond_them_unknown(tmp_path):
    topics = {
        "/joint_states": (JOINT_STATE, states(ROS2, motion())),
        "/imu/data": (IMU, imus(10, step_ns=3 * STEP_NS, first=1)),
    }
    force = load(write_bag(tmp_path / "bag", topics)).measured["body.specific_force"][:, 0, 0]
    assert np.isnan(force[:3]).all()
    np.testing.assert_allclose(force[3:31], (np.arange(3, 31) - 3) / 30, atol=1e-7)
    assert np.isnan(force[31:]).all()


@pytest.mark.parametrize(
    ("known", "turned", "signals"),
    [
        ((-1.0, 0.0), (0.0, 0.0, 0.0, 1.0), {"body.specific_force"}),
        ((0.0, 0.0), (0.0, 0.0, 0.0, 0.0), {"body.specific_force"}),
        ((0.0, -1.0), (0.0, 0.0, 0.0, 1.0), set()),
    ],
)
def test_what_a_sensor_does_not_measure_is_no_signal(tmp_path, known, turned, signals):
    items = [
        (START_NS + k * STEP_NS, imu(START_NS + k * STEP_NS, (1.0, 2.0, 3.0), turned, known=known)) for k in range(40)
    ]
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, motion())), "/imu": (IMU, items)}
    measured = load(write_bag(tmp_path / "bag", topics)).measured
    assert {name for name in measured.signals if name.startswith("body.")} == signals


def test_two_sensors_in_one_frame_are_told_apart_by_their_topics(tmp_path):
    topics = {
        "/joint_states": (JOINT_STATE, states(ROS2, motion())),
        "/left/imu": (IMU, imus(100)),
        "/right/imu": (IMU, imus(100)),
        "/head/imu": (IMU, imus(100, frame="head", known=(-1.0, 0.0))),
    }
    measured = load(write_bag(tmp_path / "bag", topics)).measured
    assert set(measured.bodies) == {"left/imu", "right/imu", "head"}
    assert np.isnan(measured["body.rotation"][:, measured.bodies.index("head")]).all()
