"""Every formula against an independent computation, and one case worked by hand."""

import math
import statistics

import numpy as np
import pytest
from scipy import signal as scipy_signal
from scipy import stats
from scipy.spatial.transform import Rotation

from trueup.errors import MissingSignal
from trueup.measure import (
    METRICS,
    MetricOptions,
    Samples,
    ccc,
    cosine,
    gap_iqr,
    gap_range,
    large_gap_ratio,
    mae,
    mape,
    max_error,
    metric,
    metric_unit,
    mse,
    nrmse,
    pearson,
    position_distance,
    r2,
    rmse,
    robustness,
    rotation_distance,
    saturation_incidence,
    smoothness,
    trajectory_consistency,
)
from trueup.measure.derivatives import gradient

JOINTS = 3
PLAIN = (mse, rmse, nrmse, mae, max_error, mape, pearson, cosine, ccc, r2, large_gap_ratio, gap_iqr, gap_range)


@pytest.fixture
def pair():
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.uniform(0.015, 0.025, 157))
    measured = 0.7 + np.sin(time_s[:, None] * np.array([1.0, 2.0, 5.0]))
    simulated = 1.1 * measured - 0.2 + rng.normal(0.0, 0.3, measured.shape)
    return time_s, measured, simulated


def loops(name, m, s):
    """The same formulas on lists, written in another way."""
    n = len(m)
    gaps = [abs(a - b) for a, b in zip(m, s, strict=True)]
    if name == "mse":
        return sum(g * g for g in gaps) / n
    if name == "rmse":
        return math.dist(m, s) / math.sqrt(n)
    if name == "nrmse":
        return math.dist(m, s) / math.sqrt(n) / (max(m) - min(m))
    if name == "mae":
        return statistics.fmean(gaps)
    if name == "max_error":
        return max(gaps)
    if name == "mape":
        floor = 0.05 * max(abs(a) for a in m)
        return statistics.fmean([100.0 * g / abs(a) for g, a in zip(gaps, m, strict=True) if abs(a) >= floor])
    if name == "pearson":
        return stats.pearsonr(m, s).statistic
    if name == "cosine":
        return sum(a * b for a, b in zip(m, s, strict=True)) / (math.hypot(*m) * math.hypot(*s))
    if name == "ccc":
        covariance = statistics.fmean([a * b for a, b in zip(m, s, strict=True)]) - statistics.fmean(
            m
        ) * statistics.fmean(s)
        shift = statistics.fmean(m) - statistics.fmean(s)
        return 2.0 * covariance / (statistics.pvariance(m) + statistics.pvariance(s) + shift**2)
    if name == "r2":
        return 1.0 - sum(g * g for g in gaps) / (n * statistics.pvariance(m))
    if name == "large_gap_ratio":
        return len([g for g in gaps if g >= 0.5]) / n
    if name == "gap_iqr":
        return stats.iqr(gaps)
    if name == "gap_range":
        return max(gaps) - min(gaps)
    raise AssertionError(name)


@pytest.mark.parametrize("function", PLAIN, ids=lambda f: f.__name__)
def test_against_loops(pair, function):
    _, measured, simulated = pair
    expected = [loops(function.__name__, list(measured[:, j]), list(simulated[:, j])) for j in range(JOINTS)]
    np.testing.assert_allclose(function(measured, simulated), expected, rtol=1e-11)


@pytest.mark.parametrize("function", PLAIN, ids=lambda f: f.__name__)
def test_samples_that_are_not_finite_are_left_out_pairwise(pair, function):
    _, measured, simulated = (item.copy() for item in pair)
    measured[3, 0] = np.nan
    measured[40, 2] = np.inf
    simulated[7, 0] = -np.inf
    simulated[40, 2] = np.inf
    measured[:, 1] = np.nan
    found = function(measured, simulated)
    for j in (0, 2):
        kept = np.isfinite(measured[:, j]) & np.isfinite(simulated[:, j])
        expected = loops(function.__name__, list(measured[kept, j]), list(simulated[kept, j]))
        assert found[j] == pytest.approx(expected, rel=1e-11)
    assert np.isnan(found[1])


