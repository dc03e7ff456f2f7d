"""Cutting the rest before and after a motion."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from align.align_cases import make_episode, make_series
from trueup.align import cut_rest, moving_span
from trueup.errors import DataError


def there_and_back(start, end, seconds=10.0, rate=100.0, back=1.0):
    time_s = np.arange(0.0, seconds, 1.0 / rate)
    share = np.clip((time_s - start) / (end - start), 0.0, 1.0)
    return time_s, np.where(share < 0.5, share, back * (1 - share) + (1 - back) * share)


@given(st.floats(1.0, 4.0), st.floats(5.0, 9.0), st.floats(0.0, 0.4), st.sampled_from([0.0, 1.0]))
def test_ends_are_cut_and_the_motion_is_whole(start, end, lag, back):
    time_s, asked = there_and_back(start, end, back=back)
    _, done = there_and_back(start + lag, end + lag, back=back)
    run = make_series(time_s, position=done)
    episode = make_episode(make_series(time_s, position=done), make_series(time_s, position=asked))
    cut = cut_rest(replace(episode, simulated={"one": run}), margin_s=0.2)
    assert cut.command is not None
    for series in (cut.measured, cut.command, cut.simulated["one"]):
        assert start - 0.25 < series.time_s[0] <= start + 0.01 - 0.2 + 0.1
        assert end + lag + 0.05 <= series.time_s[-1] + 0.1
        assert series.time_s[-1] <= end + lag + 0.25
        assert np.all(np.diff(series.time_s) > 0.0)
    # Nothing that moved is gone.
    assert np.ptp(cut.measured["position"]) == np.ptp(done)
    assert np.ptp(cut.command["position"]) == np.ptp(asked)


def test_cutting_twice_is_cutting_once():
    time_s, move = there_and_back(2.0, 6.0)
    episode = make_episode(make_series(time_s, position=move), make_series(time_s, position=move))
    once = cut_rest(episode, margin_s=0.3)
    twice = cut_rest(once, margin_s=0.3)
    assert np.array_equal(once.measured.time_s, twice.measured.time_s)


def test_command_in_force_is_kept():
    sent = np.array([0.0, 5.0, 6.0])
    time_s = np.arange(0.0, 10.0, 0.01)
    done = np.where(time_s < 5.1, 0.0, 1.0)
    cut = cut_rest(
        make_episode(make_series(time_s, position=done), make_series(sent, position=[0.0, 1.0, 1.0])), margin_s=0.5
    )
    assert cut.command is not None
    assert cut.command.time_s.tolist() == [0.0, 5.0]
    assert cut.measured.time_s[0] == pytest.approx(4.5)


def test_noise_is_rest_and_nothing_moving_is_left_alone():
    rng = np.random.default_rng(0)
    time_s, move = there_and_back(3.0, 7.0)
    noisy = make_series(time_s, position=move + 0.003 * rng.normal(size=move.size))
    span = moving_span(noisy)
    assert span is not None
    assert 2.9 < span[0] < 3.3
    assert 6.7 < span[1] < 7.1
    rest = make_episode(make_series(time_s, position=0.003 * rng.normal(size=move.size)))
    assert cut_rest(rest) is rest
    with pytest.raises(DataError):
        cut_rest(rest, margin_s=-1.0)


def test_motion_without_rest_is_not_cut():
    time_s = np.arange(0.0, 10.0, 0.01)
    series = make_series(time_s, position=np.sin(time_s))
    cut = cut_rest(make_episode(series), margin_s=0.02)
    assert len(cut.measured) >= len(series) - 2


def test_torque_commands_decide_without_positions():
    time_s = np.arange(0.0, 10.0, 0.01)
    torque = np.where((time_s > 4.0) & (time_s < 6.0), 1.0, 0.0)
    span = moving_span(make_series(time_s, torque=torque))
    assert span == pytest.approx((4.01, 5.99), abs=0.011)


def test_leading_nan_does_not_move():
    time_s, move = there_and_back(3.0, 7.0)
    move[:5] = np.nan
    move[500] = np.nan
    span = moving_span(make_series(time_s, position=move))
    assert span is not None
    assert span[0] == pytest.approx(3.02, abs=0.05)
