"""The recorder on robots that behave, and on robots that stop, go silent, stall, or raise errors."""

import contextlib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from record.scenes import panda_scene
from trueup.core.protocols import Hardware, TrajectoryIO
from trueup.errors import ConfigError, DataError, NameMismatch, NoPlan, RobotStopped
from trueup.lab import Fault, LabSpec, SimulatedRobot, VirtualRobot, draw_truth
from trueup.record import Box, MotionSettings, Recorder, RecordSettings, Scene, Workspace, joint_motion
from trueup.record.following import follow
from trueup.record.profile import ClockSettings
from trueup.robots import ControllerSpec, find_model, load_robot
from trueup.sim import MujocoSimulator

TRUTH = draw_truth()
HOME = panda_scene("floor").home
AWAY = HOME + np.array([0.2, 0.1, -0.15, 0.15, 0.2, -0.15, 0.2])
FARTHER = AWAY + np.array([0.3, 0.2, 0.2, -0.2, -0.4, 0.3, -0.5])
CLOCK = MotionSettings(clock=ClockSettings(rest_s=0.1))
PLAN = joint_motion(panda_scene("floor"), AWAY, FARTHER, velocity_share=0.3, settings=CLOCK, id="one")
NEXT = joint_motion(panda_scene("floor"), FARTHER, AWAY, velocity_share=0.3, settings=CLOCK, id="next")
# Where robots are driven step by step, a quarter of the steps says as much in less time.
COARSE = RecordSettings(control_hz=250.0, record_hz=50.0, settle_s=0.0)
ROW_S = 0.02


class Driver:
    """A robot as a driver has it: commands and readings one by one, its joints in an order of its own.

    Everything that is written is compared with where the robot really is: nothing may make it jump, least of all what
    comes first after a stop.
    """

    def __init__(self, robot, *, order=None):
        self.robot = robot
        self.order = list(range(len(robot.joints))) if order is None else order
        self.joints = tuple(robot.joints[row] for row in self.order)
        self.command_signals = robot.command_signals
        self.recovered = 0
        self.jump = 0.0
        self.jolt = 0.0
        self.written = 0
        self.resting = True

    def now_s(self):
        return self.robot.now_s()

    def wait_until_s(self, time_s):
        self.robot.wait_until_s(time_s)

    def read(self):
        return {name: values[self.order] for name, values in self.robot.read().items()}

    def write(self, command):
        back = np.argsort(self.order)
        asked = {name: values[back] for name, values in command.items()}
        self.robot.write(asked)
        self.written += 1
        away = np.abs(asked["position"] - self.robot._plant.position()).max()
        self.jump = max(self.jump, away)
        self.jolt = max(self.jolt, away if self.resting else 0.0)
        self.resting = False

    def recover(self):
        self.recovered += 1
        self.resting = True
        self.robot.recover()


def lab(*, faults=(), seed=0, payload_kg=0.0):
    return VirtualRobot(TRUTH, seed=seed, faults=faults, payload_kg=payload_kg)


def recorder(robot, settings=COARSE):
    return Recorder(robot, panda_scene("floor"), settings)


def rows(plan, every_s=ROW_S):
    return plan.position[:: round(plan.rate_hz * every_s)]


@cache
def begin_s(settings=COARSE):
    """When the motion begins on the robot's clock: after the way to its start."""
    robot = lab()
    recorder(robot, settings).reach(PLAN.start)
    return robot.now_s()


BEGIN_S = begin_s()
MIDDLE_S = 0.5


def kinds(recording):
    return [flag.kind for flag in recording.flags]


def assert_same(one, other, *, step_s=0.0):
    """The same recordings; who drives step by step learns of a stop one step later."""
    for series in ("measured", "command"):
        left, right = getattr(one, series), getattr(other, series)
        assert (left.joints, set(left.signals)) == (right.joints, set(right.signals))
        np.testing.assert_array_equal(left.time_s, right.time_s)
        for name in left.signals:
            np.testing.assert_array_equal(left[name], right[name])
    assert kinds(one) == kinds(other)
    for left, right in zip(one.flags, other.flags, strict=True):
        assert left.start_s == right.start_s or 0 <= right.start_s - left.start_s < step_s


def at_home(robot):
    return np.abs(robot._plant.position() - HOME).max() < 0.05