def test_worked_by_hand():
    # measured  = (1, 2, 4, 1), simulated = (1, 3, 2, 2); residual = (0, -1, 2, -1), |residual| = (0, 1, 2, 1)
    m = np.array([[1.0], [2.0], [4.0], [1.0]])
    s = np.array([[1.0], [3.0], [2.0], [2.0]])
    # squares 0 + 1 + 4 + 1 = 6, over 4 samples 1.5; the range of measured is 4 - 1 = 3
    assert mse(m, s)[0] == pytest.approx(1.5)
    assert rmse(m, s)[0] == pytest.approx(math.sqrt(1.5))
    assert nrmse(m, s)[0] == pytest.approx(math.sqrt(1.5) / 3.0)
    assert mae(m, s)[0] == pytest.approx(1.0)  # (0 + 1 + 2 + 1) / 4
    assert max_error(m, s)[0] == 2.0
    assert mape(m, s)[0] == pytest.approx(50.0)  # (0/1 + 1/2 + 2/4 + 1/1) / 4 = 2 / 4
    # Means 2 and 2; deviations (-1, 0, 2, -1) and (-1, 1, 0, 0); covariance (1 + 0 + 0 + 0) / 4 = 1/4;
    # variances (1 + 0 + 4 + 1) / 4 = 3/2 and (1 + 1) / 4 = 1/2
    assert pearson(m, s)[0] == pytest.approx(0.25 / math.sqrt(1.5 * 0.5))
    assert ccc(m, s)[0] == pytest.approx(2 * 0.25 / (1.5 + 0.5 + 0.0))
    assert r2(m, s)[0] == pytest.approx(1.0 - 1.5 / 1.5)
    # dot product 1 + 6 + 8 + 2 = 17; squared norms 1 + 4 + 16 + 1 = 22 and 1 + 9 + 4 + 4 = 18
    assert cosine(m, s)[0] == pytest.approx(17.0 / math.sqrt(22.0 * 18.0))
    # eq. 12 uses >=: three of four gaps are at least 1, one is at least 2
    assert large_gap_ratio(m, s, tau=1.0)[0] == 0.75
    assert large_gap_ratio(m, s, tau=2.0)[0] == 0.25
    # sorted gaps 0 1 1 2: quartiles at positions 0.75 and 2.25: 0.75 and 1.25
    assert gap_iqr(m, s)[0] == pytest.approx(0.5)
    assert gap_range(m, s)[0] == 2.0
    assert saturation_incidence(m, np.array([2.0]))[0] == 0.5  # 2 and 4, again with >=
    assert saturation_incidence(-m, np.array([2.0]))[0] == 0.5
    # step 0.5 s. Residual r = (0, -1, 2, -1): second differences at the two inner samples
    # (0 + 2 + 2) / 0.25 = 16 and (-1 - 4 - 1) / 0.25 = -24, mean of the sizes 20
    t = np.array([0.0, 0.5, 1.0, 1.5])
    assert smoothness(m, s, t)[0] == pytest.approx(20.0)
    # gradient: one-sided -1/0.5 = -2, central (2 - 0)/1 = 2 and (-1 + 1)/1 = 0, one-sided -3/0.5 = -6
    # its gradient: (2 + 2)/0.5 = 8, (0 + 2)/1 = 2, (-6 - 2)/1 = -8, (-6 - 0)/0.5 = -12; mean size 30/4
    assert trajectory_consistency(m, s, t)[0] == pytest.approx(7.5)


def test_trajectory_consistency_is_the_difference_of_two_gradients_each(pair):
    time_s, measured, simulated = pair

    def twice(values):
        return np.gradient(np.gradient(values, time_s), time_s)

    expected = [np.mean(np.abs(twice(measured[:, j]) - twice(simulated[:, j]))) for j in range(JOINTS)]
    np.testing.assert_allclose(trajectory_consistency(measured, simulated, time_s), expected, rtol=1e-9)


def test_smoothness_fits_parabolas(pair):
    """The second derivative of three samples is that of the parabola through them."""
    time_s, measured, simulated = pair
    expected = []
    for j in range(JOINTS):
        bends = []
        for t in range(1, len(time_s) - 1):
            window = slice(t - 1, t + 2)
            clock = time_s[window] - time_s[t]
            bends.append(
                2.0 * (np.polyfit(clock, measured[window, j], 2) - np.polyfit(clock, simulated[window, j], 2))[0]
            )
        expected.append(np.mean(np.abs(bends)))
    np.testing.assert_allclose(smoothness(measured, simulated, time_s), expected, rtol=1e-6)


@pytest.mark.parametrize("function", [trajectory_consistency, smoothness])
def test_derivatives_do_not_cross_a_restart(pair, function):
    time_s, measured, simulated = pair
    starts = np.array([0, 50, 51, 53, 100])  # with segments of 1 and of 2 samples, which have no bend
    lengths = np.diff(np.append(starts, len(time_s)))
    pieces = [slice(a, a + n) for a, n in zip(starts, lengths, strict=True) if n >= 3]
    values = np.array([function(measured[p], simulated[p], time_s[p]) for p in pieces])
    inner = 2 if function is smoothness else 0
    weights = [p.stop - p.start - inner for p in pieces]
    expected = np.average(values, axis=0, weights=weights)
    np.testing.assert_allclose(function(measured, simulated, time_s, starts=starts), expected, rtol=1e-11)
    jumped = simulated + np.searchsorted(starts, np.arange(len(time_s)), side="right")[:, None] * 100.0
    np.testing.assert_allclose(function(measured, jumped, time_s, starts=starts), expected, rtol=1e-6)


