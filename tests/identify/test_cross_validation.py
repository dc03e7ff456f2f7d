"""Fits that leave a motion out, told from one fit of all motions."""

from dataclasses import replace

import numpy as np
import pytest

from identify.recovery_cases import SERVO, Truth, nominal_of
from trueup.identify import IdentifyConfig, Problem, SegmentRule, SolveSettings, identify, make_segments, solve
from trueup.identify.config import DataChoice, make_parameters
from trueup.identify.cross_validation import without_each
from trueup.identify.scoring import CROSS_VALIDATION

FIT = {"kp": "all", "damping": "all"}


@pytest.fixture
def motions(tmp_path):
    """Robot, nominal model and four motions of it that no model explains by the same numbers."""
    robot, nominal = nominal_of(tmp_path, SERVO)
    logs = []
    for number in range(4):
        truth = Truth(robot, nominal, {"damping[shoulder]": 0.6 + 0.1 * number, "kp[shoulder]": 30.0 + number})
        log = truth.log(number, seconds=3.0)
        logs.append(replace(log, meta=replace(log.meta, id=f"m{number}")))
    return robot, nominal, logs


def problem_of(nominal, logs):
    segments, _ = make_segments(logs, nominal.simulator, SegmentRule())
    return Problem(nominal, make_parameters(FIT, nominal), segments)


def test_each_is_near_to_a_fit_of_the_others(motions):
    _, nominal, logs = motions
    whole = problem_of(nominal, logs)
    found = solve(whole, SolveSettings(solver="gauss-newton"))
    estimates = without_each(whole, found, {log.id: log.id for log in logs})
    assert list(estimates) == [log.id for log in logs]
    for log in logs:
        others = problem_of(nominal, [other for other in logs if other is not log])
        expected = solve(others, SolveSettings(solver="gauss-newton")).z
        moved = np.linalg.norm(expected - found.z)
        assert np.linalg.norm(estimates[log.id] - expected) < 0.35 * moved


def test_repetitions_are_left_out_together(motions):
    _, nominal, logs = motions
    whole = problem_of(nominal, logs)
    found = solve(whole, SolveSettings(solver="gauss-newton"))
    estimates = without_each(whole, found, {"m0": "a", "m1": "a", "m2": "b", "m3": "b"})
    assert list(estimates) == ["a", "b"]
    expected = solve(problem_of(nominal, logs[2:]), SolveSettings(solver="gauss-newton")).z
    assert np.linalg.norm(estimates["a"] - expected) < 0.35 * np.linalg.norm(expected - found.z)
    assert without_each(whole, found, {log.id: "a" for log in logs}) == {}


@pytest.mark.long
@pytest.mark.parametrize("held_out", [False, True])
def test_few_motions_are_judged_by_cross_validation(motions, held_out):
    robot, nominal, logs = motions
    splits = {"train": logs[:3], "val": logs[3:]} if held_out else {"train": logs}
    config = IdentifyConfig(fit=FIT, data=DataChoice(budget_s=20.0))
    result = identify(splits, robot, nominal.path, config=config).result
    assert (CROSS_VALIDATION in result.errors["fitted"]) == (not held_out)
    assert any(text.startswith("cross-validation: ") for text in result.statements) == (not held_out)
    if not held_out:
        errors = result.errors["fitted"]
        assert errors["train"].value < errors[CROSS_VALIDATION].value < result.errors["nominal"]["train"].value
