"""Who hears what is published: commands everyone, and who does not hear is told why."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from benchmarks.networks import inputs_of, outputs_of, real_time
from cyclonedds.qos import Policy

from deploy.compensation_cases import compensation
from ros2.ros2_cases import JOINTS, InThread, Publishing, asking, network, state, wait_for
from trueup.errors import RobotStopped
from trueup.robots import load_robot
from trueup.ros2 import Float64MultiArray, JointState, Node, RobotTopics, Ros2Robot
from trueup.ros2.listeners import Listeners
from trueup.stages.bridging import BridgeTopics, bridge

PANDA = load_robot("panda")
RATE_HZ = 100.0
HUMANOID = [f"joint_{number}" for number in range(29)]
LISTENER = Path(__file__).with_name("reliable_listener.py")
# DDS's own time that a reliable writer may wait for a reader [s].
USUAL_WAIT_S = 0.1


@pytest.mark.parametrize("form", ["joint_state", "array"])
@pytest.mark.parametrize("reliable", [True, False])
def test_commands_are_heard_by_listeners_of_both_kinds(reliable, form):
    """ros2_control's controllers take the system's defaults, which ask for reliable commands; others do not."""
    where, type_ = network(), {"joint_state": JointState, "array": Float64MultiArray}[form]
    with Node(where) as node, Publishing(node):
        reader = asking(node, "/joint_commands", type_, reliable=reliable)
        robot = Ros2Robot(JOINTS, RobotTopics(form=form, network=where), patience_s=5.0)
        try:
            robot.write({"position": np.array([1.0, 2.0])})
            wait_for(lambda: reader.read())
        finally:
            robot.close()
        (message,) = reader.take()
    assert list(message.data if form == "array" else message.position) == [1.0, 2.0]


class Bridging(InThread):
    """`trueup deploy ros2` in a thread: a bridge with its own way of opening topics, and of saying what is wrong."""

    def __init__(self, folder, where, **options):
        self.warnings = []

        def run(stop):
            bridge(folder, network=where, stop=stop, on_warning=lambda *said: self.warnings.append(said), **options)

        super().__init__(run)


@pytest.mark.long
@pytest.mark.parametrize("reliable", [True, False])
def test_corrected_commands_are_heard_by_listeners_of_both_kinds(tmp_path, reliable):
    compensation(tmp_path, PANDA.joint_names, rate_hz=RATE_HZ)
    where = network()
    with (
        Node(where) as node,
        Publishing(node, names=PANDA.joint_names),
        Publishing(node, "/joint_targets", names=PANDA.joint_names),
        Bridging(tmp_path, where, robot=PANDA, form="array", payload_kg=0.0) as live,
    ):
        reader = asking(node, "/joint_commands", Float64MultiArray, reliable=reliable)
        wait_for(lambda: len(reader.read(N=10)) >= 5, seconds=20.0)
        assert len(reader.take(N=1)[0].data) == len(PANDA.joint_names)
        time.sleep(4.0)
    # A computer that is busy publishes late, and that is told, too.
    assert not [message for message, _ in live.warnings if "listen" in message]


@pytest.mark.long
def test_corrected_commands_that_nobody_hears_are_a_warning(tmp_path):
    compensation(tmp_path, PANDA.joint_names, rate_hz=RATE_HZ)
    topics = BridgeTopics(publish="/forward_position_controller/commands")
    with Bridging(tmp_path, network(), robot=PANDA, topics=topics, payload_kg=0.0) as live:
        wait_for(lambda: live.warnings, seconds=20.0)
        time.sleep(2.5)
    ((message, hint),) = live.warnings  # said once
    assert message == "nobody listens to /forward_position_controller/commands"
    assert "--publish" in hint
    assert "--form" in hint


@pytest.fixture(scope="module")
def states_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("network")
    inputs, outputs = inputs_of(JOINTS), outputs_of(JOINTS)
    real_time(folder, hidden=(8, 5), rate_hz=RATE_HZ, joints=JOINTS, inputs=inputs, outputs=outputs)
    return folder


@pytest.mark.long
def test_joint_states_are_offered_as_sensors_do_and_who_asks_for_more_is_named(states_folder):
    where = network()
    with Node(where) as node, Bridging(states_folder, where) as live:
        reader = asking(node, "/joint_states_corrected")
        wait_for(lambda: live.warnings, seconds=20.0)
        time.sleep(1.5)
        assert not reader.get_matched_publications()
    ((message, hint),) = live.warnings
    assert (
        message == "a listener to /joint_states_corrected asks for reliability, which is not offered: it hears nothing"
    )
    assert "--reliable" in hint


@pytest.mark.long
def test_joint_states_are_reliable_where_it_is_asked_for(states_folder):
    where = network(reliable=True)
    with Node(where) as node, Bridging(states_folder, where) as live:
        reader = asking(node, "/joint_states_corrected")
        wait_for(reader.get_matched_publications, seconds=20.0)
        time.sleep(1.5)
    assert not live.warnings


@pytest.mark.long
def test_a_robot_that_asks_for_what_is_not_offered_is_told_apart_from_one_that_is_not_there():
    where = network()
    with Node(where) as node, Publishing(node):
        reader = asking(node, "/joint_commands", policies=(Policy.Durability.TransientLocal,))
        with pytest.raises(RobotStopped, match="nobody listens to /joint_commands") as refused:
            Ros2Robot(JOINTS, RobotTopics(network=where), patience_s=2.0)
        assert not reader.get_matched_publications()
    assert "a listener asks for durability, which is not offered" in str(refused.value)
    assert "ros2 topic info -v /joint_commands" in refused.value.hint


def test_a_listener_to_messages_of_another_type_is_called_that():
    where = network()
    with Node(where) as node, Node(where) as other:
        outbox = node.publish("/joint_commands", JointState, commands=True)
        asking(other, "/joint_commands", Float64MultiArray)
        told = []
        listeners = Listeners(outbox, commands=True, tell=lambda *said: told.append(said))
        wait_for(lambda: listeners.look(0.0) or told)
    ((message, hint),) = told
    assert message == "a listener to /joint_commands asks for another type, which is not offered: it hears nothing"
    assert "--form" in hint


@pytest.mark.long
def test_a_listener_that_stalls_does_not_hold_up_the_loop():
    """A reliable reader in a process that is stopped: two seconds of a humanoid's commands, more than DDS keeps unread."""
    where, last_ns = network(), state(1.999).header.stamp.ns
    listener = subprocess.Popen(
        [sys.executable, LISTENER, str(where.number), str(last_ns)], stdout=subprocess.PIPE, text=True
    )
    longest_s = 0.0
    try:
        with Node(where) as node:
            outbox = node.publish("/joint_commands", JointState, commands=True)
            wait_for(lambda: outbox.readers, seconds=20.0)
            os.kill(listener.pid, signal.SIGSTOP)
            for number in range(2000):
                began = time.perf_counter()
                outbox.send(state(number / 1000.0, names=HUMANOID))
                longest_s = max(longest_s, time.perf_counter() - began)
                time.sleep(0.001)
            os.kill(listener.pid, signal.SIGCONT)
            stamps = [int(word) for word in listener.communicate(timeout=20.0)[0].split()]
    finally:
        listener.kill()
        listener.wait()
    assert longest_s < USUAL_WAIT_S
    assert stamps == sorted(set(stamps))
    assert stamps[-1] == last_ns


