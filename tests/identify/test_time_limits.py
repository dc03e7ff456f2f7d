"""Searches end when their time is over: on a clock that every simulated candidate moves by a second."""

import time

import numpy as np
import pytest

from identify.recovery_cases import SERVO, Truth, nominal_of
from trueup.core.time_limit import OutOfTime, TimeLimit
from trueup.identify import IdentifyConfig, Problem, SegmentRule, SolveSettings, explain, identify, make_segments, solve
from trueup.identify.config import DataChoice, make_parameters
from trueup.identify.start import swept_start

TRUTH = {"damping[shoulder]": 0.9, "damping[elbow]": 0.5, "kp[shoulder]": 30.0}
FIT = {"kp": "all", "damping": "all"}


@pytest.fixture
def clock(monkeypatch):
    """Seconds that only simulations take: one for each candidate on each piece of a log."""
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    simulate = Problem._simulate

    def slowly(self, task, *rest):
        now[0] += task.rows.size
        return simulate(self, task, *rest)

    monkeypatch.setattr(Problem, "_simulate", slowly)
    return now


@pytest.fixture
def problem(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    logs = [Truth(robot, nominal, TRUTH).log(seed, seconds=2.0) for seed in (1, 2, 3)]
    segments, _ = make_segments(logs, nominal.simulator, SegmentRule())
    return Problem(nominal, make_parameters(FIT, nominal), segments)


def test_a_batch_is_broken_off_in_the_middle(problem, clock):
    rows = np.tile(problem.parameters.start, (8, 1))
    limit = TimeLimit.after(9.0)
    with problem.ending(limit), pytest.raises(OutOfTime):
        problem.residuals(rows)
    assert clock[0] <= 1000.0 + 9.0 + 8.0  # one piece late at most
    assert problem.evaluations == 0, "none of them was finished"
    assert np.isfinite(problem.residuals(rows)).all(), "outside there is no limit"
    assert (problem.evaluations, problem.seconds) == (8, 24.0)
    with problem.ending(TimeLimit.after(10.0), keep=4), pytest.raises(OutOfTime):  # four candidates take 12 s
        problem.residuals(rows[:1])


def test_threads_that_have_not_begun_are_not_waited_for(problem, clock):
    many = Problem(problem.nominal, problem.parameters, problem.segments, jobs=2)
    with many.ending(TimeLimit.after(3.0)), pytest.raises(OutOfTime):
        many.residuals(np.tile(problem.parameters.start, (8, 1)))
    assert clock[0] < 1000.0 + 24.0


@pytest.mark.parametrize("given_s", [0.0, 10.0, 25.0, 60.0, 150.0])
def test_a_search_ends_with_the_best_so_far(problem, clock, given_s):
    start = float(np.sum(problem.residuals(problem.parameters.start[None]) ** 2))
    before = clock[0]
    found = solve(problem, SolveSettings(solver="gauss-newton"), limit=TimeLimit.after(given_s))
    # Where it begins and its derivatives at the end are simulated in any case: 5 candidates on 3 pieces.
    assert clock[0] - before <= max(given_s, 15.0) + 3.0
    assert found.solver["stop"] == ("converged" if given_s > 100.0 else "time")
    assert found.jacobian.shape == (4, problem.size)
    assert np.isfinite(found.jacobian).all()
    assert float(np.sum(found.residual**2)) <= start * (1 + 1e-9)
    if given_s >= 60.0:
        assert float(np.sum(found.residual**2)) < 0.5 * start


def test_a_search_with_time_is_not_hurried(problem, clock):
    free = solve(problem, SolveSettings(solver="gauss-newton"))
    timed = solve(problem, SolveSettings(solver="gauss-newton"), limit=TimeLimit.after(1e6))
    assert timed.solver["stop"] == free.solver["stop"] == "converged"
    np.testing.assert_array_equal(timed.z, free.z)


def test_the_look_for_a_start_ends_between_kinds(problem, clock):
    whole = swept_start(problem)
    swept_s = clock[0] - 1000.0
    limit = TimeLimit.after(0.6 * swept_s)
    part = swept_start(problem, limit)
    assert limit.left_s == 0.0
    assert clock[0] - 1000.0 - swept_s < 0.75 * swept_s
    values = [{item.name: item.value for item in each} for each in (whole, part)]
    assert values[0]["kp[shoulder]"] == values[1]["kp[shoulder]"], "stiffness comes first"


@pytest.fixture
def logs(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    truth = Truth(robot, nominal, TRUTH)
    return robot, {
        split: [truth.log(seed, seconds=2.0) for seed in seeds]
        for split, seeds in (("train", (1, 2, 3)), ("val", (4,)), ("test", (5, 6)))
    }


@pytest.mark.long
@pytest.mark.parametrize("given_s", [20.0, 60.0, 200.0])
def test_an_explanation_ends_in_time_and_says_what_it_lacks(logs, tmp_path, clock, given_s):
    robot, motions = logs
    config = IdentifyConfig(data=DataChoice(budget_s=12.0))
    found = explain(motions, robot, tmp_path / "arm.xml", config=config, limit=TimeLimit.after(given_s))
    assert clock[0] - 1000.0 <= 1.15 * given_s + 10.0
    assert found.short_of_time
    assert any(line.startswith("the time limit ended the search for") for line in found.statements)
    assert sum(found.shares_total.values()) == pytest.approx(1.0)


def test_an_explanation_without_time_has_no_causes(logs, tmp_path, clock):
    robot, motions = logs
    found = explain(motions, robot, tmp_path / "arm.xml", limit=TimeLimit.after(0.0))
    assert found.causes == ()
    assert found.short_of_time


@pytest.mark.long
@pytest.mark.parametrize("given_s", [60.0, 200.0, 600.0])
def test_an_identification_ends_in_time(logs, tmp_path, clock, given_s):
    robot, motions = logs
    config = IdentifyConfig(fit=FIT, data=DataChoice(budget_s=12.0))
    found = identify(motions, robot, tmp_path / "arm.xml", config=config, limit=TimeLimit.after(given_s)).result
    # Beyond its time: the held-out motions by two models, 3 s each, and a piece.
    assert clock[0] - 1000.0 <= 1.15 * given_s + 12.0
    assert {"val", "test"} <= set(found.errors["fitted"])
    assert found.short_of_time == (found.solver["stop"] == "time" or bool(found.solver.get("short_of_time")))
    assert found.free
