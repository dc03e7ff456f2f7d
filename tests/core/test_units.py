import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.hold import held_rows
from trueup.core.units import SI_UNIT, UNITS, conversion, si_factor
from trueup.core.windows import window_starts
from trueup.errors import UnitError

names = st.sampled_from(sorted(UNITS))


@given(names, names)
def test_there_and_back_is_one(left, right):
    if UNITS[left][0] == UNITS[right][0]:
        assert conversion(left, right) * conversion(right, left) == pytest.approx(1.0)
    else:
        with pytest.raises(UnitError, match="cannot be converted"):
            conversion(left, right)


@given(names)
def test_the_si_unit_of_a_si_unit_is_itself(name):
    si, factor = si_factor(name)
    assert conversion(name, si) == factor
    assert si_factor(si) == (si, 1.0)


def test_known_factors():
    assert conversion("deg", "rad") == pytest.approx(math.pi / 180)
    assert conversion("rpm", "rad/s") == pytest.approx(0.104719755)
    assert conversion("mNm", "Nm") == pytest.approx(1e-3)
    assert all(si_factor(unit)[1] == 1.0 for unit in SI_UNIT.values())


def test_an_unknown_unit_is_answered_with_the_known_ones():
    with pytest.raises(UnitError, match=r"'furlong'.*rad, deg"):
        si_factor("furlong")


@given(st.lists(st.floats(1e-3, 0.4), min_size=1, max_size=200), st.floats(0.05, 2.0))
def test_every_window_starts_within_its_length_and_is_not_empty(steps, window_s):
    clock = np.cumsum(steps)
    starts = window_starts(clock, window_s)
    assert starts[0] == 0
    assert np.all(np.diff(starts) > 0)
    ends = np.append(starts[1:], clock.size) - 1
    # Boundaries lie on the common grid, so no window is longer than window_s plus the gap before its first stamp.
    assert np.all(
        np.floor((clock[ends] - clock[0]) / window_s + 1e-6) - np.floor((clock[starts] - clock[0]) / window_s + 1e-6)
        <= 1
    )
    assert list(window_starts(clock, None)) == [0]


def test_windows_shorter_than_a_step_are_the_steps():
    clock = np.arange(5) * 0.1
    assert list(window_starts(clock, 1e-9)) == [0, 1, 2, 3, 4]


@given(st.integers(1, 1000), st.integers(2, 300))
def test_stamps_that_mean_the_same_instant_are_the_same(rate_hz, count):
    """k * (1 / rate) and k / rate differ by a rounding error; a command is held from its own stamp on."""
    left, right = np.arange(count) * (1.0 / rate_hz), np.arange(count) / rate_hz
    np.testing.assert_array_equal(held_rows(left, right), np.arange(count))
    np.testing.assert_array_equal(held_rows(right, left), np.arange(count))
    assert held_rows(left, np.array([-1.0]))[0] == -1


@given(st.integers(1, 5000), st.integers(2, 300), st.floats(1.6e9, 1.9e9))
def test_a_command_with_stamps_since_1970_is_held_from_its_own_instant(rate_hz, count, start):
    """Doubles near 1.7e9 are 0.24 microseconds apart; so rounded, a command must not act a simulation step late."""
    exact = np.arange(count) / rate_hz
    rounded = (start + exact) - start
    np.testing.assert_array_equal(held_rows(rounded, exact), np.arange(count))
    np.testing.assert_array_equal(held_rows(exact, rounded), np.arange(count))
