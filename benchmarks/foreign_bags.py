"""Bags as recorders of ROS write them."""

import importlib
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.recorded import Kind, Recorded

_STATE, _ARRAY = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
_TRAJECTORY, _NUMBER = "trajectory_msgs/msg/JointTrajectory", "std_msgs/msg/Float64"
_SEEN = "control_msgs/msg/JointTrajectoryControllerState"
_DYNAMIC = "control_msgs/msg/DynamicJointState"
_TEXT = """std_msgs/Header header
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
_NONE = np.array([])
Item = tuple[int, str, str, Any]  # stamp [ns], topic, type, message


class _Store:
    """Messages of a distribution of ROS."""

    def __init__(self, store: Stores) -> None:
        self.types, self.first = get_typestore(store), store is Stores.ROS1_NOETIC
        if not self.first:
            own: dict[str, Any] = {}
            point = "trajectory_msgs/JointTrajectoryPoint"
            fields = "".join(f"{point} {name}\n" for name in ("reference", "feedback", "error", "output"))
            own.update(get_types_from_msg(f"std_msgs/Header header\nstring[] joint_names\n{fields}", _SEEN))
            own.update(
                get_types_from_msg("string[] interface_names\nfloat64[] values", "control_msgs/msg/InterfaceValue")
            )
            dynamic = "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values"
            own.update(get_types_from_msg(dynamic, _DYNAMIC))
            self.types.register(own)

    def __getitem__(self, name: str) -> Any:
        return self.types.types[name]

    def header(self, stamp_ns: int) -> Any:
        stamp = self["builtin_interfaces/msg/Time"](sec=int(stamp_ns // 10**9), nanosec=int(stamp_ns % 10**9))
        words = {"seq": 0} if self.first else {}
        return self["std_msgs/msg/Header"](**words, stamp=stamp, frame_id="base")

    def state(self, stamp_ns: int, names: Iterable[str], position: np.ndarray, velocity: np.ndarray = _NONE) -> Any:
        return self[_STATE](self.header(stamp_ns), list(names), np.array(position), np.array(velocity), _NONE)

    def array(self, values: np.ndarray) -> Any:
        return self[_ARRAY](self["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0), np.array(values))

    def point(self, position: np.ndarray, after_s: float = 0.0) -> Any:
        after = self["builtin_interfaces/msg/Duration"](sec=int(after_s), nanosec=round(1e9 * (after_s % 1)))
        return self["trajectory_msgs/msg/JointTrajectoryPoint"](np.array(position), _NONE, _NONE, _NONE, after)

    def raw(self, message: Any, kind: str) -> bytes:
        return bytes(
            self.types.serialize_ros1(message, kind) if self.first else self.types.serialize_cdr(message, kind)
        )


def _write(path: Path, items: Iterable[Item], store: _Store, storage: str, *, packed: bool = False) -> None:
    """Messages in the order of their stamps."""
    writer: Any = Writer1(path)
    if not store.first:
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
        if packed:
            writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        known: dict[str, Any] = {}
        for stamp_ns, topic, kind, message in sorted(items, key=lambda item: item[0]):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store.types)
            writer.write(known[topic], int(stamp_ns), store.raw(message, kind))


def _states(store: _Store, truth: Recorded, order: Iterable[int] | None = None) -> list[Item]:
    order = list(order) if order is not None else list(range(len(truth.joints)))
    names = [truth.joints[number] for number in order]
    return [
        (stamp, "/joint_states", _STATE, store.state(stamp, names, done[order], speed[order]))
        for stamp, done, speed in zip(truth.time_ns, truth.done, truth.speed, strict=True)
    ]


def _bag(
    commands: Callable[[_Store, Recorded], list[Item]],
    *,
    store: Stores = Stores.ROS2_HUMBLE,
    storage: str = "mcap",
    packed: bool = False,
    states: bool = True,
    order: Iterable[int] | None = None,
) -> Callable[[Path, Recorded], None]:
    def write(folder: Path, truth: Recorded) -> None:
        own = _Store(store)
        items = [*(_states(own, truth, order) if states else []), *commands(own, truth)]
        _write(folder / ("run.bag" if own.first else "run"), items, own, storage, packed=packed)

    return write


def told_states(store: _Store, truth: Recorded) -> list[Item]:
    """Commands as joint states, joints in another order."""
    return [
        (stamp, "/joint_command", _STATE, store.state(stamp, truth.joints[::-1], told[::-1]))
        for stamp, told in zip(truth.time_ns, truth.told, strict=True)
    ]


def told_arrays(store: _Store, truth: Recorded) -> list[Item]:
    """Commands of a forward position controller."""
    topic = "/forward_position_controller/commands"
    return [(stamp, topic, _ARRAY, store.array(told)) for stamp, told in zip(truth.time_ns, truth.told, strict=True)]


def told_numbers(store: _Store, truth: Recorded) -> list[Item]:
    """A topic for each joint."""
    return [
        (stamp, f"/{name}_position_controller/command", _NUMBER, store[_NUMBER](float(value)))
        for stamp, told in zip(truth.time_ns, truth.told, strict=True)
        for name, value in zip(truth.joints, told, strict=True)
    ]


def told_points(store: _Store, truth: Recorded) -> list[Item]:
    """Trajectories of a point, streamed."""
    step_s = float(truth.time_s[1] - truth.time_s[0])
    kind = store[_TRAJECTORY]
    return [
        (stamp, "/arm_controller/joint_trajectory", _TRAJECTORY,
         kind(store.header(0), list(truth.joints), [store.point(told, step_s)]))
        for stamp, told in zip(truth.time_ns, truth.told, strict=True)
    ]  # fmt: skip


def told_plan(store: _Store, truth: Recorded) -> list[Item]:
    """One planned trajectory."""
    points = [store.point(told, time_s) for time_s, told in zip(truth.time_s, truth.told, strict=True)]
    first = truth.time_ns[0]
    message = store[_TRAJECTORY](store.header(first), list(truth.joints), points)
    return [(first, "/arm_controller/joint_trajectory", _TRAJECTORY, message)]


def seen(store: _Store, truth: Recorded) -> list[Item]:
    """What a controller of ros2_control was told and saw."""
    kind, none = store[_SEEN], store.point(_NONE)
    return [
        (stamp, "/arm_controller/controller_state", _SEEN,
         kind(store.header(stamp), list(truth.joints), store.point(told), store.point(done), none, none))
        for stamp, told, done in zip(truth.time_ns, truth.told, truth.done, strict=True)
    ]  # fmt: skip


def dynamic(store: _Store, truth: Recorded) -> list[Item]:
    """DynamicJointState of ros2_control, and a forward controller's commands."""
    kind, value = store[_DYNAMIC], store["control_msgs/msg/InterfaceValue"]
    return [
        *told_arrays(store, truth),
        *(
            (stamp, "/dynamic_joint_states", _DYNAMIC, kind(
                store.header(stamp),
                list(truth.joints),
                [value(["position", "velocity"], np.array(pair)) for pair in zip(done, speed, strict=True)],
            ))
            for stamp, done, speed in zip(truth.time_ns, truth.done, truth.speed, strict=True)
        ),
    ]  # fmt: skip


