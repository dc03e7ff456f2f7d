"""PACE's problem (2 h 15 min on a GPU there): a legged robot in the air, a chirp of 20 s, all joints at once."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.identify_cases import Case
from benchmarks.identify_legged import humanoid, quadruped
from benchmarks.table import Row, at_least, at_most, shown
from trueup.identify import SolveSettings, solve
from trueup.identify.uncertainty import posterior_of

_ROUNDS = 3


@dataclass(frozen=True)
class _Run:
    """One fit.

    Attributes:
        seconds: it took.
        iterations: Jacobians.
        relative: cost of an iteration and parameter in simulations of the same log on one thread.
        errors: relative, by parameter.
        covered: whether the 95 % interval holds the truth, by parameter.
    """

    seconds: float
    iterations: int
    relative: float
    errors: np.ndarray
    covered: np.ndarray


def run() -> list[Row]:
    """Seconds, errors and coverage for 49 parameters and for 117, and how the cost of an iteration grows."""
    with tempfile.TemporaryDirectory() as folder:
        small = [_fit(quadruped(Path(folder), seed)) for seed in range(_ROUNDS)]
        large = _fit(humanoid(Path(folder), 0))
    errors = np.array([run.errors for run in small])
    growth = large.relative / float(np.median([run.relative for run in small]))
    return [
        at_most(
            "49 parameters of 12 joints, 20 s, 2 threads", float(np.median([run.seconds for run in small])), 300, "s"
        ),
        at_most("49: median relative error", float(np.median(errors)), 0.02, ""),
        shown("49: largest relative error", float(errors.max()), ""),
        at_least("49: 95 % intervals that hold the truth", float(np.mean([run.covered for run in small])), 0.85, ""),
        shown("117 parameters of 29 joints, 20 s, 2 threads", large.seconds, "s"),
        at_most("117: median relative error", float(np.median(large.errors)), 0.05, ""),
        at_least("117: 95 % intervals that hold the truth", float(large.covered.mean()), 0.85, ""),
        at_most("cost of an iteration per parameter and simulation, 117 / 49", growth, 1.0, "x"),
    ]


def _fit(case: Case) -> _Run:
    problem = case.problem(jobs=2)
    simulation = _one_simulation(case)
    started = time.perf_counter()
    found = solve(problem, SolveSettings())
    seconds = time.perf_counter() - started
    iterations = int(found.solver["iterations"])
    posterior = posterior_of(problem, found.z, found.residual, found.jacobian)
    names = [parameter.name for parameter in posterior.parameters.free]
    intervals = [posterior.interval(index) for index in range(len(names))]
    covered = [low <= case.true[name] <= high for name, (low, high) in zip(names, intervals, strict=True)]
    relative = seconds / iterations / len(names) / simulation
    return _Run(seconds, iterations, relative, case.errors(found.values), np.array(covered))


def _one_simulation(case: Case) -> float:
    """Seconds for the log, simulated once with the nominal model."""
    model, command = case.nominal.model, case.logs[0].commanded()
    steps = round(command.duration_s / model.opt.timestep)
    held = np.searchsorted(command.time_s, np.arange(steps) * model.opt.timestep + 1e-9, side="right") - 1
    state = np.zeros((1, 1 + model.nq + model.nv))
    data = mujoco.MjData(model)
    seconds = []
    for _ in range(5):
        started = time.perf_counter()
        rollout.rollout(model, data, state, command["position"][held][None])
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds))
