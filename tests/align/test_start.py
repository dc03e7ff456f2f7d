"""Start detection against the algorithm written out, and where it beats cross-correlation or loses to it."""

import sys
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from align.align_cases import make_series
from trueup.align import align_starts, detect_motion_start, detect_start, shift_by_cross_correlation
from trueup.errors import DataError, NotIdentifiable


def algorithm_2(x, initial, window, factor, resolution=0.0):
    """LSTM thesis, Algorithm 2, sample by sample; a constant past is left by any difference."""
    for end in range(initial, len(x) - window + 1):
        past = x[:end]
        mean = sum(past) / end
        sigma = (sum((v - mean) ** 2 for v in past) / end) ** 0.5
        if all(abs(v - mean) >= factor * sigma and abs(v - mean) > resolution for v in x[end : end + window]):
            return end
    return None


@given(st.integers(0, 10_000), st.integers(2, 12), st.integers(1, 8), st.floats(0.3, 3.0), st.floats(-1e3, 1e3))
def test_same_as_the_algorithm_written_out(seed, initial, window, factor, level):
    rng = np.random.default_rng(seed)
    rest = rng.integers(0, 60)
    signal = level + np.concatenate([rng.normal(size=rest), rng.normal(size=60) + rng.choice([0.0, 3.0, 30.0])])
    found = detect_start(signal, initial=initial, window=window, factor=factor)
    assert found.row == algorithm_2(signal.tolist(), initial, window, factor)
    assert found.found == (found.row is not None)
    past = signal[: found.row]
    assert found.mean == pytest.approx(past.mean())
    assert found.deviation == pytest.approx(past.std(), rel=1e-6, abs=1e-9)


def test_window_begins_right_after_the_past_and_may_leave_to_both_sides():
    signal = np.array([0.0, 0.1, -0.1, 0.0, 5.0, -5.0, 5.0, 0.0])
    assert detect_start(signal, initial=4, window=3).row == 4
    assert detect_start(signal, initial=4, window=4).row is None


def test_constant_past():
    assert not detect_start(np.full(100, 0.1)).found
    step = np.concatenate([np.full(30, 0.1), np.full(30, 0.1015)])
    assert detect_start(step).row == 30
    assert not detect_start(step, resolution=0.002).found


def test_far_from_zero_nothing_is_lost():
    rng = np.random.default_rng(0)
    signal = np.concatenate([1e-4 * rng.normal(size=50), 1e-2 + 1e-4 * rng.normal(size=50)])
    assert detect_start(signal + 1e6).row == detect_start(signal).row == 50


def test_short_or_bad_input():
    assert not detect_start(np.zeros(5)).found
    assert not detect_start(np.zeros(0)).found
    with pytest.raises(DataError):
        detect_start(np.array([0.0, np.nan]))
    for wrong in ({"initial": 1}, {"window": 0}):
        with pytest.raises(DataError):
            detect_start(np.zeros(50), **wrong)


def calls_and_memory(count):
    signal = np.random.default_rng(0).normal(size=count)
    calls = 0

    def count_call(frame, event, arg):
        nonlocal calls
        calls += event in ("call", "c_call")

    detect_start(signal)
    sys.setprofile(count_call)
    try:
        detect_start(signal)
    finally:
        sys.setprofile(None)
    tracemalloc.start()
    try:
        detect_start(signal)
        return calls, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_work_grows_linearly():
    # As many calls for ten times the samples: no loop over samples. Ten times the memory: every call is O(T).
    (few, small), (many, large) = calls_and_memory(20_000), calls_and_memory(200_000)
    assert many == few
    assert large < 11 * small


def rest_move_rest(start, seconds=6.0, rate=100.0, size=1.0, rise_s=1.0, noise=2e-4, seed=0):
    time_s = np.arange(0.0, seconds, 1.0 / rate)
    share = np.clip((time_s - start) / rise_s, 0.0, 1.0)
    return time_s, size * (share - np.sin(2 * np.pi * share) / (2 * np.pi)) + noise * np.random.default_rng(
        seed
    ).normal(size=time_s.size)


