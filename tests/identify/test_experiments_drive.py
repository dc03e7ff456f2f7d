"""Driving robots: limits, failures in the middle, silence, holding and returning, ids and clocks."""

import time

import numpy as np
import pytest

from identify.experiment_robots import Friction, SlidingRobot
from trueup.core.protocols import Clock, RobotIO
from trueup.errors import ConfigError, MissingSignal, NameMismatch
from trueup.identify.experiments import (
    PANDA_TORQUES_NM,
    Limits,
    PoseHold,
    PulsePlan,
    RampPlan,
    RunSettings,
    WallClock,
    estimate_breakaway,
    run_breakaway,
    run_coast,
    run_constant_torque,
)

LIMITS = Limits({"joint1": 2.0, "joint2": 2.0})
FAST = RunSettings(rate_hz=200.0)


def robot(**options):
    return SlidingRobot({"joint1": Friction(), "joint2": Friction(offset=0.1)}, **{"dt": 0.005, **options})


def kinds(episode):
    return [flag.kind for flag in episode.meta.flags]


def test_excite_and_coast_are_1500_and_500_steps():
    own = SlidingRobot({"joint1": Friction()})
    episodes = list(run_coast(own, own, {"joint1": (1.5, -0.45)}, limits=LIMITS_ONE))
    assert [episode.id for episode in episodes] == ["joint1_torque1.5", "joint1_torque-0.45"]
    torque = episodes[0].commanded()["torque"][:, 0]
    np.testing.assert_array_equal(torque[:1500], 1.5)
    np.testing.assert_array_equal(torque[1500:], 0.0)
    assert len(episodes[0].measured) == 2001  # states before, between and after 2000 steps
    np.testing.assert_allclose(episodes[0].measured.time_s, np.arange(2001) * 0.001, atol=1e-9)
    assert not kinds(episodes[0])


LIMITS_ONE = Limits({"joint1": 2.0})


def test_the_table_of_the_thesis_has_28_trajectories():
    assert sum(map(len, PANDA_TORQUES_NM.values())) == 28
    assert [len(torques) for torques in PANDA_TORQUES_NM.values()] == [4, 3, 4, 4, 4, 4, 5]


def test_directions_are_interleaved_joint_by_joint():
    own = robot()
    plan = RampPlan(ramp_nm_per_s=2.0, repetitions=2, rest_s=0.2)
    ids = [episode.id for episode in run_breakaway(own, own, limits=LIMITS, plan=plan, settings=FAST)]
    assert ids[:4] == [
        "joint1_ramp-positive-01",
        "joint1_ramp-negative-01",
        "joint1_ramp-negative-02",
        "joint1_ramp-positive-02",
    ]
    assert ids[4].startswith("joint2")


def test_constant_torques_take_turns_and_end_after_their_travel():
    own = robot()
    plan = PulsePlan(rest_s=0.1, max_travel_rad=0.2, coast_s=0.1, repetitions=2)
    torques = {"joint1": (-2.0, -1.0, 1.0, 2.0)}
    episodes = list(run_constant_torque(own, own, torques, limits=LIMITS, plan=plan, settings=FAST))
    assert [episode.id.removeprefix("joint1_torque") for episode in episodes] == [
        *("1.0", "-1.0", "2.0", "-2.0"),
        *("1.0_02", "-1.0_02", "2.0_02", "-2.0_02"),
    ]
    for episode in episodes:
        position = episode.measured["position"][:, 0]
        pushed = episode.commanded()["torque"][:, 0] != 0
        assert abs(position[pushed][-1] - position[0]) < 0.2 + 0.05
        assert abs(position[~pushed & (episode.measured.time_s > 0.2)][0] - position[0]) >= 0.2 - 1e-3


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        (Limits({"joint1": 2.0}, position_rad={"joint1": (-0.1, 0.1)}), "rad, allowed"),
        (Limits({"joint1": 2.0}, velocity_rad_s={"joint1": 0.5}), "rad/s, allowed"),
    ],
)
@pytest.mark.parametrize("velocity_noise", [0.0, 1e-3])  # without a velocity signal the position is differentiated
def test_a_limit_stops_the_episode_and_says_so(limits, said, velocity_noise):
    own = SlidingRobot({"joint1": Friction()}, velocity_noise=velocity_noise)
    episodes = list(run_coast(own, own, {"joint1": (2.0, -2.0)}, limits=limits))
    assert len(episodes) == 2
    assert kinds(episodes[0])[0] == "safety_stop"
    assert said in episodes[0].meta.flags[0].detail
    assert episodes[0].meta.warned
    assert len(episodes[0].measured) < 1000
    np.testing.assert_array_equal(episodes[0].commanded()["torque"][-1], 0.0)
    np.testing.assert_array_equal(own.written[-1], 0.0)


