"""Where the gap comes from: nested fits, each with one more cause, scored on motions they were not fitted to."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from trueup.core.attribution import SHORT_OF_TIME, Attribution, AttributionStep
from trueup.core.episode import Episode
from trueup.core.parameters import ParameterSet
from trueup.core.provenance import provenance
from trueup.core.quality import left_out
from trueup.core.time_limit import TimeLimit
from trueup.errors import NotIdentifiable
from trueup.identify.candidate import Nominal
from trueup.identify.config import IdentifyConfig, make_parameters
from trueup.identify.excitation import excitation_of, freeze_still
from trueup.identify.problem import Problem, Weights
from trueup.identify.quantities import Cause, quantity
from trueup.identify.scoring import Scorer, judged
from trueup.identify.segments import make_segments, usable
from trueup.identify.solution import OnModel, OnProgress
from trueup.identify.solve import solve
from trueup.identify.start import off_bounds, swept_start
from trueup.robots import RobotSpec, refuse_unknown_gains

# Share of the time of a cause at which looking for a start ends.
_SWEEP = 0.4
# Shares of the gap are told in percent: a search ends when an iteration lowers the cost by less than this share, and
# after so many of them.
_ROUGH, _ITERATIONS = 0.005, 8
_LABELS: Mapping[Cause, str] = {
    "delay": "delay",
    "gains": "gains of the drive",
    "friction": "friction",
    "gravity": "gravity or payload",
    "inertia": "inertia",
}


def explain(
    episodes: Mapping[str, Sequence[Episode]],
    robot: RobotSpec,
    model: Path,
    *,
    config: IdentifyConfig | None = None,
    jobs: int = 1,
    seed: int = 0,
    data_hash: str | None = None,
    on_progress: OnModel | None = None,
    limit: TimeLimit | None = None,
) -> Attribution:
    """How much of the gap each cause takes away, in the order delay, gains, friction, gravity, inertia.

    Each step fits its own quantities and all those before it on train, starting where the last one ended, and is
    scored on test (val, or train itself, where there is none). What a cause takes away depends on what was taken
    away before it; the order is fixed so that results can be compared.

    Args:
        episodes: split -> motions, in the robot's joint names and SI units.
        robot: its description.
        model: MJCF or URDF.
        config: what to fit and to what; the default for the robot's controller if None. Its `models` are left out
            except for masses.
        jobs: threads.
        seed: of all draws.
        data_hash: of the dataset, for the provenance.
        on_progress: called after every iteration of every step.
        limit: when searches have to end, each with a fair share of what is left; which ones it ended is said.

    Raises:
        NotIdentifiable: there is nothing to learn from these motions.
        DataError: no motion can be simulated.
    """
    robot = judged(robot, config)
    # MuJoCo's soft friction is part of what the model says; from the friction step on it is held exactly.
    soft, hard = Nominal(robot, model, hard_friction=False), Nominal(robot, model)
    given = config or IdentifyConfig()
    settled = given.resolved(hard)
    fit = dict(settled.fit)
    if not given.fit:
        fit.setdefault("mass", "all")
    logs, broken = usable(episodes, drop_flagged=settled.data.drop)
    refuse_unknown_gains(robot, (log.meta for own in logs.values() for log in own))
    nested = _NestedFits(soft, hard, logs, settled, jobs, seed)
    steps = [nested.nominal_step()]
    causes = {
        cause: own
        for cause in _LABELS
        if (own := {name: choice for name, choice in fit.items() if quantity(name).cause == cause})
    }
    for number, (cause, own) in enumerate(causes.items()):
        report = None if on_progress is None else _named(on_progress, _LABELS[cause])
        if limit is not None and limit.left_s <= nested.least_s(own):
            nested.unfinished += [_LABELS[name] for name in list(causes)[number:]]
            break
        share = None if limit is None else limit.share(1.0 / (len(causes) - number)).sooner(nested.scoring_s)
        steps.append(nested.step(cause, _LABELS[cause], own, report, share))
    statements = [
        *left_out(nested.unused(broken)),
        *nested.seen.statements,
        "causes are removed from left to right; another order would split the gap differently",
    ]
    if nested.unfinished:
        statements.append(f"{SHORT_OF_TIME} {', '.join(nested.unfinished)}")
    if nested.split == "train":
        statements.insert(0, "scored on the motions it was fitted to, because there are no others")
    return Attribution.of(
        nested.split,
        nested.unit,
        steps,
        statements=statements,
        provenance=provenance(
            config={"robot": robot.to_dict(), "model": model.name, "identify": replace(settled, fit=fit).to_json()},
            seed=seed,
            data_hash=data_hash,
        ),
    )


class _NestedFits:
    """Fits of which each has one more cause than the one before, and begins where that one has ended."""

    def __init__(
        self,
        soft: Nominal,
        hard: Nominal,
        logs: Mapping[str, Sequence[Episode]],
        config: IdentifyConfig,
        jobs: int,
        seed: int,
    ) -> None:
        self._soft, self._hard, self._jobs = soft, hard, jobs
        first = Scorer(soft, logs, jobs=jobs, seed=seed)
        split = next((name for name in ("test", "val", "train") if name in first.splits), None)
        if split is None or not logs.get("train"):
            raise NotIdentifiable("there is no motion to fit", hint="Give --splits at import.")
        self.split, self.unit, self._unscored = split, first.unit, first.refused
        self._scorers = {id(soft): first, id(hard): Scorer(hard, {split: logs[split]}, jobs=jobs, seed=seed)}
        robot = soft.robot
        self.seen = excitation_of(logs["train"], robot.scored_joints, robot.controller.signal, soft.commanded_limits)
        rule = replace(config.data, budget_s=config.data.budget_s / 2).rule(robot, seed)
        self._segments, self._refused = make_segments(logs["train"], soft.simulator, rule)
        self._motions = [segment.episode_id for segment in self._segments]
        self._weights = Weights(config.weights, config.joints)
        settings = config.solver.settings(seed)
        newton = settings.gauss_newton
        tolerance, iterations = max(newton.tolerance, _ROUGH), min(newton.max_iterations, _ITERATIONS)
        newton = replace(newton, tolerance=tolerance, max_iterations=iterations)
        self._settings = replace(settings, solver="gauss-newton", starts=1, gauss_newton=newton)
        self._chosen: dict[str, object] = {}
        self._values: dict[str, float] = {}
        self._scored_s = sum(log.measured.duration_s for log in logs[split])
        self.unfinished: list[str] = []
        self.scoring_s = self._candidate_s = 0.0

    def nominal_step(self) -> AttributionStep:
        """The model as it came."""
        began = time.perf_counter()
        scores = self._scorers[id(self._soft)].score(ParameterSet(()), {}, self.split)
        self.scoring_s = time.perf_counter() - began
        self._candidate_s = self.scoring_s * sum(item.seconds for item in self._segments) / self._scored_s
        return AttributionStep("", "the model as it came", (), 0, scores.pooled, scores.estimate(self.unit))

    def least_s(self, own: Mapping[str, object]) -> float:
        """What one more cause takes at least: where it begins, derivatives there, and a step; then its score [s]."""
        parameters = freeze_still(make_parameters({**self._chosen, **own}, self._hard, self._motions), self.seen)
        return self.scoring_s + self._candidate_s * (2 * len(parameters.free) + 2)

    def step(
        self,
        cause: Cause,
        label: str,
        own: Mapping[str, object],
        on_progress: OnProgress | None,
        limit: TimeLimit | None,
    ) -> AttributionStep:
        """Fit the quantities of one more cause and all those before."""
        began = time.perf_counter()
        self._chosen |= own
        nominal = self._soft if cause in ("delay", "gains") else self._hard
        parameters = off_bounds(
            freeze_still(make_parameters(self._chosen, nominal, self._motions), self.seen).at(self._values)
        )
        problem = Problem(nominal, parameters, self._segments, weights=self._weights, jobs=self._jobs)
        # Only what is new is looked for from afar.
        new = parameters.hold(item.name for item in parameters if item.quantity not in own)
        if new.free:
            swept = swept_start(problem.with_parameters(new), None if limit is None else limit.until(_SWEEP))
            problem = problem.with_parameters(
                parameters.at({item.name: item.value for item in swept if not item.frozen})
            )
        if parameters.free:
            found = solve(problem, self._settings, on_progress=on_progress, limit=limit)
            self._values = found.values
            if found.solver["stop"] == "time":
                self.unfinished.append(label)
            self._candidate_s = problem.seconds / max(1, problem.evaluations)
        scores = self._scorers[id(nominal)].score(problem.parameters, self._values, self.split)
        seconds = time.perf_counter() - began
        count = len(parameters.free)
        return AttributionStep(cause, label, tuple(own), count, scores.pooled, scores.estimate(self.unit), seconds)

    def unused(self, flagged: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, str]]:
        """Split -> motion -> why it was neither fitted nor scored."""
        found = {name: dict(why) for name, why in flagged.items()}
        found.setdefault("train", {}).update({name: error.summary for name, error in self._refused.items()})
        for name, own in self._unscored.items():
            found.setdefault(name, {}).update(own)
        return found


def _named(on_progress: OnModel, label: str) -> OnProgress:
    return lambda progress: on_progress(label, progress)
