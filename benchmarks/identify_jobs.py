"""Threads of a fit: two against one, beside what two threads bring to `mujoco.rollout` alone."""

from __future__ import annotations

import time
from statistics import median

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.identify_cases import Case, panda_case
from benchmarks.table import Row, at_least, shown
from trueup.identify import SolveSettings, solve

_ROUNDS = 5
_FITS = 3


def run() -> list[Row]:
    """How many times faster two threads are, in alternation."""
    case = panda_case(0)
    raw = [_seconds(lambda: _rollouts(case, 1)) / _seconds(lambda: _rollouts(case, 2)) for _ in range(_ROUNDS)]
    problems = {jobs: case.problem(jobs=jobs) for jobs in (1, 2)}
    moved = case.start.start + 0.01 * np.eye(len(case.start))
    jacobian = [
        _seconds(lambda: problems[1].residuals(moved)) / _seconds(lambda: problems[2].residuals(moved))
        for _ in range(_ROUNDS)
    ]
    fit = [
        _seconds(lambda: solve(problems[1], SolveSettings())) / _seconds(lambda: solve(problems[2], SolveSettings()))
        for _ in range(_FITS)
    ]
    return [
        shown("mujoco.rollout alone, 2 threads / 1", median(raw), "x"),
        at_least("one Jacobian of 21 parameters, 2 threads / 1", median(jacobian), 1.7, "x"),
        at_least("a whole fit of 21 parameters, 2 threads / 1", median(fit), 1.7, "x"),
    ]


def _rollouts(case: Case, threads: int) -> None:
    model = case.nominal.model
    data = [mujoco.MjData(model) for _ in range(threads)]
    control = np.stack([log.commanded()["position"] for log in case.logs for _ in case.start])
    states = np.zeros((len(control), 1 + model.nq + model.nv))
    states[:, 1 : 1 + model.nq] = control[:, 0]
    rollout.rollout(model, data, states, control)


def _seconds(work) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started
