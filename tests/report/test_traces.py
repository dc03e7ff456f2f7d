"""Thinned curves: the laws of decimation, and traces.npz with traces.json."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from trueup.core.atomic import file_hash
from trueup.core.decimation import decimation_rows
from trueup.core.timeseries import TimeSeries, same_units
from trueup.core.traces import TraceSet
from trueup.errors import ConfigError, DataError, FormatError, NameMismatch, TrueupError, UnitError

curves = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 3), st.integers(1, 400)),
    elements=st.floats(-1e3, 1e3) | st.just(float("nan")),
)


@given(values=curves, max_points=st.integers(15, 80))
def test_rows_are_few_increasing_and_keep_ends_and_extremes(values, max_points):
    rows = decimation_rows(values, max_points)
    assert rows.size <= max(max_points, 1)
    assert np.all(np.diff(rows) > 0)
    assert rows[0] == 0
    assert rows[-1] == values.shape[1] - 1
    for full, kept in zip(values, values[:, rows], strict=True):
        assert np.isnan(full).any() == np.isnan(kept).any()
        if not np.isnan(full).all():
            assert np.nanmin(kept) == np.nanmin(full)
            assert np.nanmax(kept) == np.nanmax(full)


@given(values=hnp.arrays(np.float64, st.integers(1, 60), elements=st.floats(-1e3, 1e3)))
def test_a_short_curve_stays_as_it_is(values):
    np.testing.assert_array_equal(decimation_rows(values[None], 60), np.arange(values.size))


def test_every_bucket_keeps_its_own_extremes():
    values = np.sin(np.arange(10_000) / 7.0) * np.linspace(0, 1, 10_000)
    rows = decimation_rows(values[None], 402)
    # 200 buckets at least: no stretch of 50 rows loses its peak.
    for start in range(0, 10_000, 50):
        stretch = values[max(0, start - 50) : start + 100]
        kept = values[rows[(rows >= start - 50) & (rows < start + 100)]]
        assert kept.max() == stretch.max()
        assert kept.min() == stretch.min()


def test_a_spike_of_one_sample_survives():
    values = np.zeros(5000)
    values[3217] = 9.0
    rows = decimation_rows(values[None], 50)
    assert rows.size <= 50
    assert 3217 in rows


def test_room_left_by_shared_rows_is_used():
    rows = decimation_rows(np.linspace(0, 1, 1001)[None], 1000)
    assert rows.size > 700
    assert np.diff(rows).max() <= 3


def test_every_curve_keeps_its_gap():
    values = np.sin(np.arange(3000) / 50.0) * np.ones((2, 1))
    values[0, 1501] = np.nan
    values[1, 1503] = np.nan
    kept = values[:, decimation_rows(values, 60)]
    assert np.isnan(kept).any(axis=1).all()


def test_too_few_points_are_refused():
    with pytest.raises(ConfigError, match="too small"):
        decimation_rows(np.zeros((3, 100)), 7)
    with pytest.raises(ConfigError, match="too small"):
        TraceSet(max_points=10)


def series(time_s, joints=("a", "b"), scale=1.0, unit="rad", **signals):
    values = signals or {"position": scale * np.stack([np.sin(time_s), np.cos(time_s)], axis=1)[:, : len(joints)]}
    return TimeSeries(time_s, joints, values, same_units(dict.fromkeys(values, unit), joints))


def test_curves_share_rows_so_that_residuals_are_true():
    clock = np.arange(4000) * 0.005
    measured, simulated = series(clock), series(clock, scale=0.9)
    traces = TraceSet(max_points=200)
    traces.add("one", "test", measured, None, {"mujoco/stock": simulated})
    trace = traces.episodes["one"].traces[0]
    rows = np.searchsorted(clock, trace.time_s.astype(float) - 1e-6)
    expected = measured["position"][rows, 0] - simulated["position"][rows, 0]
    np.testing.assert_allclose(trace.curves["measured"] - trace.curves["mujoco/stock"], expected, atol=1e-6)
    assert trace.time_s.size <= 200
    assert trace.samples == 4000


def test_extremes_of_every_curve_and_residual_are_kept():
    rng = np.random.default_rng(0)
    clock = np.arange(3000) * 0.01
    measured = series(clock, position=rng.normal(size=(3000, 2)))
    runs = {f"run{number}": series(clock, position=rng.normal(size=(3000, 2))) for number in range(3)}
    traces = TraceSet(max_points=150)
    traces.add("one", "", measured, series(clock, position=rng.normal(size=(3000, 2))), runs)
    for column, trace in enumerate(traces.episodes["one"].traces):
        assert trace.time_s.size <= 150
        for label, run in runs.items():
            full = (measured["position"] - run["position"])[:, column]
            kept = trace.curves["measured"] - trace.curves[label]
            assert kept.max() == pytest.approx(full.max(), abs=1e-5)
            assert kept.min() == pytest.approx(full.min(), abs=1e-5)
            assert trace.curves[label].max() == pytest.approx(run["position"][:, column].max(), abs=1e-6)


def test_commands_are_held_and_simulations_interpolated_on_the_measured_clock():
    measured = series(np.array([10.0, 10.5, 11.0, 11.5, 12.0]), joints=("a",), position=np.zeros((5, 1)))
    command = series(np.array([10.4, 11.2]), joints=("a",), position=np.array([[1.0], [2.0]]))
    run = series(np.array([10.0, 11.0, 11.999]), joints=("a",), position=np.array([[0.0], [2.0], [3.998]]))
    traces = TraceSet()
    traces.add("one", "", measured, command, {"run": run})
    trace = traces.episodes["one"].traces[0]
    np.testing.assert_array_equal(trace.curves["command"], [np.nan, 1, 1, 2, 2])
    np.testing.assert_allclose(trace.curves["run"], [0, 1, 2, 3, 3.998], atol=1e-6)
    np.testing.assert_array_equal(trace.time_s, [0, 0.5, 1, 1.5, 2])
    assert traces.episodes["one"].start_s == 10.0


def test_nothing_is_made_up_outside_a_simulation():
    measured = series(np.arange(0.0, 10.0), joints=("a",), position=np.zeros((10, 1)))
    run = series(np.arange(3.0, 6.0), joints=("a",), position=np.ones((3, 1)))
    traces = TraceSet()
    traces.add("one", "", measured, None, {"run": run})
    curve = traces.episodes["one"].traces[0].curves["run"]
    np.testing.assert_array_equal(np.isfinite(curve), [False] * 3 + [True] * 3 + [False] * 4)


def test_joints_are_matched_by_name():
    clock = np.arange(5.0)
    values = np.column_stack([np.zeros(5), np.ones(5)])
    traces = TraceSet()
    traces.add("one", "", series(clock, position=values), None, {"run": series(clock, ("b", "a"), position=values)})
    assert [trace.curves["run"][0] for trace in traces.episodes["one"].traces] == [1.0, 0.0]


def test_what_does_not_fit_together_is_refused():
    clock = np.arange(5.0)
    traces = TraceSet()
    with pytest.raises(NameMismatch, match=r"run \[a, c\].*measured \[a, b\]"):
        traces.add("one", "", series(clock), None, {"run": series(clock, ("a", "c"))})
    with pytest.raises(UnitError, match="other units"):
        traces.add("one", "", series(clock), series(clock, unit="deg"), {})
    with pytest.raises(DataError, match="cannot be called"):
        traces.add("one", "", series(clock), None, {"measured": series(clock)})
    traces.add("one", "", series(clock), None, {})
    with pytest.raises(DataError, match="twice"):
        traces.add("one", "", series(clock), None, {})


def test_saved_traces_come_back(tmp_path):
    clock = np.arange(700) * 0.02 + 3.0
    holes = np.sin(clock)[:, None] * np.ones(2)
    holes[100:120] = np.nan
    traces = TraceSet(max_points=300)
    for name in ("b", "a/1", "ü"):
        traces.add(name, "test", series(clock, position=holes), series(clock), {"x": series(clock, scale=2.0)})
    traces.save(tmp_path)
    loaded = TraceSet.load(tmp_path)
    assert list(loaded.episodes) == ["b", "a/1", "ü"]
    assert loaded.max_points == 300
    for name, episode in traces.episodes.items():
        other = loaded.episodes[name]
        assert (episode.split, episode.start_s) == (other.split, other.start_s)
        for one, two in zip(episode.traces, other.traces, strict=True):
            assert (one.signal, one.joint, one.unit, one.samples) == (two.signal, two.joint, two.unit, two.samples)
            assert list(one.curves) == list(two.curves)
            for label in one.curves:
                np.testing.assert_array_equal(one.curves[label], two.curves[label])
        assert np.isnan(other.traces[0].curves["measured"]).any()


def test_saving_twice_gives_the_same_bytes(run_folder, tmp_path):
    for name in ("first", "second"):
        TraceSet.load(run_folder).save(tmp_path / name)
    for file in ("traces.npz", "traces.json"):
        assert (tmp_path / "first" / file).read_bytes() == (tmp_path / "second" / file).read_bytes()


@pytest.fixture
def saved(tmp_path):
    traces = TraceSet()
    traces.add("one", "", series(np.arange(50.0)), None, {"x": series(np.arange(50.0))})
    traces.save(tmp_path)
    return tmp_path


def edit_index(folder, change):
    index = json.loads((folder / "traces.json").read_text())
    change(index)
    (folder / "traces.json").write_text(json.dumps(index))


@pytest.mark.parametrize(
    "change",
    [
        lambda index: index["episodes"][0].update(array="no"),
        lambda index: index["episodes"][0]["traces"][0].update(rows=51),
        lambda index: index["episodes"][0]["traces"][0].update(rows=-1),
        lambda index: index["episodes"][0]["traces"][0].update(rows="many"),
        lambda index: index["episodes"][0]["traces"].pop(),
        lambda index: index["episodes"][0]["traces"][0].pop("curves"),
        lambda index: index["episodes"][0].pop("start_s"),
        lambda index: index.update(episodes=None),
        lambda index: index.update(max_points="all"),
    ],
)
def test_a_broken_index_is_an_error(saved, change):
    edit_index(saved, change)
    with pytest.raises(DataError):
        TraceSet.load(saved)


def test_foreign_and_missing_files_are_errors(saved):
    with pytest.raises(DataError, match="does not exist"):
        TraceSet.load(saved / "nowhere")
    (saved / "traces.npz").rename(saved / "away.npz")
    with pytest.raises(DataError, match="belong together"):
        TraceSet.load(saved)
    (saved / "traces.json").write_text('{"schema": "trueup.traces/99"}')
    with pytest.raises(FormatError, match=r"trueup\.traces/1"):
        TraceSet.load(saved)


def test_a_pickle_is_never_opened(saved):
    np.savez(saved / "traces.npz", episode_000000=np.array([{"a": 1}], dtype=object))
    with pytest.raises(DataError, match="is not the file that"):
        TraceSet.load(saved)
    index = json.loads((saved / "traces.json").read_text())
    (saved / "traces.json").write_text(json.dumps({**index, "curves": file_hash(saved / "traces.npz")}))
    with pytest.raises(DataError, match="do not agree"):
        TraceSet.load(saved)


def test_damaged_bytes_are_errors_or_other_numbers(saved):
    whole = (saved / "traces.npz").read_bytes()
    rng = np.random.default_rng(5)
    for _ in range(150):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), rng.integers(1, 6)):
            damaged[place] = rng.integers(0, 256)
        (saved / "traces.npz").write_bytes(damaged[: rng.integers(1, len(whole))] if rng.random() < 0.3 else damaged)
        try:
            TraceSet.load(saved)
        except TrueupError:
            continue
