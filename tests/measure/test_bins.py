"""What the error depends on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.analysis import Analysis
from trueup.core.episode import EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.errors import ConfigError, NameMismatch
from trueup.measure import (
    AnalysisBuilder,
    Comparison,
    binned_error,
    error_against_horizon,
    lags_of,
    measure_gap,
)
from trueup.measure.analysis import _Thinned


def test_bins_against_a_loop():
    rng = np.random.default_rng(0)
    driver = rng.normal(size=3000)
    residual = rng.normal(size=3000) * (1.0 + np.abs(driver))
    found = binned_error(driver, residual, bins=8)
    edges = np.linspace(*np.quantile(driver, [0.01, 0.99]), 9)
    for k in range(8):
        low, high = (-np.inf if k == 0 else edges[k]), (np.inf if k == 7 else edges[k + 1])
        inside = np.abs(residual[(driver >= low) & (driver < high)])
        assert found.samples[k] == len(inside)
        assert (found.q25[k], found.median[k], found.q75[k]) == pytest.approx(
            tuple(np.percentile(inside, [25, 50, 75]))
        )
        assert found.centers[k] == pytest.approx((edges[k] + edges[k + 1]) / 2.0)
    assert found.median[0] > found.median[4]  # this error grows with the size of the driver


def test_spikes_do_not_widen_the_bins():
    driver = np.append(np.linspace(0.0, 1.0, 1000), 1e6)
    assert binned_error(driver, np.ones(1001)).centers[-1] < 1.1


def test_thin_bins_have_no_median_and_missing_samples_do_not_count():
    driver = np.concatenate([np.zeros(50), np.ones(50), [0.5, 0.5, np.nan, 0.5]])
    residual = np.concatenate([np.full(50, -2.0), np.full(50, 3.0), [9.0, 9.0, 9.0, np.inf]])
    found = binned_error(driver, residual, bins=3)
    assert found.samples.tolist() == [50, 2, 50]
    assert found.median.tolist() == [2.0, pytest.approx(np.nan, nan_ok=True), 3.0]


def test_a_driver_that_rests_has_one_bin_and_none_has_none():
    found = binned_error(np.full(30, 0.7), np.arange(30.0))
    assert (found.centers.tolist(), found.samples.tolist(), found.median.tolist()) == ([0.7], [30], [14.5])
    assert binned_error(np.full(5, np.nan), np.ones(5)).centers.size == 0


def test_error_against_horizon_by_hand():
    # windows start at rows 0 and 3 (0.0 s and 0.3 s); steps of 0.1 s
    time_s = np.array([0.0, 0.1, 0.2, 0.3, 0.41, 0.5])
    residual = np.array([[0.0], [1.0], [2.0], [0.0], [3.0], [np.nan]])
    sums = error_against_horizon(residual, time_s, np.array([0, 3]), step_s=0.1, steps=4)
    assert sums.squares[:, 0].tolist() == [0.0, 1.0 + 9.0, 4.0, 0.0]
    assert sums.samples[:, 0].tolist() == [2, 2, 1, 0]
    assert sums.rmse()[:3, 0] == pytest.approx([0.0, np.sqrt(5.0), 2.0])
    assert np.isnan(sums.rmse()[3, 0])


@given(st.lists(st.integers(0, 40), min_size=1, max_size=20), st.integers(2, 30))
def test_thinning_keeps_every_nth_row_within_the_limit(chunks, limit):
    store = _Thinned(limit)
    rows = np.arange(sum(chunks), dtype=np.float32)[:, None]
    at = 0
    for size in chunks:
        store.add(rows[at : at + size])
        at += size
    kept = store.rows()[:, 0]
    stride = 1 if len(kept) < 2 else int(kept[1] - kept[0])
    assert kept.tolist() == rows[::stride, 0].tolist()
    assert len(kept) <= limit
    assert stride == 1 or 2 * len(kept) >= limit  # and not thinner than necessary


def compared(number, *, joints=("a", "b"), velocity=True, load="torque"):
    rng = np.random.default_rng(number)
    clock = np.arange(400) * 0.01
    position = np.sin(clock[:, None] * np.array([2.0, 3.0]) + number)
    speed = np.gradient(position, clock, axis=0)
    signals = {"position": position, "velocity": speed, load: rng.normal(size=(400, 2))}
    units = {"position": "rad", "velocity": "rad/s", "torque": "Nm", "current": "A"}
    if not velocity:
        del signals["velocity"]
    measured = TimeSeries(clock, joints, signals, same_units({name: units[name] for name in signals}, joints))
    lagging = np.sin((clock[:, None] + 0.03) * np.array([2.0, 3.0]) + number)
    simulated = TimeSeries(
        clock, joints, {"position": position - 0.1 * np.abs(speed)}, same_units({"position": "rad"}, joints)
    )
    command = TimeSeries(clock, joints, {"position": lagging}, same_units({"position": "rad"}, joints))
    return Comparison(EpisodeMeta(id=str(number)), measured, {"s": simulated}, command, starts=np.arange(0, 400, 50))


def test_analysis_of_an_error_that_grows_with_velocity(tmp_path):
    items = [compared(k) for k in range(3)]
    builder = AnalysisBuilder(bins=9, window_s=0.5, horizon_steps=10)
    for item in items:
        builder.add(item)
    analysis = builder.result(lags_of(measure_gap(items)))
    curve = analysis.bins["s"]["position"]["a"]["velocity"]
    np.testing.assert_allclose(curve.median, 0.1 * np.abs(curve.centers), atol=0.03)
    assert (curve.x_unit, curve.y_unit, sum(curve.count)) == ("rad/s", "rad", 1200)
    assert analysis.bins["s"]["position"]["b"]["load"].x_unit == "Nm"
    assert set(analysis.bins) == {"s", "command"}
    assert analysis.lags["command"]["a"].value_s == pytest.approx(0.03, abs=2e-3)
    horizon = analysis.horizon["s"]["position"]["a"]
    assert horizon.time_s[:3] == pytest.approx((0.0, 0.05, 0.1))
    residual = np.concatenate([(item.measured["position"] - item.run("s")["position"])[:, 0] for item in items])
    total = np.sqrt(np.mean(residual**2))
    assert min(horizon.rmse) < total < max(horizon.rmse)
    analysis.save(tmp_path / "analysis.json")
    assert Analysis.load(tmp_path / "analysis.json").to_json() == analysis.to_json()


def test_analysis_makes_do_with_what_was_measured():
    builder = AnalysisBuilder()
    builder.add(compared(0, velocity=False, load="current"))
    analysis = builder.result()
    curves = analysis.bins["s"]["position"]["a"]
    assert {name: curve.x_unit for name, curve in curves.items()} == {
        "velocity": "rad/s",
        "position": "rad",
        "load": "A",
    }
    np.testing.assert_allclose(curves["velocity"].median, 0.1 * np.abs(curves["velocity"].centers), atol=0.03)
    assert analysis.horizon == {}


def test_analysis_refuses_other_joints_and_bad_numbers():
    builder = AnalysisBuilder()
    builder.add(compared(0))
    with pytest.raises(NameMismatch, match=r"a, c.*a, b"):
        builder.add(compared(1, joints=("a", "c")))
    with pytest.raises(ConfigError, match="positive"):
        AnalysisBuilder(window_s=0.0)