def test_robots_with_and_without_trajectories_are_both_hardware():
    assert isinstance(lab(), TrajectoryIO)
    assert isinstance(Driver(lab()), Hardware)
    assert not isinstance(Driver(lab()), TrajectoryIO)


TROUBLES = {
    "none": (),
    "stop": (Fault("stop", at_s=0.7),),
    "stop between rows": (Fault("stop", at_s=0.7051),),
    "stop at once": (Fault("stop", at_s=0.021),),
    "silent": (Fault("drop", at_s=0.5),),
    "some lost": (Fault("drop", at_s=0.0, share=0.5),),
    "stall": (Fault("stall", at_s=0.4, duration_s=0.3, joint="joint6"),),
}


# Read more often than commanded; of a stop, who writes seldom learns late.
HELD = RecordSettings(control_hz=50.0, record_hz=250.0, settle_s=0.0)
FOLLOWED = [(name, COARSE) for name in TROUBLES] + [(name, HELD) for name in ("none", "silent", "some lost", "stall")]


@pytest.mark.parametrize(("name", "settings"), [*FOLLOWED, ("none", RecordSettings())])
def test_step_by_step_and_whole_trajectories_record_the_same(name, settings):
    faults = [replace(fault, at_s=begin_s(settings) + fault.at_s) for fault in TROUBLES[name]]
    driver = Driver(lab(faults=faults, seed=3))
    stepwise = recorder(driver, settings).record(PLAN)
    assert driver.written > 60
    whole = recorder(lab(faults=faults, seed=3), settings).record(PLAN)
    assert_same(whole, stepwise, step_s=1 / settings.control_hz)


@pytest.mark.parametrize(("stop_s", "sent"), [(0.021, 5), (0.024, 5), (0.025, 5), (0.026, 6), (0.029, 6)])
def test_commands_that_were_sent_before_a_stop_are_kept_and_no_others(stop_s, sent):
    settings = RecordSettings(control_hz=200.0, record_hz=200.0, settle_s=0.0)
    faults = [Fault("stop", at_s=begin_s(settings) + stop_s)]
    for robot in (lab(faults=faults), Driver(lab(faults=faults))):
        np.testing.assert_array_equal(
            recorder(robot, settings).record(PLAN).command["position"], rows(PLAN, 0.005)[:sent]
        )


def test_all_commands_are_kept_where_readings_are_more_frequent():
    driver = Driver(lab())
    for robot in (lab(), driver):
        done = recorder(robot, HELD).record(PLAN)
        assert done.flags == ()
        np.testing.assert_array_equal(done.command["position"], rows(PLAN, 0.02))
        np.testing.assert_allclose(np.diff(done.command.time_s), 0.02, atol=1e-9)
        np.testing.assert_allclose(np.diff(done.measured.time_s), 0.004, atol=1e-9)
        assert done.measured.time_s[-1] == pytest.approx(0.02 * len(done.command))
    ways = round(begin_s(HELD) * HELD.control_hz)
    assert driver.written <= ways + len(done.command) + 1
    finer = recorder(lab(), replace(HELD, record_hz=500.0)).record(PLAN).measured
    np.testing.assert_array_equal(finer["position"][::2], done.measured["position"])


@pytest.mark.parametrize(("stop_s", "sent"), [(0.019, 1), (0.02, 1), (0.021, 2), (0.039, 2), (0.041, 3)])
def test_held_commands_that_were_sent_before_a_stop_are_kept_and_no_others(stop_s, sent):
    faults = [Fault("stop", at_s=begin_s(HELD) + stop_s)]
    for robot in (lab(faults=faults), Driver(lab(faults=faults))):
        done = recorder(robot, HELD).record(PLAN)
        assert kinds(done) == ["stopped"]
        np.testing.assert_array_equal(done.command["position"], rows(PLAN, 0.02)[:sent])


