"""Unitree's LowState and LowCmd give the numbers that were written, by joint name, and what they cannot say is told."""

import sqlite3
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from conftest import shared_folder
from dataset.test_import_rosbag import JOINT_STATE, ROS2, START_NS, STEP_NS, fill, flags, load, states
from trueup.dataset.importers import rosbag, unitree
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import ConfigError, DataError, FormatError

LINE = "=" * 80
GO_STATE = f"""uint8[2] head
uint8 level_flag
uint8 frame_reserve
uint32[2] sn
uint32[2] version
uint16 bandwidth
IMUState imu_state
MotorState[20] motor_state
BmsState bms_state
int16[4] foot_force
int16[4] foot_force_est
uint32 tick
uint8[40] wireless_remote
uint8 bit_flag
float32 adc_reel
int8 temperature_ntc1
int8 temperature_ntc2
float32 power_v
float32 power_a
uint16[4] fan_frequency
uint32 reserve
uint32 crc
{LINE}
MSG: unitree_go/IMUState
float32[4] quaternion
float32[3] gyroscope
float32[3] accelerometer
float32[3] rpy
int8 temperature
{LINE}
MSG: unitree_go/MotorState
uint8 mode
float32 q
float32 dq
float32 ddq
float32 tau_est
float32 q_raw
float32 dq_raw
float32 ddq_raw
int8 temperature
uint32 lost
uint32[2] reserve
{LINE}
MSG: unitree_go/BmsState
uint8 version_high
uint8 version_low
uint8 status
uint8 soc
int32 current
uint16 cycle
int8[2] bq_ntc
int8[2] mcu_ntc
uint16[15] cell_vol
"""
GO_COMMAND = f"""uint8[2] head
uint8 level_flag
uint8 frame_reserve
uint32[2] sn
uint32[2] version
uint16 bandwidth
MotorCmd[20] motor_cmd
BmsCmd bms_cmd
uint8[40] wireless_remote
uint8[12] led
uint8[2] fan
uint8 gpio
uint32 reserve
uint32 crc
{LINE}
MSG: unitree_go/MotorCmd
uint8 mode
float32 q
float32 dq
float32 tau
float32 kp
float32 kd
uint32[3] reserve
{LINE}
MSG: unitree_go/BmsCmd
uint8 off
uint8[3] reserve
"""
HG_STATE = f"""uint32[2] version
uint8 mode_pr
uint8 mode_machine
uint32 tick
IMUState imu_state
MotorState[35] motor_state
uint8[40] wireless_remote
uint32[4] reserve
uint32 crc
{LINE}
MSG: unitree_hg/IMUState
float32[4] quaternion
float32[3] gyroscope
float32[3] accelerometer
float32[3] rpy
int16 temperature
{LINE}
MSG: unitree_hg/MotorState
uint8 mode
float32 q
float32 dq
float32 ddq
float32 tau_est
int16[2] temperature
float32 vol
uint32[2] sensor
uint32 motorstate
uint32[4] reserve
"""
HG_COMMAND = f"""uint8 mode_pr
uint8 mode_machine
MotorCmd[35] motor_cmd
uint32[4] reserve
uint32 crc
{LINE}
MSG: unitree_hg/MotorCmd
uint8 mode
float32 q
float32 dq
float32 tau
float32 kp
float32 kd
uint32 reserve
"""
TEXTS = {
    "unitree_go/msg/LowState": GO_STATE,
    "unitree_go/msg/LowCmd": GO_COMMAND,
    "unitree_hg/msg/LowState": HG_STATE,
    "unitree_hg/msg/LowCmd": HG_COMMAND,
}
MOTORS = {"unitree_go": 20, "unitree_hg": 35}
DOG = [f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")]
ROWS = 40


def store_of(texts=TEXTS):
    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, text in texts.items():
        store.register(get_types_from_msg(text, kind))
    return store


STORE = store_of()


def filled(store, kind, **given):
    """A message with numbers in all of its fields, none of them zero, so that a shift by a byte shows."""

    def value(node, place):
        tag, of = int(node[0]), node[1]
        if tag == 2:
            return filled(store, of)
        if tag == 3:
            child, count = of
            if int(child[0]) == 1:
                return np.full(count, 3 + place, dtype=child[1][0])
            return [value(child, place) for _ in range(count)]
        return 7 + place

    fields = store.fielddefs[kind][1]
    return store.types[kind](
        **{name: given.get(name, value(node, place % 50)) for place, (name, node) in enumerate(fields)}
    )


def low(package, part, columns, store=STORE):
    """Bytes of messages; columns: field -> (rows, motors), zero beyond the motors that are given."""
    kind = f"{package}/msg/{'LowState' if part == 'motor_state' else 'LowCmd'}"
    motor = f"{package}/msg/{'MotorState' if part == 'motor_state' else 'MotorCmd'}"
    rows, width = next(iter(columns.values())).shape
    items = []
    for k in range(rows):
        motors = []
        for number in range(MOTORS[package]):
            own = {field: float(values[k, number]) if number < width else 0.0 for field, values in columns.items()}
            motors.append(filled(store, motor, **own))
        raw = bytes(store.serialize_cdr(filled(store, kind, **{part: motors}), kind))
        items.append((START_NS + k * STEP_NS, raw))
    return kind, items


def seen(rows=ROWS, motors=12, seed=0):
    numbers = np.random.default_rng(seed).normal(size=(3, rows, motors)).astype(np.float32)
    return dict(zip(("q", "dq", "tau_est"), numbers, strict=True))


def told(rows=ROWS, motors=12, seed=1, **given):
    own = {"q": np.random.default_rng(seed).normal(size=(rows, motors)).astype(np.float32)}
    own |= {name: np.zeros((rows, motors), dtype=np.float32) for name in ("dq", "tau", "kp", "kd")}
    return own | {name: np.broadcast_to(np.float32(values), (rows, motors)) for name, values in given.items()}


def write(path, topics, storage="mcap", store=STORE):
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        fill(writer, topics, store)
    return path


def bag(path, package="unitree_go", state=None, command=None, storage="mcap"):
    topics = {"/lowstate": low(package, "motor_state", state or seen())}
    if command is not None:
        topics["/lowcmd"] = low(package, "motor_cmd", command)
    return write(path, topics, storage)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_quadruped_is_read_by_joint_name_exactly(tmp_path, storage):
    state, command = seen(), told(kp=60, kd=5)
    episode = load(bag(tmp_path / "go2", state=state, command=command, storage=storage))
    assert episode.measured.joints == tuple(DOG)
    for signal, field in {"position": "q", "velocity": "dq", "torque": "tau_est"}.items():
        np.testing.assert_array_equal(episode.measured[signal], state[field])
    assert episode.measured.units["torque"] == ("Nm",) * 12
    assert episode.command.joints == tuple(DOG)
    assert set(episode.command.signals) == {"position"}
    np.testing.assert_array_equal(episode.command["position"], command["q"])
    np.testing.assert_allclose(episode.measured.time_s, 0.01 * np.arange(ROWS), atol=1e-12)
    np.testing.assert_array_equal(episode.measured.time_s, episode.command.time_s)
    assert episode.meta.kp_setting == 60.0
    (motors,) = flags(episode, "motors")
    assert "left out since they report nothing: 12 to 19" in motors.detail
    (gains,) = flags(episode, "gains")
    assert (gains.severity, gains.detail) == ("note", "gains that were sent: kp 60, kd 5 (all joints)")


def test_a_humanoid_with_29_or_23_joints_is_read(tmp_path):
    state, command = seen(motors=29), told(motors=29, kp=40.3, kd=1)
    plan = rosbag.scan(bag(tmp_path / "g1", "unitree_hg", state, command), ImportOptions())
    assert any("motors are named as those of a G1" in note for note in plan.notes)
    episode = plan.episodes[0].load()
    legs = ["hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll"]
    arms = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw"]
    names = [f"{side}_{part}_joint" for side in ("left", "right") for part in legs]
    names += ["waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint"]
    names += [f"{side}_{part}_joint" for side in ("left", "right") for part in arms]
    assert episode.measured.joints == tuple(names)
    np.testing.assert_array_equal(episode.measured["torque"], state["tau_est"])
    np.testing.assert_array_equal(episode.command["position"], command["q"])
    assert episode.meta.kp_setting == 40.3  # not the float32 next to it
    lacking = [13, 14, 20, 21, 27, 28]
    for values in state.values():
        values[:, lacking] = 0
    small = load(bag(tmp_path / "small", "unitree_hg", state, command))
    there = [name for number, name in enumerate(names) if number not in lacking]
    assert small.measured.joints == small.command.joints == tuple(there)
    assert "13 to 14, 20 to 21, 27 to 34" in flags(small, "motors")[0].detail


def test_the_names_of_a_humanoid_are_those_of_its_model():
    shared = shared_folder()
    model = None if shared is None else shared / "data" / "foreign" / "g1.xml"
    if model is None or not model.is_file():
        pytest.skip("the model of a G1 is not there")
    joints = [joint.get("name") for joint in ET.parse(model).iter("joint") if joint.get("name")]
    assert set(unitree.HUMANOID) <= set(joints)


def test_what_a_joint_follows_is_read_from_its_gains(tmp_path):
    kp, kd = np.zeros((ROWS, 12)), np.zeros((ROWS, 12))
    kp[:, :4], kd[:, :8] = 60, 2
    command = told(kp=kp, kd=kd)
    command["dq"] = np.random.default_rng(2).normal(size=(ROWS, 12)).astype(np.float32)
    command["tau"] = np.random.default_rng(3).normal(size=(ROWS, 12)).astype(np.float32)
    command["tau"][:, :8] = 0
    command["tau"][3, 9] = 0  # a torque of zero is one, too
    command["dq"][:, :4] = 0
    episode = load(bag(tmp_path / "go2", command=command))
    assert set(episode.command.signals) == {"position", "velocity", "torque"}
    for signal, field, own in (("position", "q", slice(0, 4)), ("velocity", "dq", slice(4, 8))):
        np.testing.assert_array_equal(episode.command[signal][:, own], command[field][:, own])
        assert np.isnan(np.delete(episode.command[signal], own, axis=1)).all()
    np.testing.assert_array_equal(episode.command["torque"][:, 8:], command["tau"][:, 8:])
    assert np.isnan(episode.command["torque"][:, :8]).all()
    assert episode.meta.kp_setting is None
    assert not [flag for flag in flags(episode, "gains") if flag.severity == "warning"]


def test_torques_and_velocities_beside_a_position_are_told(tmp_path):
    command = told(kp=60, kd=5)
    command["tau"] = np.full((ROWS, 12), -12.5, dtype=np.float32)
    command["dq"] = np.full((ROWS, 12), 0.5, dtype=np.float32)
    episode = load(bag(tmp_path / "go2", command=command))
    assert set(episode.command.signals) == {"position"}
    beside = [flag.detail for flag in flags(episode, "gains") if "also told" in flag.detail]
    told_too = "torques of up to 12.5 Nm and velocities of up to 0.5 rad/s"
    assert beside == [f"the drives were also told {told_too}, which the command does not have"]


def test_gains_that_differ_from_joint_to_joint_are_told_by_joint(tmp_path):
    kp = np.tile([100.0, 100.0, 150.0], 4)
    episode = load(bag(tmp_path / "go2", command=told(kp=kp, kd=3)))
    assert episode.meta.kp_setting is None
    (flag,) = flags(episode, "gains")
    assert flag.severity == "note"
    assert "kp 100, kd 3 (FR_hip_joint, FR_thigh_joint, FL_hip_joint" in flag.detail
    assert "kp 150, kd 3 (FR_calf_joint, FL_calf_joint, RR_calf_joint, RL_calf_joint)" in flag.detail
    mapping = tmp_path / "m.yaml"
    mapping.write_text("kp_setting: 20\n")
    assert load(tmp_path / "go2", mapping=mapping).meta.kp_setting == 20
    one = bag(tmp_path / "one", command=told(kp=60, kd=3))
    with pytest.raises(ConfigError, match=r"another kp_setting than the mapping: got 60.*expected 20"):
        load(one, mapping=mapping)


def test_gains_that_change_within_a_motion_are_a_warning(tmp_path):
    kp = np.full((ROWS, 12), 20.0)
    kp[20:] = 60
    episode = load(bag(tmp_path / "go2", command=told(kp=kp, kd=3)))
    assert episode.meta.kp_setting is None
    (flag,) = flags(episode, "gains")
    assert flag.severity == "warning"
    assert "kp 20 to 60, kd 3 (all joints); they change within the motion" in flag.detail
    mixed = told(kp=kp, kd=3, tau=1)
    mixed["kp"], mixed["kd"] = mixed["kp"].copy(), mixed["kd"].copy()
    mixed["kp"][:20, 2] = mixed["kd"][:20, 2] = 0
    other = load(bag(tmp_path / "mixed", command=mixed))
    (flag,) = [flag for flag in flags(other, "gains") if flag.joint]
    assert (flag.joint, flag.severity) == ("FR_calf_joint", "warning")
    assert "told position and torque within one motion" in flag.detail
    assert np.isnan(other.command["position"][:20, 2]).all()


def test_messages_that_tell_nothing_are_no_commands(tmp_path):
    kp = np.full((ROWS, 12), 60.0)
    kp[:7] = kp[37:] = 0
    command = told(kp=kp)
    episode = load(bag(tmp_path / "go2", command=command))
    np.testing.assert_array_equal(episode.command["position"], command["q"][7:37])
    assert episode.command.time_s[0] == pytest.approx(0.07)
    assert any("10 messages that tell the motors nothing" in flag.detail for flag in flags(episode, "gains"))
    limp = load(bag(tmp_path / "limp", command=told()))
    assert limp.command is None
    assert "tells the motors nothing" in flags(limp, "gains")[0].detail


def test_a_bag_without_commands_says_what_is_missing(tmp_path):
    plan = rosbag.scan(bag(tmp_path / "go2"), ImportOptions())
    assert "command: none found in the bag; record LowCmd (/lowcmd) beside /lowstate" in plan.notes
    assert plan.episodes[0].load().command is None


def test_topics_of_the_same_at_a_lower_rate_leave_the_choice_as_it_is(tmp_path):
    state = seen()
    topics = {
        "/lf/lowstate": low("unitree_go", "motor_state", seen(rows=5, seed=9)),
        "rt/lowstate": low("unitree_go", "motor_state", state),
        "rt/lowcmd": low("unitree_go", "motor_cmd", told(kp=20, kd=0.5)),
    }
    episode = load(write(tmp_path / "go2", topics))
    np.testing.assert_array_equal(episode.measured["position"], state["q"])
    assert episode.command is not None


def test_joint_states_beside_commands_of_motors(tmp_path):
    command = told(kp=20, kd=0.5)
    values = np.random.default_rng(0).normal(size=(3, ROWS, 12))
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, values, DOG))}
    topics["/lowcmd"] = low("unitree_go", "motor_cmd", command)
    episode = load(write(tmp_path / "go2", topics))
    np.testing.assert_array_equal(episode.measured["position"], values[0])
    np.testing.assert_array_equal(episode.command["position"], command["q"])
    assert "command: times of the recorder" in flags(episode, "clock")[0].detail


