"""Identification of one robot: motions in, fit result out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from trueup.core.episode import Episode, warning_kinds
from trueup.core.fit_result import FitResult, FitStatus, FittedParameter, ModelRow
from trueup.core.parameters import ParameterSet
from trueup.core.provenance import provenance
from trueup.core.results import Estimate
from trueup.errors import NotIdentifiable
from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.config import IdentifyConfig, make_parameters
from trueup.identify.excitation import excitation_of, freeze_still
from trueup.identify.problem import Problem, Weights
from trueup.identify.scoring import Scorer, Scores
from trueup.identify.segments import SegmentRule, make_segments
from trueup.identify.solution import Progress, Solution, SolveSettings
from trueup.identify.solve import solve
from trueup.identify.start import idle_names, off_bounds, regressed_start, swept_start
from trueup.identify.uncertainty import (
    Posterior,
    fitted_parameters,
    noise_of,
    open_directions,
    posterior_of,
    whiteness_of,
)
from trueup.robots import RobotSpec

# A richer model must make motions that it was not fitted to better by this share.
_WORTH = 0.01
_SHOWN_CORRELATION = 0.3

# Name of the model, then how its search goes on.
OnModel = Callable[[str, Progress], None]


@dataclass(frozen=True, eq=False)
class Identification:
    """What an identification leaves in memory.

    Attributes:
        result: for fit.json.
        nominal: the model as it came.
        parameters: what was fitted, from where.
        posterior: for samples.
    """

    result: FitResult
    nominal: Nominal
    parameters: ParameterSet
    posterior: Posterior

    def candidate(self) -> Candidate:
        """The fitted model, editable, with the numbers as fit.json has them."""
        problem = Problem(self.nominal, self.parameters, ())
        return problem.candidate(self.result.values)


@dataclass(frozen=True, eq=False)
class _Attempt:
    """One model that was fitted."""

    row: ModelRow
    solution: Solution
    val: Scores | None


def identify(
    episodes: Mapping[str, Sequence[Episode]],
    robot: RobotSpec,
    model: Path,
    *,
    config: IdentifyConfig | None = None,
    jobs: int = 1,
    seed: int = 0,
    checkpoints: Path | None = None,
    data_hash: str | None = None,
    on_progress: OnModel | None = None,
) -> Identification:
    """Estimate what the simulator has wrong.

    Fits on `train`, chooses among models on `val`, and looks at `test` once, with the chosen one and, for the table,
    with the others.

    Args:
        episodes: split -> motions, in the robot's joint names and SI units.
        robot: its description.
        model: MJCF or URDF.
        config: what to fit; the default for the robot's controller if None.
        jobs: threads.
        seed: of all draws.
        checkpoints: folder for the state of the searches; a search that was interrupted goes on from it.
        data_hash: of the dataset, for the provenance.
        on_progress: called after every iteration of every model.

    Raises:
        NotIdentifiable: there is nothing to learn from these motions.
        ConfigError: the configuration does not fit the robot.
        DataError: no motion can be simulated.
    """
    nominal = Nominal(robot, model)
    chosen_by_user = config is not None and bool(config.fit)
    config = (config or IdentifyConfig()).resolved(nominal)
    train, flagged = usable(episodes.get("train", ()), keep_flagged=config.data.keep_flagged)
    if not train:
        raise NotIdentifiable(
            "there is no motion to fit",
            got=f"{len(flagged)} flagged ones" if flagged else "an empty train split",
            hint="Give --splits at import, or data: {keep_flagged: true} in the configuration.",
        )
    signal = nominal.robot.controller.signal
    seen = excitation_of(train, nominal.robot.scored_joints, signal, nominal.simulator.torque_limits)
    data = config.data
    rule = SegmentRule(data.window_s, data.cut_s, data.budget_s, data.burn_in_s, seed)
    segments, refused = make_segments(train, nominal.simulator, rule)
    scored = {split: usable(logs, keep_flagged=config.data.keep_flagged)[0] for split, logs in episodes.items()}
    scorer = Scorer(nominal, {split: logs for split, logs in scored.items() if logs}, jobs=jobs, seed=seed)
    weights = Weights(config.signals, config.joints)
    settings = SolveSettings(
        solver=config.solver.name,
        gauss_newton=config.solver.gauss_newton(),
        max_evaluations=config.solver.max_evaluations,
        max_seconds=config.solver.max_seconds,
        starts=config.solver.starts,
        seed=seed,
    )

    def attempt(name: str, fit: Mapping[str, Any], start: Solution | None) -> _Attempt:
        parameters = freeze_still(make_parameters(fit, nominal), seen)
        began = time.perf_counter()
        problem = Problem(nominal, parameters, segments, weights=weights, jobs=jobs)
        own = settings
        if start is not None:
            problem = problem.with_parameters(off_bounds(parameters.at(start.values)))
            # From a good place there may be nothing left to gain, which is no reason to search everywhere.
            own = replace(own, solver="gauss-newton") if own.solver == "auto" else own
        else:
            begin = regressed_start(problem, train) if signal == "torque" else swept_start(problem)
            problem = problem.with_parameters(begin)
            if not chosen_by_user:
                problem = problem.with_parameters(_without_idle(problem))
        if not problem.parameters.free:
            raise NotIdentifiable("no parameter is left to fit", got="; ".join(seen.statements) or "all are frozen")
        solution = solve(
            problem,
            own,
            checkpoint=checkpoints / f"{name}.json" if checkpoints else None,
            on_progress=None if on_progress is None else lambda progress: on_progress(name, progress),
        )
        val = scorer.score(parameters, solution.values, "val") if "val" in scorer.splits else None
        row = ModelRow(
            name=name,
            quantities=tuple(fit),
            parameters=len(solution.parameters.free),
            seconds=round(time.perf_counter() - began, 2),
            splits={},
        )
        return _Attempt(row, solution, val)

    attempts = [attempt("base", config.fit, None)]
    best, fit = attempts[0], dict(config.fit)
    for name, extra in (config.models or {}).items():
        richer = {**fit, **dict.fromkeys(extra, "all")}
        attempts.append(attempt(_joined(best.row.name, name), richer, best.solution))
        if _better(attempts[-1], best):
            best, fit = attempts[-1], richer

    solution = best.solution
    problem = Problem(nominal, solution.parameters, segments, weights=weights, jobs=jobs)
    posterior = posterior_of(problem, solution.z, solution.residual, solution.jacobian)
    start = make_parameters(fit, nominal)
    parameters = fitted_parameters(posterior, {item.name: item.value for item in start})
    rows = tuple(_scored_row(item, best, scorer) for item in attempts)
    soft = Scorer(Nominal(robot, model, hard_friction=False), scored, jobs=jobs, seed=seed)
    errors = {
        "nominal": {s: soft.score(ParameterSet(()), {}, s).estimate(soft.unit) for s in soft.splits},
        "fitted": dict(next(row for row in rows if row.chosen).splits),
    }
    status, statements = _verdict(solution, parameters, errors, seen.statements, chosen_by_user=chosen_by_user)
    result = FitResult(
        status=status,
        statements=statements,
        solver={**solution.solver, "why": _why(signal, config)},
        parameters=parameters,
        correlation=_correlations(posterior),
        directions=open_directions(posterior),
        whiteness=whiteness_of(problem, solution.residual),
        models=rows,
        errors=errors,
        data={
            "episodes": sorted({segment.episode_id for segment in segments}),
            "seconds": round(sum(segment.seconds for segment in segments), 2),
            "window_s": data.window_s,
            "samples": problem.size,
            "flagged": flagged,
            "refused": {name: str(error) for name, error in refused.items()},
        },
        provenance=provenance(
            config={"robot": robot.to_dict(), "model": model.name, "identify": config.to_json()},
            seed=seed,
            data_hash=data_hash,
        ),
    )
    return Identification(result, nominal, solution.parameters, posterior)


def usable(logs: Sequence[Episode], *, keep_flagged: bool) -> tuple[list[Episode], dict[str, str]]:
    """The motions without quality warnings, and why the others are left out."""
    flagged = (
        {} if keep_flagged else {log.id: ", ".join(warning_kinds(log.meta.flags)) for log in logs if log.meta.warned}
    )
    return [log for log in logs if log.id not in flagged], flagged


def _without_idle(problem: Problem) -> ParameterSet:
    """The default parameters without those that change nothing in these motions."""
    z, step = problem.parameters.start, 0.02
    rows = problem.residuals(np.vstack([z, z + step * np.eye(z.size)]))
    if not np.isfinite(rows[0]).all():
        return problem.parameters
    jacobian = np.nan_to_num((rows[1:] - rows[0]) / step, nan=1.0)
    idle = idle_names(problem, jacobian, noise_of(problem, rows[0]).weight, among=problem.parameters.names)
    return problem.parameters.freeze(idle)


def _joined(base: str, extra: str) -> str:
    return extra if base == "base" else f"{base}+{extra}"


def _better(richer: _Attempt, best: _Attempt) -> bool:
    """Whether a richer model earns its parameters on motions that it was not fitted to."""
    if richer.val is None or best.val is None:
        return False
    return richer.val.mean < (1.0 - _WORTH) * best.val.mean


def _scored_row(item: _Attempt, best: _Attempt, scorer: Scorer) -> ModelRow:
    values = item.solution.values
    scores = {
        split: item.val if split == "val" and item.val else scorer.score(item.solution.parameters, values, split)
        for split in scorer.splits
    }
    return replace(
        item.row,
        splits={split: own.estimate(scorer.unit) for split, own in scores.items()},
        per_joint={split: own.per_joint for split, own in scores.items()},
        chosen=item is best,
    )


def _correlations(posterior: Posterior) -> dict[str, dict[str, float]]:
    names = [parameter.name for parameter in posterior.parameters.free]
    matrix = posterior.correlation
    return {
        name: {
            other: round(float(matrix[i, j]), 3)
            for j, other in enumerate(names)
            if i != j and abs(matrix[i, j]) > _SHOWN_CORRELATION
        }
        for i, name in enumerate(names)
    }


def _why(signal: str, config: IdentifyConfig) -> str:
    if config.solver.name != "auto":
        return "chosen by the user"
    if config.data.window_s is not None:
        return (
            f"the robot follows {signal}: Gauss-Newton on windows of {config.data.window_s:g} s that start from the "
            "measured state (multiple shooting), since open-loop motion forgets its parameters over longer ones"
        )
    return f"the robot follows {signal}: its loop is closed, so Gauss-Newton sees a slope over whole motions"


def _verdict(
    solution: Solution,
    parameters: Sequence[FittedParameter],
    errors: Mapping[str, Mapping[str, Estimate]],
    beforehand: Sequence[str],
    *,
    chosen_by_user: bool,
) -> tuple[FitStatus, tuple[str, ...]]:
    """The worst that applies, and everything that must be said."""
    status: FitStatus = "ok"
    statements = list(beforehand)
    unknown = [item for item in parameters if item.identified == "no" and not item.frozen]
    if unknown:
        status = "not-identifiable"
        names = ", ".join(item.name for item in unknown[:6]) + (", …" if len(unknown) > 6 else "")
        statements.append(
            f"{len(unknown)} of {len(parameters)} parameters are not determined by these motions: {names}; their "
            "values are the prior's, not the robot's"
        )
    # A law that ended on zero is one that the robot does not have: no cause for alarm.
    stuck = [item for item in parameters if item.at_bound and not (item.at_bound == "low" and item.low == 0.0)]
    if stuck:
        status = "at-bound"
        statements.append(
            "ended on a bound: " + ", ".join(f"{item.name} = {item.value:.4g} {item.unit}" for item in stuck)
        )
    if solution.solver["stop"] not in ("converged",):
        status = "not-converged"
        statements.append(f"the search stopped early ({solution.solver['stop']}): run longer, or with --resume")
    judge = next((split for split in ("val", "test", "train") if split in errors["fitted"]), None)
    if judge is not None:
        before, after = errors["nominal"].get(judge), errors["fitted"][judge]
        if before is not None and not after.value < before.value:
            status = "no-better"
            statements.insert(
                0,
                f"the fitted model is no better than the nominal one on {judge}: {after.value:.4g} against "
                f"{before.value:.4g} {after.unit}; is this the log of another robot?",
            )
        if judge == "train":
            statements.append("there is no val split: the fit is judged on the motions that it was fitted to")
    if not chosen_by_user:
        idle = [item.name for item in parameters if item.frozen]
        if idle:
            statements.append(f"left as they are, since these motions do not show them: {', '.join(idle)}")
    return status, tuple(statements)