def test_gradient_is_numpys_in_each_segment(pair):
    time_s, measured, _ = pair
    starts = np.array([0, 40, 41, 43, 90])
    found = gradient(measured, time_s, starts)
    for start, end in zip(starts, [*starts[1:], len(time_s)], strict=True):
        if end - start == 1:
            assert np.isnan(found[start]).all()
        else:
            np.testing.assert_allclose(
                found[start:end], np.gradient(measured[start:end], time_s[start:end], axis=0), rtol=1e-9
            )


def test_derivatives_leave_out_what_a_missing_sample_touches():
    time_s = np.arange(9) * 0.1
    measured = time_s[:, None] ** 2
    simulated = np.zeros_like(measured)
    measured[4] = np.nan
    assert smoothness(measured, simulated, time_s)[0] == pytest.approx(2.0)  # d2/dt2 of t^2


def test_robustness_reproduces_the_written_equation(pair):
    """Eq. 18 with independent draws has the expected value 2 sigma / sqrt(pi), whatever the data."""
    _, measured, simulated = pair
    many = np.tile(measured, (200, 1)), np.tile(simulated, (200, 1))
    sigmas = (0.01, 0.05)
    expected = np.mean([2.0 * sigma / math.sqrt(math.pi) for sigma in sigmas])
    np.testing.assert_allclose(robustness(*many, sigmas=sigmas, seed=5), expected, rtol=0.02)
    # |N - N'| has standard deviation sqrt(2 - 4 / pi) sigma: a single level tells sigma from sigma^2
    np.testing.assert_allclose(robustness(*many, sigmas=(0.05,), seed=5), 0.1 / math.sqrt(math.pi), rtol=0.02)
    assert np.array_equal(robustness(measured, simulated, seed=1), robustness(measured, simulated, seed=1))
    assert not np.array_equal(robustness(measured, simulated, seed=1), robustness(measured, simulated, seed=2))


def test_rotation_distance_against_scipy():
    rng = np.random.default_rng(0)
    first, second = Rotation.random(500, random_state=rng), Rotation.random(500, random_state=rng)
    found = rotation_distance(first.as_matrix(), second.as_matrix())
    np.testing.assert_allclose(found, (first * second.inv()).magnitude(), atol=1e-12)
    # eq. 4 as printed, where it is well conditioned
    trace = np.einsum("nij,nij->n", first.as_matrix(), second.as_matrix())
    clear = np.abs(trace - 1.0) < 1.9
    np.testing.assert_allclose(found[clear], np.arccos((trace[clear] - 1.0) / 2.0), atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 0.3, math.pi - 1e-6, math.pi - 1e-9, math.pi])
def test_rotation_distance_keeps_its_digits_near_zero_and_pi(angle):
    axis = np.array([1.0, -2.0, 2.0]) / 3.0
    base = Rotation.from_euler("xyz", [0.4, -1.0, 2.0])
    turned = Rotation.from_rotvec(angle * axis) * base
    assert rotation_distance(turned.as_matrix(), base.as_matrix()) == pytest.approx(angle, abs=1e-15, rel=2e-7)


def test_position_distance_is_euclidean():
    measured = np.zeros((2, 1, 3))
    simulated = np.array([[[2.0, -3.0, 6.0]], [[np.nan, 0.0, 0.0]]])
    distance = position_distance(measured, simulated)
    assert distance[0, 0] == 7.0  # sqrt(4 + 9 + 36)
    assert np.isnan(distance[1, 0])


def test_constants_are_undefined_without_a_warning():
    constant = np.full((20, 1), 0.1)  # its mean is not exactly 0.1
    moving = np.linspace(0.0, 1.0, 20)[:, None]
    for function in (pearson, r2, nrmse, ccc):
        assert np.isnan(function(constant, constant))
    assert np.isnan(pearson(moving, constant))
    assert np.isnan(pearson(constant, moving))
    assert ccc(constant, moving)[0] == pytest.approx(0.0, abs=1e-15)  # defined: no concordance at all
    assert np.isnan(cosine(np.zeros((5, 1)), np.ones((5, 1))))
    assert np.isnan(mape(np.zeros((5, 1)), np.ones((5, 1))))


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_very_short_series_give_numbers_or_nan(rows):
    values, time_s, starts = np.zeros((rows, 2)), np.arange(rows) * 0.1, np.zeros(1, dtype=np.int64)
    sample = Samples(values, values + 1.0, time_s, starts, limit=np.ones(2))
    for entry in METRICS.values():
        if entry.kind == "joint":
            assert entry.function(sample).shape == (2,)


