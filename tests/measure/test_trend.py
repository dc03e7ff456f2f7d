import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.results import Estimate, GapResult, MetricResult
from trueup.measure.trend import trend, trends_of


@given(st.floats(-3, 3), st.floats(-3, 3), st.integers(0, 1000))
def test_a_straight_line_is_found(slope, at_zero, seed):
    loads = np.random.default_rng(seed).choice([0.0, 1.0, 2.0, 3.0], 12)
    loads[:2] = 0.0, 3.0
    loads[2:4] = 0.0, 3.0
    found = trend(loads, at_zero + slope * loads, "rad")
    assert found.slope.value == pytest.approx(slope, abs=1e-9)
    assert found.at_zero == pytest.approx(at_zero, abs=1e-9)
    assert (found.slope.unit, found.motions) == ("rad/kg", 12)


def test_the_interval_is_that_of_hc3_by_hand():
    """White's sandwich with residuals over (1 - leverage), written with matrices."""
    rng = np.random.default_rng(0)
    loads = np.repeat([0.0, 1.0, 3.0], 4)
    values = 0.1 + 0.02 * loads + 0.01 * (1 + loads) * rng.normal(size=12)
    design = np.column_stack([np.ones(12), loads])
    inverse = np.linalg.inv(design.T @ design)
    residual = values - design @ inverse @ design.T @ values
    residual /= 1 - np.diag(design @ inverse @ design.T)
    error = np.sqrt((inverse @ design.T @ np.diag(residual**2) @ design @ inverse)[1, 1])
    found = trend(loads, values, "1").slope
    assert found.unit == "1/kg"
    assert found.high - found.value == pytest.approx(2.228139 * error, rel=1e-5)  # t, 10 degrees of freedom
    assert found.value - found.low == pytest.approx(found.high - found.value)


def test_the_interval_covers_the_truth_where_loaded_motions_scatter_more():
    rng = np.random.default_rng(1)
    loads = np.repeat([0.0, 1.0, 2.0, 3.0], 8)
    hits = 0
    for _ in range(800):
        found = trend(loads, 0.1 + 0.02 * loads + 0.01 * (0.3 + loads) * rng.normal(size=32), "rad").slope
        hits += found.low <= 0.02 <= found.high
    assert 0.92 < hits / 800 < 0.985


@pytest.mark.parametrize(
    ("loads", "values", "verdict"),
    [
        ([0, 0, 1, 1, 2, 2], [1, 1.1, 2, 2.1, 3, 3.1], "grows"),
        ([0, 0, 1, 1, 2, 2], [3, 3.1, 2, 2.1, 1, 1.1], "falls"),
        ([0, 0, 1, 1, 2, 2], [1, 2, 2, 1, 1.5, 1.6], "undecided"),
        ([0, 1], [1, 2], "undecided"),
    ],
)
def test_a_verdict_needs_an_interval_beside_zero(loads, values, verdict):
    found = trend(np.array(loads, dtype=float), np.array(values, dtype=float), "rad")
    assert found.verdict == verdict
    assert (found.slope.low is None) == (len(loads) < 3)


def test_what_makes_no_line():
    ones = np.ones(5)
    assert trend(ones, np.arange(5.0), "rad") is None
    assert trend(np.arange(5.0), np.full(5, np.nan), "rad") is None
    # One loaded motion decides alone: its own scatter cannot be seen.
    assert trend(np.array([0.0, 0.0, 0.0, 1.0]), np.arange(4.0), "rad").slope.low is None


def repeated(rng, *, slope=0.02, motions=10, level=1.0):
    """Motions of very different size, each with four payloads; what one motion adds to the noise, all payloads share."""
    loads = np.tile([0.0, 1.0, 2.0, 3.0], motions)
    names = np.repeat([f"m{k}" for k in range(motions)], 4)
    own = np.repeat(level * rng.normal(size=motions), 4)
    tilt = np.repeat(0.01 * rng.normal(size=motions), 4)
    return loads, own + (slope + tilt) * loads + 0.002 * rng.normal(size=loads.size), names