def test_torques_beyond_the_limit_are_refused_before_anything_is_written():
    own = robot()
    with pytest.raises(ConfigError, match="beyond the limit"):
        run_coast(own, own, {"joint1": (1.0, -2.5)}, limits=LIMITS)
    with pytest.raises(ConfigError, match="no torque limit"):
        run_breakaway(own, own, limits=Limits({"joint1": 1.0}))
    with pytest.raises(NameMismatch, match=r"joint7.*robot has \[joint1, joint2\]"):
        run_coast(own, own, {"joint7": (1.0,)}, limits=LIMITS)
    with pytest.raises(ConfigError, match="too short"):
        run_breakaway(own, own, limits=LIMITS, plan=RampPlan(rest_s=0.01))
    with pytest.raises(ConfigError, match="no ramp_nm_per_s for joint 'joint2'"):
        run_breakaway(own, own, limits=LIMITS, plan=RampPlan(ramp_nm_per_s={"joint1": 0.2}))
    assert own.written == []


def test_a_ramp_never_exceeds_the_torque_limit():
    own = robot()
    limits = Limits({"joint1": 0.2, "joint2": 0.2})
    plan = RampPlan(ramp_nm_per_s=0.5, repetitions=1, rest_s=0.2)
    list(run_breakaway(own, own, limits=limits, joints=["joint1"], plan=plan, settings=FAST))
    assert 0.19 < np.abs(own.written).max() <= 0.2


def test_a_robot_that_fails_in_the_middle_loses_only_that_episode():
    own = robot(fail_at_s=2.5, heal_at_s=4.0)
    torques = {"joint1": (1.0, -1.0, 1.5, -1.5)}
    episodes = list(run_coast(own, own, torques, limits=LIMITS, settings=FAST))
    assert len(episodes) == 4
    failed = [episode for episode in episodes if "robot_failed" in kinds(episode)]
    assert failed
    assert "no answer from the bus" in failed[0].meta.flags[0].detail
    assert "not_released" in kinds(failed[0])  # zero torque could not be sent either, and that is said
    assert 10 < len(failed[0].measured) < 400
    assert np.isfinite(failed[0].measured["position"]).all()


def test_a_robot_that_is_dead_from_the_start_gives_empty_episodes():
    own = robot(fail_at_s=0.0)
    plan = RampPlan(repetitions=1, rest_s=0.2)
    episodes = list(run_breakaway(own, own, limits=LIMITS, plan=plan, settings=FAST))
    assert [len(episode.measured) for episode in episodes] == [1] * 4
    assert all("robot_failed" in kinds(episode) for episode in episodes)
    with pytest.raises(Exception, match="no answer from the bus"):
        estimate_breakaway(episodes)


def test_silence_is_a_failure_and_not_a_joint_without_motion():
    own = robot(silent_from_s=0.5)
    plan = RampPlan(repetitions=1, rest_s=0.2)
    episode = next(iter(run_breakaway(own, own, limits=LIMITS, plan=plan, settings=FAST)))
    assert kinds(episode)[0] == "robot_failed"
    assert "silent" in episode.meta.flags[0].detail
    assert np.abs(own.written).max() < 0.3


@pytest.mark.parametrize("first", ["read", "write"])
@pytest.mark.parametrize("ramp", [False, True])
def test_a_robot_that_misses_its_first_call_is_never_told_a_torque_that_is_no_number(first, ramp):
    class Late(SlidingRobot):
        calls = 0

        def once(self, name):
            self.calls += name == first
            if name == first and self.calls == 1:
                raise OSError("not ready")

        def read(self):
            self.once("read")
            return super().read()

        def write(self, command):
            self.once("write")
            super().write(command)

    own = Late({"joint1": Friction(), "joint2": Friction()}, dt=0.005)
    hold = PoseHold({"joint1": 60.0, "joint2": 60.0}, {"joint1": 6.0, "joint2": 6.0})
    settings = RunSettings(rate_hz=200.0, hold=hold)
    if ramp:
        plan = RampPlan(ramp_nm_per_s=2.0, repetitions=1, rest_s=0.2)
        episodes = list(run_breakaway(own, own, limits=LIMITS, joints=["joint1"], plan=plan, settings=settings))
    else:
        episodes = list(run_coast(own, own, {"joint1": (1.0, -1.0)}, limits=LIMITS, settings=settings))
    assert np.isfinite(own.written).all()
    assert kinds(episodes[0]) == ["robot_failed", "not_returned"]
    assert not kinds(episodes[1])
    assert np.ptp(episodes[1].measured["position"][:, 0]) > 1e-3, "the robot has recovered"


def test_a_torque_that_is_no_number_stops_the_episode_with_zero_torque():
    own = robot()
    hold = PoseHold({"joint2": np.nan}, {})
    settings = RunSettings(rate_hz=200.0, hold=hold)
    episode = next(iter(run_coast(own, own, {"joint1": (1.0,)}, limits=LIMITS, settings=settings)))
    assert kinds(episode)[0] == "robot_failed"
    assert "joint2" in episode.meta.flags[0].detail
    assert np.isfinite(own.written).all()
    np.testing.assert_array_equal(own.written[-1], 0.0)


