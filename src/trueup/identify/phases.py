"""One search from one start: which solver has its turn, and from where it goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from trueup.core.time_limit import TimeLimit
from trueup.errors import DataError
from trueup.identify.problem import Problem
from trueup.identify.search import HARDLY, Search, Stopwatch, space_of
from trueup.identify.solution import OnProgress, Solution, SolveSettings
from trueup.identify.solvers import draw_starts

# Places that are tried where the start cannot be simulated.
_PLACES = 32


def search_from(
    problem: Problem,
    settings: SolveSettings,
    *,
    checkpoint: Path | None,
    on_progress: OnProgress | None = None,
    limit: TimeLimit | None = None,
    slopes: Float64[np.ndarray, "P N"] | None = None,
) -> Solution:
    """Search from the start of the problem; settings of several starts count as one.

    Args:
        problem: logs, model and parameters.
        settings: how to search.
        checkpoint: as of `solve`.
        on_progress: called after every iteration.
        limit: when to end with the best so far.
        slopes: as of `Search.gauss_newton`, for that solver.

    Raises:
        DataError: the start cannot be simulated.
    """
    search = Search(problem, settings, Stopwatch(), checkpoint=checkpoint, on_progress=on_progress, limit=limit)
    match settings.solver:
        case "cma-es" | "evolution":
            return search.derivative_free(settings.solver)
        case "gauss-newton":
            return search.gauss_newton(slopes=slopes).solution
        case _:
            return _auto(search)


def _auto(search: Search) -> Solution:
    """Every phase has a checkpoint of its own, so that a resumed search walks through the finished ones at once."""
    try:
        first = search.gauss_newton()
    except DataError:
        remark = "the simulation diverges at the start values; the fit began at others that can be simulated"
        found = _continued(search, _somewhere_else(search.problem, search.settings.seed), "gauss-newton-elsewhere")
        return replace(found, solver={**found.solver, "remark": remark})
    if first.solution.solver["stop"] == "time" or first.gained > HARDLY or search.at_minimum(first):
        return first.solution
    rough = search.derivative_free("cma-es")
    # Gauss-Newton goes down only, so that its end is at least as good.
    found = _continued(search, rough.values, "gauss-newton-again")
    remark = "Gauss-Newton could not reduce the error from the start values; CMA-ES searched for better ones"
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
            "the simulation diverges, both at the start values of the fit and elsewhere within the bounds",
            hint="Give a smaller simulation.timestep_s in robot.yaml, or narrower bounds.",
        )
    return problem.parameters.values(starts[int(np.nanargmin(costs))])