def test_other_robots_need_names(tmp_path):
    state = seen(motors=20)
    path = bag(tmp_path / "h1", state=state, command=told(motors=20, kp=20))
    with pytest.raises(ConfigError, match=r"(?s)not those of a Go1, Go2 or B2.*motors 0 to 19 report.*joints: \[name0"):
        load(path)
    names = [f"motor{k}" for k in range(20)]
    mapping = tmp_path / "m.yaml"
    mapping.write_text(f"joints: [{', '.join(names)}]\n")
    episode = load(path, mapping=mapping)
    assert episode.measured.joints == episode.command.joints == tuple(names)
    np.testing.assert_array_equal(episode.measured["position"], state["q"])
    mapping.write_text(f"joints: [{', '.join(f'm{k}' for k in range(21))}]\n")
    with pytest.raises(ConfigError, match=r"more joints are stated.*got 21.*expected 20"):
        load(path, mapping=mapping)
    with pytest.raises(ConfigError, match="not those of a G1"):
        load(bag(tmp_path / "h1_2", "unitree_hg", seen(motors=27)))


def test_the_wheels_of_a_quadruped_are_left_out(tmp_path):
    episode = load(bag(tmp_path / "go2w", state=seen(motors=16), command=told(motors=16, kp=20)))
    assert episode.measured.joints == episode.command.joints == tuple(DOG)
    assert "since they have no name: 12 to 15" in flags(episode, "motors")[0].detail


