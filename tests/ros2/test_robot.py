"""A robot behind topics: driven by a recorder, lost, found again, and served by ourselves."""

import time
from dataclasses import replace

import numpy as np
import pytest

from ros2.ros2_cases import JOINTS, InThread, Publishing, network, state, wait_for
from trueup.core.protocols import Hardware
from trueup.errors import ConfigError, NameMismatch, RobotStopped
from trueup.lab import SimulatedRobot
from trueup.record.following import follow
from trueup.robots import find_model, load_robot
from trueup.ros2 import Float64MultiArray, JointState, Node, RobotTopics, Ros2Robot, serve
from trueup.sim import MujocoSimulator

ARM = load_robot("demo_arm")
RATE_HZ = 200.0


class Served(InThread):
    """The demo arm in MuJoCo, behind topics, in a thread."""

    def __init__(self, topics, *, rate_hz=RATE_HZ, robot=None):
        self.robot = robot or SimulatedRobot(MujocoSimulator.from_robot(ARM, find_model(ARM)), steps_per_control=1)
        self.done = None

        def run(stop):
            self.done = serve(self.robot, topics, rate_hz=rate_hz, stop=stop)

        super().__init__(run)


@pytest.mark.long
@pytest.mark.parametrize("form", ["joint_state", "array"])
def test_it_reads_and_follows(form):
    topics = RobotTopics(form=form, network=network())
    with Served(topics) as served:
        robot = Ros2Robot(ARM.joint_names, topics)
        try:
            assert isinstance(robot, Hardware)
            assert robot.joints == ARM.joint_names
            assert robot.command_signals == ("position",)
            here = robot.read()
            assert set(here) == {"position", "velocity", "torque"}
            goal = here["position"] + 0.4
            for _ in range(200):  # best effort: said again and again, as loops do
                robot.write({"position": goal})
                robot.wait_until_s(robot.now_s() + 0.01)
            np.testing.assert_allclose(robot.read()["position"], goal, atol=0.06)
            robot.recover()
        finally:
            robot.close()
    assert served.done.published > 100
    assert served.done.commands > 150
    assert served.done.refused == 0


@pytest.mark.long
def test_the_order_of_joints_is_the_callers():
    topics = RobotTopics(network=network())
    turned = ARM.joint_names[::-1]
    with Served(topics):
        robot = Ros2Robot(turned, topics)
        try:
            goal = np.linspace(0.2, 0.8, len(turned))
            for _ in range(200):
                robot.write({"position": goal})
                robot.wait_until_s(robot.now_s() + 0.01)
            np.testing.assert_allclose(robot.read()["position"], goal, atol=0.06)
        finally:
            robot.close()


def test_a_recorder_follows_it():
    """The series of `follow` are those of any hardware."""
    topics = RobotTopics(network=network())
    with Served(topics):
        robot = Ros2Robot(ARM.joint_names, topics)
        try:
            start = robot.read()["position"]
            way = start + 0.2 * (1 - np.cos(np.linspace(0, np.pi, 100)))[:, None]
            done = follow(robot, {"position": way}, step_s=0.01, every=1, silent_s=0.5)
        finally:
            robot.close()
    assert done.trouble is None
    assert len(done.measured) == pytest.approx(101, abs=2)
    np.testing.assert_allclose(done.measured["position"][-1], way[-1], atol=0.1)
    assert np.ptp(done.measured["position"], axis=0).min() > 0.2


def test_a_robot_that_goes_silent_is_noticed():
    topics = RobotTopics(network=network(), silent_s=0.2)
    with Served(topics):
        robot = Ros2Robot(ARM.joint_names, topics)
        robot.read()
    try:
        robot.read()  # what had come before it left
        time.sleep(0.3)
        with pytest.raises(TimeoutError, match=r"no joint states on /joint_states for 0\.[2-9] s"):
            robot.read()
        way = np.zeros((50, len(ARM.joint_names)))
        done = follow(robot, {"position": way}, step_s=0.01, every=1, silent_s=0.2)
        assert done.trouble.kind == "failed"
        with Served(topics):  # and one that is back is heard again
            wait_for(lambda: robot._states.writers)
            robot.recover()
            time.sleep(0.1)
            assert np.isfinite(robot.read()["position"]).all()
    finally:
        robot.close()


