"""The models that an identification tries: what they share, and how one of them is chosen."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from trueup.core.episode import Episode
from trueup.core.fit_result import ModelRow, Suspect
from trueup.core.parameters import ParameterSet, widened
from trueup.core.ray_workers import Cluster
from trueup.core.results import Estimate
from trueup.core.time_limit import OutOfTime, TimeLimit
from trueup.errors import DataError, NotIdentifiable
from trueup.identify.assumptions import assumption_shifts
from trueup.identify.candidate import Nominal
from trueup.identify.config import AUTO, IdentifyConfig, make_parameters
from trueup.identify.cross_validation import without_each
from trueup.identify.discretization import (
    DECIDED,
    Alternative,
    Discretization,
    Minimum,
    alternative,
    coarser,
    extrapolated,
    finer,
    probability,
)
from trueup.identify.excitation import excitation_of, freeze_still
from trueup.identify.lag_exchange import exchanged
from trueup.identify.logged_torque import logged_torque
from trueup.identify.problem import Problem
from trueup.identify.quantities import quantity
from trueup.identify.scoring import Scorer, Scores
from trueup.identify.search import Search, Stopwatch
from trueup.identify.segments import usable
from trueup.identify.sensitivity import late_shifts, split_shifts
from trueup.identify.simulated_logs import SimulatedLogs
from trueup.identify.solution import OnModel, OnProgress, Solution
from trueup.identify.solve import solve
from trueup.identify.start import begun_start, idle_names, off_bounds
from trueup.identify.suspects import strange_masses, suspects_of
from trueup.identify.uncertainty import (
    Posterior,
    absent_at,
    bound_of,
    noise_of,
    posterior_of,
    remaining_step,
    rounded,
    unexplained,
    whiteness_of,
)
from trueup.robots import CommandTiming, refuse_unknown_gains

# A richer model must make motions that it was not fitted to better by this share.
_WORTH = 0.01
# A search of a model that is only compared ends when an iteration lowers the cost by less than this share.
_ROUGH = 0.005
# What is left is the noise of the measurement up to this ratio.
EXPLAINED = 1.1
# Of a simulation with the model's own step: a fit simulates it exactly, and leaves of each joint the noise alone.
_EXACT = 1.05
# Where so many times the noise is left, a finer step has to take away this share of its squares, and how commands act
# between their stamps is not looked at again.
_FAR_FROM_NOISE, _WORTH_A_STEP = 5.0, 0.1
# Simulations with a finer step that a fit still needs when it takes that step, for each of its numbers.
_TO_FINISH = 12
# A timing that leaves so many times more is not the better one with a smaller step either.
_HOPELESS = 3.0
# How often bounds that were hit are moved.
_WIDENINGS = 2
# One standard deviation of the logarithm of a number that the data know exactly. No model is truer: gravity differs by
# more from one city to another, and what a drive's cycle of half a millisecond does to inertia is as much.
_LEAST_KNOWN = 5e-4
# A number below this share of its usual start hardly moves from there.
_DEAD = 0.1
# Shares of a time limit at which the base model ends, no richer one is begun, these end, the best one ends, and what
# makes its intervals certain.
_BASE, _LAST_BEGIN, _RICHER, _BEST, _SURE = 0.4, 0.55, 0.65, 0.75, 0.95


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
        self._jobs, self._seed = jobs, seed
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
        refuse_unknown_gains(nominal.given, (log.meta for own in self.usable.values() for log in own))
        self.notes = () if nominal.robot.payload else _payload_note(self._train)
        self._signal = nominal.robot.controller.signal
        self.seen = excitation_of(self._train, nominal.robot.scored_joints, self._signal, nominal.commanded_limits)
        self._torque_said = ""
        self._settings = self.config.solver.settings(seed)
        self.logs = SimulatedLogs(nominal, self.usable, self.config, jobs=jobs, seed=seed, limit=limit)
        self.motions = [segment.episode_id for segment in self.logs.segments]
        # For each way to simulate the logs.
        self._scorers = {self.logs.way: Scorer(nominal, self.usable, jobs=jobs, seed=seed)}
        self._finer: Alternative | None = None
        # The way in which the logs were found to be those of a simulation with the model's own step.
        self._simulated: Discretization | None = None
        self._undecided: list[dict[str, float]] = []
        # Wider bounds than those of the catalogue, for what ended on these.
        self._room: dict[str, tuple[float, float]] = {}
        # A solution that was brought to the minimum of the present way, with parameters and residual there.
        self._minimum: tuple[Solution, Discretization, Minimum] | None = None
        # The base model with the other timing of the command, if that is not far worse, and that timing.
        self._rival: tuple[TriedModel | None, CommandTiming] | None = None
        self.searched: Solution | None = None

    def climb(self) -> tuple[TriedModel, list[TriedModel]]:
        """Fit the base model, then richer ones, then without what the motions do not show; the best, and all."""
        models = self.config.models or {}
        fit = dict(self.config.fit)
        # Before anything richer is tried: other models would make up for a wrong step, or timing, with their numbers.
        best = self._timed(fit, rough=bool(models))
        rough, limit = bool(models), self._until(_BASE)
        best = self._exchanged(best, fit, rough=rough, limit=limit)
        best = self._heard(best, fit, rough=rough, limit=limit)
        step, best = self.logs.way, self._settled(best, fit, rough=rough, limit=limit)
        if self.logs.way != step:  # the error of the larger one may have hidden what is better
            best = self._exchanged(best, fit, rough=rough, limit=limit)
        best = self._retimed(best, fit, rough=rough, limit=limit)
        best = self._smoothed(best, fit, rough=rough, limit=limit)
        best = self._braked(best, fit, rough=rough, limit=limit)
        tried = [best]
        if self._explained(best) and not _over(self._until(_BEST)):
            # Nothing is left that a richer model could explain, unless masses have made up for what hangs at the end.
            best = self._further(best, fit, "to the end", (), limit=self._until(_BEST))
            strange = strange_masses(best.solution.parameters, best.solution.values)
            models = {name: extra for name, extra in models.items() if strange and _carries(extra)}
            tried = [best]
        # What changes nothing near the solution is left out from here on; far from it, nothing can be told.
        idle = self._idle(best)
        for name, extra in models.items():
            richer = {**fit, **dict.fromkeys(extra, "all")}
            joined = name if best.row.name == "base" else f"{best.row.name}+{name}"
            if self._limit is not None and self._limit.spent > _LAST_BEGIN:
                self.untried.append(name)
                continue
            limit = self._until(_RICHER)
            if _carries(extra):
                tried.append(self._loaded(joined, richer, best, idle, limit=limit))
            else:
                tried.append(self._try(joined, richer, best.solution, left_out=idle, rough=True, limit=limit))
            if self._earned(tried[-1], best):
                best, fit = tried[-1], richer
                idle = self._frozen(best) if _carries(extra) else idle  # some may have died of the payload
        if _carries(fit):
            # What made up for the payload may have been delays; with it, all is free again.
            limit, idle = self._until(_RICHER), []
            again = self._exchanged(best, fit, rough=True, limit=limit)
            again = self._further(again, fit, "all free", (), limit=limit)
            tried[tried.index(best)] = best = again
        if best is not tried[0]:
            # Where far more than noise was left, how commands act between their stamps could not be told.
            smoothed = self._smoothed(best, fit, rough=True, limit=self._until(_RICHER))
            tried[tried.index(best)] = best = smoothed
        if models and not _over(self._until(_BEST)):
            # What the richer models have brought, and changes nothing either, goes; the motion stays as it is.
            idle = [*idle, *(name for name in self._idle(best) if name not in idle)]
            finished = self._to_the_end(best, fit, idle)
            tried[tried.index(best)] = best = finished
        settled = self._settled(best, fit, left_out=self._frozen(best), limit=self._until(_BEST))
        heard = self._heard(settled, fit, left_out=self._frozen(settled), limit=self._until(_BEST))
        certain = self._certain(heard)
        self.searched = certain.solution
        self._finer = self._nearer_to_no_step(certain)
        tried[tried.index(best)] = certain
        return certain, tried

    def encoder_zeros(self, item: TriedModel) -> dict[str, float]:
        """What single recordings were off by, where that was fitted: `MOTION:JOINT` -> [rad or m]."""
        return {
            parameter.target: rounded(item.solution.values[parameter.name])
            for parameter in item.solution.parameters
            if parameter.quantity == "encoder_zero" and not parameter.frozen
        }

    def problem_of(self, item: TriedModel) -> Problem:
        """The problem that a model's fit has solved."""
        return self.logs.problem(item.solution.parameters)

    def posterior_of(self, item: TriedModel) -> Posterior:
        """What is known after a model's fit, by its own derivatives."""
        found = item.solution
        return posterior_of(self.problem_of(item), found.z, found.residual, found.jacobian)

    def certain_posterior(self, item: TriedModel) -> Posterior:
        """What is known after a fit, with what another discretization, or the end of its search, would bring."""
        found, problem = item.solution, self.problem_of(item)
        known = posterior_of(problem, found.z, found.residual, found.jacobian)
        # The robot takes new commands at a rate of its own, and holds them: by half of that time they are later.
        unknown = np.zeros(found.z.size)
        if self.logs.way.command != "held":
            held_s = 0.125 * self.logs.period_s
            unknown = np.array([held_s / item.scale * (item.quantity == "delay_s") for item in found.parameters.free])
        undecided = [
            np.array([own.get(item.name, 0.0) for item in found.parameters.free])
            for own in (*self._undecided, *self._compared_too_early(found, known.std))
        ]
        step = 0.0 if self._finer is None else self._finer.unknown(self.logs.way)
        left = remaining_step(problem, found.z, found.residual, found.jacobian)
        weight = noise_of(problem, found.residual).weight
        split = split_shifts(problem, found.z, found.jacobian, weight)
        assumed = assumption_shifts(problem, found.z, found.jacobian, weight)
        late = late_shifts(problem, found.z)
        sized = _LEAST_KNOWN * np.diag([float(item.transform == "log") for item in found.parameters.free])
        return known.widened([left, *undecided, *split, *assumed, *late, *sized, step * np.ones(found.z.size), unknown])

    def _compared_too_early(self, found: Solution, std: Float64[np.ndarray, "P"]) -> list[dict[str, float]]:
        """What numbers change by, in z, with the other timing of the command, if a finer step is still to decide.

        A large step acts late by itself, as a command that is held does: timings that were compared with it alone,
        since the time was over, are both possible.
        """
        rival = self._rival[0] if self._rival else None
        settled = self._finer is not None and not self._finer.matters(self.logs.way, std)
        if rival is None or self._of_this_step or settled:
            return []
        there = rival.solution.values
        rows = zip(found.parameters.free, found.z.tolist(), strict=True)
        return [{item.name: item.to_z(there[item.name]) - at for item, at in rows if item.name in there}]

    def suspects(self, item: TriedModel, known: Posterior) -> tuple[Suspect, ...] | None:
        """What the model may lack, with its numbers `known` that well; None where no time is left to look for it."""
        if _over(self._limit):
            return None
        found = self.searched or item.solution
        problem, held_out = self.logs.problem(found.parameters), self.logs.held_out(found.parameters)
        spread = dict(zip((own.name for own in known.parameters.free), known.std.tolist(), strict=True))
        try:
            with ExitStack() as stack:
                for own in (problem, held_out):
                    for simulated in (own, own.coarse) if own is not None else ():
                        if simulated is not None:
                            stack.enter_context(simulated.ending(self._limit))
                return suspects_of(problem, held_out, found, self._settings, spread)
        except OutOfTime:
            return None

    def _certain(self, item: TriedModel) -> TriedModel:
        """The same model with verified derivatives, at the minimum that these see."""
        found = self._verified(item)
        if found is None:
            self.short_of_time.append(item.row.name)
            return replace(item, solution=replace(item.solution, solver={**item.solution.solver, "stop": "time"}))
        return self._timed_for_certain(found)

    def _verified(self, item: TriedModel) -> TriedModel | None:
        """The same, in the present timing of the command; None where no time is left for it."""
        found, problem = item.solution, self.problem_of(item)
        says = self._said(item.row.name)
        search = Search(problem, self._settings, Stopwatch(), checkpoint=None, on_progress=says)
        try:
            with problem.ending(self._until(_SURE)):
                solution = replace(found, **search.certain(found.z))
        except OutOfTime:
            return None
        self.logs.begin_at(solution.values, problem.starts)
        return replace(item, solution=solution, val=self._on_val(solution))

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

    def cross_validated(self, item: TriedModel) -> Estimate | None:
        """The error on each motion of a fit to the others; None where motions are held out, or all are of one kind."""
        if set(self._scorer.splits) != {"train"} or _over(self._limit):
            return None
        problem = self.problem_of(item)
        try:
            with problem.ending(self._limit):
                places = without_each(problem, item.solution, self._scorer.executed)
        except OutOfTime:
            return None
        parameters = item.solution.parameters
        found = [
            self._scorer.score(parameters, parameters.values(z), "train", executed) for executed, z in places.items()
        ]
        return Scores.together(found).estimate(self._scorer.unit) if found else None

    def signals(self, item: TriedModel, split: str) -> dict[str, dict[str, float]]:
        """Logged signal -> joint -> error of one model on one split."""
        return self._scorer.signals(item.solution.parameters, item.solution.values, split, self.logs.weights.torque)

    @cached_property
    def judged(self) -> tuple[str, ...]:
        """The splits on which models are scored in the end: all, or without train where the time is over.

        Val says which is best, and the ladder has the errors of all splits.
        """
        splits = self._scorer.splits
        return tuple(split for split in splits if split != "train") if self._late and "val" in splits else splits

    @property
    def _scorer(self) -> Scorer:
        """Of models as the logs are simulated now."""
        way = self.logs.way.plain
        if way not in self._scorers:
            self._scorers[way] = Scorer(self.logs.exported, self.usable, jobs=self._jobs, seed=self._seed)
        return self._scorers[way]

    @property
    def _late(self) -> bool:
        return self._limit is not None and self._limit.spent >= _SURE

    @property
    def _of_this_step(self) -> bool:
        """Whether the logs are those of a simulation with the model's own step, as far as the present way tells."""
        return self._simulated == self.logs.way

    @property
    def torque_seen(self) -> bool:
        """Whether the logs' torques enter the residual, or drive the robot."""
        return self._signal == "torque" or bool(self.logs.weights.signals.get("torque"))

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
        segments = self.logs.segments
        return {
            "episodes": sorted({segment.episode_id for segment in segments}),
            "seconds": round(sum(segment.seconds for segment in segments), 2),
            "timestep_s": self.logs.exported.simulator.timestep_s,
            "command": self.logs.way.command,
            "window_s": self.config.data.window_s,
            "replay_window_s": self.logs.nominal.robot.replay.window_s,
            "samples": self.logs.problem(ParameterSet(())).size,
            **({"torque_weights": dict(self.logs.weights.own["torque"])} if self.logs.weights.own else {}),
            "flagged": self._flagged,
            "refused": self._refused,
        }

    @property
    def _refused(self) -> dict[str, dict[str, str]]:
        """Split -> motion -> why it can be neither fitted nor scored."""
        train = {**self._scorer.refused.get("train", {}), **self.logs.unfitted}
        return {**self._scorer.refused, **({"train": train} if train else {})}

    @property
    def ways_in_words(self) -> tuple[str, ...]:
        """How the fit simulates otherwise than the robot's description says."""
        said = self.logs.in_words
        if self._of_this_step:
            said += ("the logs look like those of a simulation with the model's own time step, and are fitted as such",)
        return (*said, self._torque_said) if self._torque_said else said

    def _timed(self, fit: Mapping[str, Any], *, rough: bool) -> TriedModel:
        """The base model, with the command held between its stamps or moving on, whichever explains the logs better.

        Both are searched from the same start: a fit that has made up for the wrong one with its numbers is far away.
        A command that moves on may be a curve: that of held ones comes nearer to it than lines do.
        """
        limit = self._until(_BASE)
        best = self._widened(self._try("base", fit, rough=rough, limit=limit), fit, rough=rough, limit=limit)
        if not self.logs.between_stamps or _over(limit):
            return best
        now, self.logs.way = self.logs.way, self.logs.way.retimed
        begun = {
            item.name: item.value + self.logs.later_s * (item.quantity == "delay_s")
            for item in best.solution.parameters
        }
        other = self._try(f"base, {self.logs.way.command}", fit, begun=begun, rough=rough, limit=limit)
        other = self._widened(other, fit, rough=rough, limit=limit)
        return self._better_timed(best, now, self._smoothed(other, fit, rough=rough, limit=limit))

    def _retimed(self, best: TriedModel, fit: Mapping[str, Any], *, rough: bool, limit: TimeLimit | None) -> TriedModel:
        """The same model with the other timing of the command, if that is better by now.

        Where numbers depend on the step, a wrong step may have decided. Where torques are weighed, positions alone did,
        which a wrong timing explains with other delays and inertias. Where more than noise is left, all is in doubt,
        also where the other timing was far worse: its search may have ended elsewhere, so that it begins where this one
        has ended if that is better. Where far more is left, something else is missing.
        """
        if self._rival is None or _over(limit) or self._left(best) > _FAR_FROM_NOISE:
            return best
        rival, command = self._rival
        close = rival is not None and (self.logs.way.trapezoidal or self.logs.weights.signals.get("torque"))
        if not close and self._explained(best):
            return best
        now, self.logs.way = self.logs.way, replace(self.logs.way, command=command)
        self._undecided.clear()
        places = [place for place in (self._shifted(best), rival) if place is not None]
        place = min(places, key=lambda own: self._rms_at(own.solution))
        other = self._further(place, fit, "once more", (), rough=rough, limit=limit)
        return self._better_timed(best, now, self._smoothed(other, fit, rough=rough, limit=limit))

    def _shifted(self, item: TriedModel) -> TriedModel:
        """A model of the other timing of the command, its delays as the present one has them."""
        found = item.solution
        delays = {own.name for own in found.parameters.free if own.quantity == "delay_s"}
        later = {name: at + self.logs.later_s * (name in delays) for name, at in found.values.items()}
        return replace(item, solution=replace(found, z=found.parameters.at(later).start))

    def _rms_at(self, found: Solution) -> float:
        """What numbers leave in the present way; infinite where they cannot be simulated."""
        residual = self.logs.problem(found.parameters).residuals(found.z[None])[0]
        return float(np.linalg.norm(residual)) if np.isfinite(residual).all() else float("inf")

    def _timed_for_certain(self, best: TriedModel) -> TriedModel:
        """The same model with the other timing of the command, if a payload was found since they were compared.

        Both at their minima, by verified derivatives: what a search leaves is more than they differ by.
        """
        rival, command = self._rival or (None, self.logs.way.command)
        if rival is None or _carries(rival.row.quantities) or not _carries(best.row.quantities):
            return best
        if self._left(best) > _FAR_FROM_NOISE:
            return best
        found, now = best.solution, self.logs.way
        self.logs.way = replace(now, command=command)
        self._undecided.clear()
        other = self._verified(self._shifted(best))
        if other is None:
            self.logs.way = now
            self.logs.begin_at(found.values)
            return best
        return self._better_timed(best, now, other)

    def _better_timed(self, best: TriedModel, now: Discretization, other: TriedModel) -> TriedModel:
        """The better one of two timings: that of the model until now, and the one which it was just fitted with."""
        gain = self._gained(best, other)
        better = gain > 0 and (gain > DECIDED or best.solution.rms > other.solution.rms)
        if not better:
            self._undecided.clear()  # between lines and a curve, neither of which it is
        if abs(gain) < DECIDED:
            ends = best.solution, other.solution
            one, other_one = (
                {item.name: item.to_z(own.values[item.name]) for item in own.parameters.free} for own in ends
            )
            root = probability(-abs(gain)) ** 0.5
            self._undecided.append({name: root * (other_one[name] - one[name]) for name in one if name in other_one})
        worse, way = (best, now) if better else (other, self.logs.way)
        kept = other if better else best
        self._rival = (worse if worse.solution.rms < _HOPELESS * kept.solution.rms else None, way.command)
        if better:
            return replace(other, row=replace(other.row, name=best.row.name))
        self.logs.way = now
        self.logs.begin_at(best.solution.values)
        return best

    def _exchanged(
        self, best: TriedModel, fit: Mapping[str, Any], *, rough: bool, limit: TimeLimit | None
    ) -> TriedModel:
        """The same model from where delays have taken a part of the drives' lag, or given some of theirs to it."""
        if _over(limit):
            return best
        z = exchanged(self.problem_of(best), best.solution, worth=_ROUGH)
        if z is None:
            return best
        place = replace(best, solution=replace(best.solution, z=z))
        return self._further(place, fit, "lags for delays", (), rough=rough, limit=limit, near=False)

    def _widened(self, best: TriedModel, fit: Mapping[str, Any], *, rough: bool, limit: TimeLimit | None) -> TriedModel:
        """The same model with more room where it ended on a bound that nobody has asked for."""
        asked = {name for name, choice in fit.items() if isinstance(choice, Mapping) and {"low", "high"} & set(choice)}
        for _ in range(_WIDENINGS):
            ended = zip(best.solution.parameters.free, best.solution.z, strict=True)
            edges = [(item, bound_of(item, float(z))) for item, z in ended if item.quantity not in asked]
            room = {item.name: widened(item, edge) for item, edge in edges if edge and not absent_at(item, edge)}
            if not room or _over(limit):
                break
            self._room |= room
            best = self._further(best, fit, "wider", (), rough=rough, limit=limit)
        return best

    def _gained(self, before: TriedModel, now: TriedModel) -> float:
        """Twice the logarithm of how much likelier the logs are, each sample counted as often as its memory allows."""
        samples = noise_of(self.problem_of(now), now.solution.residual).effective
        return 2.0 * samples * float(np.log(before.solution.rms / max(now.solution.rms, 1e-300)))

    def _loaded(
        self,
        name: str,
        fit: Mapping[str, Any],
        best: TriedModel,
        left_out: Sequence[str],
        *,
        limit: TimeLimit | None,
    ) -> TriedModel:
        """A model with a payload, which is found before masses are free.

        Masses and gains of the model without one have made up for it: it begins where that one began, or where it ended
        if that is near, with as much payload as its link was too heavy. Positions show products of masses and places:
        masses that are free from the beginning divide it among themselves, and a way back need not go down.
        """
        nominal, before = self.logs.nominal, best.solution
        begun, near = {item.name: item.value for item in before.parameters}, self._left(best) < _FAR_FROM_NOISE
        if not near:
            left_out = []  # what changes nothing where that ended may count from where it began
        masses = [item.name for item in before.parameters.free if item.quantity == "mass" and item.name not in left_out]
        if near:
            heavy = f"mass[{nominal.carrier}]"
            more = before.values[heavy] - nominal.inertial(nominal.carrier).mass if heavy in masses else 0.0
            # On a logarithmic scale no slope leads back from next to nothing. The gain that follows commands is never
            # that: where it is far below what robot.yaml says, the motions say so.
            follows = "kv" if self._signal == "velocity" else "kp"
            made = [item for item in make_parameters(fit, nominal, self.motions) if item.transform == "log"]
            least = {item.name: _DEAD * item.value for item in made if item.quantity != follows}
            dead = {name: low for name, low in least.items() if before.values.get(name, np.inf) < low}
            begun = {**before.values, **dead, "payload_mass": max(0.0, more)}
            left_out = [own for own in left_out if own not in dead]
        found = self._try(name, fit, begun=begun, left_out=[*left_out, *masses], rough=True, limit=limit)
        return self._further(found, fit, "with masses", left_out, rough=True, limit=limit)

    def _earned(self, richer: TriedModel, best: TriedModel) -> bool:
        """Whether a richer model earns its parameters: on motions that it was not fitted to.

        Few motions of val decide nothing by themselves; those of train count beside them. Without val, train decides,
        and a richer model has to be more likely by far than its further parameters make any: by twice the logarithm of
        the likelihood, as Akaike's criterion of 1974 counts it. A payload may leave val as it is if masses are where
        the robot's description has them for it.
        """
        gain = self._gained(best, richer)
        more = len(richer.solution.parameters.free) - len(best.solution.parameters.free)
        needed = DECIDED + 2.0 * max(more, 0)
        if richer.val is not None and best.val is not None:
            before, after = (
                self._scorer.deciding_error(item.solution.parameters, item.solution.values) for item in (best, richer)
            )
            if after < (1.0 - _WORTH) * before and (gain > needed or "train" not in self._scorer.deciding):
                return True
            nearer = _strangeness(best.solution) - _strangeness(richer.solution)
            heavy = _carries(richer.row.quantities) and not _carries(best.row.quantities) and nearer > DECIDED
            return heavy and after < (1.0 + _WORTH) * before and gain + nearer > needed
        return richer.solution.rms < (1.0 - _WORTH) * best.solution.rms and gain > needed

    def _explained(self, item: TriedModel) -> bool:
        """Whether what a fit leaves is no more than the noise of the measurement."""
        return self._left(item) < EXPLAINED

    def _left(self, item: TriedModel) -> float:
        """How many times the noise of the measurement a fit leaves."""
        return unexplained(whiteness_of(self.problem_of(item), item.solution.residual))

    def _on_val(self, solution: Solution) -> Scores | None:
        if "val" not in self._scorer.splits:
            return None
        return self._scorer.score(solution.parameters, solution.values, "val")

    def _settled(
        self,
        best: TriedModel,
        fit: Mapping[str, Any],
        *,
        left_out: Sequence[str] = (),
        rough: bool = False,
        limit: TimeLimit | None = None,
    ) -> TriedModel:
        """The same model, fitted with a finer time step while numbers depend on it and the data do not object."""
        while not _over(limit):
            self._finer = self._nearer_to_no_step(best)
            if self._finer is None or not self._finer.matters(self.logs.way, self.posterior_of(best).std):
                break
            if self._finer.lowers < _WORTH_A_STEP and self._left(best) > _FAR_FROM_NOISE:
                break  # whatever the model lacks, it is not a finer step; what that would change is in the intervals
            sure, candidates = self._until(_SURE), _TO_FINISH * len(best.solution.parameters.free)
            if sure is not None and sure.left_s < candidates * self._finer.candidate_s:
                break  # no time to come to an end with it
            best = self._moved(best, fit, self._finer, "finer", left_out, rough=rough, limit=limit)
        if self._finer is not None and self._finer.way.divisor == 2 and self._finer.gain < -DECIDED:
            return self._as_simulated(best, fit, left_out, rough=rough, limit=limit)
        return best

    def _as_simulated(
        self, best: TriedModel, fit: Mapping[str, Any], left_out: Sequence[str], *, rough: bool, limit: TimeLimit | None
    ) -> TriedModel:
        """The same model with the step and damping that it came with, if the logs are a simulation's with these.

        A robot has no step. Logs that are explained to their noise, and decidedly worse with half of the model's step,
        have the error of that step in them: a simulation has made them, and with it comes MuJoCo's own damping. A large
        step also makes friction that holds creep, so that soft friction must not be what the logs ask for.
        """
        left = whiteness_of(self.problem_of(best), best.solution.residual)
        if any(own.rms > _EXACT * own.noise for own in left.values() if own.noise):
            return best
        rigid = self.logs.way.rigid
        best = self._braked(best, fit, left_out, rough=rough, limit=limit)
        if self.logs.way.rigid != rigid:
            return self._settled(best, fit, left_out=left_out, rough=rough, limit=limit)
        if not self.logs.way.trapezoidal:
            self._simulated, self._finer = self.logs.way, None
            return best
        way = replace(self.logs.way, trapezoidal=False)
        other = self._compared(best, way)
        if other is None or other.gain < -DECIDED:
            return best
        self._simulated, self._finer = way, None
        return self._moved(best, fit, other, "as simulated", left_out, rough=rough, limit=limit)

    def _smoothed(
        self, best: TriedModel, fit: Mapping[str, Any], *, rough: bool, limit: TimeLimit | None
    ) -> TriedModel:
        """The same model with a command that has no corners at its stamps, if the logs say so.

        A line between two stamps that are h apart cuts a curve by up to h^2 / 8 times its second derivative: little
        beside the motion, and much beside what tells damping from inertia.
        """
        if self.logs.way.command != "linear" or _over(limit) or self._left(best) > _FAR_FROM_NOISE:
            return best
        return self._chosen(best, fit, replace(self.logs.way, command="smooth"), rough=rough, limit=limit)

    def _braked(
        self,
        best: TriedModel,
        fit: Mapping[str, Any],
        left_out: Sequence[str] = (),
        *,
        rough: bool,
        limit: TimeLimit | None,
    ) -> TriedModel:
        """The same model with dry friction as soft as the model has it, if the logs say so: those of simulations do."""
        friction = [item for item in best.solution.parameters if item.quantity == "frictionloss"]
        own = self.logs.nominal.model.dof_frictionloss.any()
        felt = own or any(best.solution.values[item.name] > 0.0 for item in friction)
        if not self.logs.way.rigid or not felt or _over(limit):
            return best
        return self._chosen(best, fit, replace(self.logs.way, rigid=False), left_out, rough=rough, limit=limit)

    def _chosen(
        self,
        best: TriedModel,
        fit: Mapping[str, Any],
        way: Discretization,
        left_out: Sequence[str] = (),
        *,
        rough: bool,
        limit: TimeLimit | None,
    ) -> TriedModel:
        """The same model simulated another way, if that explains the logs better."""
        other = self._compared(best, way)
        if other is None or not self._better(other, best):
            return best
        return self._moved(best, fit, other, "another way", left_out, rough=rough, limit=limit)

    def _moved(
        self,
        best: TriedModel,
        fit: Mapping[str, Any],
        other: Alternative,
        what: str,
        left_out: Sequence[str],
        *,
        rough: bool,
        limit: TimeLimit | None,
    ) -> TriedModel:
        """The same model in the way that it was compared with, from where that has its minimum."""
        assert self._minimum is not None
        z = np.asarray(np.clip(self._minimum[2][0] + other.shift, *best.solution.parameters.bounds))
        self.logs.way = other.way
        place = replace(best, solution=replace(best.solution, z=z))
        return self._further(place, fit, what, left_out, rough=rough, limit=limit)

    def _better(self, other: Alternative, best: TriedModel) -> bool:
        """Whether data prefer another fit; if they do not decide, what it would change by is kept for the intervals."""
        if abs(other.gain) < DECIDED:
            shift = probability(other.gain) ** 0.5 * other.shift
            names = [item.name for item in best.solution.parameters.free]
            self._undecided.append(dict(zip(names, shift.tolist(), strict=True)))
        return other.gain >= DECIDED

    def _heard(
        self,
        best: TriedModel,
        fit: Mapping[str, Any],
        *,
        left_out: Sequence[str] = (),
        rough: bool = False,
        limit: TimeLimit | None = None,
    ) -> TriedModel:
        """The same model with a logged torque beside the position, each joint's by what the present fit leaves of it.

        Weights by residuals are those of least squares whose variances are not known, found by iteration. They begin
        low, since a fit to positions alone leaves the scale of all torques to the model's masses.
        """
        if self._signal == "torque" or self.config.signals.get("torque") != AUTO or _over(limit):
            return best
        heard = logged_torque(self.problem_of(best), best.solution, self.config)
        if heard is None:
            return best
        self.logs.weights, self._torque_said = heard
        if not self.torque_seen:
            return best
        return self._further(best, fit, "with torque", left_out, rough=rough, limit=limit)

    def _nearer_to_no_step(self, item: TriedModel) -> Alternative | None:
        """What a way with less error of the step would find.

        A large step may have much error even so: a model that came is not taken for that of the logs before half of its
        step was looked at. None where the logs are those of a simulation with the model's step.
        """
        if self._of_this_step:
            return None
        found = self._compared(item)
        if found is None or self.logs.way.trapezoidal or found.gain > -DECIDED:
            return found
        return self._compared(item, finer(found.way)) or found

    def _compared(self, item: TriedModel, way: Discretization | None = None) -> Alternative | None:
        """What another way, or a finer time step, would find; None where it cannot be simulated, or no time is left."""
        found, present = item.solution, self.logs.way
        halved = way is None and present.divisor > 1
        way = way or (coarser(present) if halved else finer(present))
        now, other = self.problem_of(item), self.logs.problem(found.parameters, way)
        weight = noise_of(now, found.residual).weight
        # Both have nearly the same derivatives: with these, corrected by what steps show, each comes to its minimum.
        if self._minimum is None or self._minimum[0] is not found or self._minimum[1] != present:
            here = self._polished(now, found, weight)
            self._minimum = (found, present, here) if here is not None else None
        there = self._polished(other, found, weight)
        if self._minimum is None or there is None:
            return None
        if halved:
            return extrapolated(now, other, self._minimum[2], there, present)
        compared = alternative(now, other, self._minimum[2], there, weight, way)
        # Half of a step leaves a quarter of its error.
        left = 4.0 / 3.0 if present.trapezoidal and way.divisor > present.divisor else 1.0
        return replace(compared, shift=left * compared.shift)

    def _polished(self, problem: Problem, found: Solution, weight: float) -> Minimum | None:
        """The minimum of a fit that is simulated in some way, near a solution; None where it cannot be, or in time."""
        search = Search(problem, self._settings, Stopwatch(), checkpoint=None, on_progress=None)
        try:
            with problem.ending(self._until(_SURE)):
                return search.polished(found.z, found.jacobian, weight)
        except (DataError, OutOfTime):
            return None

    def _said(self, name: str) -> OnProgress | None:
        """What is called with how the search of a model goes on."""
        report = self._on_progress
        return None if report is None else lambda progress: report(name, progress)

    def _frozen(self, item: TriedModel) -> list[str]:
        return [parameter.name for parameter in item.solution.parameters if parameter.frozen]

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
        begun: Mapping[str, float] | None = None,
        near: bool = True,
    ) -> TriedModel:
        """Fit one model, from where another search ended (`start`) or began (`begun`), or from afar.

        Of its parameters, `left_out` stays as the nominal model has it and `absent` at zero; `rough` is to compare
        with. `near` a start, its derivatives lead on.
        """
        began = time.perf_counter()
        parameters = freeze_still(make_parameters(fit, self.logs.nominal, self.motions), self.seen).freeze(left_out)
        parameters = parameters.within(self._room).at(dict.fromkeys(absent, 0.0)).hold(absent)
        settings = replace(self._settings, starts=starts or self._settings.starts)
        if rough:
            newton = settings.gauss_newton
            newton = replace(newton, tolerance=max(newton.tolerance, _ROUGH))
            settings = replace(settings, gauss_newton=newton)
        if begun is not None:
            problem = self.logs.problem(off_bounds(parameters.at(begun)))
        elif start is None:
            started = begun_start(self.logs.problem(parameters), self._train, limit)
            self.logs.begin_at({item.name: item.value for item in started})
            problem = self.logs.problem(started)
        else:
            problem = self.logs.problem(off_bounds(parameters.at(start.values)))
            # From a good place there may be nothing left to gain, which is no reason to search everywhere.
            settings = replace(settings, solver="gauss-newton") if settings.solver == "auto" else settings
        if not problem.parameters.free:
            raise NotIdentifiable(
                "no parameter is left to fit", got="; ".join(self.seen.statements) or "all are frozen"
            )
        prepared_s = time.perf_counter() - began
        solution = solve(
            problem,
            settings,
            checkpoint=self._checkpoints / f"{name}.json" if self._checkpoints else None,
            on_progress=self._said(name),
            limit=limit,
            cluster=self._cluster,
            slopes=_slopes_of(start, problem.parameters) if near else None,
        )
        took_s = time.perf_counter() - began
        if self._cluster is None:  # with one, the seconds of the starts are not one after the other
            took_s = max(took_s, prepared_s + solution.solver["seconds"])  # before an interruption, too
        if solution.solver["stop"] == "time":
            self.short_of_time.append(name)
        self.logs.begin_at(solution.values)
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
            self._on_val(solution),
        )

    def _until(self, spent: float) -> TimeLimit | None:
        return None if self._limit is None else self._limit.until(spent)

    def _to_the_end(self, rough: TriedModel, fit: Mapping[str, Any], left_out: Sequence[str]) -> TriedModel:
        """The same model from where a rough search ended."""
        return self._further(rough, fit, "to the end", left_out, limit=self._until(_BEST))

    def _further(
        self,
        first: TriedModel,
        fit: Mapping[str, Any],
        what: str,
        left_out: Sequence[str],
        *,
        rough: bool = False,
        limit: TimeLimit | None = None,
        near: bool = True,
    ) -> TriedModel:
        """The same model from where another search ended; what is told of both is told as of one."""
        name, before = first.row.name, first.solution
        absent = [item.name for item in before.parameters if item.name in left_out and item.value == 0.0]
        kept = [item for item in left_out if item not in absent]
        end = self._try(
            f"{name}, {what}",
            fit,
            before,
            left_out=kept,
            absent=absent,
            rough=rough,
            starts=1,
            limit=limit,
            near=near,
        )
        last = end.solution
        spent = {key: before.solver[key] + last.solver[key] for key in ("iterations", "evaluations", "seconds")}
        begun = {item.name: item.value for item in before.parameters.free}
        solution = replace(
            last,
            parameters=last.parameters.at(begun),
            solver={**before.solver, "stop": last.solver["stop"], **spent},
            agreement=before.agreement,
        )
        seconds = round(first.row.seconds + end.row.seconds, 2)
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


