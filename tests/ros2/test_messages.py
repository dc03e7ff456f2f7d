"""Messages have ROS 2's names, and the bytes of a bag."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from trueup.errors import ConfigError
from trueup.ros2 import Float64MultiArray, JointState, Network
from trueup.ros2.messages import TYPE_HASHES, Header, MultiArrayDimension, MultiArrayLayout, Time
from trueup.ros2.node import mangled

STORE = get_typestore(Stores.ROS2_HUMBLE)
NUMBERS = st.lists(st.floats(), max_size=9)
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)


@settings(max_examples=200, deadline=None)
@given(
    st.integers(-(2**31), 2**31 - 1), st.integers(0, 999_999_999), TEXTS, st.lists(TEXTS, max_size=9), *[NUMBERS] * 3
)
def test_joint_states_are_the_bytes_of_a_bag(sec, nanosec, frame, names, position, velocity, effort):
    types = STORE.types
    theirs = types["sensor_msgs/msg/JointState"](
        types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](sec, nanosec), frame),
        names,
        *(np.array(values, np.float64) for values in (position, velocity, effort)),
    )
    raw = bytes(STORE.serialize_cdr(theirs, "sensor_msgs/msg/JointState"))
    ours = JointState(Header(Time(sec, nanosec), frame), names, position, velocity, effort)
    assert ours.serialize(use_version_2=False) == raw
    back = JointState.deserialize(raw)
    assert (back.header.stamp.sec, back.header.stamp.nanosec, back.header.frame_id) == (sec, nanosec, frame)
    assert list(back.name) == names
    for field, values in (("position", position), ("velocity", velocity), ("effort", effort)):
        np.testing.assert_array_equal(getattr(back, field), values)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(TEXTS, st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1)), max_size=3), NUMBERS)
def test_arrays_are_the_bytes_of_a_bag(dims, data):
    types = STORE.types
    theirs = types["std_msgs/msg/Float64MultiArray"](
        types["std_msgs/msg/MultiArrayLayout"](
            [types["std_msgs/msg/MultiArrayDimension"](*dim) for dim in dims], data_offset=3
        ),
        np.array(data, np.float64),
    )
    ours = Float64MultiArray(MultiArrayLayout([MultiArrayDimension(*dim) for dim in dims], 3), data)
    assert ours.serialize(use_version_2=False) == bytes(STORE.serialize_cdr(theirs, "std_msgs/msg/Float64MultiArray"))


def test_types_are_called_as_ros_calls_them():
    assert JointState.__idl_typename__ == "sensor_msgs::msg::dds_::JointState_"
    assert Float64MultiArray.__idl_typename__ == "std_msgs::msg::dds_::Float64MultiArray_"


@pytest.mark.parametrize(
    ("type_", "name"),
    [(JointState, "sensor_msgs/msg/JointState"), (Float64MultiArray, "std_msgs/msg/Float64MultiArray")],
)
def test_types_have_the_hashes_of_their_definitions(type_, name):
    assert TYPE_HASHES[type_.__idl_typename__] == STORE.hash_rihs01(name)


@given(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
def test_stamps_are_whole_nanoseconds(stamp_ns):
    stamp = Time.of_ns(stamp_ns)
    assert stamp.ns == stamp_ns
    assert 0 <= stamp.nanosec < 10**9


@pytest.mark.parametrize(
    ("topic", "name"), [("/joint_states", "rt/joint_states"), ("left/arm_1/states", "rt/left/arm_1/states")]
)
def test_names_of_topics(topic, name):
    assert mangled(topic) == name


@pytest.mark.parametrize("topic", ["", "/", "//a", "/a/", "/1a", "/a b", "/a-b", "/é", "/a\n"])
def test_names_that_ros_does_not_allow(topic):
    with pytest.raises(ConfigError, match="no name of a topic"):
        mangled(topic)


def test_where_the_environment_says(monkeypatch):
    for name in ("ROS_DOMAIN_ID", "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "CYCLONEDDS_URI"):
        monkeypatch.delenv(name, raising=False)
    assert (Network().number, Network().local) == (0, False)
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")
    assert (Network().number, Network().local) == (42, True)
    assert (Network(7, localhost=False).number, Network(7, localhost=False).local) == (7, False)
    monkeypatch.delenv("ROS_LOCALHOST_ONLY")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost")
    assert Network().local
    monkeypatch.setenv("CYCLONEDDS_URI", "file:///etc/dds.xml")
    assert not Network().local  # whoever has written settings means them
    with pytest.raises(ConfigError, match="CYCLONEDDS_URI"):
        Network(localhost=True)


@pytest.mark.parametrize("said", ["-1", "233", "two", "1.5", "²"])
def test_domains_that_are_none(said, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", said)
    with pytest.raises(ConfigError, match="domain"):
        Network()
