"""Populations: known mean and spread are found, and the formulas agree with the textbook's own steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueup.errors import DataError
from trueup.measure.population import population

NUMBERS = st.lists(
    st.tuples(st.floats(-100.0, 100.0), st.floats(0.01, 10.0)), min_size=2, max_size=30, unique_by=lambda pair: pair[0]
)


def test_the_spread_is_what_uncertainty_does_not_explain():
    """2,000 populations of 40 units: mean 5, spread 0.3, each unit uncertain by 0.1 to 0.4."""
    rng = np.random.default_rng(1)
    spreads, covered = [], 0
    for _ in range(2000):
        own = rng.uniform(0.1, 0.4, 40)
        found = population(5.0 + 0.3 * rng.standard_normal(40) + own * rng.standard_normal(40), own)
        spreads.append(found.spread**2)
        covered += abs(found.mean - 5.0) <= found.half_width
    assert np.mean(spreads) == pytest.approx(0.09, rel=0.03)  # the estimator of the variance has no bias
    assert covered / 2000 == pytest.approx(0.94, abs=0.02)


def test_units_that_are_all_the_same_have_no_spread():
    rng = np.random.default_rng(2)
    spreads = [population(3.0 + 0.2 * rng.standard_normal(30), np.full(30, 0.2)).spread for _ in range(200)]
    assert np.median(spreads) < 0.05
    assert sum(spread == 0 for spread in spreads) > 80


@given(NUMBERS)
def test_with_equal_uncertainties_it_is_the_variance_less_theirs(pairs):
    values = np.array([value for value, _ in pairs])
    own = pairs[0][1]
    found = population(values, np.full(values.size, own))
    assert found.mean == pytest.approx(values.mean(), abs=1e-9)
    assert found.spread**2 == pytest.approx(max(0.0, values.var(ddof=1) - own**2), rel=1e-6, abs=1e-9)


@given(NUMBERS)
def test_it_is_the_textbook_step_by_step(pairs):
    """DerSimonian and Laird 1986, in their own order, with loops."""
    values, own = (list(column) for column in zip(*pairs, strict=True))
    weights = [1 / deviation**2 for deviation in own]
    middle = sum(w * y for w, y in zip(weights, values, strict=True)) / sum(weights)
    q = sum(w * (y - middle) ** 2 for w, y in zip(weights, values, strict=True))
    room = sum(weights) - sum(w**2 for w in weights) / sum(weights)
    between = max(0.0, (q - (len(values) - 1)) / room)
    again = [1 / (deviation**2 + between) for deviation in own]
    found = population(np.array(values), np.array(own))
    assert found.spread == pytest.approx(between**0.5, rel=1e-5, abs=1e-6)
    expected = sum(w * y for w, y in zip(again, values, strict=True)) / sum(again)
    assert found.mean == pytest.approx(expected, rel=1e-5, abs=1e-6)
    assert found.half_width == pytest.approx(1.959964 / sum(again) ** 0.5, rel=1e-5)


@settings(max_examples=50)
@given(NUMBERS, st.floats(-50.0, 50.0), st.floats(0.1, 10.0))
def test_shift_and_scale(pairs, shift, scale):
    values, own = (np.array(column) for column in zip(*pairs, strict=True))
    plain, moved = population(values, own), population(scale * values + shift, scale * own)
    assert moved.mean == pytest.approx(scale * plain.mean + shift, rel=1e-6, abs=1e-5)
    assert moved.spread == pytest.approx(scale * plain.spread, rel=1e-4, abs=1e-4)
    assert moved.half_width == pytest.approx(scale * plain.half_width, rel=1e-4)


def test_one_that_is_not_like_the_others():
    values, own = np.array([1.0, 1.1, 0.9, 1.05, 0.95, 3.0]), np.full(6, 0.05)
    assert population(values, own).apart.tolist() == [False] * 5 + [True]
    own[-1] = 2.0  # nobody knows whether it is
    assert not population(values, own).apart.any()
    rng = np.random.default_rng(3)
    called = [population(rng.standard_normal(50), np.full(50, 0.1)).apart.sum() for _ in range(200)]
    assert np.mean(called) < 0.1  # of fifty ordinary ones


def test_a_single_one_has_no_spread():
    found = population(np.array([2.0]), np.array([0.5]))
    assert (found.mean, found.spread) == (2.0, 0.0)
    assert found.half_width == pytest.approx(0.98, abs=0.001)
    assert found.apart.tolist() == [False]


@pytest.mark.parametrize(
    ("values", "own"),
    [([], []), ([1.0], [0.0]), ([1.0], [-1.0]), ([np.nan], [1.0]), ([1.0], [np.inf])],
)
def test_what_is_no_population(values, own):
    with pytest.raises(DataError, match="population"):
        population(np.array(values), np.array(own))
