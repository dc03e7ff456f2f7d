"""The models that an identification tries: what they share, and how one of them is chosen."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from trueup.core.episode import Episode
from trueup.core.fit_result import ModelRow
from trueup.core.parameters import ParameterSet
from trueup.core.ray_workers import Cluster
from trueup.core.time_limit import TimeLimit
from trueup.errors import NotIdentifiable
from trueup.identify.candidate import Nominal
from trueup.identify.config import IdentifyConfig, make_parameters
from trueup.identify.excitation import excitation_of, freeze_still
from trueup.identify.problem import Problem, Weights
from trueup.identify.quantities import quantity
from trueup.identify.scoring import Scorer, Scores
from trueup.identify.segments import make_segments, usable
from trueup.identify.solution import OnModel, Solution
from trueup.identify.solve import solve
from trueup.identify.start import idle_names, off_bounds, regressed_start, swept_start
from trueup.identify.uncertainty import Posterior, absent_names, noise_of, open_names, posterior_of, rounded

# A richer model must make motions that it was not fitted to better by this share.
_WORTH = 0.01
# A search of a model that is only compared ends when an iteration lowers the cost by less than this share.
_ROUGH = 0.005
# Shares of a time limit at which the base model ends, no richer one is begun, these end, and the best one ends.
_BASE, _LAST_BEGIN, _RICHER, _BEST = 0.5, 0.65, 0.75, 0.9


@dataclass(frozen=True, eq=False)
class TriedModel:
    """One model that was fitted."""

    row: ModelRow
    solution: Solution
    val: Scores | None


class ModelSearch:
    """Tries models on the same motions, pieces of them, weights, judge and settings."""

    def __init__(
        self,
        nominal: Nominal,
        episodes: Mapping[str, Sequence[Episode]],
        config: IdentifyConfig | None,
        *,
        jobs: int,
        seed: int,
        checkpoints: Path | None,
        on_progress: OnModel | None,
        limit: TimeLimit | None = None,
        cluster: Cluster | None = None,
    ) -> None:
        self.nominal, self._jobs = nominal, jobs
        self._limit, self._cluster = limit, cluster
        self.untried: list[str] = []
        self.short_of_time: list[str] = []
        self.chosen_by_user = config is not None and bool(config.fit)
        self.config = (config or IdentifyConfig()).resolved(nominal)
        self._checkpoints, self._on_progress = checkpoints, on_progress
        self.usable, self._flagged = usable(episodes, drop_flagged=self.config.data.drop)
        self._train = self.usable.get("train", [])
        if not self._train:
            raise NotIdentifiable(
                "there is no motion to fit",
                got="nothing in train but flagged motions" if self._flagged.get("train") else "an empty train split",
                hint="Give --splits at import, and leave `data: {drop_flagged: true}` out.",
            )
        self.notes = () if nominal.robot.payload else _payload_note(self._train)
        self._signal = nominal.robot.controller.signal
        self.seen = excitation_of(self._train, nominal.robot.scored_joints, self._signal, nominal.commanded_limits)
        rule = self.config.data.rule(nominal.robot, seed)
        self._segments, refused = make_segments(self._train, nominal.simulator, rule)
        self._unfitted = {name: error.summary for name, error in refused.items()}
        self.motions = [segment.episode_id for segment in self._segments]
        self._weights = Weights(self.config.signals, self.config.joints)
        self._scorer = Scorer(nominal, self.usable, jobs=jobs, seed=seed)
        self._settings = self.config.solver.settings(seed)

    def climb(self) -> tuple[TriedModel, list[TriedModel]]:
        """Fit the base model, then richer ones, then without what the motions do not show; the best, and all."""
        models = self.config.models or {}
        best = self._try("base", self.config.fit, rough=bool(models), limit=self._until(_BASE))
        tried, fit = [best], dict(self.config.fit)
        # What changes nothing near the solution is left out from here on; far from it, nothing can be told.
        idle = self._idle(best)
        for name, extra in models.items():
            richer = {**fit, **dict.fromkeys(extra, "all")}
            joined = name if best.row.name == "base" else f"{best.row.name}+{name}"
            if self._limit is not None and self._limit.spent > _LAST_BEGIN:
                self.untried.append(name)
                continue
            limit = self._until(_RICHER)
            tried.append(self._try(joined, richer, best.solution, left_out=idle, rough=True, limit=limit))
            if _better(tried[-1], best):
                best, fit = tried[-1], richer
        if models:
            # What the richer models have brought, and changes nothing either, goes; the motion stays as it is.
            idle = [*idle, *(name for name in self._idle(best) if name not in idle)]
            finished = self._to_the_end(best, fit, idle)
            tried[tried.index(best)] = best = finished
        known = self.posterior_of(best).of_model()
        absent = absent_names(known)
        surplus = [] if self.chosen_by_user else open_names(known)
        timely = self._limit is None or not self._limit.over
        if timely and surplus and len(surplus) + len(absent) < len(known.parameters.free):
            leaner = self._try(
                f"{best.row.name}, known only",
                fit,
                best.solution,
                left_out=[*idle, *surplus],
                absent=absent,
                limit=self._limit,
            )
            tried.append(leaner)
            if _as_good(leaner, best):
                best = leaner
        return best, tried

    def encoder_zeros(self, item: TriedModel) -> dict[str, float]:
        """What single recordings were off by, where that was fitted: `MOTION:JOINT` -> [rad or m]."""
        return {
            parameter.target: rounded(item.solution.values[parameter.name])
            for parameter in item.solution.parameters
            if parameter.quantity == "encoder_zero" and not parameter.frozen
        }

    def problem_of(self, item: TriedModel) -> Problem:
        """The problem that a model's fit has solved."""
        return self._problem(item.solution.parameters)

    def posterior_of(self, item: TriedModel) -> Posterior:
        """What is known after a model's fit."""
        found = item.solution
        return posterior_of(self.problem_of(item), found.z, found.residual, found.jacobian)

    def scored_row(self, item: TriedModel, *, chosen: bool) -> ModelRow:
        """The row of the table of models, with its errors; where the time is over, on val alone if it is not chosen."""
        values = item.solution.values
        brief = not chosen and self._late and item.val is not None
        scores = {
            split: item.val
            if split == "val" and item.val
            else self._scorer.score(item.solution.parameters, values, split)
            for split in (("val",) if brief else self.judged)
        }
        return replace(
            item.row,
            splits={split: own.estimate(self._scorer.unit) for split, own in scores.items()},
            per_joint={split: own.per_joint for split, own in scores.items()},
            chosen=chosen,
        )

    @cached_property
    def judged(self) -> tuple[str, ...]:
        """The splits on which models are scored in the end: all, or without train where the time is over.

        Val says which is best, and the ladder has the errors of all splits.
        """
        splits = self._scorer.splits
        return tuple(split for split in splits if split != "train") if self._late and "val" in splits else splits

    @property
    def _late(self) -> bool:
        return self._limit is not None and self._limit.spent >= _BEST

    @property
    def torque_seen(self) -> bool:
        """Whether the logs' torques enter the residual, or drive the robot."""
        return self._signal == "torque" or bool(self.config.signals.get("torque"))

    @property
    def why(self) -> str:
        """Why this solver."""
        if self.config.solver.name != "auto":
            return "chosen by the user"
        window_s = self.config.data.window_s
        if window_s is not None:
            return (
                f"the robot follows {self._signal}: Gauss-Newton on windows of {window_s:g} s that start from the "
                "measured state (multiple shooting), since open-loop motion forgets its parameters over longer ones"
            )
        return f"the robot follows {self._signal}: its loop is closed, so Gauss-Newton sees a slope over whole motions"

    @property
    def data(self) -> dict[str, Any]:
        """What was fitted to."""
        return {
            "episodes": sorted({segment.episode_id for segment in self._segments}),
            "seconds": round(sum(segment.seconds for segment in self._segments), 2),
            "window_s": self.config.data.window_s,
            "replay_window_s": self.nominal.robot.replay.window_s,
            "samples": self._problem(ParameterSet(())).size,
            "flagged": self._flagged,
            "refused": self._refused,
        }

    @property
    def _refused(self) -> dict[str, dict[str, str]]:
        """Split -> motion -> why it can be neither fitted nor scored."""
        train = {**self._scorer.refused.get("train", {}), **self._unfitted}
        return {**self._scorer.refused, **({"train": train} if train else {})}

    def _problem(self, parameters: ParameterSet) -> Problem:
        return Problem(self.nominal, parameters, self._segments, weights=self._weights, jobs=self._jobs)

    def _try(
        self,
        name: str,
        fit: Mapping[str, Any],
        start: Solution | None = None,
        *,
        left_out: Sequence[str] = (),
        absent: Sequence[str] = (),
        rough: bool = False,
        starts: int | None = None,
        limit: TimeLimit | None = None,
    ) -> TriedModel:
        """Fit one model; `left_out` stays as the nominal model has it, `absent` at zero; `rough` to compare with."""
        began = time.perf_counter()
        parameters = freeze_still(make_parameters(fit, self.nominal, self.motions), self.seen).freeze(left_out)
        parameters = parameters.at(dict.fromkeys(absent, 0.0)).hold(absent)
        settings = replace(self._settings, starts=starts or self._settings.starts)
        if rough:
            newton = settings.gauss_newton
            newton = replace(newton, tolerance=max(newton.tolerance, _ROUGH))
            settings = replace(settings, gauss_newton=newton)
        if start is None:
            problem = self._started(self._problem(parameters), limit)
        else:
            problem = self._problem(off_bounds(parameters.at(start.values)))
            # From a good place there may be nothing left to gain, which is no reason to search everywhere.
            settings = replace(settings, solver="gauss-newton") if settings.solver == "auto" else settings
        if not problem.parameters.free:
            raise NotIdentifiable(
                "no parameter is left to fit", got="; ".join(self.seen.statements) or "all are frozen"
            )
        report, prepared_s = self._on_progress, time.perf_counter() - began
        solution = solve(
            problem,
            settings,
            checkpoint=self._checkpoints / f"{name}.json" if self._checkpoints else None,
            on_progress=None if report is None else lambda progress: report(name, progress),
            limit=limit,
            cluster=self._cluster,
        )
        took_s = time.perf_counter() - began
        if self._cluster is None:  # with one, the seconds of the starts are not one after the other
            took_s = max(took_s, prepared_s + solution.solver["seconds"])  # before an interruption, too
        if solution.solver["stop"] == "time":
            self.short_of_time.append(name)
        splits = self._scorer.splits
        if start is not None and "remark" in start.solver:
            # It holds for all that goes on from there.
            solution = replace(solution, solver={"remark": start.solver["remark"], **solution.solver})
        return TriedModel(
            ModelRow(
                name=name,
                quantities=tuple(fit),
                parameters=sum(quantity(item.quantity).of != "motion" for item in solution.parameters.free),
                seconds=round(took_s, 2),
                splits={},
            ),
            solution,
            self._scorer.score(solution.parameters, solution.values, "val") if "val" in splits else None,
        )

    def _until(self, spent: float) -> TimeLimit | None:
        return None if self._limit is None else self._limit.until(spent)

    def _started(self, problem: Problem, limit: TimeLimit | None) -> Problem:
        """The problem with a start from afar."""
        begin = regressed_start(problem, self._train) if self._signal == "torque" else swept_start(problem, limit)
        return problem.with_parameters(begin)

    def _to_the_end(self, rough: TriedModel, fit: Mapping[str, Any], left_out: Sequence[str]) -> TriedModel:
        """The same model from where a rough search ended; what is told of both is told as of one."""
        name = rough.row.name
        limit = self._until(_BEST)
        end = self._try(f"{name}, to the end", fit, rough.solution, left_out=left_out, starts=1, limit=limit)
        first, last = rough.solution, end.solution
        spent = {key: first.solver[key] + last.solver[key] for key in ("iterations", "evaluations", "seconds")}
        begun = {item.name: item.value for item in first.parameters.free}
        solution = replace(
            last,
            parameters=last.parameters.at(begun),
            solver={**first.solver, "stop": last.solver["stop"], **spent},
            agreement=first.agreement,
        )
        seconds = round(rough.row.seconds + end.row.seconds, 2)
        return replace(end, row=replace(end.row, name=name, seconds=seconds), solution=solution)

    def _idle(self, item: TriedModel) -> list[str]:
        """Parameters that change next to nothing in these motions, even if all others were known.

        None where the user has chosen what is fitted, and none where nothing would be left.
        """
        if self.chosen_by_user:
            return []
        problem, found = self.problem_of(item), item.solution
        weight = noise_of(problem, found.residual).weight
        idle = idle_names(problem, found.jacobian, weight)
        return idle if len(idle) < len(found.parameters.free) else []


def _payload_note(logs: Sequence[Episode]) -> tuple[str, ...]:
    carried = sorted({log.meta.payload_kg for log in logs if log.meta.payload_kg})
    if not carried:
        return ()
    amounts = ", ".join(f"{payload:g}" for payload in carried)
    note = (
        f"some motions carry a payload ({amounts} kg) that the model does not: say where it hangs in robot.yaml "
        "(payload: {sites: [...]}), leave them out, or expect a compromise"
    )
    return (note,)


def _better(richer: TriedModel, best: TriedModel) -> bool:
    """Whether a richer model earns its parameters on motions that it was not fitted to."""
    if richer.val is None or best.val is None:
        return False
    return richer.val.mean < (1.0 - _WORTH) * best.val.mean


def _as_good(leaner: TriedModel, best: TriedModel) -> bool:
    """Whether a model with fewer parameters is no worse, on motions that it was not fitted to if there are any."""
    if leaner.val is None or best.val is None:
        return leaner.solution.rms <= (1.0 + _WORTH) * best.solution.rms
    return leaner.val.mean <= (1.0 + _WORTH) * best.val.mean
