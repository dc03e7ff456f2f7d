"""One problem through one solver, with checkpoints: the `fit` behind all of them."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from threadpoolctl import threadpool_limits

from trueup.errors import DataError
from trueup.identify.problem import Problem
from trueup.identify.quantities import quantity
from trueup.identify.solution import (
    Checkpoint,
    OnProgress,
    Progress,
    Solution,
    SolveSettings,
    fingerprint_of,
)
from trueup.identify.solvers import (
    AskTell,
    CmaEs,
    Evaluation,
    EvolutionStrategy,
    GaussNewton,
    GaussNewtonState,
    Roles,
    Space,
    Step,
    Stop,
    compare_solutions,
    draw_starts,
    minimize,
)
from trueup.identify.solvers.multi_start import LocalSolution
from trueup.identify.uncertainty import noise_of

# More of it makes a joint slower, whatever else is the case.
_BRAKES = ("damping", "frictionloss", "load", "tanh_coulomb", "sigmoid_level")
# A search that takes less than this off the start's cost has not found its way.
_HARDLY = 0.01
# Places that are tried where the start cannot be simulated.
_PLACES = 32


def solve(
    problem: Problem,
    settings: SolveSettings,
    *,
    checkpoint: Path | None = None,
    on_progress: OnProgress | None = None,
) -> Solution:
    """Drive a solver to its end.

    `auto` is Gauss-Newton; where that finds no way down (a cost without slope, as steps make it), CMA-ES looks for a
    better place and Gauss-Newton goes on from there. The solution says what was done.

    Args:
        problem: logs, model and parameters.
        settings: how to search.
        checkpoint: JSON file that is written after every iteration and read at the beginning; the search goes on
            from it if it belongs to the same problem.
        on_progress: called after every iteration.

    Raises:
        DataError: the start cannot be simulated.
    """
    # The matrices are small, and idle BLAS threads spin: they would take the simulations' cores.
    with threadpool_limits(1, "blas"):
        if settings.starts > 1:
            return _from_many_starts(problem, settings, checkpoint, on_progress)
        run = _Run(problem, settings, checkpoint, on_progress)
        match settings.solver:
            case "cma-es" | "evolution":
                return run.derivative_free(settings.solver)
            case "gauss-newton":
                return run.gauss_newton()
            case _:
                return _auto(run, settings)


def _auto(run: _Run, settings: SolveSettings) -> Solution:
    derived = replace(settings, solver="gauss-newton")
    try:
        found = run.gauss_newton()
        begin = run.start_cost
        if begin is None or found.rms**2 < (1.0 - _HARDLY) * begin:
            return found
        remark = "Gauss-Newton found no way down from the start"
        rough = run.derivative_free("cma-es")
        place, moved = rough.values, rough.parameters
    except DataError:
        remark = "the model diverges at the start; the search began at another place that can be simulated"
        moved, place = run.problem.parameters, _somewhere_else(run.problem, settings.seed)
        rough = None
    other = _Run(run.problem.with_parameters(moved.at(place)), derived, run.checkpoint_of("again"), run.on_progress)
    best = min((item for item in (rough, other.gauss_newton()) if item is not None), key=lambda item: item.rms)
    name = "gauss-newton" if rough is None else "cma-es, gauss-newton"
    return replace(best, solver={**best.solver, "name": name, "remark": remark})


def _somewhere_else(problem: Problem, seed: int) -> dict[str, float]:
    """The best of some places all over the bounds, where the start itself cannot be simulated.

    Raises:
        DataError: none of them can.
    """
    space = _space(problem)
    starts = draw_starts(space, _PLACES, seed=seed)
    costs = np.sum(problem.residuals(starts) ** 2, axis=1)
    if not np.isfinite(costs).any():
        raise DataError(
            "the model cannot be simulated, neither at the start of the fit nor elsewhere within the bounds",
            hint="Give a smaller simulation.timestep_s in robot.yaml, or narrower bounds.",
        )
    return problem.parameters.values(starts[int(np.nanargmin(costs))])


def _space(problem: Problem) -> Space:
    low, high = problem.parameters.bounds
    free = problem.parameters.free
    return Space(low, high, problem.parameters.start, np.ones(len(free)), tuple(item.name for item in free))


class _Run:
    """One search and its clock."""

    def __init__(
        self, problem: Problem, settings: SolveSettings, checkpoint: Path | None, on_progress: OnProgress | None
    ) -> None:
        self.problem, self.settings, self.on_progress = problem, settings, on_progress
        self._checkpoint = checkpoint
        self.start_cost: float | None = None

    def gauss_newton(self) -> Solution:
        """By derivatives."""
        problem = self.problem
        store, kept = self._store("gauss-newton")
        low, high = problem.parameters.bounds
        mean, std = problem.parameters.prior
        state = GaussNewtonState(problem.parameters.start)
        if kept:
            state = GaussNewtonState.from_json(kept["solver"])
            problem.evaluations = int(kept["evaluations"])
            self.start_cost = kept["start_cost"]
        search = GaussNewton(
            problem.residuals,
            low,
            high,
            state,
            prior_mean=mean,
            prior_std=std,
            prior_weight=lambda residual: noise_of(problem, residual).weight,
            logarithmic=np.array([parameter.transform == "log" for parameter in problem.parameters.free]),
            colors=problem.colors(),
            support=problem.support,
            settings=self.settings.gauss_newton,
        )
        clock = _Clock(float(kept.get("seconds", 0.0)))
        while not search.done:
            search.step()
            if self.start_cost is None and state.history:
                self.start_cost = search.start_cost
            if self.settings.max_seconds is not None and clock.seconds > self.settings.max_seconds and not search.done:
                state.reason = "time"
            store.save(
                {
                    "solver": state.to_json(),
                    "seconds": clock.seconds,
                    "evaluations": problem.evaluations,
                    "start_cost": self.start_cost,
                }
            )
            self._say("gauss-newton", state.iteration, np.sqrt(state.square), clock.seconds)
        jacobian = search.final_jacobian()
        assert search.residual is not None
        return self._solution("gauss-newton", state.reason, state.iteration, state.z, search.residual, jacobian, clock)

    def derivative_free(self, name: str) -> Solution:
        """By ask and tell."""
        problem, settings = self.problem, self.settings
        space = _space(problem)
        solver: AskTell = CmaEs(space, seed=settings.seed)
        if name == "evolution":
            solver = EvolutionStrategy(space, _roles(problem), seed=settings.seed)
        store, kept = self._store(name)
        history: tuple[Step, ...] = ()
        if kept:
            solver.restore(kept["solver"])
            history = tuple(Step(*step) for step in kept["history"])
        steps = list(history)
        clock = _Clock(history[-1].seconds if history else 0.0)

        def on_step(step: Step) -> None:
            steps.append(step)
            store.save(
                {
                    "solver": solver.state(),
                    "history": [[item.evaluations, item.cost, item.seconds] for item in steps],
                }
            )
            self._say(name, len(steps), float(np.sqrt(solver.best[1])), clock.seconds)

        result = minimize(
            solver,
            _evaluation(problem, by_joint=name == "evolution"),
            on_step=on_step,
            max_evaluations=settings.max_evaluations,
            max_seconds=settings.max_seconds,
            history=history,
        )
        if not np.isfinite(result.cost):
            raise DataError("no candidate could be simulated", got=result.stop.text)
        residual, jacobian = self._at(result.z)
        stop = "converged" if result.stop.kind in ("converged", "stalled", "target") else result.stop.kind
        return self._solution(name, stop, len(steps), result.z, residual, jacobian, clock)

    def checkpoint_of(self, name: str) -> Path | None:
        """The file of a part of this search."""
        path = self._checkpoint
        return path.with_name(f"{path.stem}.{name}.json") if path else None

    def _store(self, name: str) -> tuple[Checkpoint, dict[str, Any]]:
        store = Checkpoint(self.checkpoint_of(name), fingerprint_of(self.problem, self.settings))
        return store, store.load()

    def _at(self, z: Float64[np.ndarray, "P"]) -> tuple[Float64[np.ndarray, "N"], Float64[np.ndarray, "P N"]]:
        """Residual and Jacobian at a point that a derivative-free solver has found."""
        low, high = self.problem.parameters.bounds
        mean, std = self.problem.parameters.prior
        search = GaussNewton(
            self.problem.residuals,
            low,
            high,
            GaussNewtonState(z),
            prior_mean=mean,
            prior_std=std,
            prior_weight=lambda residual: noise_of(self.problem, residual).weight,
            colors=self.problem.colors(),
            support=self.problem.support,
            settings=self.settings.gauss_newton,
        )
        jacobian = search.final_jacobian()
        assert search.residual is not None
        return search.residual, jacobian

    def _say(self, phase: str, iteration: int, rms: float, seconds: float) -> None:
        if self.on_progress is not None:
            self.on_progress(Progress(phase, iteration, float(rms), self.problem.evaluations, seconds))

    def _solution(
        self,
        name: str,
        stop: str,
        iterations: int,
        z: Float64[np.ndarray, "P"],
        residual: Float64[np.ndarray, "N"],
        jacobian: Float64[np.ndarray, "P N"],
        clock: _Clock,
    ) -> Solution:
        return Solution(
            parameters=self.problem.parameters,
            z=z,
            residual=residual,
            jacobian=jacobian,
            rms=float(np.sqrt(residual @ residual)),
            solver={
                "name": name,
                "stop": stop,
                "iterations": iterations,
                "evaluations": self.problem.evaluations,
                "seconds": round(clock.seconds, 3),
            },
        )


class _Clock:
    """Seconds of a search, earlier runs of it included."""

    def __init__(self, earlier_s: float) -> None:
        self._began = time.perf_counter() - earlier_s

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self._began


def _from_many_starts(
    problem: Problem, settings: SolveSettings, checkpoint: Path | None, on_progress: OnProgress | None
) -> Solution:
    space = _space(problem)
    # Half a unit of z around the start: far enough to leave a dent, near enough to be simulated.
    starts = draw_starts(space, settings.starts, spread=0.5, seed=settings.seed)
    found: list[Solution] = []
    local: list[LocalSolution] = []
    for index, start in enumerate(starts):
        moved = problem.with_parameters(problem.parameters.at(problem.parameters.values(start)))
        path = checkpoint.with_name(f"{checkpoint.stem}.start{index}.json") if checkpoint else None
        try:
            found.append(solve(moved, replace(settings, starts=1), checkpoint=path, on_progress=on_progress))
        except DataError:
            continue
        problem.evaluations = moved.evaluations
        end = found[-1]
        stop = Stop("converged", str(end.solver["stop"]))
        local.append(LocalSolution(start, end.z, end.rms**2, int(end.solver["evaluations"]), stop))
    if not found:
        raise DataError("the model cannot be simulated from any of the starts", got=f"{len(starts)} starts")
    agreement = compare_solutions(space, local, cost_tolerance=0.01, place_tolerance=0.1)
    best = min(found, key=lambda solution: solution.rms)
    seconds = round(sum(float(solution.solver["seconds"]) for solution in found), 3)
    solver = {**best.solver, "seconds": seconds, "evaluations": problem.evaluations, "starts": agreement.text}
    return replace(best, solver=solver)


def _evaluation(problem: Problem, *, by_joint: bool) -> Any:
    """Candidates to costs; by joint as the evolution strategy of the ES thesis wants them (3.2.1).

    Its error of a joint is the sum of absolute position differences at regular intervals; the signed one takes the
    differences in the direction of motion, so that it is positive where the simulation lags behind: too much
    friction.
    """
    mean, std = problem.parameters.prior
    precision = std**-2.0
    best = np.inf
    weight = 0.0
    directions = [
        np.sign(np.gradient(segment.plan.measured["position"], axis=0))[segment.counts][:, problem.columns]
        for segment in problem.segments
    ]

    def evaluate(z: Float64[np.ndarray, "C P"]) -> Evaluation:
        nonlocal best, weight
        residuals = problem.residuals(z)
        square = np.einsum("cn,cn->c", residuals, residuals)
        if by_joint:
            joints = len(problem.nominal.robot.joint_names)
            signed, absolute = np.full((2, z.shape[0], joints), np.nan)
            for row in np.flatnonzero(np.isfinite(square)):
                signed[row], absolute[row] = _joint_errors(problem, residuals[row], directions)
            return Evaluation(absolute.sum(axis=1), signed, absolute)
        if np.isfinite(square).any() and np.nanmin(square) < best:
            lowest = int(np.nanargmin(square))
            best, weight = float(square[lowest]), noise_of(problem, residuals[lowest]).weight
        return Evaluation(square + weight * (((z - mean) ** 2) @ precision))

    return evaluate


def _joint_errors(
    problem: Problem, residual: Float64[np.ndarray, "N"], directions: list[np.ndarray]
) -> tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "J"]]:
    signed, absolute = np.zeros((2, len(problem.nominal.robot.joint_names)))
    blocks = [values for _, signal, values in problem.by_segment(residual) if signal == "position"]
    for values, direction in zip(blocks, directions, strict=True):
        absolute[problem.columns] += np.abs(values).sum(axis=0)
        signed[problem.columns] -= (values * direction).sum(axis=0)
    return signed, absolute


def _roles(problem: Problem) -> Roles:
    joints = problem.nominal.robot.joint_names
    free = problem.parameters.free
    group = [
        joints.index(item.target)
        if item.target and quantity(item.quantity).of == "joint"
        else _joint_of_body(problem, item.target)
        for item in free
    ]
    effect = [1 if item.quantity in _BRAKES else 0 for item in free]
    return Roles(np.array(group), np.array(effect))


def _joint_of_body(problem: Problem, body: str) -> int:
    """The joint that moves a body, -1 for what belongs to the whole robot."""
    model, joints = problem.nominal.model, problem.nominal.robot.joint_names
    if not body:
        return -1
    index = int(model.body(body).id)
    while index and model.body_jntnum[index] == 0:
        index = int(model.body_parentid[index])
    name = model.joint(int(model.body_jntadr[index])).name if index else ""
    return joints.index(name) if name in joints else -1
