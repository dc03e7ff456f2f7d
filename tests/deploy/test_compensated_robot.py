"""A robot with a compensation on its way in: virtual hardware, step by step and under the recorder."""

from typing import ClassVar

import numpy as np
import pytest

from deploy.compensation_cases import compensation
from trueup.core.protocols import Hardware, RobotIO, TrajectoryIO
from trueup.deploy import CompensatedIO, CompensatedRobot, Compensator, CompensatorSettings, Limits, Status, Why
from trueup.errors import ConfigError, MissingSignal, NameMismatch
from trueup.lab import VirtualRobot, draw_truth, load_lab
from trueup.record import MotionSettings, Recorder, RecordSettings, Scene, joint_motion
from trueup.record.profile import ClockSettings
from trueup.robots import load_robot

PERIOD_S = 0.02


@pytest.fixture(scope="module")
def upper_body():
    return load_robot("upper_body")


@pytest.fixture(scope="module")
def limits(upper_body):
    return Limits(*zip(*(joint.position_limits for joint in upper_body.joints), strict=True))


@pytest.fixture(scope="module")
def truth():
    return draw_truth(load_lab("upper_body"), unit=1)


@pytest.fixture(scope="module")
def folder(upper_body, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    compensation(folder, upper_body.joint_names, size=0.02)
    return folder


def driven(folder, truth, limits, *, loop_hz=50.0, **settings):
    robot = VirtualRobot(truth, payload_kg=2.0)
    made = Compensator.load(
        folder,
        joints=robot.joints,
        limits=limits,
        loop_hz=loop_hz,
        settings=CompensatorSettings(**settings),
        payload_kg=2.0,
    )
    return CompensatedRobot(robot, made)


def targets(robot, samples, loop_hz):
    here = robot.read()["position"]
    wave = 1 - np.cos(2 * np.pi * np.arange(samples) / loop_hz / 1.5)
    return here + 0.1 * wave[:, None] * np.where(here > 0, -1.0, 1.0)


class Sent:
    """Remembers what it was sent."""

    joints: ClassVar[tuple[str, ...]] = ("a", "b")

    def __init__(self, **reading):
        self.reading, self.sent = reading, []

    def read(self):
        return self.reading

    def write(self, command):
        self.sent.append(command)


@pytest.mark.parametrize("loop_hz", [50.0, 1000.0])
def test_what_a_robot_gets_is_the_target_and_a_bounded_correction(folder, truth, limits, loop_hz):
    robot = driven(folder, truth, limits, loop_hz=loop_hz, largest=0.015)
    assert isinstance(robot, Hardware)
    assert not isinstance(robot, TrajectoryIO)  # whole trajectories are sent before anything was measured
    sent, status, start = [], [], robot.now_s()
    whole = robot.inner.write
    robot.inner.write = lambda command: (sent.append(command["position"]), whole(command))
    rows = targets(robot, round(0.6 * loop_hz), loop_hz)
    for k, row in enumerate(rows):
        robot.write({"position": row})
        status.append((robot.latest.status, robot.latest.why & ~Why.LIMITED))
        robot.wait_until_s(start + (k + 1) / loop_hz)
    delta = np.array(sent) - np.clip(rows, limits.low, limits.high)
    assert np.abs(delta).max() <= 0.015 + 1e-12
    assert np.abs(delta).max() > 0.005
    assert set(status) == {(Status.OK, Why.NONE)}
    assert robot.now_s() == pytest.approx(start + 0.6)
    assert set(robot.read()) == {"position", "velocity", "torque"}


def test_a_loop_at_another_rate_than_it_said_is_seen_on_the_robots_clock(folder, truth, limits):
    robot = driven(folder, truth, limits)
    rows = targets(robot, 250, 50.0)
    for k, row in enumerate(rows):
        robot.write({"position": row})
        robot.wait_until_s((k + 1) * PERIOD_S * 1.25)
    assert Why.OFF_RATE in robot.latest.why
    assert robot.latest.status is Status.FALLBACK
    np.testing.assert_array_equal(robot.latest.target, rows[-1])


def test_a_recorder_drives_it(folder, truth, limits, upper_body):
    robot = driven(folder, truth, limits)
    scene = Scene(upper_body)
    goal = scene.home + 0.15 * np.where(scene.home > 0, -1.0, 1.0)
    way = MotionSettings(clock=ClockSettings(rest_s=0.1))
    plan = joint_motion(scene, scene.home, goal, velocity_share=0.5, settings=way, id="one")
    settings = RecordSettings(control_hz=50.0, record_hz=50.0, tolerance_rad=0.6, path_tolerance_rad=1.0)
    recording = Recorder(robot, scene, settings).record(plan)
    assert recording.flags == ()
    # What was asked for is recorded, and the robot's motion under what was sent.
    rows = plan.position[:: round(plan.rate_hz * PERIOD_S)]
    np.testing.assert_allclose(recording.command["position"][: len(rows)], rows, atol=1e-9)
    assert np.abs(robot.latest.delta).max() > 0.001


def test_other_signals_are_passed_on(tmp_path):
    compensation(tmp_path)
    two = np.zeros(2)
    made = Compensator.load(tmp_path, joints=("a", "b"), limits=Limits((-1.0, -1.0), (1.0, 1.0)), payload_kg=0.0)
    robot = Sent(position=two, velocity=two, torque=two)
    io = CompensatedIO(robot, made)
    assert isinstance(io, RobotIO)
    assert io.read() is robot.reading
    io.write({"position": two, "velocity": two + 3.0})
    np.testing.assert_array_equal(robot.sent[0]["velocity"], 3.0)
    assert np.abs(robot.sent[0]["position"]).max() > 0
    io.write({"position": two})
    assert robot.sent[0]["position"] is not robot.sent[1]["position"]


def test_what_does_not_fit_is_refused(tmp_path):
    compensation(tmp_path, direction="simulator")
    two = np.zeros(2)
    made = Compensator.load(tmp_path, joints=("a", "b"), limits=Limits((-1.0, -1.0), (1.0, 1.0)), payload_kg=0.0)
    robot = Sent(position=two)
    with pytest.raises(ConfigError, match="corrects the commands of a simulator"):
        CompensatedIO(robot, made)
    io = CompensatedIO(robot, made, direction="simulator")
    with pytest.raises(MissingSignal, match="velocity"):
        io.write({"position": two})
    with pytest.raises(MissingSignal, match="sent none"):
        io.write({"velocity": two})
    robot.reading["velocity"] = two
    robot.joints = ("b", "a")
    with pytest.raises(NameMismatch, match="in another order"):
        CompensatedIO(robot, made, direction="simulator")
    assert robot.sent == []