def mcap_ros2(folder: Path, truth: Recorded) -> None:
    """Foxglove's writer for ROS 2."""
    with (folder / "run.mcap").open("wb") as file:
        writer = importlib.import_module("mcap_ros2.writer").Writer(file)
        schema = writer.register_msgdef(_STATE, _TEXT)
        for stamp, done, told in zip(truth.time_ns.tolist(), truth.done, truth.told, strict=True):
            header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": ""}
            for topic, values in (("/joint_states", done), ("/joint_command", told)):
                message = {"header": header, "name": list(truth.joints), "position": values.tolist()}
                writer.write_message(topic, schema, {**message, "velocity": [], "effort": []}, stamp, stamp)
        writer.finish()


def mcap_json(folder: Path, truth: Recorded) -> None:
    """JSON messages, as Foxglove's own recorders write."""
    module = importlib.import_module("mcap.writer")
    with (folder / "run.mcap").open("wb") as file:
        writer = module.Writer(file)
        writer.start()
        fields = {"name": {"type": "array"}, "position": {"type": "array"}}
        schema = writer.register_schema(
            "JointState", "jsonschema", json.dumps({"type": "object", "properties": fields}).encode()
        )
        topics = {name: writer.register_channel(name, "json", schema) for name in ("/joint_states", "/joint_command")}
        for stamp, done, told in zip(truth.time_ns.tolist(), truth.done, truth.told, strict=True):
            for topic, values in (("/joint_states", done), ("/joint_command", told)):
                data = json.dumps({"name": list(truth.joints), "position": values.tolist()}).encode()
                writer.add_message(topics[topic], stamp, data, stamp)
        writer.finish()


BAGS: dict[str, Kind] = {
    "rosbags: ROS 1, joint states": Kind(_bag(told_states, store=Stores.ROS1_NOETIC)),
    "rosbags: ROS 1, a topic for each joint": Kind(_bag(told_numbers, store=Stores.ROS1_NOETIC)),
    "rosbags: ROS 2, sqlite3, an array": Kind(_bag(told_arrays, storage="sqlite3")),
    "rosbags: ROS 2, another order": Kind(_bag(told_states, order=(5, 3, 1, 0, 2, 4))),
    "rosbags: ROS 2, compressed messages": Kind(_bag(told_states, storage="sqlite3", packed=True)),
    "rosbags: ROS 2, streamed points": Kind(_bag(told_points), lost=2),
    "rosbags: ROS 2, a planned trajectory": Kind(_bag(told_plan), lost=2),
    "rosbags: ROS 2, controller_state": Kind(_bag(seen, states=False)),
    "rosbags: ROS 2, DynamicJointState": Kind(_bag(dynamic, states=False)),
    "mcap: ROS 2": Kind(mcap_ros2),
    "mcap: JSON": Kind(mcap_json),
}
