"""A full set of physically possible bodies that agrees with base parameters and stays near the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from trueup.identify.inertial import Inertial
from trueup.identify.regression.linkage import LinkBody
from trueup.identify.regression.pseudo_inertia import (
    PARAMETERS,
    deformed,
    deformed_slopes,
    inertial_from,
    parameters_of,
    square_root,
)

_COUNT = len(PARAMETERS)
_ITERATIONS = 60
_MOST_DAMPING = 1e12
_TRUST = (1e-3, 1e-2, 1e-1, 1.0)
_ENOUGH = 1e-10  # relative decrease of the cost at which it has converged


class Consistent(NamedTuple):
    """The solution.

    Attributes:
        bodies: the bodies that were adjusted.
        inertials: what became of them.
        extras: parameters of the joints.
    """

    bodies: tuple[LinkBody, ...]
    inertials: tuple[Inertial, ...]
    extras: Float64[np.ndarray, "K"]


class Extras(NamedTuple):
    """Parameters of the joints, which are linear.

    Attributes:
        start: where they start and what they are drawn to, (K,).
        deviation: how far they may easily go from there, (K,).
        low: lower bounds, (K,).
    """

    start: Float64[np.ndarray, "K"]
    deviation: Float64[np.ndarray, "K"]
    low: Float64[np.ndarray, "K"]


class _Prior(NamedTuple):
    """Where coordinates are drawn to, how strongly, and how low they may go."""

    center: Float64[np.ndarray, "X"]
    weight: Float64[np.ndarray, "X"]
    low: Float64[np.ndarray, "X"]


def consistent_bodies(
    root: Float64[np.ndarray, "R P"],
    target: Float64[np.ndarray, "R"],
    bodies: Sequence[LinkBody],
    extras: Extras,
    *,
    links: int,
    prior_deviation: float,
) -> Consistent:
    """Minimize |root p - target|^2 + |theta / prior_deviation|^2 over log-Cholesky coordinates theta of all bodies.

    Every iterate is possible, so nothing has to be rejected. What the torques do not tell is decided by the nearness
    to the model alone; a link of several bodies shares its change among them.

    Args:
        root: square root of the information on the P parameters: 10 per link, then those of the joints.
        target: `root` times the best parameters.
        bodies: all bodies that move; those without mass stay without.
        extras: the parameters of the joints.
        links: number of links.
        prior_deviation: standard deviation of theta: 0.5 lets a mass easily become 2.7 times as large. Larger follows
            the data further where they say little.
    """
    massive = tuple(body for body in bodies if body.nominal.mass > 0.0)
    roots = [body.pose.matrix @ square_root(body.nominal) for body in massive]
    width = _COUNT * len(massive)

    def parameters(x: Float64[np.ndarray, "X"]) -> Float64[np.ndarray, "P"]:
        full = np.zeros((links, _COUNT))
        for number, (body, factor) in enumerate(zip(massive, roots, strict=True)):
            full[body.link] += parameters_of(deformed(factor, x[_COUNT * number : _COUNT * (number + 1)]))
        return np.concatenate([full.ravel(), x[width:]])

    def slopes(x: Float64[np.ndarray, "X"]) -> Float64[np.ndarray, "P X"]:
        result = np.zeros((_COUNT * links + extras.start.size, x.size))
        for number, (body, factor) in enumerate(zip(massive, roots, strict=True)):
            own = slice(_COUNT * number, _COUNT * (number + 1))
            into = slice(_COUNT * body.link, _COUNT * (body.link + 1))
            result[into, own] = parameters_of(deformed_slopes(factor, x[own])).T
        result[_COUNT * links :, width:] = np.eye(extras.start.size)
        return result

    center = np.concatenate([np.zeros(width), extras.start])
    weight = 1.0 / np.concatenate([np.full(width, prior_deviation), extras.deviation])
    low = np.concatenate([np.full(width, -np.inf), extras.low])
    x = np.maximum(center, low)
    # Precise torques make a narrow curved valley; the way into it is wide while they count for less.
    for trust in _TRUST:
        x = _minimize(parameters, slopes, trust * root, trust * target, _Prior(center, weight, low), x)
    inertials = tuple(
        inertial_from(deformed(square_root(body.nominal), x[_COUNT * number : _COUNT * (number + 1)]))
        for number, body in enumerate(massive)
    )
    return Consistent(massive, inertials, np.asarray(x[width:]))


def _minimize(
    parameters: Callable[[Float64[np.ndarray, "X"]], Float64[np.ndarray, "P"]],
    slopes: Callable[[Float64[np.ndarray, "X"]], Float64[np.ndarray, "P X"]],
    root: Float64[np.ndarray, "R P"],
    target: Float64[np.ndarray, "R"],
    prior: _Prior,
    start: Float64[np.ndarray, "X"],
) -> Float64[np.ndarray, "X"]:
    """Levenberg-Marquardt with lower bounds; steps are short in the prior's metric."""

    def residual(x: Float64[np.ndarray, "X"]) -> Float64[np.ndarray, "M"]:
        return np.concatenate([root @ parameters(x) - target, prior.weight * (x - prior.center)])

    x, left = start, residual(start)
    cost, damping = float(left @ left), 1.0
    for _ in range(_ITERATIONS):
        matrix = np.vstack([root @ slopes(x), np.diag(prior.weight)])
        gradient = matrix.T @ left
        free = np.flatnonzero((x > prior.low) | (gradient < 0.0))
        normal = (matrix.T @ matrix)[np.ix_(free, free)]
        before = cost
        while cost >= before and damping < _MOST_DAMPING:
            step = np.linalg.solve(normal + damping * np.diag(prior.weight[free] ** 2), -gradient[free])
            tried = x.copy()
            tried[free] = np.maximum(x[free] + step, prior.low[free])
            new = residual(tried)
            if float(new @ new) < cost:
                x, left, cost = tried, new, float(new @ new)
                damping = max(0.2 * damping, 1e-12)
            else:
                damping *= 5.0
        if before - cost <= _ENOUGH * before:
            break
    return x