@pytest.mark.parametrize(
    "settings", [RecordSettings(), RecordSettings(control_hz=500.0, record_hz=50.0), RecordSettings(record_hz=1000.0)]
)
def test_what_is_kept_is_the_plan_on_a_clock_of_the_rates_that_were_asked_for(settings):
    robot = lab()
    done = recorder(robot, settings).record(PLAN)
    assert done.flags == ()
    skip = round(PLAN.rate_hz / settings.record_hz)
    for name in ("position", "velocity"):
        np.testing.assert_array_equal(done.command[name], getattr(PLAN, name)[::skip])
    np.testing.assert_allclose(done.command.time_s, PLAN.time_s[::skip], atol=1e-9)
    for series in (done.measured, done.command):
        assert series.time_s[0] == 0
        assert np.all(np.diff(series.time_s) > 0)
        np.testing.assert_allclose(np.diff(series.time_s), 1 / settings.record_hz, atol=1e-9)
        assert series.joints == PLAN.joints
    # From before the first command to after the last one: neither more nor much less than the plan.
    assert PLAN.duration_s - 1 / settings.record_hz < done.measured.time_s[-1] <= PLAN.duration_s + 1e-3 + 1e-9
    there = np.stack([np.interp(done.measured.time_s, PLAN.time_s, joint) for joint in PLAN.position.T], axis=1)
    assert np.abs(done.measured["position"] - there).max() < 0.04
    assert np.abs(done.measured["position"] - there).max() > 1e-4  # it is measured, not commanded
    assert set(done.measured.signals) == {"position", "velocity", "torque"}
    assert set(done.measured.units["torque"]) == {"Nm"}
    # With the rest before, the start of the motion is in the recording.
    assert np.ptp(done.measured["position"][done.measured.time_s < PLAN.start_s], axis=0).max() < 2e-3


def test_joints_in_another_order_are_matched_by_name():
    order = [3, 0, 6, 1, 5, 2, 4]
    mixed, straight = Driver(lab(seed=2), order=order), Driver(lab(seed=2))
    one, other = recorder(mixed).record(PLAN), recorder(straight).record(PLAN)
    assert one.measured.joints == tuple(PLAN.joints[row] for row in order)
    for series in ("measured", "command"):
        for name, values in getattr(one, series).signals.items():
            np.testing.assert_array_equal(values, getattr(other, series)[name][:, order])
    turned = replace(
        PLAN,
        joints=mixed.joints,
        **{name: getattr(PLAN, name)[:, order] for name in ("position", "velocity", "acceleration")},
    )
    assert_same(recorder(lab(seed=2)).record(turned), recorder(lab(seed=2)).record(PLAN))
    assert mixed.jump < 0.05


def test_motions_follow_one_another_without_a_jump():
    robot = Driver(lab())
    hands = recorder(robot)
    for plan in (PLAN, NEXT, NEXT, PLAN):
        done = hands.record(plan)
        assert done.flags == ()
        assert done.measured.time_s[0] == 0
        np.testing.assert_allclose(done.measured["position"][0], plan.start, atol=0.02)
    assert robot.jump < 0.05
    assert robot.recovered == 0


@pytest.mark.parametrize("wrap", [Driver, lambda robot: robot], ids=["step by step", "trajectories"])
def test_a_protective_stop_ends_the_episode_and_the_rest_goes_on(wrap):
    stop_s = 0.7
    robot = lab(faults=[Fault("stop", at_s=BEGIN_S + stop_s)])
    hands = recorder(wrap(robot))
    done = hands.record(PLAN)
    assert kinds(done) == ["stopped"]
    flag = done.flags[0]
    assert flag.severity == "warning"
    assert flag.start_s == pytest.approx(stop_s, abs=5e-3)
    assert done.measured.time_s[-1] == pytest.approx(stop_s, abs=ROW_S)
    assert done.command.time_s[-1] < stop_s + 1e-9
    np.testing.assert_array_equal(done.command["position"], rows(PLAN)[: len(done.command)])
    assert not robot.stopped
    assert at_home(robot)
    again = hands.record(NEXT)
    assert again.flags == ()
    assert len(again.command) == len(rows(NEXT))


@pytest.mark.parametrize("wrap", [Driver, lambda robot: robot], ids=["step by step", "trajectories"])
def test_a_robot_that_says_nothing_any_more_is_silent(wrap):
    robot = lab(faults=[Fault("drop", at_s=BEGIN_S + MIDDLE_S, duration_s=1.0)])
    hands = recorder(wrap(robot))
    done = hands.record(PLAN)
    assert kinds(done) == ["silent"]
    assert MIDDLE_S + 0.2 - ROW_S < done.flags[0].start_s < MIDDLE_S + 0.2 + 2 * ROW_S
    assert done.measured.time_s[-1] == pytest.approx(done.flags[0].start_s)
    assert hands.record(NEXT).flags == ()