def test_values_that_are_not_finite_are_a_failure():
    class Broken(SlidingRobot):
        def read(self):
            reading = super().read()
            return {**reading, "position": reading["position"] * (np.nan if self.time_s > 0.3 else 1.0)}

    own = Broken({"joint1": Friction()}, dt=0.005)
    episode = next(iter(run_coast(own, own, {"joint1": (1.0,)}, limits=LIMITS_ONE, settings=FAST)))
    assert kinds(episode)[0] == "robot_failed"
    assert np.isfinite(episode.measured["position"]).all()
    assert episode.measured.time_s[-1] == pytest.approx(0.3, abs=0.01)


def test_a_robot_without_positions_is_refused():
    class Blind(SlidingRobot):
        def read(self):
            return {"torque": self.tau}

    own = Blind({"joint1": Friction()})
    with pytest.raises(MissingSignal, match="position"):
        next(iter(run_coast(own, own, {"joint1": (1.0,)}, limits=LIMITS_ONE)))
    np.testing.assert_array_equal(own.written[-1], 0.0)


def test_an_interrupt_leaves_zero_torque_behind():
    class Interrupted(SlidingRobot):
        def read(self):
            if self.time_s > 0.5:
                raise KeyboardInterrupt
            return super().read()

    own = Interrupted({"joint1": Friction()}, dt=0.005)
    with pytest.raises(KeyboardInterrupt):
        next(iter(run_coast(own, own, {"joint1": (1.0,)}, limits=LIMITS_ONE, settings=FAST)))
    np.testing.assert_array_equal(own.written[-2:], [[1.0], [0.0]])


def test_other_joints_are_held_and_the_excited_one_comes_back():
    frictions = {"joint1": Friction(), "joint2": Friction(offset=0.9)}  # joint2 would fall
    hold = PoseHold({"joint1": 60.0, "joint2": 60.0}, {"joint1": 6.0, "joint2": 6.0})
    own = SlidingRobot(frictions, dt=0.005, velocity_noise=1e-3)
    settings = RunSettings(rate_hz=200.0, hold=hold)
    limits = Limits({"joint1": 3.0, "joint2": 3.0})
    episodes = list(run_coast(own, own, {"joint1": (1.0, 1.5)}, limits=limits, settings=settings))
    for episode in episodes:
        assert np.ptp(episode.measured["position"][:, 1]) < 0.05
        assert np.ptp(episode.measured["position"][:, 0]) > 0.3
        assert abs(episode.measured["position"][0, 0]) < 0.02
        assert not kinds(episode)


def test_a_joint_that_does_not_come_back_is_noted():
    hold = PoseHold({"joint1": 1.0}, {}, tolerance_rad=0.01, timeout_s=0.5)  # too weak for its friction
    own = robot()
    settings = RunSettings(rate_hz=200.0, hold=hold)
    episode = next(iter(run_coast(own, own, {"joint1": (1.0,)}, limits=LIMITS, settings=settings)))
    assert kinds(episode) == ["not_returned"]
    assert not episode.meta.warned


def test_a_loop_that_is_too_slow_says_so_and_does_not_drift():
    own = robot(dt=0.005)
    episode = next(iter(run_coast(own, own, {"joint1": (1.0,)}, limits=LIMITS, settings=RunSettings(rate_hz=1000.0))))
    assert kinds(episode) == ["late_ticks"]
    np.testing.assert_allclose(np.diff(episode.measured.time_s), 0.005)
    assert episode.measured.duration_s == pytest.approx(2.0, abs=0.01)


def test_a_clock_that_stands_still_is_a_failure():
    class Stuck(SlidingRobot):
        def now_s(self):
            return min(self.time_s, 0.1)

    own = Stuck({"joint1": Friction()}, dt=0.005)
    episode = next(iter(run_coast(own, own, {"joint1": (1.0,)}, limits=LIMITS_ONE, settings=FAST)))
    assert kinds(episode)[0] == "robot_failed"
    assert "clock stands still" in episode.meta.flags[0].detail


def test_the_wall_clock_waits():
    clock = WallClock()
    assert isinstance(clock, Clock)
    begin = time.monotonic()
    clock.wait_until_s(clock.now_s() + 0.02)
    assert time.monotonic() - begin >= 0.019
    before = clock.now_s()
    clock.wait_until_s(-1.0)
    assert clock.now_s() >= before


def test_the_robot_of_these_tests_is_one():
    assert isinstance(robot(), RobotIO)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Limits({"joint1": 0.0}),
        lambda: Limits({"joint1": 1.0}, velocity_rad_s={"joint1": -1.0}),
        lambda: Limits({"joint1": 1.0}, position_rad={"joint1": (1.0, 1.0)}),
        lambda: RunSettings(rate_hz=0.0),
        lambda: RampPlan(repetitions=0),
        lambda: PulsePlan(excite_s=0.0),
        lambda: PulsePlan(max_travel_rad=-0.1),
    ],
)
def test_plans_without_sense_are_refused(make):
    with pytest.raises(ConfigError):
        make()
