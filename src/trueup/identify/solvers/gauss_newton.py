"""Bounded Levenberg-Marquardt with batched finite differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64
from scipy.optimize import lsq_linear

from trueup.errors import DataError

Residuals = Callable[[Float64[np.ndarray, "C P"]], Float64[np.ndarray, "C N"]]
PriorWeight = Callable[[Float64[np.ndarray, "N"]], float]

# How much more and less damping than the last good one is tried at once: one batch keeps all threads busy.
_DAMPINGS = (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0)
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e9


@dataclass(frozen=True)
class GaussNewtonSettings:
    """How to search.

    Attributes:
        max_iterations: at most this many Jacobians.
        steps: sizes of the finite differences in z, one stage after the other. The first is coarse, so that stiction
            and quantized delays show a slope at all; the last decides the accuracy.
        tolerance: a stage ends when an iteration lowers the cost by less than this share.
        max_step: largest change of a parameter per iteration, in z; the model is linear only nearby.
        loss: `linear` for least squares, `soft_l1` to let single bad windows count less.
        loss_scale: residuals above this many robust standard deviations count as outliers, `soft_l1` only.
    """

    max_iterations: int = 40
    steps: tuple[float, ...] = (0.02, 0.002)
    tolerance: float = 1e-4
    max_step: float = 1.5
    loss: Literal["linear", "soft_l1"] = "linear"
    loss_scale: float = 3.0


@dataclass
class GaussNewtonState:
    """Where a search stands; `to_json` and `from_json` carry it over an interruption.

    Attributes:
        z: best parameters so far, (P,).
        cost: their cost, prior included.
        square: sum of squares of their residual alone.
        damping: of the last good step.
        stage: index into the steps.
        iteration: Jacobians so far.
        history: cost after each iteration.
        reason: why the search ended, empty while it goes on.
    """

    z: Float64[np.ndarray, "P"]
    cost: float = np.inf
    square: float = np.inf
    damping: float = 1e-2
    stage: int = 0
    iteration: int = 0
    history: list[float] = field(default_factory=list)
    reason: str = ""

    def to_json(self) -> dict[str, Any]:
        """JSON types only."""
        return {**vars(self), "z": self.z.tolist()}

    @staticmethod
    def from_json(tree: dict[str, Any]) -> GaussNewtonState:
        """What `to_json` wrote."""
        return GaussNewtonState(**{**tree, "z": np.array(tree["z"], dtype=np.float64)})


class GaussNewton:
    """Least squares over a batch of simulations.

    Minimizes sum(rho(r(z))) + w * sum(((z - mean) / std)^2) within bounds, with w the weight of one observation.
    Each iteration evaluates P + 1 candidates for the Jacobian and six steps of different damping in one further
    batch. A candidate whose residual is not finite loses; the search goes on.

    Args:
        residuals: candidates in, residuals out.
        low: lower bounds, (P,).
        high: upper bounds, (P,).
        state: where to start.
        prior_mean: (P,).
        prior_std: (P,), infinite for none.
        prior_weight: residual -> variance of one independent observation in it; what the prior is weighed against.
        settings: how to search.

    Attributes:
        residual: at the best parameters, None before the first step.
        start_cost: sum of squares at the start, None before the first step.
    """

    def __init__(
        self,
        residuals: Residuals,
        low: Float64[np.ndarray, "P"],
        high: Float64[np.ndarray, "P"],
        state: GaussNewtonState,
        *,
        prior_mean: Float64[np.ndarray, "P"],
        prior_std: Float64[np.ndarray, "P"],
        prior_weight: PriorWeight,
        settings: GaussNewtonSettings | None = None,
    ) -> None:
        self._residuals = residuals
        self.low, self.high = low, high
        self.state = state
        self._mean, self._precision = prior_mean, prior_std**-2.0
        self._prior_weight = prior_weight
        self.settings = settings or GaussNewtonSettings()
        self.residual: Float64[np.ndarray, "N"] | None = None
        self.start_cost: float | None = None
        self._outlier = np.inf

    @property
    def done(self) -> bool:
        """Whether the search has ended."""
        return bool(self.state.reason)

    def step(self) -> None:
        """One iteration: a Jacobian, and the best of several steps.

        Raises:
            DataError: the start itself cannot be simulated.
        """
        state = self.state
        r = self._start() if self.residual is None else self.residual
        if self.start_cost is None:
            self.start_cost = float(r @ r)
        # What counts as an outlier shrinks with the residual; within an iteration it is fixed.
        self._outlier = self.settings.loss_scale * 1.4826 * float(np.median(np.abs(r))) + 1e-300
        weight = self._prior_weight(r)
        state.cost = self._cost(r, state.z, weight)
        jacobian = self.jacobian(self.settings.steps[state.stage])
        root = np.sqrt(self._loss_weights(r))
        jw, rw = jacobian * root, r * root
        normal = jw @ jw.T + weight * np.diag(self._precision)
        gradient = jw @ rw + weight * self._precision * (state.z - self._mean)
        dampings = [min(max(state.damping * f, _LEAST_DAMPING), _MOST_DAMPING) for f in _DAMPINGS]
        z = np.array([state.z + self._bounded_step(normal, gradient, damping) for damping in dampings])
        tried = self._residuals(z)
        costs = np.array([self._cost(own, row, weight) for own, row in zip(tried, z, strict=True)])
        best = int(np.argmin(costs))
        state.iteration += 1
        if costs[best] < state.cost:
            gain = 1.0 - costs[best] / state.cost if state.cost > 0 else 0.0
            state.z, state.cost, state.damping = z[best], float(costs[best]), float(dampings[best])
            self.residual = tried[best]
            finished = bool(gain < self.settings.tolerance)
        else:
            finished = bool(state.damping >= dampings[-1] or dampings[-1] > 1e6)
            state.damping = float(dampings[-1])
        assert self.residual is not None
        state.square = float(self.residual @ self.residual)
        state.history.append(state.cost)
        self._advance(finished=finished)

    def jacobian(self, step: float) -> Float64[np.ndarray, "P N"]:
        """Derivatives of the residual at the present z, one row per parameter, by one-sided differences.

        A parameter at its upper bound is moved down; one whose candidate cannot be simulated is moved the other way,
        and has derivative zero if that fails too.
        """
        z, r = self.state.z, self.residual
        assert r is not None
        signs = np.where(z + step <= self.high, 1.0, -1.0)
        signs[(signs < 0) & (z - step < self.low)] = 1.0
        moved = self._residuals(z + np.diag(signs * step))
        failed = np.flatnonzero(~np.isfinite(moved).all(axis=1))
        if failed.size:
            signs[failed] *= -1.0
            moved[failed] = self._residuals((z + np.diag(signs * step))[failed])
        slopes = (moved - r) / (signs * step)[:, None]
        slopes[~np.isfinite(slopes).all(axis=1)] = 0.0
        return np.asarray(slopes)

    def _start(self) -> Float64[np.ndarray, "N"]:
        r = self._residuals(self.state.z[None])[0]
        if not np.isfinite(r).all():
            raise DataError(
                "the model cannot be simulated at the start of the fit",
                hint="Give a smaller simulation.timestep_s in robot.yaml, or other start values.",
            )
        start: Float64[np.ndarray, "N"] = r
        self.residual = start
        return start

    def _cost(self, r: Float64[np.ndarray, "N"], z: Float64[np.ndarray, "P"], weight: float) -> float:
        if not np.isfinite(r).all():
            return float("inf")
        prior = weight * float(self._precision @ (z - self._mean) ** 2)
        if self.settings.loss == "linear":
            return float(r @ r) + prior
        return float(2 * self._outlier**2 * np.sum(np.sqrt(1 + (r / self._outlier) ** 2) - 1)) + prior

    def _loss_weights(self, r: Float64[np.ndarray, "N"]) -> Float64[np.ndarray, "N"]:
        if self.settings.loss == "linear":
            return np.ones_like(r)
        return np.asarray(1 / np.sqrt(1 + (r / self._outlier) ** 2))

    def _bounded_step(
        self, normal: Float64[np.ndarray, "P P"], gradient: Float64[np.ndarray, "P"], damping: float
    ) -> Float64[np.ndarray, "P"]:
        diagonal = np.diag(normal)
        damped = normal + damping * np.diag(diagonal + 1e-9 * diagonal.max() + 1e-300)
        try:
            root = np.linalg.cholesky(damped)
        except np.linalg.LinAlgError:
            return np.zeros_like(gradient)
        z, most = self.state.z, self.settings.max_step
        # Bounds that nearly touch would be refused; a parameter there stays where it is.
        low = np.minimum(np.maximum(self.low - z, -most), -1e-12)
        high = np.maximum(np.minimum(self.high - z, most), 1e-12)
        target = -np.linalg.solve(root, gradient)
        solution = lsq_linear(root.T, target, bounds=(low, high), method="bvls" if gradient.size < 200 else "trf")
        step: Float64[np.ndarray, "P"] = np.clip(z + solution.x, self.low, self.high) - z
        return step

    def _advance(self, *, finished: bool) -> None:
        state = self.state
        if finished and state.stage + 1 < len(self.settings.steps):
            state.stage, state.damping = state.stage + 1, 1e-2
        elif finished:
            state.reason = "converged"
        if not state.reason and state.iteration >= self.settings.max_iterations:
            state.reason = "iterations"

    def final_jacobian(self) -> Float64[np.ndarray, "P N"]:
        """Derivatives at the best parameters, for the covariance; simulates them again after a resume."""
        if self.residual is None:
            self._start()
        return self.jacobian(self.settings.steps[-1])
