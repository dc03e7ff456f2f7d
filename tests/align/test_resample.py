"""Laws of resampling, common grids and derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from align.align_cases import make_series
from trueup.align import common_grid, resample
from trueup.core.timeseries import TimeSeries
from trueup.errors import DataError


def uneven(rng, count):
    return np.cumsum(rng.uniform(0.001, 0.1, count))


def with_bodies(rng, count):
    clock = uneven(rng, count)
    turns = Rotation.random(count, rng=rng).as_matrix()[:, None]
    return TimeSeries(
        clock,
        ("a", "b"),
        {
            "position": rng.normal(size=(count, 2)),
            "body.position": rng.normal(size=(count, 1, 3)),
            "body.rotation": turns,
        },
        {"position": ("rad", "rad"), "body.position": ("m",), "body.rotation": ("1",)},
        bodies=("hand",),
    )


@given(st.integers(1, 30), st.integers(0, 99), st.booleans())
def test_identity_on_the_same_grid(count, seed, hold):
    series = with_bodies(np.random.default_rng(seed), count)
    again = resample(series, series.time_s, hold=hold)
    for name in series.signals:
        assert np.array_equal(again[name], series[name])


@given(st.integers(2, 30), st.integers(0, 99))
def test_straight_lines_stay_straight(count, seed):
    rng = np.random.default_rng(seed)
    clock = uneven(rng, count)
    query = np.unique(rng.uniform(clock[0], clock[-1], 50))
    line = resample(make_series(clock, position=3.0 * clock - 2.0), query)
    np.testing.assert_allclose(line["position"][:, 0], 3.0 * query - 2.0, atol=1e-9)
    assert np.array_equal(line.time_s, query)


@given(st.integers(1, 20), st.integers(0, 99))
def test_hold_takes_the_last_value_at_or_before(count, seed):
    rng = np.random.default_rng(seed)
    clock = uneven(rng, count)
    values = rng.normal(size=count)
    query = np.unique(np.concatenate([clock, rng.uniform(clock[0], clock[-1] + 1.0, 30)]))
    held = resample(make_series(clock, position=values), query, hold=True)
    expected = [[v for t, v in zip(clock, values, strict=True) if t <= q][-1] for q in query]
    assert held["position"][:, 0].tolist() == expected


def test_rotations_stay_rotations_on_the_shortest_arc():
    rng = np.random.default_rng(0)
    series = with_bodies(rng, 8)
    query = np.linspace(series.time_s[0], series.time_s[-1], 40)
    turns = resample(series, query)["body.rotation"]
    np.testing.assert_allclose(turns @ np.swapaxes(turns, -1, -2), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)
    quarter = Rotation.from_rotvec([[0, 0, 0.0], [0, 0, 2.0]]).as_matrix()[:, None]
    pair = TimeSeries(np.array([0.0, 1.0]), (), {"body.rotation": quarter}, {"body.rotation": ("1",)}, bodies=("hand",))
    angle = Rotation.from_matrix(resample(pair, np.array([0.25]))["body.rotation"][0, 0]).as_rotvec()
    np.testing.assert_allclose(angle, [0, 0, 0.5], atol=1e-12)


@pytest.mark.parametrize("signal", ["position", "body.rotation"])
def test_nan_reaches_only_its_neighbors(signal):
    series = with_bodies(np.random.default_rng(1), 6)
    series[signal][2] = np.nan
    clock = series.time_s
    query = np.sort(np.concatenate([clock, 0.5 * (clock[1:] + clock[:-1])]))
    bad = ~np.isfinite(resample(series, query)[signal]).reshape(query.size, -1).all(axis=1)
    assert np.flatnonzero(bad).tolist() == [3, 4, 5]


def test_nothing_is_extrapolated():
    series = make_series([0.0, 1.0], position=[0.0, 1.0])
    for query in ([-0.1, 0.5], [0.5, 1.1]):
        with pytest.raises(DataError, match="outside"):
            resample(series, np.array(query))
        clipped = resample(series, np.array(query), clip=True)
        assert clipped.time_s.tolist() == [0.5]
        assert clipped["position"].tolist() == [[0.5]]
    with pytest.raises(DataError):
        resample(series, np.array([2.0, 3.0]), clip=True)
    with pytest.raises(DataError):
        resample(series, np.array([-1.0]), hold=True)
    assert resample(series, np.array([7.0]), hold=True)["position"].tolist() == [[1.0]]


def test_float_type_is_kept():
    series = make_series([0.0, 1.0], position=[0.0, 1.0])
    narrow = TimeSeries(series.time_s, ("a",), {"position": series["position"].astype(np.float32)}, series.units)
    assert resample(narrow, np.array([0.3]))["position"].dtype == np.float32


@given(st.floats(-10, 10), st.floats(0.05, 5), st.floats(0.0, 3.0), st.floats(5.0, 300.0))
def test_common_grid_lies_in_both(start, length, shift, rate_hz):
    one = make_series([start, start + length], position=[0, 0])
    two = make_series([start + shift, start + shift + 1.0], position=[0, 0])
    if shift > length:
        with pytest.raises(DataError):
            common_grid(one, two, rate_hz=rate_hz)
        return
    grid = common_grid(one, two, rate_hz=rate_hz)
    end = min(start + length, start + shift + 1.0)
    assert grid[0] == start + shift
    assert grid[-1] <= end
    assert grid[-1] > end - 1.0 / rate_hz - 1e-9
    np.testing.assert_allclose(np.diff(grid), 1.0 / rate_hz, rtol=1e-3)
    resample(one, grid), resample(two, grid)


def test_common_grid_reaches_an_end_that_is_on_it():
    for start in (0.1, 0.3, 1.7):
        for steps in range(1, 40):
            series = make_series([start, start + steps / 10.0], position=[0, 0])
            grid = common_grid(series, rate_hz=10.0)
            assert grid.size == steps + 1
            resample(series, grid)
    short = make_series([0.0, 0.3 - 5e-8], position=[0, 0])
    resample(short, common_grid(short, rate_hz=10.0))
    with pytest.raises(DataError):
        common_grid(series, rate_hz=0.0)