def test_motors_that_never_report_are_no_joints(tmp_path):
    state = seen()
    for values in state.values():
        values[:, 4] = 0
    measured = load(bag(tmp_path / "go2", state=state)).measured
    assert measured.joints == tuple(name for name in DOG if name != "FL_thigh_joint")
    for values in state.values():
        values[:] = 0
    with pytest.raises(DataError, match="no values to import"):
        load(bag(tmp_path / "off", state=state))


def test_bags_of_recorders_that_keep_no_definitions_are_read(tmp_path):
    state = seen()
    path = bag(tmp_path / "go2", state=state, command=told(kp=20), storage="sqlite3")
    with sqlite3.connect(path / "go2.db3") as database:
        database.execute("DELETE FROM message_definitions")
    episode = load(path)
    np.testing.assert_array_equal(episode.measured["velocity"], state["dq"])
    assert episode.meta.kp_setting == 20


def test_a_ros_1_bag_has_no_alignment(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    for kind, text in TEXTS.items():
        store.register(get_types_from_msg(text, kind))
    state, command = seen(), told(kp=20)
    topics = {}
    for name, part, columns in (("/lowstate", "motor_state", state), ("/lowcmd", "motor_cmd", command)):
        kind, items = low("unitree_go", part, columns)
        items = [(log_ns, bytes(store.serialize_ros1(STORE.deserialize_cdr(raw, kind), kind))) for log_ns, raw in items]
        topics[name] = (kind, items)
    with Writer1(tmp_path / "go2.bag") as writer:
        fill(writer, topics, store)
    episode = load(tmp_path / "go2.bag")
    np.testing.assert_array_equal(episode.measured["torque"], state["tau_est"])
    np.testing.assert_array_equal(episode.command["position"], command["q"])


def test_definitions_of_other_versions_are_read_as_they_are(tmp_path):
    older = dict(TEXTS)
    older["unitree_hg/msg/LowCmd"] = HG_COMMAND.replace("uint32 reserve\n", "uint32[3] reserve\n")
    store = store_of(older)
    command = told(motors=29, kp=20)
    topics = {
        "/lowstate": low("unitree_hg", "motor_state", seen(motors=29), store),
        "/lowcmd": low("unitree_hg", "motor_cmd", command, store),
    }
    episode = load(write(tmp_path / "g1", topics, store=store))
    np.testing.assert_array_equal(episode.command["position"], command["q"])


def test_foreign_and_damaged_messages_are_refused(tmp_path):
    with Writer2(tmp_path / "own", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/lowstate", "unitree_go/msg/LowState", msgdef="float64[] surprise", rihs01="x")
    with pytest.raises(FormatError, match=r"type of its own.*surprise"):
        load(tmp_path / "own")
    kind, items = low("unitree_go", "motor_state", seen(rows=5))
    items[3] = (items[3][0], items[3][1][:-9])
    with pytest.raises(DataError, match=r"message 4 of .*/lowstate is damaged, or of another version"):
        load(write(tmp_path / "cut", {"/lowstate": (kind, items)}))
    items[3] = (items[3][0], b"\x00\x03" + items[2][1][2:])
    with pytest.raises(DataError, match=r"not little-endian CDR: got 0003"):
        load(write(tmp_path / "encoded", {"/lowstate": (kind, items)}))


def test_a_type_that_nobody_asked_for_may_be_unknown(tmp_path):
    with Writer2(tmp_path / "own", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/lf/lowstate", "unitree_go/msg/LowState", msgdef="float64[] surprise", rihs01="x")
        values = np.random.default_rng(0).normal(size=(3, ROWS, 3))
        fill(writer, {"/joint_states": (JOINT_STATE, states(ROS2, values))}, ROS2)
    np.testing.assert_array_equal(load(tmp_path / "own").measured["position"], values[0])


def test_many_messages_are_decoded_in_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr(unitree, "_BLOCK", 7)
    state = seen()
    np.testing.assert_array_equal(load(bag(tmp_path / "go2", state=state)).measured["position"], state["q"])