def test_mape_leaves_out_samples_near_zero():
    measured = np.array([[10.0], [0.4], [-5.0]])
    simulated = np.array([[11.0], [5.0], [-4.0]])
    # 0.4 lies below 5 % of 10: (1/10 + 1/5) / 2 = 15 %
    assert mape(measured, simulated)[0] == pytest.approx(15.0)
    # with a floor of 1 % it counts: (10 + 1150 + 20) / 3 %
    assert mape(measured, simulated, floor=0.01)[0] == pytest.approx(1180.0 / 3.0)


def test_saturation_without_a_limit_is_undefined():
    torque = np.array([[1.0, 1.0, 3.0], [-3.0, np.nan, np.nan], [3.0, 3.0, 3.0], [2.9, 0.0, 0.0]])
    found = saturation_incidence(torque, np.array([3.0, np.nan, 3.0]))
    assert found[0] == 0.5
    assert np.isnan(found[1])
    assert found[2] == pytest.approx(2.0 / 3.0)  # a missing sample counts on neither side


def test_registry_names_units_and_functions(pair):
    time_s, measured, simulated = pair
    starts = np.zeros(1, dtype=np.int64)
    sample = Samples(measured, simulated, time_s, starts, options=MetricOptions(tau_rad=0.25))
    by_name = {"max": max_error, "iqr": gap_iqr, "range": gap_range}
    for function in (mse, rmse, nrmse, mae, mape, pearson, cosine, ccc, r2):
        by_name[function.__name__] = function
    for name, function in by_name.items():
        assert np.array_equal(metric(name).function(sample), function(measured, simulated)), name
    assert np.array_equal(metric("large_gap_ratio").function(sample), large_gap_ratio(measured, simulated, tau=0.25))
    assert not np.array_equal(metric("large_gap_ratio").function(sample), large_gap_ratio(measured, simulated))
    with pytest.raises(MissingSignal, match=r"'rsme'.*available: rmse, mse"):
        metric("rsme")
    assert all(name == entry.name and entry.description and entry.source for name, entry in METRICS.items())


@pytest.mark.parametrize(
    ("rule", "signal", "expected"),
    [
        ("signal", "rad", "rad"),
        ("signal^2", "rad", "rad^2"),
        ("signal^2", "rad/s", "(rad/s)^2"),
        ("signal^2", "Nm", "(Nm)^2"),
        ("signal^2", "1", "1"),
        ("signal/s^2", "rad", "rad/s^2"),
        ("signal/s^2", "rad/s", "rad/s^3"),
        ("signal/s^2", "rad/s^2", "rad/s^4"),
        ("signal/s^2", "m", "m/s^2"),
        ("s", "rad", "s"),
        ("%", "rad", "%"),
    ],
)
def test_units_of_metrics(rule, signal, expected):
    assert metric_unit(rule, signal) == expected


def test_float32_is_not_summed_in_float32():
    rng = np.random.default_rng(0)
    measured = (1000.0 + rng.normal(0.0, 1e-2, (100_000, 1))).astype(np.float32)
    simulated = np.full_like(measured, 1000.0)
    expected = np.sqrt(np.mean((measured.astype(np.float64) - 1000.0) ** 2))
    assert rmse(measured, simulated)[0] == pytest.approx(expected, rel=1e-12)
    assert pearson(measured, measured)[0] == pytest.approx(1.0, abs=1e-12)


def test_correlation_agrees_with_scipy_correlate():
    from trueup.measure.correlation import cross_correlation

    rng = np.random.default_rng(1)
    source, delayed = rng.normal(size=(83, 2)), rng.normal(size=(83, 2))
    found = cross_correlation(source, delayed, np.zeros(1, dtype=np.int64), max_lag=20)
    for j in range(2):
        a, b = source[:, j] - source[:, j].mean(), delayed[:, j] - delayed[:, j].mean()
        raw = scipy_signal.correlate(b, a, mode="full")[82 - 20 : 82 + 21]
        for row, lag in enumerate(found.lags):
            first = a[max(0, -lag) : len(a) - max(0, lag)]
            second = b[max(0, lag) : len(b) - max(0, -lag)]
            assert found.values[row, j] == pytest.approx(
                raw[row] / (math.hypot(*first) * math.hypot(*second)), abs=1e-12
            )
