"""Intervals over seeds and goals: against a computation of their own, and how often they hold the truth."""

import numpy as np
import pytest
from scipy import stats

from trueup.errors import DataError
from trueup.measure.seeds import seeds_interval


def drawn(rng, seeds, goals, *, of_seeds=1.0, of_goals=1.0, of_both=0.5):
    return (
        of_seeds * rng.normal(size=(seeds, 1))
        + of_goals * rng.normal(size=(1, goals))
        + of_both * rng.normal(size=(seeds, goals))
    )


@pytest.mark.parametrize("statistic", ["mean", "median"])
def test_many_seeds_are_drawn_as_by_hand(statistic):
    values = drawn(np.random.default_rng(3), 12, 40) ** 2
    over = getattr(np, statistic)
    rng = np.random.default_rng(99)
    found = []
    for _ in range(4000):
        rows, columns = rng.integers(12, size=12), rng.integers(40, size=40)
        found.append(np.mean([over(values[row][columns]) for row in rows]))
    value, low, high = seeds_interval(values, statistic=statistic, draws=4000)
    assert value == pytest.approx(np.mean([over(row) for row in values]))
    np.testing.assert_allclose([low, high], np.quantile(found, [0.025, 0.975]), rtol=0.05)


def test_few_seeds_have_the_interval_of_student_where_goals_do_not_matter():
    values = np.repeat([[1.0], [2.0], [4.0]], 50, axis=1)
    value, low, high = seeds_interval(values)
    expected = stats.t.interval(0.95, 2, loc=7 / 3, scale=stats.sem([1.0, 2.0, 4.0]))
    np.testing.assert_allclose([value, low, high], [7 / 3, *expected], rtol=1e-9)


def test_few_goals_have_it_where_seeds_do_not_matter():
    goals = np.array([0.2, 0.7, 1.9, 0.1])
    _, low, high = seeds_interval(np.tile(goals, (15, 1)), draws=20_000)
    np.testing.assert_allclose([low, high], stats.t.interval(0.95, 3, goals.mean(), stats.sem(goals)), rtol=0.03)


def test_goals_that_are_hard_for_both_do_not_widen_a_difference():
    rng = np.random.default_rng(0)
    hard = 10 * rng.normal(size=(1, 60))
    one, other = hard + 0.1 * rng.normal(size=(12, 60)), hard + 1.0 + 0.1 * rng.normal(size=(11, 60))
    value, low, high = seeds_interval(one, other)
    assert value == pytest.approx(one.mean() - other.mean())
    assert -1.1 < low < value < high < -0.9
    assert np.diff(seeds_interval(one)[1:])[0] > 3.0
    # A single policy beside several: its seed is not drawn, theirs are.
    apart = np.array([[0.0], [1.0], [2.0]]) + hard
    assert np.diff(seeds_interval(hard, apart)[1:])[0] > 2.0


@pytest.mark.parametrize(("seeds", "goals"), [(3, 30), (5, 10), (12, 30)])
def test_they_hold_the_truth_about_as_often_as_they_say(seeds, goals):
    rng, held = np.random.default_rng([seeds, goals]), 0
    for number in range(200):
        _, low, high = seeds_interval(drawn(rng, seeds, goals), draws=400, seed=number)
        held += low <= 0.0 <= high
    assert held >= 180


def test_goals_alone_would_say_too_much():
    rng, held = np.random.default_rng(8), 0
    for _ in range(200):
        values = drawn(rng, 3, 30)
        low, high = stats.t.interval(0.95, 29, values.mean(), stats.sem(values.mean(axis=0)))
        held += low <= 0.0 <= high
    assert held < 120


def test_what_has_no_interval():
    value, low, high = seeds_interval(np.ones((3, 1)))
    assert value == 1.0
    assert np.isnan([low, high]).all()
    with pytest.raises(DataError, match="same goals"):
        seeds_interval(np.ones((3, 4)), np.ones((3, 5)))
    with pytest.raises(DataError):
        seeds_interval(np.ones((3, 4)), draws=0)