def test_a_robot_that_is_not_heard_is_not_made_to_jump():
    robot = Driver(lab(faults=[Fault("drop", at_s=BEGIN_S + MIDDLE_S, duration_s=0.8)]))
    hands = recorder(robot)
    assert kinds(hands.record(PLAN)) == ["silent"]
    assert at_home(robot.robot)
    assert robot.jump < 0.06


def test_a_silence_on_the_way_to_the_start_is_waited_for():
    robot = Driver(lab(faults=[Fault("drop", at_s=0.2, duration_s=0.9)]))
    assert recorder(robot).record(PLAN).flags == ()
    assert robot.jump < 0.06


def test_a_robot_that_stays_silent_is_given_up():
    robot = Driver(lab(faults=[Fault("drop", at_s=BEGIN_S + MIDDLE_S, duration_s=4.0)]))
    hands = recorder(robot)
    assert kinds(hands.record(PLAN)) == ["silent"]
    for _ in range(2):
        with pytest.raises(RobotStopped, match="silent, and is given up"):
            hands.record(NEXT)
    assert robot.jump < 0.06
    robot.wait_until_s(BEGIN_S + 5.0)
    hands.recover()  # somebody has seen to it
    assert hands.record(NEXT).flags == ()
    assert robot.jump < 0.06


def test_a_joint_that_stalls_misses_the_goal_and_the_robot_goes_home():
    still = PLAN.end_s + 0.3
    robot = lab(faults=[Fault("stall", at_s=BEGIN_S + 0.4, duration_s=still, joint="joint5")])
    hands = recorder(robot)
    done = hands.record(PLAN)
    assert kinds(done) == ["off_path", "goal_missed"]
    assert {flag.joint for flag in done.flags} == {"joint5"}
    assert len(done.command) == len(rows(PLAN))
    assert at_home(robot)
    assert hands.record(NEXT).flags == ()


def test_a_joint_that_stalls_and_catches_up_was_off_its_path():
    robot = lab(faults=[Fault("stall", at_s=BEGIN_S + 0.3, duration_s=0.3, joint="joint5")])
    hands = recorder(robot, replace(COARSE, path_tolerance_rad=0.08))
    done = hands.record(PLAN)
    assert kinds(done) == ["off_path"]
    count = min(len(done.measured), len(done.command))
    away = np.abs(done.measured["position"][:count] - done.command["position"][:count])[:, 4]
    assert done.flags[0].joint == "joint5"
    assert f"{away.max():.3g}" in done.flags[0].detail
    assert hands.record(NEXT).flags == ()


class Unwell(Driver):
    """Raises an error of its driver at one call, for a while."""

    def __init__(self, robot, error, *, call, begin_s, end_s=np.inf):
        super().__init__(robot)
        self.error, self.call, self.begin_s, self.end_s = error, call, begin_s, end_s

    def _perhaps(self, call):
        if call == self.call and self.begin_s <= self.robot.now_s() < self.end_s:
            if call != "wait_until_s":
                self.robot.wait_until_s(self.robot.now_s() + 0.02)  # nobody answers at once that he does not answer
            raise self.error

    def wait_until_s(self, time_s):
        super().wait_until_s(time_s)
        self._perhaps("wait_until_s")

    def read(self):
        self._perhaps("read")
        return super().read()

    def write(self, command):
        self._perhaps("write")
        super().write(command)

    def recover(self):
        self._perhaps("recover")
        super().recover()


ERRORS = [
    (OSError(104, "Connection reset by peer"), "read"),
    (TimeoutError("no answer\nwithin 1 s"), "write"),
    (DataError("the frame is cut"), "wait_until_s"),
]


@pytest.mark.parametrize(("error", "call"), ERRORS)
def test_an_error_of_the_driver_closes_the_episode_as_failed(error, call):
    begin_s = BEGIN_S + MIDDLE_S
    robot = Unwell(lab(), error, call=call, begin_s=begin_s, end_s=begin_s + 0.02)
    hands = recorder(robot)
    done = hands.record(PLAN)
    assert kinds(done) == ["failed"]
    assert " ".join(str(error).split()) in done.flags[0].detail
    assert done.flags[0].start_s == pytest.approx(MIDDLE_S, abs=0.03)
    assert done.measured.time_s[-1] == pytest.approx(MIDDLE_S, abs=1.01 * ROW_S)
    assert hands.record(NEXT).flags == ()
    assert robot.jump < 0.06


