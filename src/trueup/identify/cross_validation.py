"""What a fit would have found without some of its motions, where there are too few to hold any out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float64

from trueup.identify.problem import Problem
from trueup.identify.solution import Solution
from trueup.identify.uncertainty import noise_of, precision_of

# Shares of the step that are tried.
_SHARES = (1.0, 0.5, 0.25, 0.0)
# A number falls to this share of itself at most.
_LEAST = 0.1


def without_each(problem: Problem, found: Solution, executed: Mapping[str, str]) -> dict[str, Float64[np.ndarray, "P"]]:
    """Estimates from all motions but those that executed the same; one step of Gauss-Newton for each.

    With residuals r, derivatives J (one row per parameter), prior precision L around m, and variance w of one
    observation, a fit ends where J r + w L (z - m) = 0. Without the residuals r_k of some motions and their derivatives
    J_k, the gradient there is -J_k r_k, so that the estimate moves by (J J^T - J_k J_k^T + w L)^-1 J_k r_k, or by the
    share of this that suits the other motions best.

    Source: Cook 1977, "Detection of influential observation in linear regression", for nonlinear least squares.

    Args:
        problem: of the fit.
        found: its solution.
        executed: motion -> what it executed, the same for its repetitions.

    Returns:
        What was executed -> estimate, in z; empty if all motions are of one kind.
    """
    rows = _rows(problem, executed)
    if len(rows) < 2:
        return {}
    mean, _ = problem.parameters.prior
    prior = noise_of(problem, found.residual).weight * precision_of(problem.parameters)
    logarithmic = np.array([item.transform == "log" for item in problem.parameters.free])
    low, high = problem.parameters.bounds
    whole, estimates = found.jacobian @ found.jacobian.T + prior, {}
    for name, own in rows.items():
        part = found.jacobian[:, own]
        normal = whole - part @ part.T
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal / np.outer(size, size) + 1e-9 * np.eye(size.size)
        step = np.linalg.solve(scaled, part @ found.residual[own] / size) / size
        moves = [
            np.where(logarithmic, np.log(np.maximum(1.0 + share * step, _LEAST)), share * step) for share in _SHARES
        ]
        places = np.clip(found.z + np.array(moves), low, high)
        left = (problem.residuals(places)[:, ~own] ** 2).sum(axis=1)
        cost = left + np.einsum("cp,pq,cq->c", places - mean, prior, places - mean)
        estimates[name] = places[int(np.argmin(np.nan_to_num(cost, nan=np.inf)))]
    return estimates


def _rows(problem: Problem, executed: Mapping[str, str]) -> dict[str, Bool[np.ndarray, "N"]]:
    """Which residuals are of which kind of motion."""
    names = [
        np.full(values.size, executed[segment.episode_id])
        for segment, _, values in problem.by_segment(np.empty(problem.size))
    ]
    of_row = np.concatenate(names)
    return {str(name): of_row == name for name in dict.fromkeys(of_row.tolist())}
