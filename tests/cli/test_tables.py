"""Results as lines for the terminal."""

import math

import pytest
from rich.console import Console

from trueup.cli.tables import gap_table, ladder_table, verdicts
from trueup.core.results import Estimate, GapResult, Ladder, MetricResult, PairedDifference, Rung


@pytest.mark.parametrize(
    ("value", "relative", "said"),
    [
        (-0.02, -0.5, "50.0 % less (better)"),
        (0.02, math.nan, "0.02 rad more (worse)"),  # the baseline has no error at all
        (math.nan, math.nan, "not defined (undecided)"),
    ],
)
def test_how_much_one_run_is_better_than_another(value, relative, said):
    verdict = "undecided" if math.isnan(value) else "better" if value < 0 else "worse"
    pair = PairedDifference(
        *("mujoco/fitted", "mujoco/stock", "test", "position", "rmse"),
        difference=Estimate(value, "rad", value, value),
        relative=relative,
        verdict=verdict,
    )
    gap = GapResult({}, ("a",), ("a",), paired=(pair,), splits={"m": "test"})
    assert verdicts(gap) == [f"mujoco/fitted against mujoco/stock, test: {said}"]


@pytest.mark.parametrize(("motions", "said"), [(1, True), (3, False)])
def test_one_motion_has_no_interval_and_it_is_said(motions, said):
    result = MetricResult(Estimate(0.02, "rad"), {}, motions)
    ladder = Ladder([Rung("stock", 0.0, {"test": {"position": {"rmse": result}}})])
    gap = GapResult({"stock": {"test": {"position": {"rmse": result}}}}, ("a",), ("a",), splits={"m": "test"})
    for table in (ladder_table(ladder), gap_table(gap)):
        assert (table.caption == "no interval from one motion") == said


@pytest.mark.parametrize(
    ("value", "low", "high", "said"),
    [
        (0.0082934, 0.0015912, 0.0154, "0.0083 [0.0016, 0.015]"),
        (0.0072, 0.0, 0.016, "0.0072 [0, 0.016]"),
        (123.4, 99.7, 1234.0, "123 [100, 1234]"),
        (0.5, None, None, "0.5"),
        (math.nan, None, None, "not defined"),
    ],
)
def test_the_ladder_has_two_digits_and_says_its_unit_once(value, low, high, said, capsys):
    result = MetricResult(Estimate(value, "rad", low, high), {}, 3)
    table = ladder_table(Ladder([Rung("stock", 0.0, {"test": {"position": {"rmse": result}}})]))
    Console(width=120).print(table)
    shown = capsys.readouterr().out
    assert "position rmse [rad], mean" in shown
    assert f"│ stock │ {said.rjust(8)} │" in shown
