from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.arms import episode, series, two_links
from trueup.core.timeseries import TimeSeries
from trueup.core.windows import window_starts
from trueup.errors import ConfigError, DataError
from trueup.robots import ControllerSpec
from trueup.sim import ReplayPlan, ReplaySettings, replay, replay_episode
from trueup.sim.replay_plan import held_commands

SERVO = ControllerSpec(kind="position", kp=40.0, kv=2.0)


def logged_motion(simulator, *, delay_s=0.0, seed=0):
    """A log that the simulator itself made: stamps on its grid every 10 ms."""
    time_s = np.arange(0, 3.0, 0.01)
    rng = np.random.default_rng(seed)
    target = 0.4 * np.sin(2 * np.pi * rng.uniform(0.3, 1.0, 2) * time_s[:, None])
    command = series(time_s, position=target)
    start = series(time_s, position=np.zeros((time_s.size, 2)))
    return episode(replay_episode(episode(start, command), simulator, ReplaySettings(delay_s=delay_s)), command)


def test_replaying_a_log_of_the_simulator_gives_the_log(tmp_path):
    simulator = two_links(tmp_path, SERVO)
    log = logged_motion(simulator)
    again = replay_episode(log, simulator, ReplaySettings())
    for signal in ("position", "velocity", "torque"):
        np.testing.assert_allclose(again[signal], log.measured[signal], atol=1e-9)


def test_windows_of_a_log_of_the_simulator_give_the_log_too(tmp_path):
    simulator = two_links(tmp_path, SERVO)
    log = logged_motion(simulator)
    again = replay_episode(log, simulator, ReplaySettings(window_s=0.25))  # from the measured state, velocity included
    np.testing.assert_allclose(again["position"], log.measured["position"], atol=1e-7)
    np.testing.assert_allclose(again["velocity"], log.measured["velocity"], atol=1e-7)
    np.testing.assert_allclose(again["torque"], log.measured["torque"], atol=1e-5)  # of the last stamp, too
    at_rest = replay_episode(log, simulator, ReplaySettings(window_s=0.25, initial_velocity="zero"))
    assert np.abs(at_rest["position"] - log.measured["position"]).max() > 1e-3


def test_every_window_starts_in_the_measured_state(tmp_path):
    simulator = two_links(tmp_path, SERVO)
    log = logged_motion(simulator)
    noisy = log.measured["position"] + 0.05 * np.random.default_rng(1).normal(size=log.measured["position"].shape)
    other = episode(series(log.measured.time_s, position=noisy), log.commanded())
    result = replay_episode(other, simulator, ReplaySettings(window_s=0.5))
    starts = window_starts(result.time_s, 0.5)
    assert len(starts) == 6
    np.testing.assert_allclose(result["position"][starts], noisy[starts])
    assert np.abs(result["position"] - noisy)[starts[1] - 1].max() > 1e-3


def test_a_log_in_single_precision_is_worked_with_in_double(tmp_path):
    simulator = two_links(tmp_path, SERVO)
    log = logged_motion(simulator)
    single = {name: np.float32(values) for name, values in log.measured.signals.items()}
    plan = ReplayPlan(
        episode(replace(log.measured, signals=single), log.commanded()), simulator, ReplaySettings(window_s=0.25)
    )
    assert {values.dtype for values in plan.measured.signals.values()} == {np.dtype(np.float64)}
    assert plan.request(np.zeros(2)).position.dtype == np.float64
    np.testing.assert_allclose(plan.measured["position"], log.measured["position"], atol=1e-6)


def sagging_log(simulator, seconds=0.5):
    """Held in a pose by a soft servo that its weight pulls down; the log says that the robot rested in that pose."""
    time_s = np.arange(0, seconds, 0.01)
    held = series(time_s, position=np.tile([0.8, -0.3], (time_s.size, 1)))
    return episode(held, held)


def test_a_settled_replay_begins_where_the_controller_carries_the_weight(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="position", kp=200.0, kv=20.0))
    log = sagging_log(simulator)
    sagging, settled = (replay_episode(log, simulator, ReplaySettings(settle_s=settle)) for settle in (0.0, 3.0))
    assert np.ptp(sagging["position"], axis=0).max() > 1e-3
    assert np.ptp(settled["position"], axis=0).max() < 1e-6
    # The longer one of two replays that do not settle ends in the same pose.
    longer = replay_episode(sagging_log(simulator, 3.5), simulator, ReplaySettings())
    np.testing.assert_allclose(settled["position"][-1], longer["position"][349], atol=1e-9)
    assert len(settled) == len(log.measured)


def test_windows_do_not_settle(tmp_path):
    simulator = two_links(tmp_path, SERVO)
    log = logged_motion(simulator)
    plain, other = (replay_episode(log, simulator, ReplaySettings(window_s=0.5, settle_s=s)) for s in (0.0, 1.0))
    np.testing.assert_array_equal(plain["position"], other["position"])


