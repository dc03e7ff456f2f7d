"""The `fit` behind all solvers: which of them has its turn, and from where."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from trueup.core.time_limit import TimeLimit
from trueup.errors import DataError
from trueup.identify.problem import Problem
from trueup.identify.search import HARDLY, Search, Stopwatch, space_of
from trueup.identify.solution import OnProgress, Solution, SolveSettings
from trueup.identify.solvers import compare_ends, draw_starts

# Places that are tried where the start cannot be simulated.
_PLACES = 32
# Half a unit of z around the start: far enough to leave a dent, near enough to be simulated.
_SPREAD = 0.5


def solve(
    problem: Problem,
    settings: SolveSettings,
    *,
    checkpoint: Path | None = None,
    on_progress: OnProgress | None = None,
    limit: TimeLimit | None = None,
) -> Solution:
    """Drive a solver to its end.

    `auto` is Gauss-Newton; where that finds no way down and is not at a minimum that it can see (a cost without slope,
    as steps make it), CMA-ES looks for a better place and Gauss-Newton goes on from there. The solution says what was
    done.

    Args:
        problem: logs, model and parameters.
        settings: how to search.
        checkpoint: JSON file beside which every phase of the search writes its own after every iteration (`fit.json`:
            `fit.gauss-newton.json`), and from which it goes on if that belongs to the same problem.
        on_progress: called after every iteration.
        limit: when to end with the best so far, all starts together.

    Raises:
        DataError: the start cannot be simulated.
    """

    def from_start(own: Problem, name: str) -> Solution:
        path = checkpoint.with_name(f"{checkpoint.stem}{name}.json") if checkpoint else None
        search = Search(own, settings, Stopwatch(), checkpoint=path, on_progress=on_progress, limit=limit)
        match settings.solver:
            case "cma-es" | "evolution":
                return search.derivative_free(settings.solver)
            case "gauss-newton":
                return search.gauss_newton().solution
            case _:
                return _auto(search)

    # The matrices are small, and idle BLAS threads spin: they would take the simulations' cores.
    with threadpool_limits(1, "blas"):
        if settings.starts > 1:
            return _from_many_starts(problem, settings, from_start)
        return from_start(problem, "")


def _auto(search: Search) -> Solution:
    """Every phase has a checkpoint of its own, so that a resumed search walks through the finished ones at once."""
    try:
        first = search.gauss_newton()
    except DataError:
        remark = "the model diverges at the start; the search began at another place that can be simulated"
        found = _continued(search, _somewhere_else(search.problem, search.settings.seed), "gauss-newton-elsewhere")
        return replace(found, solver={**found.solver, "remark": remark})
    if first.solution.solver["stop"] == "time" or first.gained > HARDLY or search.at_minimum(first):
        return first.solution
    rough = search.derivative_free("cma-es")
    # Gauss-Newton goes down only, so that its end is at least as good.
    found = _continued(search, rough.values, "gauss-newton-again")
    remark = "Gauss-Newton found no way down from the start; CMA-ES looked for a better one"
    return replace(found, solver={**found.solver, "name": "cma-es, gauss-newton", "remark": remark})


def _continued(search: Search, place: dict[str, float], phase: str) -> Solution:
    """Gauss-Newton from another place, with its own checkpoint."""
    moved = search.problem.with_parameters(search.problem.parameters.at(place))
    found = search.moved_to(moved).gauss_newton(phase).solution
    search.problem.evaluations = moved.evaluations
    return found


def _somewhere_else(problem: Problem, seed: int) -> dict[str, float]:
    """The best of some places all over the bounds, where the start itself cannot be simulated.

    Raises:
        DataError: none of them can.
    """
    starts = draw_starts(space_of(problem), _PLACES, seed=seed)
    costs = np.sum(problem.residuals(starts) ** 2, axis=1)
    if not np.isfinite(costs).any():
        raise DataError(
            "the model cannot be simulated, neither at the start of the fit nor elsewhere within the bounds",
            hint="Give a smaller simulation.timestep_s in robot.yaml, or narrower bounds.",
        )
    return problem.parameters.values(starts[int(np.nanargmin(costs))])


def _from_many_starts(
    problem: Problem, settings: SolveSettings, from_start: Callable[[Problem, str], Solution]
) -> Solution:
    """The best of several searches, each with checkpoints of its own, and whether they agree.

    Raises:
        DataError: none of the starts can be simulated.
    """
    space = space_of(problem)
    ends = draw_starts(space, settings.starts, spread=_SPREAD, seed=settings.seed)
    costs = np.full(len(ends), np.inf)
    found: list[Solution] = []
    for index, start in enumerate(ends):
        moved = problem.with_parameters(problem.parameters.at(problem.parameters.values(start)))
        try:
            solution = from_start(moved, f".start{index}")
            found.append(solution)
            ends[index], costs[index] = solution.z, float(solution.residual @ solution.residual)
        except DataError:
            pass
        problem.evaluations = moved.evaluations
    if not found:
        raise DataError("the model cannot be simulated from any of the starts", got=f"{len(ends)} starts")
    agreement = compare_ends(space, ends, costs, cost_tolerance=0.01, place_tolerance=0.1)
    best = found[int(np.argmin(costs[np.isfinite(costs)]))]
    seconds = round(sum(float(solution.solver["seconds"]) for solution in found), 3)
    solver = {**best.solver, "seconds": seconds, "evaluations": problem.evaluations, "starts": agreement.text}
    return replace(best, solver=solver, agreement=agreement)