def test_repeated_motions_are_compared_with_themselves():
    """The same slope as with a column per motion in the design, written with matrices."""
    loads, values, names = repeated(np.random.default_rng(2))
    design = np.column_stack([loads, *(names == name for name in np.unique(names))]).astype(float)
    expected = np.linalg.lstsq(design, values, rcond=None)[0][0]
    paired, alone = trend(loads, values, "rad", motions=list(names)), trend(loads, values, "rad")
    assert paired.slope.value == pytest.approx(expected, rel=1e-9)
    assert paired.verdict == "grows"
    assert alone.verdict == "undecided"


def test_the_interval_of_repeated_motions_covers_the_truth():
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(600):
        loads, values, names = repeated(rng)
        found = trend(loads, values, "rad", motions=list(names)).slope
        hits += found.low <= 0.02 <= found.high
    assert 0.92 < hits / 600 < 0.98


def test_two_repeated_motions_are_too_few_to_compare():
    loads, values, names = repeated(np.random.default_rng(4), motions=2)
    alone = trend(loads, values, "rad")
    assert trend(loads, values, "rad", motions=list(names)) == alone
    assert trend(loads, values, "rad", motions=[f"m{k}" for k in range(8)]) == alone


def test_trends_of_a_gap_leave_out_motions_without_payload():
    names = [f"m{k}" for k in range(6)]
    loads = dict(zip(names, [0.0, 0.0, 2.0, 2.0, None, 4.0], strict=True))
    value = {name: 0.1 + 0.05 * (load or 0.0) for name, load in loads.items()}
    joints = {"a": Estimate(1.0, "rad"), "b": Estimate(1.0, "rad")}
    result = GapResult(
        runs={"dart/stock": {"all": {"position": {"rmse": MetricResult(Estimate(1.0, "rad"), joints, 6)}}}},
        joints=("a", "b"),
        scored_joints=("a", "b"),
        episodes={"dart/stock": {n: {"position": {"rmse": {"a": v, "b": 3 * v}}} for n, v in value.items()}},
    )
    found = trends_of(result, loads)["dart/stock"]["position"]["rmse"]
    assert {joint: item.slope.value for joint, item in found.items()} == pytest.approx({"": 0.1, "a": 0.05, "b": 0.15})
    assert {item.motions for item in found.values()} == {5}
    assert trends_of(result, dict.fromkeys(names, 1.0)) == {}


@pytest.mark.parametrize("repeating", [False, True])
def test_a_straight_line_is_called_straight_and_a_parabola_bent(repeating):
    rng = np.random.default_rng(5)
    loads, values, names = repeated(rng, slope=0.2, level=1.0 if repeating else 0.0, motions=14)
    names = list(names) if repeating else None
    line = trend(loads, values, "rad", motions=names)
    assert (line.verdict, line.shape) == ("grows", "straight")
    assert line.bend.low < 0.0 < line.bend.high
    for sign, shape in ((1.0, "bends up"), (-1.0, "bends down")):
        found = trend(loads, values + sign * 0.05 * loads**2, "rad", motions=names)
        assert found.shape == shape
        # The middle between the ends of 0.05 x^2 from 0 to 3 is 0.225, the parabola at 1.5 is 0.1125.
        assert found.bend.low < sign * 0.1125 < found.bend.high
        assert found.bend.value - line.bend.value == pytest.approx(sign * 0.1125)


@pytest.mark.parametrize("repeating", [False, True])
def test_the_interval_of_the_bend_covers_none(repeating):
    rng = np.random.default_rng(6)
    hits = 0
    for _ in range(500):
        loads, values, names = repeated(rng)
        if not repeating:  # what the repetitions of a motion have in common would not be seen
            values = 0.1 + 0.02 * loads + 0.01 * (0.3 + loads) * rng.normal(size=loads.size)
        bend = trend(loads, values, "rad", motions=list(names) if repeating else None).bend
        hits += bend.low <= 0.0 <= bend.high
    assert 0.92 < hits / 500 < 0.985


def test_what_shows_no_bend():
    two = trend(np.array([0.0, 0.0, 1.0, 1.0]), np.array([0.0, 0.1, 1.0, 1.1]), "rad")
    assert (two.bend, two.shape) == (None, "undecided")
    noise = np.random.default_rng(7).normal(size=40)
    assert trend(np.tile([0.0, 1.0, 2.0, 3.0], 10), noise, "rad").shape == "undecided"
