"""Phase lag: a shift that was put in comes out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.measure import phase_lag
from trueup.measure.correlation import Correlation, cross_correlation, find_peak
from trueup.measure.metrics.lag import _velocity


def motion(time_s):
    """A motion of two joints that never repeats itself."""
    t = time_s[:, None]
    return np.sin(2.1 * t * np.array([1.0, 1.4])) + 0.4 * np.sin(5.7 * t + 1.0) + 0.2 * np.sin(11.3 * t)


@given(st.floats(-0.3, 0.3))
def test_recovers_the_shift_on_a_jittering_clock(lag):
    rng = np.random.default_rng(1)
    time_s = np.cumsum(rng.uniform(0.018, 0.022, 600))
    found = phase_lag(motion(time_s - lag), motion(time_s), time_s)
    np.testing.assert_allclose(found, lag, atol=5e-4)  # a fortieth of the step


@given(st.floats(-0.2, 0.2))
def test_exchanging_the_two_changes_the_sign(lag):
    time_s = np.arange(500) * 0.02
    there = phase_lag(motion(time_s - lag), motion(time_s), time_s)
    back = phase_lag(motion(time_s), motion(time_s - lag), time_s)
    np.testing.assert_allclose(there, -back, atol=1e-9)


def test_offset_and_scale_do_not_matter():
    time_s = np.arange(500) * 0.02
    measured = 3.0 * motion(time_s - 0.05) - 7.0
    np.testing.assert_allclose(phase_lag(measured, motion(time_s), time_s), 0.05, atol=5e-4)


def test_quantized_and_noisy_encoder():
    rng = np.random.default_rng(0)
    time_s = np.arange(1000) * 0.02
    measured = np.round((0.3 * motion(time_s - 0.07) + rng.normal(0.0, 1e-3, (1000, 2))) / 0.00153) * 0.00153
    np.testing.assert_allclose(phase_lag(measured, 0.3 * motion(time_s), time_s), 0.07, atol=2e-3)


def test_periodic_motion_takes_the_lag_nearest_to_zero():
    time_s = np.arange(1000) * 0.01
    measured, source = (np.sin(2.0 * np.pi * 3.0 * (time_s - lag))[:, None] for lag in (0.04, 0.0))
    np.testing.assert_allclose(phase_lag(measured, source, time_s), 0.04, atol=1e-3)  # not 0.04 - 1/3


def test_lags_within_restarted_windows():
    """Every window is shifted by itself and lies at another offset: a lag across windows would see the jumps."""
    time_s = np.arange(1000) * 0.01
    starts = np.arange(0, 1000, 200)
    window = np.searchsorted(starts, np.arange(1000), side="right")[:, None]
    source = motion(time_s) + 50.0 * window
    measured = motion(time_s - 0.06) - 80.0 * window
    np.testing.assert_allclose(phase_lag(measured, source, time_s, starts=starts), 0.06, atol=2e-3)


def test_a_segment_of_one_sample_changes_nothing():
    time_s = np.arange(601) * 0.01
    measured, source = motion(time_s - 0.06), motion(time_s)
    starts = np.array([0, 600])
    expected = phase_lag(measured[:600], source[:600], time_s[:600])
    np.testing.assert_allclose(phase_lag(measured, source, time_s, starts=starts), expected, atol=1e-12)


def test_missing_samples_are_bridged():
    time_s = np.arange(600) * 0.02
    measured = motion(time_s - 0.05)
    measured[100:140, 0] = np.nan
    measured[300, 1] = np.inf
    np.testing.assert_allclose(phase_lag(measured, motion(time_s), time_s), 0.05, atol=2e-3)


@pytest.mark.parametrize("case", ["rests", "unrelated", "beyond the limit", "all missing", "too short"])
def test_no_lag_is_nan_and_never_a_guess(case):
    rng = np.random.default_rng(0)
    time_s = np.arange(600) * 0.02
    source = motion(time_s)
    measured = {
        "rests": np.full_like(source, 0.1),
        "unrelated": np.cumsum(rng.normal(size=source.shape), axis=0),
        "beyond the limit": motion(time_s - 0.9),
        "all missing": np.full_like(source, np.nan),
        "too short": source,
    }[case]
    rows = slice(2) if case == "too short" else slice(None)
    assert np.all(np.isnan(phase_lag(measured[rows], source[rows], time_s[rows], max_lag_s=0.3)))


def test_a_longer_search_finds_what_lay_beyond():
    time_s = np.arange(600) * 0.02
    found = phase_lag(motion(time_s - 0.9), motion(time_s), time_s, max_lag_s=1.5)
    np.testing.assert_allclose(found, 0.9, atol=1e-3)


def test_correlation_of_segments_against_loops():
    rng = np.random.default_rng(0)
    source, delayed = rng.normal(size=(40, 2)), rng.normal(size=(40, 2))
    starts = np.array([0, 7, 25])
    found = cross_correlation(source, delayed, starts, max_lag=5, min_overlap=0.1)
    a, b = source - source.mean(axis=0), delayed - delayed.mean(axis=0)
    segment = np.searchsorted(starts, np.arange(40), side="right")
    for row, lag in enumerate(found.lags):
        pairs = [(i, i + lag) for i in range(40) if 0 <= i + lag < 40 and segment[i] == segment[i + lag]]
        left, right = (np.array(side) for side in zip(*pairs, strict=True))
        expected = (a[left] * b[right]).sum(axis=0)
        expected /= np.sqrt((a[left] ** 2).sum(axis=0) * (b[right] ** 2).sum(axis=0))
        np.testing.assert_allclose(found.values[row], expected, atol=1e-12)


def curve(*values):
    half = len(values) // 2
    return Correlation(np.arange(-half, half + 1), np.array(values)[:, None])


def test_a_correlation_that_still_rises_at_the_end_has_no_peak():
    assert find_peak(curve(0.1, 0.2, 0.6, 0.5, 0.4, 0.7, 0.9)).lag == pytest.approx(np.nan, nan_ok=True)
    assert find_peak(curve(0.1, 0.2, 0.6, 0.5, 0.4, 0.4, 0.3)).lag[0] == pytest.approx(-1.0, abs=0.5)


def test_of_nearly_equal_peaks_the_one_nearest_to_zero_is_taken():
    assert find_peak(curve(0.1, 0.9003, 0.1, 0.1, 0.9, 0.1, 0.1)).lag[0] == pytest.approx(1.0)
    assert find_peak(curve(0.1, 0.91, 0.1, 0.1, 0.9, 0.1, 0.1)).lag[0] == pytest.approx(-2.0)


def test_a_parabola_through_the_peak_by_hand():
    # 1 - (x - 0.25)^2 at -1, 0, 1: 1 - 1.5625, 1 - 0.0625, 1 - 0.5625
    peak = find_peak(curve(-0.5625, 0.9375, 0.4375))
    assert (peak.lag[0], peak.height[0]) == pytest.approx((0.25, 1.0))


def test_velocities_know_where_the_segments_begin():
    # three segments of 4, 1 and 5 rows with slopes 1, -, 3; the one of a single row has no velocity
    time_s = np.arange(10) * 0.1
    values = np.concatenate([time_s[:4], [50.0], 3.0 * time_s[5:]])[:, None]
    velocity, starts = _velocity(values, time_s, np.array([0, 4, 5]), 0.1)
    np.testing.assert_allclose(velocity[:, 0], [1.0] * 3 + [3.0] * 4)
    assert starts.tolist() == [0, 3]
