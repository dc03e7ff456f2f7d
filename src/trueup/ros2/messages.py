"""Messages of ROS 2 as DDS types, under the names that every middleware of ROS 2 gives them.

Fields are those of the definitions in ROS 2's `common_interfaces`; the bytes on the wire are CDR, as a bag keeps them.
"""

# No postponed annotations: cyclonedds reads them when a class is made.
from dataclasses import dataclass, field
from typing import Any

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint32

NS_PER_S = 1_000_000_000
# Of the definitions, as ROS 2 compares them since Iron (REP-2016, `ros2 topic info -v`): without it, nodes on
# rmw_cyclonedds log "Failed to parse type hash" for each of our topics.
TYPE_HASHES = {
    f"{name}_": f"RIHS01_{digest}"
    for name, digest in (
        ("sensor_msgs::msg::dds_::JointState", "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"),
        ("std_msgs::msg::dds_::Float64MultiArray", "1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f"),
    )
}


class _Message(type(IdlStruct)):  # type: ignore[misc]  # cyclonedds keeps its metaclass to itself
    """What a class of messages is called by those who check types: as other classes are."""

    __repr__ = type.__repr__


class Unreadable:
    """What came in place of a message whose texts are not UTF-8: DDS looks at where they end, and no further."""

    sample_info: Any = None


def _read(kind: Any, *data: Any, **named: Any) -> Any:
    try:
        return kind.__idl__.deserialize(*data, **named)
    except UnicodeDecodeError:  # of many that were taken together, the others are not to be lost
        return Unreadable()


@dataclass
class Time(IdlStruct, metaclass=_Message, typename="builtin_interfaces::msg::dds_::Time_"):
    """`builtin_interfaces/msg/Time`: seconds and nanoseconds since an epoch."""

    sec: int32 = 0
    nanosec: uint32 = 0

    @classmethod
    def of_ns(cls, stamp_ns: int) -> "Time":
        """A stamp in nanoseconds."""
        return cls(*divmod(stamp_ns, NS_PER_S))

    @property
    def ns(self) -> int:
        """Nanoseconds."""
        return int(self.sec) * NS_PER_S + int(self.nanosec)


@dataclass
class Header(IdlStruct, metaclass=_Message, typename="std_msgs::msg::dds_::Header_"):
    """`std_msgs/msg/Header`."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class JointState(IdlStruct, metaclass=_Message, typename="sensor_msgs::msg::dds_::JointState_"):
    """`sensor_msgs/msg/JointState`: numbers of joints by name, each array as long as `name`, or empty [SI]."""

    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)

    @classmethod
    def deserialize(cls, data: bytes, *how: Any, **named: Any) -> Any:
        """A message, or that it cannot be read."""
        return _read(cls, data, *how, **named)


@dataclass
class MultiArrayDimension(IdlStruct, metaclass=_Message, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    """`std_msgs/msg/MultiArrayDimension`."""

    label: str = ""
    size: uint32 = 0
    stride: uint32 = 0


@dataclass
class MultiArrayLayout(IdlStruct, metaclass=_Message, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    """`std_msgs/msg/MultiArrayLayout`."""

    dim: sequence[MultiArrayDimension] = field(default_factory=list)
    data_offset: uint32 = 0


@dataclass
class Float64MultiArray(IdlStruct, metaclass=_Message, typename="std_msgs::msg::dds_::Float64MultiArray_"):
    """`std_msgs/msg/Float64MultiArray`: what the forward command controllers of ros2_control listen to."""

    layout: MultiArrayLayout = field(default_factory=MultiArrayLayout)
    data: sequence[float64] = field(default_factory=list)

    @classmethod
    def deserialize(cls, data: bytes, *how: Any, **named: Any) -> Any:
        """A message, or that it cannot be read."""
        return _read(cls, data, *how, **named)
