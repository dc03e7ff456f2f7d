"""Types of messages that are no part of the bag library, in the versions that bags have.

Types are made of our own words: a bag only says which of the fields that are known there are, in which order, and which
of the kinds that are known each of them is. Types built from its text would be code that came with the data.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from trueup.errors import FormatError

JOINT_STATE = "sensor_msgs/msg/JointState"
ARRAY = "std_msgs/msg/Float64MultiArray"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
NUMBER = "std_msgs/msg/Float64"
IMU = "sensor_msgs/msg/Imu"
CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
DYNAMIC_STATE = "control_msgs/msg/DynamicJointState"
GOAL = "control_msgs/msg/FollowJointTrajectoryActionGoal"
FEEDBACKS = (
    "control_msgs/action/FollowJointTrajectory_FeedbackMessage",
    "control_msgs/msg/FollowJointTrajectoryActionFeedback",
)
LOW_STATES = ("unitree_go/msg/LowState", "unitree_hg/msg/LowState")
LOW_COMMANDS = ("unitree_go/msg/LowCmd", "unitree_hg/msg/LowCmd")

_HEADER = {"header": "std_msgs/Header"}
_POINT, _POINTS = "trajectory_msgs/JointTrajectoryPoint", "trajectory_msgs/MultiDOFJointTrajectoryPoint"
_FEEDBACK = {
    **_HEADER,
    "joint_names": "string[]",
    **dict.fromkeys(("desired", "actual", "error"), _POINT),
    "index": "int32",
    "multi_dof_joint_names": "string[]",
    **dict.fromkeys(("multi_dof_desired", "multi_dof_actual", "multi_dof_error"), _POINTS),
    "multi_dof_index": "int32",
}
_STATES = ("reference", "feedback", "error", "output", "desired", "actual")
_MOTOR = dict.fromkeys(("q", "dq", "ddq", "tau_est"), "float32")
_TOLD = {"mode": "uint8", **dict.fromkeys(("q", "dq", "tau", "kp", "kd"), "float32"), "reserve": "uint32[3] uint32"}
_IMU = {"quaternion": "float32[4]", **dict.fromkeys(("gyroscope", "accelerometer", "rpy"), "float32[3]")}
_GO = {
    "head": "uint8[2]",
    "level_flag": "uint8",
    "frame_reserve": "uint8",
    "sn": "uint32[2]",
    "version": "uint32[2]",
    "bandwidth": "uint16",
}
_HG = {"mode_pr": "uint8", "mode_machine": "uint8"}

# Name of a field -> what it is, or may be in one version or another, in the order of the message.
_FIELDS: dict[str, dict[str, str]] = {
    CONTROLLER_STATE: {
        **_HEADER,
        "joint_names": "string[]",
        **dict.fromkeys(_STATES, _POINT),
        "multi_dof_joint_names": "string[]",
        **dict.fromkeys([f"multi_dof_{name}" for name in _STATES], _POINTS),
        "speed_scaling_factor": "float64",
    },
    DYNAMIC_STATE: {
        **_HEADER,
        "joint_names": "string[]",
        "interface_values": "control_msgs/InterfaceValue[]",
    },
    "control_msgs/msg/InterfaceValue": {"interface_names": "string[]", "values": "float64[]"},
    FEEDBACKS[0]: {
        "goal_id": "unique_identifier_msgs/UUID",
        "feedback": "control_msgs/action/FollowJointTrajectory_Feedback",
    },
    "control_msgs/action/FollowJointTrajectory_Feedback": _FEEDBACK,
    FEEDBACKS[1]: {
        **_HEADER,
        "status": "actionlib_msgs/GoalStatus",
        "feedback": "control_msgs/FollowJointTrajectoryFeedback",
    },
    "control_msgs/msg/FollowJointTrajectoryFeedback": _FEEDBACK,
    GOAL: {**_HEADER, "goal_id": "actionlib_msgs/GoalID", "goal": "control_msgs/FollowJointTrajectoryGoal"},
    "control_msgs/msg/FollowJointTrajectoryGoal": {
        "trajectory": "trajectory_msgs/JointTrajectory",
        **dict.fromkeys(("path_tolerance", "goal_tolerance"), "control_msgs/JointTolerance[]"),
        "goal_time_tolerance": "builtin_interfaces/Duration",
    },
    "control_msgs/msg/JointTolerance": {
        "name": "string",
        **dict.fromkeys(("position", "velocity", "acceleration"), "float64"),
    },
    "unitree_go/msg/LowState": {
        **_GO,
        "imu_state": "unitree_go/IMUState",
        "motor_state": "unitree_go/MotorState[20]",
        "bms_state": "unitree_go/BmsState",
        "foot_force": "int16[4]",
        "foot_force_est": "int16[4]",
        "tick": "uint32",
        "wireless_remote": "uint8[40]",
        "bit_flag": "uint8",
        "adc_reel": "float32",
        "temperature_ntc1": "int8",
        "temperature_ntc2": "int8",
        "power_v": "float32",
        "power_a": "float32",
        "fan_frequency": "uint16[4]",
        "reserve": "uint32",
        "crc": "uint32",
    },
    "unitree_go/msg/LowCmd": {
        **_GO,
        "motor_cmd": "unitree_go/MotorCmd[20]",
        "bms_cmd": "unitree_go/BmsCmd",
        "wireless_remote": "uint8[40]",
        "led": "uint8[12]",
        "fan": "uint8[2]",
        "gpio": "uint8",
        "reserve": "uint32",
        "crc": "uint32",
    },
    "unitree_go/msg/IMUState": {**_IMU, "temperature": "int8"},
    "unitree_go/msg/MotorState": {
        "mode": "uint8",
        **_MOTOR,
        **dict.fromkeys(("q_raw", "dq_raw", "ddq_raw"), "float32"),
        "temperature": "int8",
        "lost": "uint32",
        "reserve": "uint32[2]",
    },
    "unitree_go/msg/MotorCmd": _TOLD,
    "unitree_go/msg/BmsState": {
        **dict.fromkeys(("version_high", "version_low", "status", "soc"), "uint8"),
        "current": "int32",
        "cycle": "uint16",
        "bq_ntc": "int8[2]",
        "mcu_ntc": "int8[2]",
        "cell_vol": "uint16[15]",
    },
    "unitree_go/msg/BmsCmd": {"off": "uint8", "reserve": "uint8[3]"},
    "unitree_hg/msg/LowState": {
        "version": "uint32[2]",
        **_HG,
        "tick": "uint32",
        "imu_state": "unitree_hg/IMUState",
        "motor_state": "unitree_hg/MotorState[35]",
        "wireless_remote": "uint8[40]",
        "reserve": "uint32[4]",
        "crc": "uint32",
    },
    "unitree_hg/msg/LowCmd": {
        **_HG,
        "motor_cmd": "unitree_hg/MotorCmd[35]",
        "reserve": "uint32[4]",
        "crc": "uint32",
    },
    "unitree_hg/msg/IMUState": {**_IMU, "temperature": "int16 int8"},
    "unitree_hg/msg/MotorState": {
        "mode": "uint8",
        **_MOTOR,
        "temperature": "int16[2]",
        "vol": "float32",
        "sensor": "uint32[2]",
        "motorstate": "uint32",
        "reserve": "uint32[4]",
    },
    "unitree_hg/msg/MotorCmd": {**_TOLD, "reserve": "uint32 uint32[3]"},
}
# Recorders up to ROS 2 Humble keep no definitions. These messages are what they were since then, but for what is new.
_ASSUMED = frozenset({*FEEDBACKS, GOAL, *LOW_STATES, *LOW_COMMANDS})
_NEW = frozenset({"index", "multi_dof_index"})

Fields = Sequence[tuple[str, Any]]


def store_for(
    connections: Iterable[Connection], *, ros1: bool, source: str
) -> tuple[Typestore, Mapping[str, FormatError]]:
    """The library's types, and those of the above that a bag has, as it has them.

    Returns:
        The store; and of the types that are not in it the reason: they have other fields, or the bag does not say them
        and there are several versions.
    """
    kinds = {item.msgtype: item for item in connections if item.msgtype in _FIELDS}
    if not kinds:
        return _library(ros1=ros1), {}
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    wrong = {}
    for kind, connection in kinds.items():
        said = said_fields(connection)
        where = f"{source}: {connection.topic}"
        if not said and kind not in _ASSUMED:
            wrong[kind] = FormatError(f"{where} does not say its fields", got=kind)
            continue
        try:
            _register(store, kind, said, where)
        except FormatError as error:
            wrong[kind] = error
    return store, wrong


def said_fields(connection: Connection) -> dict[str, Fields]:
    """Names and kinds of the fields of a message, and of those in it, as the bag has them; none where it has not."""
    # Bags carry message definitions, but types built from them would be code that came with the data.
    if connection.msgdef.format is not MessageDefinitionFormat.MSG or not connection.msgdef.data.strip():
        return {}
    parsed = get_types_from_msg(connection.msgdef.data, connection.msgtype)
    return {kind: list(fields) for kind, (_, fields) in parsed.items()}


def other_fields(connection: Connection, store: Typestore) -> tuple[list[str], list[str]] | None:
    """Names of the fields that a bag and a store have where the two differ; None where they do not."""
    for kind, fields in said_fields(connection).items():
        if kind == connection.msgtype or kind in _FIELDS:
            known = store.fielddefs[kind][1] if kind in store.fielddefs else []
            if [(name.lower(), node) for name, node in fields] != [(name.lower(), node) for name, node in known]:
                return [name for name, _ in fields], [name for name, _ in known]
    return None


def _register(store: Typestore, kind: str, said: Mapping[str, Fields], where: str) -> None:
    """Put a type into a store, and before it those that it is made of."""
    known = _FIELDS[kind]
    fields = said.get(kind) or [(name, None) for name in known if name not in _NEW]
    lines = [_line(kind, name, node, known.get(name, "")) for name, node in fields]
    if None in lines:
        raise FormatError(
            f"{where} has a type of its own called {kind}", got=[name for name, _ in fields], expected=list(known)
        )
    for name, _ in fields:
        package, _, part = known[name].partition("[")[0].rpartition("/")
        part = f"{package}/{part}" if "/" in package else f"{package}/msg/{part}"
        if part in _FIELDS:
            _register(store, part, said, where)
    store.register(get_types_from_msg("\n".join(line for line in lines if line), kind))


def _line(kind: str, name: str, node: object, words: str) -> str | None:
    """The definition of a field, in the words that say what it is in the bag; None if none do."""
    for word in words.split():
        line = f"{word} {name}"
        if node is None or node == get_types_from_msg(line, kind)[kind][1][0][1]:
            return line
    return None


@cache
def _library(*, ros1: bool) -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