@pytest.mark.long
@given(delay=st.integers(0, 60))
def test_a_delay_is_the_command_shifted(tmp_path_factory, delay):
    simulator = two_links(tmp_path_factory.mktemp("model"), SERVO)
    log = logged_motion(simulator)
    shifted = episode(
        log.measured,
        TimeSeries(
            log.commanded().time_s + delay * 1e-3, log.measured.joints, log.commanded().signals, log.commanded().units
        ),
    )
    delayed = replay_episode(log, simulator, ReplaySettings(delay_s=delay * 1e-3))
    late = replay_episode(
        episode(
            log.measured,
            series(
                np.r_[0.0, shifted.commanded().time_s + 1e-12],
                position=np.vstack([log.commanded()["position"][:1], log.commanded()["position"]]),
            ),
        ),
        simulator,
        ReplaySettings(),
    )
    np.testing.assert_allclose(delayed["position"], late["position"], atol=1e-9)


def test_the_latest_command_acts_and_never_a_later_one():
    stamps, values = np.array([0.0, 0.1, 0.2]), np.array([0.0, 1.0, 2.0])
    grid = np.array([[-1.0, 0.0, 0.09, 0.1, 0.15, 0.2, 9.0]])
    held = held_commands(stamps, values, grid, step_s=0.01, delay_s=0.0)
    np.testing.assert_array_equal(held[0], [0, 0, 0, 1, 1, 2, 2])
    late = held_commands(stamps, values, grid, step_s=0.01, delay_s=0.06)
    np.testing.assert_array_equal(late[0], [0, 0, 0, 0, 0, 1, 2])


def test_a_delay_of_half_a_step_lies_between_two_steps():
    stamps, values = np.array([0.0, 0.1]), np.array([0.0, 1.0])
    grid = np.arange(20)[None] * 0.01
    steps = [held_commands(stamps, values, grid, step_s=0.01, delay_s=delay) for delay in (0.02, 0.025, 0.03)]
    np.testing.assert_allclose(steps[1], (steps[0] + steps[2]) / 2)
    assert steps[1][0, 12] == pytest.approx(0.5)


def test_only_stamps_with_a_command_are_replayed(tmp_path):
    simulator = two_links(tmp_path, SERVO)
    log = logged_motion(simulator)
    late = log.commanded().rows(slice(100, None))
    result = replay_episode(episode(log.measured, late), simulator, ReplaySettings())
    assert result.time_s[0] == pytest.approx(1.0)
    assert result.time_s[-1] == log.measured.time_s[-1]


def test_jittering_stamps_are_read_between_the_steps(tmp_path):
    simulator = two_links(tmp_path, SERVO)
    log = logged_motion(simulator)
    fine = replay_episode(
        episode(series(np.arange(0, 2.9, 1e-3), position=np.zeros((2900, 2))), log.commanded()),
        simulator,
        ReplaySettings(),
    )
    stamps = np.sort(np.random.default_rng(0).uniform(0.0, 2.8, 200))
    stamps[0] = 0.0
    rough = replay_episode(
        episode(series(stamps, position=np.zeros((200, 2))), log.commanded()), simulator, ReplaySettings()
    )
    for joint in range(2):
        expected = np.interp(stamps, fine.time_s, fine["position"][:, joint])
        np.testing.assert_allclose(rough["position"][:, joint], expected, atol=1e-9)


def test_one_bad_episode_does_not_stop_the_others(tmp_path):
    simulator = two_links(tmp_path, SERVO)
    good = logged_motion(simulator)
    broken = good.measured["position"].copy()
    broken[0, 0] = np.nan
    bad = episode(series(good.measured.time_s, position=broken), good.commanded(), "bad")
    results = dict(
        replay(
            [good, bad, episode(good.measured, good.commanded(), "after")], simulator.clone, ReplaySettings(), jobs=2
        )
    )
    assert list(results) == ["motion", "bad", "after"]
    assert isinstance(results["bad"], DataError)
    assert "not finite" in str(results["bad"])
    np.testing.assert_array_equal(results["motion"]["position"], results["after"]["position"])


def test_clocks_that_do_not_overlap_are_refused(tmp_path):
    simulator = two_links(tmp_path, SERVO)
    log = logged_motion(simulator)
    late = series(log.commanded().time_s + 100.0, position=log.commanded()["position"])
    with pytest.raises(DataError, match="before the first command"):
        replay_episode(episode(log.measured, late), simulator, ReplaySettings())


@pytest.mark.parametrize(
    "wrong", [{"window_s": 0.0}, {"window_s": -1.0}, {"window_s": np.nan}, {"delay_s": np.nan}, {"delay_s": np.inf}]
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        ReplaySettings(**wrong)
