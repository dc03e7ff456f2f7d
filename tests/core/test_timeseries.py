import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.timeseries import TimeSeries, same_units
from trueup.errors import DataError, MissingSignal, NameMismatch


def series(time_s, joints=("a", "b"), **signals):
    arrays = {name: np.asarray(values, float) for name, values in signals.items()}
    return TimeSeries(np.asarray(time_s, float), joints, arrays, same_units(dict.fromkeys(arrays, "rad"), joints))


@pytest.mark.parametrize("clock", [[], [0.0, 0.0], [0.0, 2.0, 1.0], [0.0, np.nan], [0.0, np.inf]])
def test_a_clock_that_does_not_run_forwards_is_refused(clock):
    with pytest.raises(DataError, match="clock"):
        series(clock, position=np.zeros((len(clock), 2)))


def test_the_place_where_the_clock_stands_still_is_named():
    with pytest.raises(DataError, match=r"0\.25 s after 0\.5 s \(row 2\)"):
        series([0.0, 0.5, 0.25], position=np.zeros((3, 2)))


@pytest.mark.parametrize("shape", [(3, 1), (2, 2), (3, 2, 1)])
def test_a_signal_of_another_shape_is_refused(shape):
    with pytest.raises(DataError, match="'position' has the wrong shape"):
        series([0.0, 1.0, 2.0], position=np.zeros(shape))


def test_joint_names_are_unique():
    with pytest.raises(NameMismatch, match="twice"):
        series([0.0], joints=("a", "a"), position=np.zeros((1, 2)))


def test_every_signal_has_units():
    with pytest.raises(NameMismatch, match="units"):
        TimeSeries(np.zeros(1), ("a",), {"position": np.zeros((1, 1))}, {})


def test_an_unknown_signal_is_answered_with_the_known_ones():
    with pytest.raises(MissingSignal, match=r"'torque'.*available: position"):
        series([0.0], position=np.zeros((1, 2)))["torque"]


def test_selecting_joints_reorders_values_and_units_by_name():
    units = {"position": ("rad", "m")}
    both = TimeSeries(np.arange(2.0), ("a", "b"), {"position": np.array([[1.0, 2.0], [3.0, 4.0]])}, units)
    swapped = both.select(("b", "a"))
    np.testing.assert_array_equal(swapped["position"], [[2, 1], [4, 3]])
    assert swapped.units["position"] == ("m", "rad")
    with pytest.raises(NameMismatch, match=r"\[c\].*\[a, b\]"):
        both.select(("c",))


@given(st.permutations(["a", "b", "c", "d"]))
def test_selecting_there_and_back_changes_nothing(order):
    original = series([0.0, 1.0], joints=("a", "b", "c", "d"), position=np.arange(8.0).reshape(2, 4))
    back = original.select(tuple(order)).select(original.joints)
    np.testing.assert_array_equal(back["position"], original["position"])


def test_body_signals_have_a_width_of_their_own():
    bodies = {"body.position": np.zeros((2, 1, 3)), "body.rotation": np.zeros((2, 1, 3, 3))}
    units = {"body.position": ("m",), "body.rotation": ("1",)}
    moving = TimeSeries(np.arange(2.0), (), bodies, units, bodies=("hand",))
    assert moving.rows(slice(1, None))["body.rotation"].shape == (1, 1, 3, 3)


def test_bodies_are_selected_by_name():
    signals = {"position": np.zeros((1, 1)), "body.position": np.arange(9.0).reshape(1, 3, 3)}
    units = {"position": ("rad",), "body.position": ("m",) * 3}
    whole = TimeSeries(np.zeros(1), ("hip",), signals, units, bodies=("thigh", "shank", "foot"))
    some = whole.select_bodies(("foot", "thigh"))
    assert (some.joints, some.bodies) == (("hip",), ("foot", "thigh"))
    np.testing.assert_array_equal(some["body.position"], [[[6, 7, 8], [0, 1, 2]]])
    with pytest.raises(NameMismatch, match="hand"):
        whole.select_bodies(("hand",))


def test_rate_and_duration():
    ticks = series([0.0, 0.1, 0.2, 0.5], position=np.zeros((4, 2)))
    assert ticks.rate_hz == pytest.approx(10.0)
    assert ticks.duration_s == 0.5
    assert series([1.0], position=np.zeros((1, 2))).rate_hz == 0.0
