import json

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dataset.store_cases import make_series, names, random_series, same_series
from trueup.core.timeseries import TimeSeries
from trueup.dataset.columns import LAYOUT_KEY, content_hash, from_table, layout_of, parse_layout, to_table
from trueup.errors import DataError, FormatError


def native(series: TimeSeries) -> TimeSeries:
    """What comes back: the machine's byte order and C order, values untouched."""
    signals = {name: np.array(values, dtype=values.dtype.name, order="C") for name, values in series.signals.items()}
    return TimeSeries(series.time_s, series.joints, signals, series.units, series.bodies)


def digest(series: TimeSeries) -> str:
    return content_hash({"measured": (series, layout_of(series))})


@pytest.mark.long
@given(random_series())
def test_a_series_comes_back_to_the_bit(series):
    table = to_table(series, layout_of(series))
    layout = parse_layout(table.schema)
    assert layout == layout_of(series)
    assert same_series(from_table(table, layout), native(series))
    assert len(set(table.column_names)) == table.num_columns
    assert digest(from_table(table, layout)) == digest(series)


@given(random_series(), st.data())
def test_the_hash_sees_a_change_of_anything(series, data):
    changed = [TimeSeries(series.time_s + 1024.0, series.joints, series.signals, series.units, series.bodies)]
    if series.joints:
        joints = (series.joints[0] + "'", *series.joints[1:])
        if len(set(joints)) == len(joints):
            changed.append(TimeSeries(series.time_s, joints, series.signals, series.units, series.bodies))
    filled = [name for name, values in series.signals.items() if values.size]
    if filled:
        name = data.draw(st.sampled_from(filled))
        values = np.array(series[name])
        values.flat[data.draw(st.integers(0, values.size - 1))] = 12345.0
        changed.append(
            TimeSeries(series.time_s, series.joints, {**series.signals, name: values}, series.units, series.bodies)
        )
        units = {**series.units, name: ("deg",) * len(series.units[name])}
        changed.append(TimeSeries(series.time_s, series.joints, series.signals, units, series.bodies))
    assert digest(series) not in {digest(other) for other in changed}


def test_columns_read_like_a_sentence():
    clock = np.arange(2.0)
    signals = {
        "position": np.zeros((2, 1), "f4"),
        "body.position": np.zeros((2, 1, 3)),
        "body.rotation": np.zeros((2, 1, 3, 3)),
    }
    units = {"position": ("rad",), "body.position": ("m",), "body.rotation": ("1",)}
    series = TimeSeries(clock, ("shoulder_pan",), signals, units, ("hand",))
    table = to_table(series, layout_of(series))
    assert table.column_names[:6] == [
        "time_s",
        "position[shoulder_pan]",
        "body.position[hand].x",
        "body.position[hand].y",
        "body.position[hand].z",
        "body.rotation[hand].xx",
    ]
    assert table.schema.types[:3] == [pa.float64(), pa.float32(), pa.float64()]
    assert table.column_names[-1] == "body.rotation[hand].zz"


def test_columns_that_would_look_alike_are_told_apart():
    clock, zeros = np.arange(2.0), np.zeros((2, 2))
    signals = {"a": zeros, "a[x]": zeros + 1}
    series = TimeSeries(clock, ("x", "x][x"), signals, {"a": ("1", "1"), "a[x]": ("1", "1")})
    table = to_table(series, layout_of(series))
    assert table.column_names == ["time_s", "a[x]", "a[x][x]", "a[x][x]~2", "a[x][x][x]"]
    assert same_series(from_table(table, layout_of(series)), series)


def test_the_table_is_a_copy():
    series = make_series(1)
    table = to_table(series, layout_of(series))
    before = table.to_pylist()
    series.time_s[:] = 0
    series["position"][:] = 0
    assert table.to_pylist() == before


def test_half_precision_and_broken_text_are_refused():
    half = TimeSeries(np.arange(2.0), ("x",), {"position": np.zeros((2, 1), "f2")}, {"position": ("rad",)})
    with pytest.raises(DataError, match="float16"):
        layout_of(half)
    broken = TimeSeries(np.arange(2.0), ("\ud800",), {"position": np.zeros((2, 1))}, {"position": ("rad",)})
    with pytest.raises(DataError, match="Unicode"):
        to_table(broken, layout_of(broken))


@pytest.mark.parametrize(
    "change",
    [
        lambda layout: layout | {"schema": "trueup.series/9"},
        lambda layout: layout | {"joints": "pan"},
        lambda layout: layout | {"joints": [1, 2]},
        lambda layout: layout | {"signals": layout["signals"][:1]},
        lambda layout: layout | {"signals": [layout["signals"][0] | {"shape": [10**12]}]},
        lambda layout: layout | {"signals": [layout["signals"][0] | {"dtype": "object"}]},
        lambda layout: {key: value for key, value in layout.items() if key != "bodies"},
        lambda layout: [layout],
    ],
)
def test_a_layout_that_does_not_fit_is_refused(change):
    schema = to_table(make_series(1), layout_of(make_series(1))).schema
    text = json.dumps(change(json.loads(schema.metadata[LAYOUT_KEY])))
    with pytest.raises(FormatError):
        parse_layout(schema.with_metadata({LAYOUT_KEY: text}))
    with pytest.raises(FormatError):
        parse_layout(schema.remove_metadata())


@given(st.lists(names, unique=True, max_size=5))
def test_joint_names_of_any_kind_stay_in_order(joints):
    values = np.arange(2.0 * len(joints)).reshape(2, len(joints))
    series = TimeSeries(np.arange(2.0), tuple(joints), {"position": values}, {"position": ("rad",) * len(joints)})
    assert from_table(to_table(series, layout_of(series)), layout_of(series)).joints == tuple(joints)
