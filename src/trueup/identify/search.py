"""One solver on one problem, driven to its end, with a checkpoint after every iteration."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from trueup.core.config import build
from trueup.core.time_limit import OutOfTime, TimeLimit
from trueup.errors import DataError
from trueup.identify.costs import PenalizedSquares, joint_errors, roles_of
from trueup.identify.problem import Problem
from trueup.identify.sensitivity import agreed, jitter_of, verified
from trueup.identify.solution import Checkpoint, OnProgress, Progress, Solution, SolveSettings, fingerprint_of
from trueup.identify.solvers import (
    AskTell,
    CmaEs,
    Evaluation,
    EvolutionStrategy,
    GaussNewton,
    GaussNewtonState,
    Loss,
    Space,
    Step,
    minimize,
)
from trueup.identify.start import idle_names
from trueup.identify.uncertainty import as_least_squares, noise_of

# A search that takes less than this off the start's cost has not moved; at a minimum no more than this is to be gained.
HARDLY = 0.01
# Derivatives over a distance so many times as long differ by less than this share of their size, or show no slope.
_LONGER, _SAME = 10.0, 0.5
_STEP = ("evaluations", "cost", "seconds")
# Of central differences, in z: of those that lead, and of the two that have to agree.
_CERTAIN_STEP, _TWO_STEPS = 0.004, (0.01, 0.002)
# Descents to the minimum of verified derivatives, at most; after how many of them these are taken anew; and the promise
# of a further one that is not worth it, in observations.
_POLISHED, _FINISHED, _AGAIN, _SETTLED = 9, 3, 3, 0.3
# Where given derivatives take away more than half of the squares, they are those of another place, and taken anew.
_FAR_AWAY = 2.0
# How often windows begin anew while another way to simulate is brought to its minimum.
_RESTARTS = 3
# A search whose windows begin anew with each iteration ends where so many have not lowered the squares by this share.
_LAST, _LOWER = 4, 0.01
# A new look at the starts that lowers the cost by less than so many observations is the last one.
_GAINED = 1.0


class Stopwatch:
    """Seconds of a search, those before an interruption included."""

    def __init__(self) -> None:
        self._began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """So far [s]."""
        return time.perf_counter() - self._began

    def forward(self, seconds: float) -> None:
        """Count at least so many seconds that were spent before."""
        self._began = min(self._began, time.perf_counter() - seconds)


@dataclass(frozen=True, eq=False)
class Descent:
    """Where Gauss-Newton ended.

    Attributes:
        solution: the end.
        gained: share that the search took off the cost of the residual at its start.
        search: in its last state.
    """

    solution: Solution
    gained: float
    search: GaussNewton


def _level(squares: Sequence[float]) -> bool:
    """Whether the last sums of squares are no lower than those before."""
    before, last = squares[:-_LAST], squares[-_LAST:]
    return bool(before) and min(last) > (1.0 - _LOWER) * min(before)


def space_of(problem: Problem) -> Space:
    """Where a solver may look for the free parameters, in z."""
    low, high = problem.parameters.bounds
    free = problem.parameters.free
    return Space(low, high, problem.parameters.start, np.ones(len(free)), tuple(item.name for item in free))


class Search:
    """A problem with settings, checkpoint and clock, for one solver after the other.

    Args:
        problem: what to solve; its count of evaluations goes on from that of the checkpoint.
        settings: how to search.
        clock: shared by searches that follow each other.
        checkpoint: path that the name of the phase is put into; None keeps nothing.
        on_progress: called after every iteration.
        limit: when to end with the best so far.
    """

    def __init__(
        self,
        problem: Problem,
        settings: SolveSettings,
        clock: Stopwatch,
        *,
        checkpoint: Path | None,
        on_progress: OnProgress | None,
        limit: TimeLimit | None = None,
    ) -> None:
        self.problem, self.settings, self.clock = problem, settings, clock
        self._checkpoint, self._on_progress, self._limit = checkpoint, on_progress, limit

    def moved_to(self, problem: Problem) -> Search:
        """The same for the problem with another start; time and checkpoints are shared."""
        return Search(
            problem,
            self.settings,
            self.clock,
            checkpoint=self._checkpoint,
            on_progress=self._on_progress,
            limit=self._limit,
        )

    def gauss_newton(self, phase: str = "gauss-newton", slopes: Float64[np.ndarray, "P N"] | None = None) -> Descent:
        """By derivatives.

        Args:
            phase: name of its checkpoint.
            slopes: derivatives that another search has ended with, near the start: they lead to the minimum, and those
                of the last stage are taken there; None begins with the first stage.

        Raises:
            DataError: the start cannot be simulated.
        """
        store, kept = self._open(phase)
        state = GaussNewtonState(self.problem.parameters.start)
        # Stage, sum of squares and parameters where windows began anew.
        ends: list[tuple[int, float, Float64[np.ndarray, "P"]]] = []
        if kept:
            with store.reading():
                ends = [(int(stage), float(square), np.array(z)) for stage, square, z in kept.get("ends", [])]
                state = GaussNewtonState.from_json(kept["solver"], space_of(self.problem), self.settings.gauss_newton)
        search = self._derivatives(state)
        if not search.done:
            begun = search.begin()  # in any case: a search without time ends where it began
            if slopes is not None and not kept and slopes.shape == (state.z.size, begun.size):
                self._led(search, slopes)
        while not search.done:
            try:
                with self.problem.ending(self._limit, keep=state.z.size):  # derivatives at its end
                    search.step()
                    if not state.reason and self.problem.restart(state.z):
                        search.renew()
                        # Each change of the starts moves the minimum a little, so that steps always find a gain.
                        ends = [*(end for end in ends if end[0] == state.stage), (state.stage, state.square, state.z)]
                        *_, best = min(ends, key=lambda end: end[1])
                        if _level([square for _, square, _ in ends]):
                            self.problem.restart(best)
                            search.settle(best)
            except OutOfTime:
                state.reason, state.square = "time", search.square
            if self._left_s() <= 0 and not search.done:
                state.reason = "time"
            kept_ends = [(stage, square, z.tolist()) for stage, square, z in ends]
            store.save({"solver": state.to_json(), "ends": kept_ends, **self._spent()})
            self._say(phase, state.iteration, float(np.sqrt(state.square)))
        jacobian = search.final_jacobian()
        solution = self._solution("gauss-newton", state.reason, state.iteration, search, jacobian)
        assert search.residual is not None
        left = search.loss_of(search.residual).cost(search.residual)
        return Descent(solution, 1.0 - left / max(state.start_cost, 1e-300), search)

    def _led(self, search: GaussNewton, slopes: Float64[np.ndarray, "P N"]) -> None:
        """Go to the minimum that given derivatives see, and on to the last stage."""
        state = search.state
        try:
            with self.problem.ending(self._limit):
                search.polish(slopes)
        except OutOfTime:
            state.reason, state.square = "time", search.square
        state.stage = len(self.settings.gauss_newton.steps) - 1

    def certain_jacobian(self, z: Float64[np.ndarray, "P"]) -> Float64[np.ndarray, "P N"]:
        """Derivatives of the residual by central differences, one row per parameter, for what is said of certainty.

        Their error is of the second order of a step of 0.4 %, and small against the derivatives; what is left of it
        where derivatives cancel is found by `sensitivity.verified`.

        Raises:
            DataError: the model cannot be simulated there.
        """
        return self._derivatives(GaussNewtonState(z)).central_jacobian(_CERTAIN_STEP)

    def polished(
        self, z: Float64[np.ndarray, "P"], jacobian: Float64[np.ndarray, "P N"], weight: float
    ) -> tuple[Float64[np.ndarray, "P"], Float64[np.ndarray, "N"]]:
        """The minimum that given derivatives lead to from z, (P,), and the residual there, (N,).

        Args:
            z: where to begin, (P,).
            jacobian: derivatives near z, (P, N).
            weight: variance of one observation at the minimum, which the prior is weighed against.

        Raises:
            DataError: the model cannot be simulated at z, or has other samples.
        """
        newton = self._derivatives(GaussNewtonState(z))
        begun = newton.begin()
        if begun.shape != jacobian.shape[1:]:
            raise DataError("other samples", got=begun.size, expected=jacobian.shape[1])
        newton.polish(jacobian, weight)
        if begun @ begun > _FAR_AWAY * newton.state.square:
            newton.polish(newton.jacobian(self.settings.gauss_newton.steps[-1]), weight)
        for _ in range(_RESTARTS):
            before = newton.state.cost
            if not self.problem.restart(newton.state.z, coarse=False):
                break
            newton.renew()
            newton.polish(jacobian, weight)
            if before - newton.state.cost < _GAINED * weight:
                break
        assert newton.residual is not None
        return newton.state.z, newton.residual

    def certain(self, z: Float64[np.ndarray, "P"]) -> dict[str, Any]:
        """`z`, `residual`, `jacobian` and `rms` of a solution with verified derivatives, at the minimum that these see.

        Where derivatives were those of a larger time step, they lead near the minimum, and those of the step itself to
        it: along what motions hardly show, the difference would count. What is told of certainty are derivatives that
        were taken there, over two distances, and not those that a search has mended by its steps, which look like
        information along what the motions do not show.

        Args:
            z: where a search has ended, (P,).

        Raises:
            DataError: the model cannot be simulated there.
        """
        search = self
        near, jacobian = self._settled(z, _POLISHED)
        newton = near
        if self.problem.coarse is not None:
            alone, say = self.problem.alone(), self._on_progress
            search = Search(alone, self.settings, self.clock, checkpoint=None, on_progress=say)
            newton, _ = search._settled(near.state.z, _FINISHED, jacobian)
            self.problem.starts = search.problem.starts
        # Errors of derivatives over two distances, and at two time steps, are others.
        first, second = _TWO_STEPS
        jacobian = agreed(newton.central_jacobian(first), near.central_jacobian(second))
        assert newton.residual is not None
        weight = self._weight(newton.residual)
        jitter = jitter_of(search.problem, newton.state.z)
        newton.polish(verified(search.problem, newton.state.z, jacobian, weight, jitter=jitter, quick=True))
        rms = float(np.linalg.norm(newton.residual))
        search._say("intervals", 1, rms)
        jacobian = verified(search.problem, newton.state.z, jacobian, weight, jitter=jitter)
        counted, factor = as_least_squares(self.problem, newton.residual, self._loss(newton.residual))
        return {"z": newton.state.z, "residual": counted, "jacobian": jacobian * factor, "rms": rms}

    def _settled(
        self, z: Float64[np.ndarray, "P"], rounds: int, jacobian: Float64[np.ndarray, "P N"] | None = None
    ) -> tuple[GaussNewton, Float64[np.ndarray, "P N"]]:
        """A search at the minimum near z, and derivatives that agree with its last steps; it begins with given ones."""
        newton, fresh = self._derivatives(GaussNewtonState(z)), jacobian is None
        if jacobian is None:
            jacobian = newton.central_jacobian(_CERTAIN_STEP)
        weight, jitter = self._weight(newton.begin()), jitter_of(self.problem, z)
        for number in range(rounds):
            if number and self.problem.restart(newton.state.z):
                newton.renew()
            # What cancels at one place does not at the next: derivatives are mended before each descent.
            jacobian = verified(self.problem, newton.state.z, jacobian, weight, jitter=jitter, quick=True)
            if number and newton.promised(jacobian) * newton.state.cost < _SETTLED * weight:
                break
            before, jacobian = newton.state.z, newton.polish(jacobian)
            self._say("derivatives", number + 1, float(np.sqrt(newton.state.cost)))
            stuck = np.array_equal(before, newton.state.z)
            if stuck and fresh:
                break  # the same derivatives would lead nowhere once more
            fresh = (stuck or number % _AGAIN == _AGAIN - 1) and number < rounds - 1
            if fresh:
                jacobian = newton.central_jacobian(_CERTAIN_STEP)
        return newton, jacobian

    def at_minimum(self, descent: Descent) -> bool:
        """Whether Gauss-Newton ended at a minimum that its derivatives can see.

        There they show every parameter, promise nothing, and are the same over a longer distance. Where one is missing,
        or an artefact of a jump, there may be a way down that they do not show.
        """
        search, residual = descent.search, descent.search.residual
        assert residual is not None
        jacobian = search.final_jacobian()
        weight = noise_of(self.problem, descent.solution.residual).weight + 1e-100
        if search.promised(jacobian) > HARDLY or idle_names(self.problem, descent.solution.jacobian, weight):
            return False
        longer = search.jacobian(_LONGER * self.settings.gauss_newton.steps[-1])
        away = np.linalg.norm(longer - jacobian, axis=1)
        return bool(np.all(away <= _SAME * np.linalg.norm(jacobian, axis=1)))

    def derivative_free(self, name: str) -> Solution:
        """By ask and tell: `cma-es` or `evolution`.

        Raises:
            DataError: no candidate could be simulated.
        """
        problem, settings, space = self.problem, self.settings, space_of(self.problem)
        store, kept = self._open(name)
        steps: list[Step] = []
        rms, squares = float("inf"), PenalizedSquares(problem)
        solver: AskTell = CmaEs(space, seed=settings.seed)
        if name == "evolution":
            solver = EvolutionStrategy(space, roles_of(problem), seed=settings.seed)
        if kept:
            with store.reading():
                steps = [build(Step, dict(zip(_STEP, step, strict=True)), "history") for step in kept["history"]]
                rms, seen = float(kept["rms"]), kept["observations"]
                squares = PenalizedSquares(problem, None if seen is None else float(seen))
                solver.restore(kept["solver"])
        errors = joint_errors(problem) if name == "evolution" else squares
        lowest = solver.best[1]
        earlier_s = self.clock.seconds - (steps[-1].seconds if steps else 0.0)

        def evaluate(z: Float64[np.ndarray, "C P"]) -> Evaluation:
            nonlocal lowest, rms
            residuals = problem.residuals(z)
            found = errors(z, residuals)
            best = int(np.argmin(np.where(found.failed, np.inf, found.cost)))
            if found.cost[best] < lowest:
                lowest, rms = float(found.cost[best]), float(np.linalg.norm(residuals[best]))
            return found

        def on_step(step: Step) -> None:
            steps.append(step)
            history = [[item.evaluations, item.cost, item.seconds] for item in steps]
            state = {"solver": solver.state(), "history": history, "rms": rms, "observations": squares.observations}
            store.save({**state, **self._spent()})
            self._say(name, len(steps), rms)

        result = minimize(
            solver,
            evaluate,
            on_step=on_step,
            max_evaluations=settings.max_evaluations,
            max_seconds=None if self._left_s() == math.inf else self._left_s() + self.clock.seconds - earlier_s,
            history=tuple(steps),
        )
        if not np.isfinite(result.cost):
            raise DataError("no candidate could be simulated", got=result.stop.text)
        search = self._derivatives(GaussNewtonState(result.z))
        jacobian = search.final_jacobian()
        stop = "converged" if result.stop.kind in ("converged", "stalled") else result.stop.kind
        return self._solution(name, stop, len(steps), search, jacobian)

    def _left_s(self) -> float:
        """Until the search has to end, for one reason or another [s]."""
        own_s, limit = self.settings.max_seconds, self._limit
        own_left = math.inf if own_s is None else own_s - self.clock.seconds
        return min(own_left, math.inf if limit is None else limit.left_s)

    def _open(self, phase: str) -> tuple[Checkpoint, dict[str, Any]]:
        """The checkpoint of a phase and what it holds; clock and count of evaluations go on from there."""
        path = self._checkpoint
        if path is None:
            return Checkpoint(None, ""), {}
        store = Checkpoint(path.with_name(f"{path.stem}.{phase}.json"), fingerprint_of(self.problem, self.settings))
        kept = store.load()
        if kept:
            with store.reading():
                self.clock.forward(float(kept["seconds"]))
                self.problem.evaluations = max(self.problem.evaluations, int(kept["evaluations"]))
        return store, kept

    def _spent(self) -> dict[str, Any]:
        return {"seconds": self.clock.seconds, "evaluations": self.problem.evaluations}

    def _loss(self, residual: Float64[np.ndarray, "N"]) -> Loss:
        settings = self.settings.gauss_newton
        return Loss.of(residual, settings.loss, settings.loss_scale)

    def _weight(self, residual: Float64[np.ndarray, "N"]) -> float:
        """What a prior is weighed against."""
        counted, _ = as_least_squares(self.problem, residual, self._loss(residual))
        return noise_of(self.problem, counted).weight

    def _derivatives(self, state: GaussNewtonState) -> GaussNewton:
        problem = self.problem
        low, high = problem.parameters.bounds
        mean, std = problem.parameters.prior
        return GaussNewton(
            problem.residuals,
            low,
            high,
            state,
            prior_mean=mean,
            prior_std=std,
            prior_weight=self._weight,
            logarithmic=np.array([parameter.transform == "log" for parameter in problem.parameters.free]),
            colors=problem.colors(),
            support=problem.support,
            slopes=None if problem.coarse is None else problem.slopes,
            settings=self.settings.gauss_newton,
        )

    def _say(self, phase: str, iteration: int, rms: float) -> None:
        if self._on_progress is not None:
            self._on_progress(Progress(phase, iteration, rms, self.problem.evaluations, self.clock.seconds))

    def _solution(
        self, name: str, stop: str, iterations: int, search: GaussNewton, jacobian: Float64[np.ndarray, "P N"]
    ) -> Solution:
        assert search.residual is not None
        counted, factor = as_least_squares(self.problem, search.residual, self._loss(search.residual))
        return Solution(
            parameters=self.problem.parameters,
            z=search.state.z,
            residual=counted,
            jacobian=jacobian * factor,
            rms=float(np.linalg.norm(search.residual)),
            solver={
                "name": name,
                "stop": stop,
                "iterations": iterations,
                "evaluations": self.problem.evaluations,
                "seconds": round(self.clock.seconds, 3),
            },
        )
