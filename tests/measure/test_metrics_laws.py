"""Laws that hold for any data."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from trueup.measure import (
    METRICS,
    Samples,
    ccc,
    cosine,
    gap_iqr,
    gap_range,
    large_gap_ratio,
    mae,
    mape,
    max_error,
    mse,
    nrmse,
    pearson,
    r2,
    rmse,
    rotation_distance,
    smoothness,
    trajectory_consistency,
)

NUMBERS = st.floats(-100.0, 100.0, width=32).map(lambda x: round(x, 3))
SHAPES = st.tuples(st.integers(1, 30), st.integers(1, 4))
JOINT_METRICS = [entry for entry in METRICS.values() if entry.kind == "joint"]


@st.composite
def pairs(draw):
    shape = draw(SHAPES)
    first, second = (draw(hnp.arrays(np.float64, shape, elements=NUMBERS)) for _ in range(2))
    return first, second


def clock(rows):
    return np.cumsum(np.random.default_rng(rows).uniform(0.01, 0.03, rows))


def samples(measured, simulated):
    return Samples(
        measured, simulated, clock(len(measured)), np.zeros(1, np.int64), limit=np.full(measured.shape[1], 50.0)
    )


@pytest.mark.long
@given(pairs())
def test_nothing_differs_from_itself(pair):
    x, _ = pair
    for function in (mse, rmse, mae, max_error, gap_iqr, gap_range, large_gap_ratio):
        assert np.all(function(x, x) == 0.0)
    for function in (nrmse, mape):
        found = function(x, x)
        assert np.all((found == 0.0) | np.isnan(found))
    for function in (pearson, cosine, ccc, r2):
        found = function(x, x)
        assert np.all(np.isnan(found) | (np.abs(found - 1.0) < 1e-9))
    for function in (trajectory_consistency, smoothness):
        found = function(x, x, clock(len(x)))
        assert np.all((found == 0.0) | np.isnan(found))


@given(pairs())
def test_symmetric_where_no_side_is_the_reference(pair):
    x, y = pair
    for function in (mse, rmse, mae, max_error, gap_iqr, gap_range, large_gap_ratio, pearson, cosine, ccc):
        np.testing.assert_allclose(function(x, y), function(y, x), rtol=1e-9, atol=1e-12)


@pytest.mark.long
@given(pairs(), st.floats(0.01, 100.0))
def test_scale(pair, factor):
    x, y = pair
    for function in (rmse, mae, max_error, gap_iqr, gap_range):
        np.testing.assert_allclose(function(factor * x, factor * y), factor * function(x, y), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(mse(factor * x, factor * y), factor**2 * mse(x, y), rtol=1e-9, atol=1e-9)
    time_s = clock(len(x))
    for function in (smoothness, trajectory_consistency):
        scaled = function(factor * x, factor * y, time_s)
        np.testing.assert_allclose(scaled, factor * function(x, y, time_s), rtol=1e-9, atol=1e-6)
        slowed = function(x, y, 2.0 * time_s)
        np.testing.assert_allclose(slowed, function(x, y, time_s) / 4.0, rtol=1e-9, atol=1e-6)


@given(pairs(), st.integers(0, 3))
def test_free_of_units(pair, power):
    """Pure numbers do not change with the unit: powers of two scale exactly."""
    x, y = pair
    factor = 2.0**power
    for function in (nrmse, mape, pearson, cosine, ccc, r2):
        np.testing.assert_allclose(function(factor * x, factor * y), function(x, y), rtol=1e-9, atol=1e-12)


@pytest.mark.long
@given(pairs(), st.randoms(use_true_random=False))
def test_joints_do_not_know_each_other(pair, random):
    x, y = pair
    order = random.sample(range(x.shape[1]), x.shape[1])
    for entry in JOINT_METRICS:
        whole = entry.function(samples(x, y))
        np.testing.assert_allclose(
            entry.function(samples(x[:, order], y[:, order])), whole[order], rtol=1e-9, atol=1e-9, err_msg=entry.name
        )


@pytest.mark.long
@given(pairs())
def test_bounds_hold(pair):
    for entry in JOINT_METRICS:
        found = entry.function(samples(*pair))
        low, high = entry.bounds
        assert np.all(np.isnan(found) | ((found >= low) & (found <= high))), entry.name


@given(pairs())
def test_order_of_the_errors(pair):
    x, y = pair
    assert np.all(mae(x, y) <= rmse(x, y) * (1.0 + 1e-12) + 1e-12)
    assert np.all(rmse(x, y) <= max_error(x, y) * (1.0 + 1e-12) + 1e-12)
    concordance, correlation = np.abs(ccc(x, y)), np.abs(pearson(x, y))
    both = np.isfinite(concordance) & np.isfinite(correlation)
    assert np.all(concordance[both] <= correlation[both] + 1e-9)


@given(st.integers(0, 10_000))
def test_geodesic_distance_is_a_metric(seed):
    a, b, c = Rotation.random(3, random_state=np.random.default_rng(seed)).as_matrix()

    def distance(first, second):
        return float(rotation_distance(first, second))

    assert distance(a, a) == pytest.approx(0.0, abs=1e-15)
    assert distance(a, b) == pytest.approx(distance(b, a), abs=1e-14)
    assert distance(a, c) <= distance(a, b) + distance(b, c) + 1e-12
    assert 0.0 <= distance(a, b) <= math.pi
    assert distance(c @ a, c @ b) == pytest.approx(distance(a, b), abs=1e-12)  # whatever the frame
