"""21 parameters of a Panda driven by torques: windows from the measured state against whole rollouts."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.identify_cases import Case, panda_case
from benchmarks.table import Row, at_least, at_most, shown
from trueup.identify import SolveSettings, solve
from trueup.identify.start import regressed_start

_ROUNDS = 3
_WINDOW_S = 0.1
_PATIENCE_S = 20.0


def run() -> list[Row]:
    """Seconds from the regression to the last Jacobian, and errors; each round has its own start and noise."""
    seconds, windows, whole = [], [], []
    for seed in range(_ROUNDS):
        case = panda_case(seed, torque=True)
        started = time.perf_counter()
        windows.append(case.errors(_fit(case, _WINDOW_S)))
        seconds.append(time.perf_counter() - started)
        if seed == 0:
            whole.append(case.errors(_fit(case, None)))
    return [
        at_most("21 parameters, 4 x 2 s of torque, 2 threads", float(np.median(seconds)), 5.0, "s"),
        at_most("median relative error, windows of 0.1 s", float(np.median(windows)), 0.05, ""),
        shown("largest relative error, windows of 0.1 s", float(np.max(windows)), ""),
        at_least("median relative error, whole rollouts from the same start", float(np.median(whole)), 0.2, ""),
    ]


def _fit(case: Case, window_s: float | None) -> dict[str, float]:
    problem = case.problem(jobs=2, window_s=window_s)
    settings = SolveSettings(solver="gauss-newton", max_seconds=_PATIENCE_S)
    if window_s is not None:
        problem = problem.with_parameters(regressed_start(problem, case.logs))
    return solve(problem, settings).values
