"""21 parameters of a Panda behind position servos: against `mujoco.sysid` and against scipy."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from rich.console import Console

from benchmarks.identify_cases import Case, panda_case
from benchmarks.identify_rivals import THREADS, Fit, fit_with_scipy, fit_with_sysid, has_sysid
from benchmarks.table import Row, at_most, shown
from trueup.identify import SolveSettings, solve

_ROUNDS = 7


def run() -> list[Row]:
    """Seconds and median relative error, side by side; each round has its own start and noise."""
    fits: dict[str, Callable[[Case], Fit]] = {"trueup": _ours, "scipy": fit_with_scipy}
    if has_sysid():
        fits["mujoco.sysid"] = fit_with_sysid
    else:
        Console().print("mujoco.sysid is left out: `pip install mujoco[sysid]` brings what it needs", markup=False)
    seconds: dict[str, list[float]] = {name: [] for name in fits}
    errors: dict[str, list[np.ndarray]] = {name: [] for name in fits}
    candidates: dict[str, list[int]] = {name: [] for name in fits}
    for seed in range(_ROUNDS):
        case = panda_case(seed)
        for name, fit in fits.items():
            started = time.perf_counter()
            found = fit(case)
            seconds[name].append(time.perf_counter() - started)
            errors[name].append(case.errors(found.values))
            candidates[name].append(found.evaluations)
    rows = []
    for name in fits:
        rows.append(shown(f"{name}: 21 parameters, 4 x 2 s, {THREADS} threads", float(np.median(seconds[name])), "s"))
        rows.append(shown(f"{name}: candidates simulated", float(np.median(candidates[name])), ""))
        rows.append(shown(f"{name}: median relative error", float(np.median(errors[name])), ""))
    for name in fits:
        if name != "trueup":
            ratio = float(np.median(np.divide(seconds["trueup"], seconds[name])))
            rows.append(at_most(f"time, trueup / {name}", ratio, 1.0, "x"))
            middle = {own: np.median(errors[own], axis=1) for own in ("trueup", name)}
            share = float(np.median(middle["trueup"] / middle[name]))
            rows.append(at_most(f"median error, trueup / {name}", share, 1.0, "x"))
    return rows


def _ours(case: Case) -> Fit:
    problem = case.problem(jobs=THREADS)
    found = solve(problem, SolveSettings())
    return Fit(found.values, problem.evaluations)