def test_nobody_there_is_said_with_what_was_seen():
    topics = RobotTopics(network=network())
    with pytest.raises(RobotStopped, match="no joint states on /joint_states") as refused:
        Ros2Robot(JOINTS, topics, patience_s=0.3)
    assert "0 publishers" in str(refused.value)
    assert "ros2 topic list" in refused.value.hint


@pytest.mark.long
def test_other_joints_are_both_listed():
    topics = RobotTopics(network=network())
    with Served(topics), pytest.raises(NameMismatch) as refused:
        Ros2Robot(JOINTS, topics, patience_s=5.0)
    for name in (*JOINTS, *ARM.joint_names):
        assert name in str(refused.value)


@pytest.mark.long
def test_a_robot_whose_controller_does_not_listen():
    where = network()
    with Node(where) as node, Publishing(node), pytest.raises(RobotStopped, match="nobody listens to /joint_commands"):
        Ros2Robot(JOINTS, RobotTopics(network=where), patience_s=2.0)


def test_commands_that_do_not_fit_are_refused_and_counted():
    topics = RobotTopics(form="array", network=network())
    with Served(topics) as served, Node(topics.network) as node:
        outbox = node.publish(topics.commands, Float64MultiArray)
        wait_for(lambda: outbox.readers)
        for numbers in ([1.0], [np.nan] * len(ARM.joint_names), [0.0] * len(ARM.joint_names)):
            outbox.send(Float64MultiArray(data=numbers))
        time.sleep(0.3)
    assert (served.done.commands, served.done.refused) == (1, 2)


def test_commands_of_other_signals_are_refused():
    topics = RobotTopics(network=network())
    with Served(topics):
        robot = Ros2Robot(ARM.joint_names, topics)
        try:
            for command in ({"torque": np.zeros(2)}, {}):
                with pytest.raises(ConfigError, match="command"):
                    robot.write(command)
        finally:
            robot.close()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"form": "trajectory"}, "no form"),
        ({"signals": ()}, "signals"),
        ({"signals": ("load",)}, "signals"),
        ({"form": "array", "signals": ("position", "velocity")}, "one signal"),
        ({"silent_s": 0.0}, "silent_s"),
    ],
)
def test_topics_that_cannot_be(changes, told):
    with pytest.raises(ConfigError, match=told):
        RobotTopics(**changes)


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, np.inf, np.nan])
def test_rates_that_are_none(rate_hz):
    robot = SimulatedRobot(MujocoSimulator.from_robot(ARM, find_model(ARM)), steps_per_control=1)
    with pytest.raises(ConfigError, match="rate"):
        serve(robot, RobotTopics(network=network()), rate_hz=rate_hz)


def test_a_robot_that_takes_no_torques_is_not_served_as_one():
    robot = SimulatedRobot(MujocoSimulator.from_robot(ARM, find_model(ARM)), steps_per_control=1)
    with pytest.raises(ConfigError, match="torque"):
        serve(robot, RobotTopics(signals=("torque",), network=network()))


@pytest.mark.parametrize("changes", [{"position": [1.0]}, {"position": [], "velocity": [], "effort": []}])
def test_a_driver_whose_arrays_do_not_fit_has_no_other_joints(changes):
    where = network()

    def speak(stop):
        with Node(where) as node:
            outbox = node.publish("/joint_states", JointState)
            while not stop.wait(0.01):
                outbox.send(replace(state(0.0), **changes))

    with InThread(speak), pytest.raises(RobotStopped, match="say nothing of their joints") as refused:
        Ros2Robot(JOINTS, RobotTopics(network=where), patience_s=1.0)
    assert "ros2 topic echo /joint_states" in refused.value.hint