@pytest.mark.parametrize("call", ["read", "write", "wait_until_s"])
def test_a_connection_that_is_lost_for_good_takes_no_recording_with_it(call):
    robot = Unwell(lab(), OSError(104, "Connection reset by peer"), call=call, begin_s=BEGIN_S + MIDDLE_S)
    hands = recorder(robot)
    done = hands.record(PLAN)
    assert kinds(done) == ["failed"]
    assert len(done.measured) >= MIDDLE_S / ROW_S
    with pytest.raises(RobotStopped, match="Connection reset"):
        hands.record(NEXT)


def test_a_connection_that_is_lost_when_the_motion_is_over_takes_no_recording_with_it():
    robot = Unwell(lab(), OSError(104, "gone"), call="read", begin_s=BEGIN_S + PLAN.duration_s + 0.0005)
    done = recorder(robot).record(PLAN)
    assert len(done.command) == len(rows(PLAN))
    assert "failed" in kinds(done)


def test_a_robot_that_cannot_recover_does_not_take_the_recording_with_it():
    faults = [Fault("stop", at_s=BEGIN_S + 0.7)]
    robot = Unwell(lab(faults=faults), OSError("no"), call="recover", begin_s=0.0)
    hands = recorder(robot)
    assert kinds(hands.record(PLAN)) == ["stopped"]
    with pytest.raises(RobotStopped):
        hands.record(NEXT)


@pytest.mark.parametrize("wrap", [Driver, lambda robot: robot], ids=["step by step", "trajectories"])
def test_a_stop_on_the_way_to_the_start_is_recovered_from(wrap):
    robot = lab(faults=[Fault("stop", at_s=0.3), Fault("stop", at_s=0.8)])
    done = recorder(wrap(robot)).record(PLAN)
    assert done.flags == ()
    np.testing.assert_allclose(done.measured["position"][0], PLAN.start, atol=0.02)


@pytest.mark.parametrize("stop_s", [0.2, 0.3, BEGIN_S + MIDDLE_S])
def test_a_robot_that_stopped_goes_on_from_where_it_is(stop_s):
    """Also beside home: a stop at 0.2 s leaves it a few hundredths away."""
    robot = Driver(lab(faults=[Fault("stop", at_s=stop_s)]))
    recorder(robot).record(PLAN)
    assert robot.recovered == 1
    assert robot.jolt < 0.011


class Dead(Driver):
    """Does not open its brakes."""

    def recover(self):
        self.recovered += 1


def test_a_robot_that_never_recovers_is_given_up_after_its_motion_was_handed_over():
    robot = Dead(lab(faults=[Fault("stop", at_s=BEGIN_S + 0.7)]))
    hands = recorder(robot, replace(COARSE, recoveries=2))
    done = hands.record(PLAN)
    assert kinds(done) == ["stopped"]
    assert len(done.measured) == 36
    for _ in range(2):
        with pytest.raises(RobotStopped, match="2 times") as caught:
            hands.record(NEXT)
        assert "--resume" in str(caught.value)
    early = Dead(lab(faults=[Fault("stop", at_s=0.3)]))
    with pytest.raises(RobotStopped, match="3 times"):
        recorder(early).record(PLAN)


def test_a_stop_before_anything_was_sent_records_nothing_and_says_so():
    robot = lab(faults=[Fault("stop", at_s=BEGIN_S)])
    hands = recorder(robot)
    with pytest.raises(DataError, match="nothing of motion 'one'"):
        hands.record(PLAN)
    assert at_home(robot)
    assert hands.record(NEXT).flags == ()


def test_no_way_to_the_start():
    there = panda_scene("floor").pose(FARTHER)[0]
    block = Workspace(boxes=(Box("block", tuple(there.tolist()), (0.05, 0.05, 0.05)),))
    robot = Driver(lab())
    hands = Recorder(robot, Scene(load_robot("panda"), workspace=block), COARSE)
    with pytest.raises(NoPlan, match="block"):
        hands.record(NEXT)
    assert robot.written == 0
    short = joint_motion(hands.scene, AWAY, HOME, velocity_share=0.5, settings=CLOCK, id="short")
    assert hands.record(short).flags == ()


class Slow(Driver):
    """Whoever waits for it oversleeps now and then."""

    def __init__(self, robot, *, every, by_s):
        super().__init__(robot)
        self.calls, self.every, self.by_s = 0, every, by_s

    def wait_until_s(self, time_s):
        self.calls += 1
        super().wait_until_s(time_s + (self.by_s if self.calls % self.every == 0 else 0.0))


