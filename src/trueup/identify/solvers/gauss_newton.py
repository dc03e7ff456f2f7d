"""Bounded Levenberg-Marquardt with batched finite differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int
from scipy.optimize import lsq_linear

from trueup.core.config import build
from trueup.errors import DataError
from trueup.identify.solvers.loss import Loss, LossName
from trueup.identify.solvers.space import Space

Residuals = Callable[[Float64[np.ndarray, "C P"]], Float64[np.ndarray, "C N"]]
Support = Callable[[int], Bool[np.ndarray, "N"]]
PriorWeight = Callable[[Float64[np.ndarray, "N"]], float]

# How much more and less damping than the last good one is tried at once; the next group only if none goes down.
_DAMPINGS = ((0.1, 1.0, 10.0), (1e2, 1e3, 1e4), (1e6, 1e8))
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e9
# A Jacobian serves again where the cost fell as it had said, so many times at most.
_TRUSTED = 0.75
_REUSES = 2
# A Jacobian from as near as this, in z, is that of the end.
_NEARBY = 0.01
_EARLY_PRIOR = 0.01
# Dampings of the last steps, how many there are at most, and the gain that is too small to go on, in observations.
_UNDAMPED = (1e-12, 1e-7, 1e-4, 1e-2)
_POLISHED, _SETTLED = 6, 0.05
# An undamped step that keeps so much of its promise needs no other beside it.
_KEPT = 0.5


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
    loss: LossName = "linear"
    loss_scale: float = 3.0


@dataclass
class GaussNewtonState:
    """Where a search stands; `to_json` and `from_json` carry it over an interruption.

    Attributes:
        z: best parameters so far, (P,).
        cost: their cost, prior included.
        square: sum of squares of their residual alone.
        start_cost: cost of the residual at the start, without the prior.
        damping: of the last good step.
        stage: index into the steps.
        iteration: Jacobians so far.
        history: cost after each iteration.
        reason: why the search ended, empty while it goes on.
        jacobian_z: where the last Jacobian was taken, (P,); None before the first of a stage.
    """

    z: Float64[np.ndarray, "P"]
    cost: float = np.inf
    square: float = np.inf
    start_cost: float = np.inf
    damping: float = 1e-2
    stage: int = 0
    iteration: int = 0
    history: list[float] = field(default_factory=list)
    reason: str = ""
    jacobian_z: Float64[np.ndarray, "P"] | None = None

    def to_json(self) -> dict[str, Any]:
        """JSON types only."""
        place = self.jacobian_z
        return {**vars(self), "z": self.z.tolist(), "jacobian_z": None if place is None else place.tolist()}

    @staticmethod
    def from_json(tree: dict[str, Any], space: Space, settings: GaussNewtonSettings) -> GaussNewtonState:
        """What `to_json` wrote.

        Raises:
            ConfigError: a value of another kind.
            ValueError: it is no state of a search in this space.
        """
        arrays = {
            name: None if tree[name] is None else np.array(tree[name], dtype=np.float64) for name in ("z", "jacobian_z")
        }
        state = build(GaussNewtonState, {**tree, **arrays}, "solver")
        for place in (state.z, state.z if state.jacobian_z is None else state.jacobian_z):
            if place.shape != space.start.shape or not np.array_equal(space.clip(place), place):
                raise ValueError(f"{place.tolist()} is out of bounds")
        if not 0 <= state.stage < len(settings.steps):
            raise ValueError(f"there is no stage {state.stage}")
        return state


@dataclass(frozen=True, eq=False)
class _Move:
    """The best of several steps from one place.

    Attributes:
        step: along the derivatives, (P,).
        z: where it leads, (P,).
        residual: there, (N,).
        cost: there.
        damping: of the step.
        expected: by how much the cost falls if the residual is linear.
    """

    step: Float64[np.ndarray, "P"]
    z: Float64[np.ndarray, "P"]
    residual: Float64[np.ndarray, "N"]
    cost: float
    damping: float
    expected: float


class GaussNewton:
    """Least squares over a batch of simulations.

    Minimizes sum(rho(r(z))) + w * sum(((z - mean) / std)^2) within bounds, with w the weight of one observation.
    Each iteration evaluates P candidates for the Jacobian, and steps of different damping, three in a batch, until
    one goes down. Where the cost falls as the Jacobian had said, that one is corrected by what was seen (Broyden
    1965, "A class of methods for solving nonlinear simultaneous equations") and serves again. A candidate whose
    residual is not finite loses; the search goes on.

    Masses, gains and friction enter the forces linearly, and the motion nearly so; their logarithms do not. So steps
    are taken in the values of logarithmic parameters: from five times too much, one step leads to a fifth.

    Args:
        residuals: candidates in, residuals out.
        low: lower bounds, (P,).
        high: upper bounds, (P,).
        state: where to start.
        prior_mean: (P,).
        prior_std: (P,), infinite for none.
        prior_weight: residual -> variance of one independent observation in it; what the prior is weighed against.
        logarithmic: which z are logarithms, (P,); none if not given.
        colors: parameters of one color change different residuals and share a candidate of the Jacobian, (P,); each
            has its own if not given.
        support: index of a parameter that shares its color -> which residuals it can change, (N,).
        slopes: a cheaper approximation of `residuals`, of which derivatives are taken; `residuals` itself if None. The
            search ends at a minimum of `residuals` all the same, since that is where no step goes down.
        settings: how to search.

    Attributes:
        residual: at the best parameters, None before the first step.
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
        logarithmic: Bool[np.ndarray, "P"] | None = None,
        colors: Int[np.ndarray, "P"] | None = None,
        support: Support | None = None,
        slopes: Residuals | None = None,
        settings: GaussNewtonSettings | None = None,
    ) -> None:
        self._residuals, self._slopes = residuals, slopes or residuals
        self._colors = np.arange(low.size) if colors is None else colors
        self._support = support or (lambda _index: np.ones(0, dtype=bool))
        self.low, self.high = low, high
        self.state = state
        self._mean, self._precision = prior_mean, prior_std**-2.0
        self._prior_weight = prior_weight
        self._logarithmic = np.zeros(low.size, dtype=bool) if logarithmic is None else logarithmic
        self.settings = settings or GaussNewtonSettings()
        self.residual: Float64[np.ndarray, "N"] | None = None
        self._loss = Loss()
        self._latest: Float64[np.ndarray, "P N"] | None = None

    @property
    def done(self) -> bool:
        """Whether the search has ended."""
        return bool(self.state.reason)

    @property
    def square(self) -> float:
        """Sum of squares at the best parameters so far."""
        return float("inf") if self.residual is None else float(self.residual @ self.residual)

    def begin(self) -> Float64[np.ndarray, "N"]:
        """The residual at the best parameters so far; at the start, it is simulated once.

        Raises:
            DataError: the start itself cannot be simulated.
        """
        return self._start() if self.residual is None else self.residual

    def step(self) -> None:
        """One iteration: a Jacobian, and the steps that it is good for.

        Raises:
            DataError: the start itself cannot be simulated.
        """
        state = self.state
        r = self.begin()
        # What counts as an outlier shrinks with the residual; within an iteration it is fixed.
        self._loss = self.loss_of(r)
        if state.iteration == 0:
            state.start_cost = self._loss.cost(r)
        weight = self._prior_weight(r)
        early = state.stage + 1 < len(self.settings.steps)
        if early:
            # Far from the data everything looks like noise, and the prior would hold the search where it is.
            weight *= _EARLY_PRIOR
        state.cost = self._cost(r, state.z, weight)
        jacobian = self.jacobian(self.settings.steps[state.stage])
        self._latest, state.jacobian_z = jacobian, state.z
        finished = False
        for reused in range(1 + _REUSES):
            move = self._best_move(jacobian, weight, fresh=reused == 0)
            if move is None:
                finished = reused == 0 or early
                break
            gain = 1.0 - move.cost / state.cost
            trusted = state.cost - move.cost > _TRUSTED * move.expected
            jacobian = self._corrected(jacobian, move)
            state.z, state.cost, state.damping, self.residual = move.z, move.cost, move.damping, move.residual
            # Only a new Jacobian can say that nothing is left to gain.
            finished = gain < self.settings.tolerance and (reused == 0 or early)
            if finished or not trusted:
                break
        state.iteration += 1
        state.square = self.square
        state.history.append(state.cost)
        self._advance(finished=finished)

    def renew(self) -> None:
        """Simulate the best parameters again, since the residuals of all have changed; a new Jacobian will be taken."""
        self.residual, self._latest, self.state.jacobian_z = None, None, None
        self._start()
        self.state.square = self.square

    def settle(self, z: Float64[np.ndarray, "P"]) -> None:
        """End a stage at these parameters, since steps no longer lead anywhere."""
        self.state.z = z
        self.renew()
        self._advance(finished=True)

    def polish(self, jacobian: Float64[np.ndarray, "P N"], weight: float | None = None) -> Float64[np.ndarray, "P N"]:
        """Go on with given derivatives to the minimum that they see, without holding back where they are small.

        Along what the data leave open, a search ends anywhere, since its cost hardly changes; only the prior decides
        there. Ends when a step lowers the cost, or promises to, by less than a twentieth of one observation.

        Args:
            jacobian: derivatives at the present z, (P, N).
            weight: of the prior, where the present residual does not tell it; as usual if None.

        Returns:
            Derivatives at the new one, in agreement with the steps, (P, N).

        Raises:
            DataError: the model cannot be simulated here.
        """
        state = self.state
        if self.residual is None:
            self._start()
        assert self.residual is not None
        self._loss = self.loss_of(self.residual)
        weight = self._prior_weight(self.residual) if weight is None else weight
        state.cost = self._cost(self.residual, state.z, weight)
        for _ in range(_POLISHED):
            normal, gradient = self._normal(jacobian, weight)
            if _expected(normal, gradient, self._bounded_step(normal, gradient, _UNDAMPED[0])) < _SETTLED * weight:
                break
            move = self._tried(normal, gradient, _UNDAMPED[:1], weight)
            if not state.cost - move.cost > _KEPT * move.expected:
                move = min(move, self._tried(normal, gradient, _UNDAMPED[1:], weight), key=lambda own: own.cost)
            if move.cost >= state.cost:
                break
            gained = state.cost - move.cost
            jacobian = self._corrected(jacobian, move)
            state.z, state.cost, self.residual = move.z, move.cost, move.residual
            if gained < _SETTLED * weight:
                break
        state.square = float(self.residual @ self.residual)
        return jacobian

    def _best_move(self, jacobian: Float64[np.ndarray, "P N"], weight: float, *, fresh: bool) -> _Move | None:
        """The best of several steps, None if none goes down; with an old Jacobian, only if it promises enough."""
        state = self.state
        normal, gradient = self._normal(jacobian, weight)
        for factors in _DAMPINGS if fresh else _DAMPINGS[:1]:
            dampings = [min(max(state.damping * factor, _LEAST_DAMPING), _MOST_DAMPING) for factor in factors]
            if not fresh:
                steps = [self._bounded_step(normal, gradient, damping) for damping in dampings]
                if max(_expected(normal, gradient, step) for step in steps) < self.settings.tolerance * state.cost:
                    return None
            move = self._tried(normal, gradient, dampings, weight)
            if move.cost < state.cost:
                return move
        return None

    def _tried(
        self,
        normal: Float64[np.ndarray, "P P"],
        gradient: Float64[np.ndarray, "P"],
        dampings: Sequence[float],
        weight: float,
    ) -> _Move:
        """The best of the steps with these dampings."""
        steps = [self._bounded_step(normal, gradient, damping) for damping in dampings]
        z = np.array([self._moved(step) for step in steps])
        tried = self._residuals(z)
        costs = [self._cost(own, row, weight) for own, row in zip(tried, z, strict=True)]
        best = int(np.argmin(costs))
        expected = _expected(normal, gradient, steps[best])
        return _Move(steps[best], z[best], tried[best], costs[best], dampings[best], expected)

    def _normal(
        self, jacobian: Float64[np.ndarray, "P N"], weight: float
    ) -> tuple[Float64[np.ndarray, "P P"], Float64[np.ndarray, "P"]]:
        """Half of the curvature and of the slope of the cost."""
        r = self.residual
        assert r is not None
        jw, rw = jacobian, r
        if self.settings.loss != "linear":
            root = np.sqrt(self._loss.weights(r))
            jw, rw = jacobian * root, r * root
        normal = jw @ jw.T + weight * np.diag(self._precision)
        return normal, jw @ rw + weight * self._precision * (self.state.z - self._mean)

    def _moved(self, step: Float64[np.ndarray, "P"]) -> Float64[np.ndarray, "P"]:
        z = self.state.z + np.where(self._logarithmic, np.log1p(np.where(self._logarithmic, step, 0.0)), step)
        return np.asarray(np.clip(z, self.low, self.high))

    def _corrected(self, jacobian: Float64[np.ndarray, "P N"], move: _Move) -> Float64[np.ndarray, "P N"]:
        """The Jacobian at the end of a move, in agreement with what the move has shown."""
        assert self.residual is not None
        unseen = move.residual - self.residual - move.step @ jacobian
        weighted = np.einsum("pn,pn->p", jacobian, jacobian) * move.step
        corrected = np.outer(weighted / (weighted @ move.step + 1e-300), unseen)
        corrected += jacobian
        # Derivatives by a logarithm grow with the value.
        corrected *= np.where(self._logarithmic, np.exp(move.z - self.state.z), 1.0)[:, None]
        return corrected

    def jacobian(self, step: float) -> Float64[np.ndarray, "P N"]:
        """Derivatives of the residual at the present z, one row per parameter, by one-sided differences.

        A parameter at its upper bound is moved down; one whose candidate cannot be simulated is moved the other way,
        and has derivative zero if that fails too.
        """
        return self._differences(self.state.z, step)

    def central_jacobian(self, step: float) -> Float64[np.ndarray, "P N"]:
        """The same by central differences, whose error is of order step^2; one-sided next to a bound.

        Raises:
            DataError: the model cannot be simulated here.
        """
        if self.residual is None:
            self._start()
        return self._differences(self.state.z, step, central=True)

    def _differences(
        self, z: Float64[np.ndarray, "P"], step: float, *, central: bool = False
    ) -> Float64[np.ndarray, "P N"]:
        signs = np.where(z + step <= self.high, 1.0, -1.0)
        signs[(signs < 0) & (z - step < self.low)] = 1.0
        # One row per color: parameters of one color change different residuals.
        members = np.equal.outer(np.unique(self._colors), self._colors)
        first = members.argmax(axis=0)
        moved, base = self._moved_and_base(z, members * signs * step)
        failed = ~np.isfinite(moved).all(axis=1)
        if failed.any():
            signs[members[failed].any(axis=0)] *= -1.0
            moved[failed] = self._slopes((z + members * signs * step)[failed])
        slopes = moved[first] - base
        slopes /= (signs * step)[:, None]
        if central:
            inside = (z - signs * step >= self.low) & (z - signs * step <= self.high)
            rows = np.flatnonzero([bool(inside[own].all()) for own in members])
            if rows.size:
                back = np.full_like(moved, np.nan)
                back[rows] = self._slopes((z - members * signs * step)[rows])
                other = (base - back[first]) / (signs * step)[:, None]
                both = np.isfinite(other).all(axis=1) & ~failed[first]
                slopes[both] = 0.5 * (slopes[both] + other[both])
        for index in np.flatnonzero(members[first].sum(axis=1) > 1):
            slopes[index, ~self._support(int(index))] = 0.0
        slopes[~np.isfinite(slopes).all(axis=1)] = 0.0
        return np.asarray(slopes)

    def _moved_and_base(
        self, z: Float64[np.ndarray, "P"], moves: Float64[np.ndarray, "C P"]
    ) -> tuple[Float64[np.ndarray, "C N"], Float64[np.ndarray, "N"]]:
        """What slopes are taken of, moved and not."""
        if self._slopes is self._residuals and self.residual is not None and np.array_equal(z, self.state.z):
            return self._slopes(z + moves), self.residual
        found = self._slopes(np.concatenate([z[None], z + moves]))
        return found[1:], found[0]

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
        return self._loss.cost(r) + weight * float(self._precision @ (z - self._mean) ** 2)

    def loss_of(self, residual: Float64[np.ndarray, "N"]) -> Loss:
        """How the residuals count near a place where they are these."""
        return Loss.of(residual, self.settings.loss, self.settings.loss_scale)

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
        low, high = (np.where(self._logarithmic, np.expm1(bound), bound) for bound in (low, high))
        target = -np.linalg.solve(root, gradient)
        solution = lsq_linear(root.T, target, bounds=(low, high), method="bvls" if gradient.size < 200 else "trf")
        step: Float64[np.ndarray, "P"] = np.clip(solution.x, low, high)
        return step

    def _advance(self, *, finished: bool) -> None:
        state = self.state
        if finished and state.stage + 1 < len(self.settings.steps):
            state.stage, state.damping, state.jacobian_z = state.stage + 1, 1e-2, None
        elif finished:
            state.reason = "converged"
        if not state.reason and state.iteration >= self.settings.max_iterations:
            state.reason = "iterations"

    def final_jacobian(self) -> Float64[np.ndarray, "P N"]:
        """Derivatives at the best parameters, for the covariance; simulates them again where the last are from afar."""
        if self.residual is None:
            self._start()
        state, step = self.state, self.settings.steps[-1]
        place, last = state.jacobian_z, state.stage + 1 == len(self.settings.steps)
        if place is None or not last or np.abs(state.z - place).max() >= _NEARBY:
            return self.jacobian(step)
        if self._latest is None:
            # A resumed search has the same derivatives as one that was not interrupted.
            self._latest = self._differences(place, step)
        return self._latest

    def promised(self, jacobian: Float64[np.ndarray, "P N"]) -> float:
        """By what share one more step would lower the cost if the residual were linear: hardly any at a minimum."""
        r = self.residual
        assert r is not None
        self._loss = self.loss_of(r)
        weight = self._prior_weight(r)
        normal, gradient = self._normal(jacobian, weight)
        step = self._bounded_step(normal, gradient, _LEAST_DAMPING)
        return _expected(normal, gradient, step) / max(self._cost(r, self.state.z, weight), 1e-300)


def _expected(
    normal: Float64[np.ndarray, "P P"], gradient: Float64[np.ndarray, "P"], step: Float64[np.ndarray, "P"]
) -> float:
    """By how much the cost falls in a step if the residual is linear."""
    return -float(2.0 * gradient @ step + step @ normal @ step)
