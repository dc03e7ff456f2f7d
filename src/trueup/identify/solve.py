"""The `fit` behind all solvers: one search, or several from different starts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float64
from threadpoolctl import threadpool_limits

from trueup.core.ray_workers import Cluster
from trueup.core.time_limit import TimeLimit
from trueup.identify.many_starts import from_many_starts
from trueup.identify.phases import search_from
from trueup.identify.problem import Problem
from trueup.identify.solution import OnProgress, Solution, SolveSettings


def solve(
    problem: Problem,
    settings: SolveSettings,
    *,
    checkpoint: Path | None = None,
    on_progress: OnProgress | None = None,
    limit: TimeLimit | None = None,
    cluster: Cluster | None = None,
    slopes: Float64[np.ndarray, "P N"] | None = None,
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
        on_progress: called after every iteration; on a cluster, after every start.
        limit: when to end with the best so far, all starts together.
        cluster: where several starts are searched from side by side; one after the other, here, if None.
        slopes: derivatives near the start, where another search has ended, to begin with (`Search.gauss_newton`).

    Raises:
        DataError: the start cannot be simulated.
        ConfigError: there is no such cluster, or a worker of it was killed again and again.
    """
    # The matrices are small, and idle BLAS threads spin: they would take the simulations' cores.
    with threadpool_limits(1, "blas"):
        if settings.starts > 1:
            return from_many_starts(
                problem, settings, checkpoint=checkpoint, on_progress=on_progress, limit=limit, cluster=cluster
            )
        return search_from(
            problem, settings, checkpoint=checkpoint, on_progress=on_progress, limit=limit, slopes=slopes
        )