def test_a_slow_clock_is_flagged_and_stays_a_clock():
    few, many = Slow(lab(), every=200, by_s=0.006), Slow(lab(), every=7, by_s=0.012)
    done = recorder(few).record(PLAN)
    assert [(flag.kind, flag.severity) for flag in done.flags] == [("late", "note")]
    assert "6.0 ms" in done.flags[0].detail
    done = recorder(many).record(PLAN)
    assert [(flag.kind, flag.severity) for flag in done.flags] == [("late", "warning")]
    # The stamps say when it was, not when it should have been.
    late = done.command.time_s - np.arange(len(done.command)) * ROW_S
    assert 0.008 < late.max() < 0.013
    np.testing.assert_array_equal(done.command["position"], rows(PLAN))
    for series in (done.measured, done.command):
        assert np.all(np.diff(series.time_s) > 0)


class Ticking(Driver):
    """A clock with few ticks."""

    def now_s(self):
        return np.floor(self.robot.now_s() / 0.016 + 1e-9) * 0.016


def test_a_clock_with_fewer_ticks_than_rows_still_increases():
    done = recorder(Ticking(lab()), RecordSettings(control_hz=250.0, record_hz=250.0)).record(PLAN)
    for series in (done.measured, done.command):
        assert np.all(np.diff(series.time_s) > 0)


class Reusing(Driver):
    """Gives the same arrays each time, filled anew, as some drivers do."""

    def __init__(self, robot):
        super().__init__(robot)
        self.state = {name: values.copy() for name, values in robot.read().items()}

    def read(self):
        for name, values in self.robot.read().items():
            self.state[name][:] = values
        return self.state


def test_a_driver_that_reuses_its_arrays():
    assert_same(recorder(Reusing(lab())).record(PLAN), recorder(lab()).record(PLAN))


class Odd(Driver):
    """Its readings are not always of the same kind."""

    def __init__(self, robot, change):
        super().__init__(robot)
        self.change = change

    def read(self):
        reading = super().read()
        return self.change(reading) if self.robot.now_s() > BEGIN_S + MIDDLE_S else reading


@pytest.mark.parametrize(
    "change",
    [
        lambda reading: {name: reading[name] for name in ("position", "velocity")},
        lambda reading: {**reading, "current": reading["torque"]},
        lambda reading: {**reading, "torque": reading["torque"][:3]},
    ],
    ids=["less", "more", "short"],
)
def test_readings_that_change_their_kind_close_the_episode(change):
    robot = Odd(lab(), change)
    hands = recorder(robot)
    done = hands.record(PLAN)
    assert kinds(done) == ["failed"]
    assert len(done.measured) == MIDDLE_S / ROW_S + 1


def test_a_robot_that_measures_no_numbers_is_given_up_and_its_motion_kept():
    robot = Odd(lab(), lambda reading: {**reading, "position": np.full(7, np.nan)})
    hands = recorder(robot)
    done = hands.record(PLAN)
    assert kinds(done) == ["failed"]
    with pytest.raises(RobotStopped):
        hands.record(NEXT)
    assert robot.jump < 0.06


def test_readings_of_unknown_unit_are_refused_before_the_robot_moves():
    robot = Driver(lab())
    plain = robot.read
    robot.read = lambda: {**plain(), "wisdom": np.zeros(7)}
    with pytest.raises(DataError, match="wisdom"):
        recorder(robot).record(PLAN)


def test_what_does_not_fit_is_refused():
    arm = load_robot("demo_arm")
    few = Scene(arm, velocity=dict.fromkeys(arm.joint_names, 2.0), acceleration=dict.fromkeys(arm.joint_names, 8.0))
    with pytest.raises(NameMismatch, match=r"joint1.*yaw"):
        Recorder(lab(), few)
    torque = LabSpec()
    torque = replace(torque, controller=replace(torque.controller, kind="torque"))
    with pytest.raises(ConfigError, match="commands positions"):
        recorder(VirtualRobot(draw_truth(torque)))
    with pytest.raises(ConfigError, match="control step"):
        recorder(lab(), RecordSettings(control_hz=800.0, record_hz=100.0))
    other = replace(PLAN, joints=("a", *PLAN.joints[1:]), moving=())
    with pytest.raises(NameMismatch, match="another robot"):
        recorder(lab()).record(other)
    with pytest.raises(ConfigError, match="1000 and 800 Hz"):
        recorder(Driver(lab()), RecordSettings(control_hz=800.0, record_hz=100.0)).record(PLAN)
    slow = VirtualRobot(draw_truth(replace(LabSpec(), control_step_s=0.004)))
    with pytest.raises(ConfigError, match="control step"):
        recorder(slow, RecordSettings())