@pytest.mark.long
def test_another_who_publishes_corrected_commands_is_told(tmp_path):
    compensation(tmp_path, PANDA.joint_names, rate_hz=RATE_HZ)
    where = network()
    with Node(where) as node, Bridging(tmp_path, where, robot=PANDA, payload_kg=0.0) as live:
        kept = [asking(node, "/joint_commands")]
        wait_for(kept[0].get_matched_publications, seconds=20.0)
        time.sleep(2.0)
        assert not [message for message, _ in live.warnings if "somebody else" in message]
        kept.append(node.publish("/joint_commands", JointState))
        wait_for(lambda: any("somebody else" in message for message, _ in live.warnings))
        time.sleep(1.5)
    ((message, hint),) = [item for item in live.warnings if "somebody else" in item[0]]  # said once
    assert message == "somebody else publishes to /joint_commands, too: whoever listens hears a mixture"
    assert "`ros2 topic info -v /joint_commands`" in hint


def test_those_who_publish_beside_are_counted_as_they_come_and_go():
    where = network()
    with Node(where) as node, Node(where) as beside:
        kept = [beside.publish("/joint_commands", JointState)]
        outbox = node.publish("/joint_commands", JointState, commands=True)
        kept.append(node.publish("/joint_commands", JointState))  # its own
        kept.append(beside.publish("/joint_states", JointState))
        kept.append(beside.publish("/joint_commands", Float64MultiArray))  # nobody hears both types
        wait_for(lambda: outbox.others == 1)
        with Node(where) as another:
            third = another.publish("/joint_commands", JointState)
            wait_for(lambda: outbox.others == 2)
            wait_for(lambda: third.others == 3)
        wait_for(lambda: outbox.others == 1)
        kept.clear()
        wait_for(lambda: outbox.others == 0)


@pytest.mark.long
def test_a_robot_that_somebody_else_drives_is_not_recorded():
    where = network()
    with Node(where) as node, Node(where) as other, Publishing(node):
        _kept = asking(node, "/joint_commands"), other.publish("/joint_commands", JointState)
        with pytest.raises(RobotStopped, match="somebody else publishes to /joint_commands, too") as refused:
            Ros2Robot(JOINTS, RobotTopics(network=where), patience_s=2.0)
    assert "ros2 topic info -v /joint_commands" in refused.value.hint
