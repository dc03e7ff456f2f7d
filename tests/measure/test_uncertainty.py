"""Intervals: against scipy's bootstrap, by hand, and by counting how often they cover the truth."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from trueup.errors import DataError
from trueup.measure import bootstrap_interval, paired_difference, ratio_interval

LABELS = {
    "run": "fitted",
    "baseline": "stock",
    "split": "all",
    "signal": "position",
    "metric": "rmse",
    "unit": "rad",
}


def difference(run, baseline, **options):
    return paired_difference(np.array(run, float), np.array(baseline, float), **LABELS, **options)


def test_agrees_with_scipys_bootstrap_at_the_expanded_level():
    values = np.random.default_rng(0).gamma(2.0, size=33)
    low, high = bootstrap_interval(values[:, None], draws=40_000, seed=1)
    tail = stats.norm.cdf(math.sqrt(33 / 32) * stats.t.ppf(0.025, 32))
    other = stats.bootstrap(
        (values,),
        np.mean,
        confidence_level=1.0 - 2.0 * tail,
        method="percentile",
        n_resamples=40_000,
        rng=np.random.default_rng(2),
    ).confidence_interval
    assert low[0] == pytest.approx(other.low, abs=0.015)
    assert high[0] == pytest.approx(other.high, abs=0.015)
    assert high[0] - low[0] > np.diff(stats.t.interval(0.94, 32, values.mean(), stats.sem(values)))[0]


def test_few_episodes_are_at_least_students_t():
    values = np.array([1.0, 2.0, 4.0, 9.0])
    low, high = bootstrap_interval(values[:, None])
    # mean 4, squares 9 + 4 + 0 + 25 = 38, s = sqrt(38 / 3), t_3 = 3.18245: half width 3.18245 s / 2 = 5.663
    assert low[0] == pytest.approx(4.0 - 5.663, abs=1e-3)
    assert high[0] == pytest.approx(4.0 + 5.663, abs=1e-3)


# Measured coverage stands in the module's docstring; the bounds here are it minus three standard errors.
@pytest.mark.parametrize(("episodes", "normal", "skewed"), [(4, 0.93, 0.85), (6, 0.935, 0.865), (33, 0.935, 0.92)])
def test_coverage_over_seeds(episodes, normal, skewed):
    rng = np.random.default_rng(episodes)
    for values, truth, least in (
        (rng.standard_normal((episodes, 2000)), 0.0, normal),
        (rng.exponential(size=(episodes, 2000)), 1.0, skewed),
    ):
        hits = []
        for seed, part in enumerate(np.split(values, 4, axis=1)):
            low, high = bootstrap_interval(part, draws=1000, seed=seed)
            hits.append((low <= truth) & (truth <= high))
        coverage = np.mean(hits)
        assert least <= coverage <= 0.975


def test_a_paired_verdict_is_wrong_one_time_in_twenty():
    rng = np.random.default_rng(0)
    for episodes in (4, 10):
        verdicts = [
            difference(rng.standard_normal(episodes), rng.standard_normal(episodes), draws=300, seed=k).verdict
            for k in range(800)
        ]
        wrong = np.mean([verdict != "undecided" for verdict in verdicts])
        assert 0.03 <= wrong <= 0.08


def test_columns_do_not_know_each_other_and_nan_leaves_only_its_own_column():
    rng = np.random.default_rng(0)
    values = rng.standard_normal((12, 3))
    values[:, 1] += 10.0  # holes that counted as zeros would show
    values[[0, 5], 1] = np.nan
    values[:, 2] = np.nan
    low, high = bootstrap_interval(values, draws=4000)
    alone_low, alone_high = bootstrap_interval(values[:, :1], draws=4000)
    assert (low[0], high[0]) == pytest.approx((alone_low[0], alone_high[0]), abs=1e-12)
    # the column with holes: the interval of its ten values, drawn in another way
    kept = values[~np.isnan(values[:, 1]), 1:2]
    kept_low, kept_high = bootstrap_interval(kept, draws=4000)
    assert low[1] == pytest.approx(kept_low[0], abs=0.12)
    assert high[1] == pytest.approx(kept_high[0], abs=0.12)
    assert np.isnan([low[2], high[2]]).all()


@pytest.mark.parametrize("rows", [0, 1])
def test_fewer_than_two_episodes_have_no_interval(rows):
    low, high = bootstrap_interval(np.ones((rows, 2)))
    assert np.isnan(low).all()
    assert np.isnan(high).all()


def test_one_value_among_nan_has_no_interval():
    values = np.array([[1.0, 1.0], [np.nan, 2.0], [np.nan, 3.0]])
    low, high = bootstrap_interval(values)
    assert np.isnan([low[0], high[0]]).all()
    assert low[1] < 2.0 < high[1]


def test_seeded():
    values = np.random.default_rng(0).standard_normal((12, 2))
    first, again, other = (bootstrap_interval(values, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_blocks_of_draws_do_not_change_the_result(monkeypatch):
    values = np.random.default_rng(0).standard_normal((12, 2))
    whole = bootstrap_interval(values, draws=500, seed=3)
    monkeypatch.setattr("trueup.measure.uncertainty._CELLS", 12 * 7)
    np.testing.assert_allclose(bootstrap_interval(values, draws=500, seed=3), whole, rtol=1e-12)


def test_no_draws_is_an_error():
    with pytest.raises(DataError, match="at least 1"):
        bootstrap_interval(np.ones((3, 1)), draws=0)


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=15), st.floats(-100.0, 100.0), st.floats(0.1, 10.0))
def test_the_interval_moves_and_scales_with_the_values(items, shift, scale):
    values = np.array(items)[:, None]
    low, high = (float(end[0]) for end in bootstrap_interval(values, draws=200))
    moved_low, moved_high = (float(end[0]) for end in bootstrap_interval(scale * values + shift, draws=200))
    assert moved_low == pytest.approx(scale * low + shift, rel=1e-6, abs=1e-6)
    assert moved_high == pytest.approx(scale * high + shift, rel=1e-6, abs=1e-6)
    assert low - 1e-9 <= values.mean() <= high + 1e-9 or len(items) > 9


def test_paired_difference_worked_by_hand():
    result = difference([1.0, 2.0, 3.0], [2.0, 3.5, 3.5])
    # differences -1, -1.5, -0.5: mean -1, s = 0.5, t_2 = 4.3027: half width 4.3027 * 0.5 / sqrt(3) = 1.242
    assert result.difference.value == pytest.approx(-1.0)
    assert result.difference.low == pytest.approx(-2.242, abs=1e-3)
    assert result.difference.high == pytest.approx(0.242, abs=1e-3)
    assert result.relative == pytest.approx(-1.0 / 3.0)  # the baseline's mean is 3
    assert result.verdict == "undecided"  # although all three are better
    assert (result.run, result.baseline, result.difference.unit) == ("fitted", "stock", "rad")


def test_pairing_sees_what_the_spread_between_episodes_hides():
    rng = np.random.default_rng(0)
    hard = rng.uniform(1.0, 100.0, 20)
    better = difference(hard - 0.5 + rng.normal(0.0, 0.1, 20), hard)
    assert better.verdict == "better"
    assert better.difference.low == pytest.approx(-0.5, abs=0.1)
    assert difference(hard, hard - 0.5 + rng.normal(0.0, 0.1, 20)).verdict == "worse"
    assert difference(hard, hard).verdict == "undecided"


def test_paired_difference_with_missing_values():
    result = difference([1.0, np.nan, 5.0], [3.0, 1.0, np.nan])
    assert result.difference.value == -2.0
    assert result.difference.low is None
    assert result.verdict == "undecided"
    assert math.isnan(difference([np.nan], [1.0]).difference.value)


def test_a_ratio_over_ones_is_a_mean():
    values = np.random.default_rng(3).gamma(2.0, size=(7, 3))
    value, low, high = ratio_interval(values, np.ones_like(values), seed=4)
    assert value == pytest.approx(values.mean(axis=0))
    expected = bootstrap_interval(values, seed=4)
    assert low == pytest.approx(expected[0])
    assert high == pytest.approx(expected[1])


def test_a_ratio_against_draws_by_hand():
    """Percentiles of sums over the same drawn rows, for enough episodes that no widening applies."""
    rng = np.random.default_rng(5)
    above, below = rng.gamma(2.0, size=(25, 1)), rng.gamma(3.0, size=(25, 1))
    value, low, high = ratio_interval(above, below, draws=20_000, seed=1)
    rows = np.random.default_rng(99).integers(0, 25, size=(20_000, 25))
    ratios = above[rows, 0].sum(axis=1) / below[rows, 0].sum(axis=1)
    tail = stats.norm.cdf(math.sqrt(25 / 24) * stats.t.ppf(0.025, 24))
    assert value[0] == pytest.approx(above.sum() / below.sum())
    assert low[0] == pytest.approx(np.quantile(ratios, tail), abs=0.01)
    assert high[0] == pytest.approx(np.quantile(ratios, 1 - tail), abs=0.01)


def test_few_episodes_widen_a_ratio_to_the_linearized_t_interval():
    above, below = np.array([[1.0], [2.0], [4.0]]), np.array([[2.0], [2.0], [2.0]])
    # equal denominators: the ratio is the mean of 0.5, 1, 2; squares 0.444 + 0.028 + 0.694, s = 0.7638
    _, low, high = ratio_interval(above, below)
    half = stats.t.ppf(0.975, 2) * np.std([0.5, 1.0, 2.0], ddof=1) / math.sqrt(3)
    assert [low[0], high[0]] == pytest.approx([7 / 6 - half, 7 / 6 + half])


def test_an_episode_without_a_say_changes_no_ratio_and_none_gives_nothing():
    above, below = np.array([[1.0, 0.0], [0.0, 0.0], [3.0, 0.0]]), np.array([[2.0, 0.0], [0.0, 0.0], [2.0, 0.0]])
    value, low, high = ratio_interval(above, below)
    assert value[0] == pytest.approx(1.0)
    assert low[0] < 1.0 < high[0]
    assert all(math.isnan(item[1]) for item in (value, low, high))
    alone = ratio_interval(above[:1], below[:1])
    assert alone[0][0] == pytest.approx(0.5)
    assert all(math.isnan(item[0]) for item in alone[1:])


def test_ratios_cover_the_truth_at_about_the_stated_rate():
    """Pooled errors of motions of different length and difficulty; 300 sets of 33."""
    rng, hits = np.random.default_rng(6), 0
    for seed in range(300):
        length = rng.uniform(200, 800, 33)
        squares = length * np.exp(0.5 * rng.normal(size=33))
        _, low, high = ratio_interval(squares[:, None], length[:, None], draws=400, seed=seed)
        hits += low[0] <= math.exp(0.125) <= high[0]
    assert 0.90 <= hits / 300 <= 0.985


def test_motions_that_are_not_repeated_have_the_intervals_that_they_had():
    """The same numbers to the last digit: numbering the motions changes nothing."""
    values = np.random.default_rng(7).normal(size=(14, 3))
    values[2, 1] = np.nan
    expected = bootstrap_interval(values, seed=2)
    found = bootstrap_interval(values, motions=np.arange(14)[::-1], seed=2)
    for own, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(own, other)


def test_a_motion_that_is_recorded_twice_alike_says_no_more_than_once():
    """Twelve motions, and the same twelve with every recording doubled; below ten and above."""
    for count in (5, 12):
        once = np.random.default_rng(count).gamma(2.0, size=(count, 2))
        expected = bootstrap_interval(once, seed=3)
        found = bootstrap_interval(np.repeat(once, 2, axis=0), motions=np.repeat(np.arange(count), 2), seed=3)
        for own, other in zip(found, expected, strict=True):
            assert own == pytest.approx(other)
    blind = bootstrap_interval(np.repeat(once, 2, axis=0), seed=3)
    assert (blind[1] - blind[0] < 0.85 * (found[1] - found[0])).all()


def test_repetitions_of_one_motion_have_no_interval_and_decide_nothing():
    low, high = bootstrap_interval(np.array([[1.0], [2.0], [3.0]]), motions=np.zeros(3, np.int64))
    assert math.isnan(low[0])
    assert math.isnan(high[0])
    found = difference([1.0, 1.1], [2.0, 2.1], motions=np.array([4, 4]))
    assert (found.verdict, found.difference.low) == ("undecided", None)
    assert found.difference.value == pytest.approx(-1.0)


def test_intervals_over_repeated_motions_cover_the_truth_at_about_the_stated_rate():
    """A motion's level and what a payload adds to it; some motions are recorded once, most twice or three times."""
    rng, hits, blind = np.random.default_rng(8), 0, 0
    motions = np.repeat(np.arange(12), rng.integers(1, 4, 12))
    for seed in range(300):
        values = (rng.normal(size=12)[motions] + 0.2 * rng.normal(size=len(motions)))[:, None]
        for own in (motions, None):
            low, high = bootstrap_interval(values, motions=own, draws=400, seed=seed)
            held = low[0] <= 0.0 <= high[0]
            hits, blind = (hits + held, blind) if own is not None else (hits, blind + held)
    assert hits / 300 >= 0.90
    assert blind / 300 < 0.88