@pytest.mark.parametrize(
    "wrong",
    [
        {"control_hz": -1000.0},
        {"control_hz": 0.0},
        {"record_hz": -100.0},
        {"record_hz": float("nan")},
        {"record_hz": float("inf")},
        {"record_hz": 300.0},
        {"control_hz": 30.0},
        {"transfer_share": 0.0},
        {"transfer_share": 1.5},
        {"tolerance_rad": 0.0},
        {"silent_s": -0.1},
        {"recoveries": 0},
    ],
)
def test_settings_that_make_no_recording_are_refused(wrong):
    with pytest.raises(ConfigError):
        RecordSettings(**wrong)


def test_an_engine_is_hardware_too():
    gains = ControllerSpec(kind="pd", kp=2000.0, kv=60.0)
    arm = replace(load_robot("panda"), controller=gains)

    def simulated():
        return SimulatedRobot(MujocoSimulator.from_robot(arm, find_model(arm)), position=HOME)

    robot = simulated()
    assert isinstance(robot, Hardware)
    done = recorder(robot).record(PLAN)
    assert done.flags == ()
    np.testing.assert_array_equal(done.command["position"], rows(PLAN))
    there = np.stack([np.interp(done.measured.time_s, PLAN.time_s, joint) for joint in PLAN.position.T], axis=1)
    assert 1e-5 < np.abs(done.measured["position"] - there).max() < 0.1
    assert_same(recorder(simulated()).record(PLAN), done)


def test_what_a_robot_did_before_leaves_no_trace():
    """A new start, after a stop, a stall, another pose and warmth, is that of a robot that never moved."""
    used = lab(
        faults=[Fault("stall", at_s=0.1, duration_s=0.2, joint="joint2"), Fault("stop", at_s=BEGIN_S + MIDDLE_S)]
    )
    recorder(used).record(PLAN)
    used.stop()
    for worked_s in (0.0, 600.0):
        fresh = lab()
        for robot in (used, fresh):
            robot.restart(seed=(4, 7), worked_s=worked_s)
        assert used.now_s() == 0
        assert_same(recorder(used).record(NEXT), recorder(fresh).record(NEXT))
    cold, warm = lab(), lab()
    warm.restart(worked_s=3600.0)
    cold.restart()
    pushed = [recorder(robot).record(NEXT).measured["torque"] for robot in (cold, warm)]
    assert np.abs(pushed[0] - pushed[1]).max() > 0.05
    with pytest.raises(ConfigError, match="worked_s"):
        cold.restart(worked_s=-1.0)


def test_seeds_of_several_numbers_are_seeds():
    readings = []
    for seed in ((1, 2), (1, 3), (2, 1), 1):
        robot = lab()
        robot.restart(seed=seed)
        readings.append(robot.read()["position"])
    assert all(not np.array_equal(one, other) for row, one in enumerate(readings) for other in readings[row + 1 :])


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_a_motion_that_is_broken_off_leaves_no_speed_behind(error):
    """The robot holds its last command: at the speed of the middle of a motion that would be no rest."""

    class BrokenOff(Driver):
        sent = None
        reads = 0

        def read(self):
            self.reads += 1
            if self.sent is not None and self.reads == 25:
                raise error
            return super().read()

        def write(self, command):
            self.sent, before = command, self.sent
            self.asked = before
            super().write(command)

    driver = BrokenOff(lab())
    driver.robot.place(PLAN.start)
    command = {"position": PLAN.position[::4], "velocity": PLAN.velocity[::4]}
    with contextlib.suppress(KeyboardInterrupt):
        done = follow(driver, command, step_s=0.004, every=5, silent_s=0.5)
        assert done.trouble.kind == "failed"
    assert np.abs(driver.asked["velocity"]).max() > 0.1
    np.testing.assert_array_equal(driver.sent["velocity"], 0.0)
    np.testing.assert_array_equal(driver.sent["position"], driver.asked["position"])