def _slopes_of(before: Solution | None, parameters: ParameterSet) -> Float64[np.ndarray, "P N"] | None:
    """Derivatives by these free parameters that a search has ended with; None where it has not, or not by all."""
    if before is None or before.solver["stop"] != "converged":
        return None
    rows = {item.name: row for item, row in zip(before.parameters.free, before.jacobian, strict=True)}
    names = [item.name for item in parameters.free]
    return np.array([rows[name] for name in names]) if set(names) <= set(rows) else None


def _carries(quantities: Iterable[str]) -> bool:
    """Whether a model has a payload."""
    return "payload_mass" in quantities


def _strangeness(found: Solution) -> float:
    """Squares of how far masses are from those of the robot's description, in standard deviations of their priors."""
    mean, std = found.parameters.prior
    masses = np.array([item.quantity == "mass" for item in found.parameters.free])
    return float(np.sum(((found.z - mean) / std)[masses] ** 2))


def _over(limit: TimeLimit | None) -> bool:
    return limit is not None and limit.over


def _payload_note(logs: Sequence[Episode]) -> tuple[str, ...]:
    carried = sorted({log.meta.payload_kg for log in logs if log.meta.payload_kg})
    if not carried:
        return ()
    amounts = ", ".join(f"{payload:g}" for payload in carried)
    note = (
        f"some motions carry a payload ({amounts} kg) that the model lacks: name its site in robot.yaml (payload: "
        "{sites: [...]}), leave these motions out, or the fit averages over both"
    )
    return (note,)