def test_joints_that_move_against_each_other_do_not_cancel():
    time_s, move = rest_move_rest(2.0)
    series = make_series(time_s, ("a", "b"), position=np.stack([move, -move], axis=1))
    row = detect_motion_start(series).row
    assert row is not None
    assert 2.0 <= time_s[row] < 2.25


def test_earliest_joint_decides():
    time_s, late = rest_move_rest(3.0)
    _, early = rest_move_rest(1.5, seed=1)
    series = make_series(time_s, ("a", "b"), position=np.stack([late, early], axis=1))
    row = detect_motion_start(series).row
    assert row is not None
    assert 1.5 <= time_s[row] < 1.75


def test_flickering_encoder_rests():
    rng = np.random.default_rng(3)
    flicker = 0.0015 * (rng.random(400) < 0.01).cumsum().clip(0, 1)
    assert not detect_motion_start(make_series(np.arange(400) * 0.01, position=flicker)).found
    flicker[300:] += 0.0015 * np.arange(100)
    assert 300 <= (detect_motion_start(make_series(np.arange(400) * 0.01, position=flicker)).row or 0) <= 303


def test_nan_is_bridged_but_not_at_the_start():
    time_s, move = rest_move_rest(2.0)
    expected = detect_motion_start(make_series(time_s, position=move)).row
    move[50] = np.nan
    assert detect_motion_start(make_series(time_s, position=move)).row == expected
    move[0] = np.nan
    with pytest.raises(DataError):
        detect_motion_start(make_series(time_s, position=move))


def test_mean_shift_wins_when_the_robot_follows_differently():
    # Both start to move at 2.0 and 1.2 s; the simulated robot is quicker and goes farther, so its whole rise is earlier.
    for seed in range(5):
        time_s, robot = rest_move_rest(2.0, rise_s=1.6, size=0.8, seed=seed)
        _, model = rest_move_rest(1.2, rise_s=0.8, size=1.0, seed=seed + 50)
        by_start = align_starts(make_series(time_s, position=robot), make_series(time_s, position=model))
        by_correlation = shift_by_cross_correlation(robot, model, max_shift=200) / 100.0
        assert abs(by_start - 0.8) < 0.12
        assert abs(by_correlation - 0.8) > 0.3


def test_cross_correlation_wins_without_a_rest_and_in_noise():
    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, 8.0, 0.01)
    for shift in (-30, 12, 45):
        truth = lambda t: np.sin(2 * np.pi * 0.7 * t) + 0.5 * np.sin(2 * np.pi * 1.1 * t)  # noqa: E731
        robot = truth(time_s - shift / 100.0) + 0.3 * rng.normal(size=time_s.size)
        model = truth(time_s) + 0.3 * rng.normal(size=time_s.size)
        assert abs(shift_by_cross_correlation(robot, model, max_shift=60) - shift) <= 3
        try:
            by_start = align_starts(make_series(time_s, position=robot), make_series(time_s, position=model))
        except NotIdentifiable:
            continue
        assert abs(by_start - shift / 100.0) > 0.1


@given(st.integers(-40, 40), st.integers(0, 99))
def test_cross_correlation_finds_an_exact_shift(shift, seed):
    long = np.cumsum(np.random.default_rng(seed).normal(size=400))
    assert shift_by_cross_correlation(long[100:300], long[100 + shift : 300 + shift], max_shift=50) == shift


def test_cross_correlation_refuses_what_has_no_answer():
    with pytest.raises(NotIdentifiable):
        shift_by_cross_correlation(np.zeros(50), np.arange(50.0), max_shift=5)
    with pytest.raises(DataError):
        shift_by_cross_correlation(np.arange(50.0), np.arange(50.0), max_shift=26)


def test_no_start_is_an_error_that_says_which():
    time_s, move = rest_move_rest(2.0)
    still = make_series(time_s, position=np.zeros(time_s.size))
    with pytest.raises(NotIdentifiable, match="simulated"):
        align_starts(make_series(time_s, position=move), still)
    with pytest.raises(NotIdentifiable, match="measured"):
        align_starts(still, make_series(time_s, position=move))
