"""Where the gap comes from: what the fitted numbers of each cause take away, on motions they were not fitted to."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from trueup.core.attribution import SHORT_OF_TIME, UNEXPLAINED, Attribution, AttributionCause
from trueup.core.episode import Episode
from trueup.core.fit_result import FitResult
from trueup.core.parameters import Parameter, ParameterSet, split_name
from trueup.core.provenance import provenance
from trueup.core.quality import left_out
from trueup.core.time_limit import TimeLimit
from trueup.errors import NotIdentifiable
from trueup.identify.candidate import Nominal
from trueup.identify.config import IdentifyConfig, make_parameters
from trueup.identify.excitation import excitation_of, freeze_still
from trueup.identify.problem import Problem, Weights
from trueup.identify.quantities import Cause, quantity
from trueup.identify.scoring import Scorer, Scores, judged
from trueup.identify.segments import make_segments, usable
from trueup.identify.solution import OnModel
from trueup.identify.solve import solve
from trueup.identify.start import begun_start
from trueup.robots import CommandTiming, RobotSpec, refuse_unknown_gains

# Shares of a time limit at which looking for a start and the search end; simulations along the way follow.
_STARTED, _SEARCHED = 0.3, 0.8
# Pieces of the way from the model as it came to the fitted one.
_PIECES = 8
# Shares of the gap are told in percent: a search ends when an iteration lowers the cost by less than this share, and
# after so many of them.
_ROUGH, _ITERATIONS = 0.005, 30
_ALL = "all causes"
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
    fitted: FitResult | None = None,
    config: IdentifyConfig | None = None,
    jobs: int = 1,
    seed: int = 0,
    data_hash: str | None = None,
    on_progress: OnModel | None = None,
    limit: TimeLimit | None = None,
) -> Attribution:
    """How much of the gap each cause takes away: delay, gains, friction, gravity or payload, inertia.

    With the numbers x of the model as it came at a, and fitted ones at b, all are moved together, x(t) = a + t (b - a),
    and the mean square error E on test (val, or train itself, where there is none) changes by the sum of the integrals
    of dE/dx_i (b_i - a_i) over t from 0 to 1. A cause has the parts of its numbers. So there is no order in which
    causes are taken away, and no model whose drive is fitted and whose inertia is not.

    Source: Aumann, Shapley 1974, "Values of Non-Atomic Games"; Sundararajan, Taly, Yan 2017, arXiv:1703.01365.

    Args:
        episodes: split -> motions, in the robot's joint names and SI units.
        robot: its description.
        model: MJCF or URDF.
        fitted: a fit of the same robot, whose numbers are taken; if None, one search without richer models is made for
            this.
        config: what that search fits and to what; the default for the robot's controller if None.
        jobs: threads.
        seed: of all draws.
        data_hash: of the dataset, for the provenance.
        on_progress: called after every iteration of the search.
        limit: when the search has to end; which one it ended is said.

    Raises:
        NotIdentifiable: there is nothing to learn from these motions.
        DataError: no motion can be simulated.
    """
    robot = judged(robot, config)
    nominal = Nominal(robot, model)
    settled = (config or IdentifyConfig()).resolved(nominal)
    fit = dict(settled.fit)
    if config is None or not config.fit:
        fit.setdefault("mass", "all")
    logs, broken = usable(episodes, drop_flagged=settled.data.drop)
    refuse_unknown_gains(robot, (log.meta for own in logs.values() for log in own))
    path = _Path(robot, model, logs, jobs, seed)
    seen = excitation_of(logs["train"], robot.scored_joints, robot.controller.signal, nominal.commanded_limits)
    refused: dict[str, str] = {}
    in_time = limit is None or not limit.over
    if fitted is not None:
        own = (quantity(name).parameter(nominal, target) for name, target in map(split_name, _lasting(fitted.values)))
        path.take(ParameterSet(tuple(own)).at(fitted.values), fitted.data.get("command", robot.replay.command))
    elif in_time:
        rule = replace(settled.data, budget_s=settled.data.budget_s / 2).rule(robot, seed)
        segments, errors = make_segments(logs["train"], nominal.simulator, rule)
        refused = {name: error.summary for name, error in errors.items()}
        motions = [segment.episode_id for segment in segments]
        parameters = freeze_still(make_parameters(fit, nominal, motions), seen)
        weights = Weights(settled.weights, settled.joints)
        problem = Problem(nominal, parameters, segments, weights=weights, jobs=jobs)
        # Derivatives where the search begins, a step, and those at its end.
        least_s = path.second_s * sum(own.seconds for own in segments) * (2 * len(parameters.free) + 2)
        in_time = limit is None or limit.left_s > least_s
        if in_time:
            values, in_time = _searched(problem, logs["train"], settled, seed, on_progress, limit)
            path.take(parameters.at(values), robot.replay.command)
    taken, end, simulated = path.taken(limit)
    statements = [
        *left_out(_unused(broken, refused, path.own.refused)),
        *seen.statements,
        "shares: each cause's part of the error removed as all parameters move together from original to fitted values",
    ]
    if not (in_time and simulated):
        statements.append(f"{SHORT_OF_TIME} {_ALL}")
    if path.split == "train":
        statements.insert(0, "scored on the motions it was fitted to, because there are no others")
    before, after = _squares(path.before), _squares(end)
    causes = path.causes if simulated else []
    total = {cause: sum(own[cause] for own in taken.values()) for cause in causes}
    return Attribution(
        split=path.split,
        unit=path.own.unit,
        before=path.before.estimate(path.own.unit),
        after=end.estimate(path.own.unit),
        causes=tuple(map(path.cause, causes)),
        shares={
            joint: _shares({cause: own[cause] for cause in causes}, before[joint], after[joint])
            for joint, own in taken.items()
        },
        shares_total=_shares(total, sum(before.values()), sum(after.values())),
        statements=tuple(statements),
        provenance=provenance(
            config={
                "robot": robot.to_dict(),
                "model": model.name,
                "identify": fitted.data.get("inputs") if fitted else replace(settled, fit=fit).to_json(),
            },
            seed=seed,
            data_hash=data_hash,
        ),
    )


def _searched(
    problem: Problem,
    episodes: Sequence[Episode],
    config: IdentifyConfig,
    seed: int,
    on_progress: OnModel | None,
    limit: TimeLimit | None,
) -> tuple[dict[str, float], bool]:
    """The numbers of all causes, roughly, and whether there was time to find them."""
    until = None if limit is None else limit.until(_STARTED)
    problem = problem.with_parameters(begun_start(problem, episodes, until))
    if not problem.parameters.free:
        return {item.name: item.value for item in problem.parameters}, True
    settings = config.solver.settings(seed)
    newton = settings.gauss_newton
    tolerance, iterations = max(newton.tolerance, _ROUGH), min(newton.max_iterations, _ITERATIONS)
    newton = replace(newton, tolerance=tolerance, max_iterations=iterations)
    found = solve(
        problem,
        replace(settings, solver="gauss-newton", starts=1, gauss_newton=newton),
        on_progress=None if on_progress is None else lambda progress: on_progress(_ALL, progress),
        limit=None if limit is None else limit.until(_SEARCHED),
    )
    return found.values, found.solver["stop"] != "time"


class _Path:
    """The way from the model as it came to the fitted one, scored on one split."""

    def __init__(
        self, robot: RobotSpec, model: Path, logs: Mapping[str, Sequence[Episode]], jobs: int, seed: int
    ) -> None:
        self._robot, self._model, self._jobs, self._seed = robot, model, jobs, seed
        split = next((name for name in ("test", "val", "train") if logs.get(name)), None)
        if split is None or not logs.get("train"):
            raise NotIdentifiable("there is no motion to fit", hint="Give --splits at import.")
        self.split, self._logs = split, {split: logs[split]}
        self._scorers: dict[tuple[bool, str], Scorer] = {}
        self._fitted: tuple[Parameter, ...] = ()
        self._command: CommandTiming = robot.replay.command
        began = time.perf_counter()
        self.before = self.scores({})
        self._each_s = time.perf_counter() - began
        # To simulate a second.
        self.second_s = self._each_s / sum(log.measured.duration_s for log in logs[split])

    def take(self, fitted: ParameterSet, command: CommandTiming) -> None:
        """Take fitted numbers, and how commands act between their stamps with them."""
        own = set(_lasting(fitted.names))
        self._fitted = tuple(item for item in fitted if item.name in own and item.value != item.nominal)
        self._command = command

    @property
    def own(self) -> Scorer:
        """Scores of the model as it came."""
        return self._scorer(hard=False, command=self._robot.replay.command)

    @property
    def causes(self) -> list[Cause]:
        """Those that have fitted numbers."""
        own = {quantity(item.quantity).cause for item in self._fitted}
        return [cause for cause in _LABELS if cause in own]

    def cause(self, name: Cause) -> AttributionCause:
        """One of them."""
        own = [item.quantity for item in self._fitted if quantity(item.quantity).cause == name]
        return AttributionCause(name, _LABELS[name], tuple(dict.fromkeys(own)), len(own))

    def scores(self, places: Mapping[Cause, float]) -> Scores:
        """Errors where each cause is at a place of its own, from 0, the model as it came, to 1.

        What that model has no number for is as it was fitted at all places but 0.
        """
        own = [(item, places.get(quantity(item.quantity).cause, 0.0)) for item in self._fitted]
        moved = ParameterSet(
            tuple(
                replace(item, value=begin + place * (item.value - begin), frozen=True)
                for item, place in own
                for begin in [item.value if item.nominal is None else item.nominal]
                if place > 0.0
            )
        )
        # MuJoCo's soft friction is part of what the model says; fitted friction holds.
        command = self._command if places.get("delay") else self._robot.replay.command
        return self._scorer(hard=bool(places.get("friction")), command=command).score(moved, {}, self.split)

    def taken(self, limit: TimeLimit | None) -> tuple[dict[str, dict[Cause, float]], Scores, bool]:
        """Joint -> cause -> mean square error that it takes away; the scores at the end; whether there was time.

        Along each piece of the way, a cause is moved before all others and after them. The mean of what it takes away
        is right to the second order of the piece; what the causes together lack of the whole is shared alike. With
        little time there are fewer pieces.
        """
        causes, joints = self.causes, list(self.before.pooled)
        taken = {joint: dict.fromkeys(causes, 0.0) for joint in joints}
        here, square, pieces = self.before, _squares(self.before), _PIECES if causes else 0
        if limit is not None:
            pieces = min(pieces, int(limit.left_s / (self._each_s * (2 * len(causes) + 1))))
        for number in range(pieces):
            now, then = (dict.fromkeys(causes, (number + more) / pieces) for more in (0, 1))
            end = self.scores(then)
            there = _squares(end)
            first = {cause: _squares(self.scores({**now, cause: then[cause]})) for cause in causes}
            last = {cause: _squares(self.scores({**then, cause: now[cause]})) for cause in causes}
            for joint in joints:
                whole = square[joint] - there[joint]
                own = {
                    cause: 0.5 * (square[joint] - first[cause][joint] + last[cause][joint] - there[joint])
                    for cause in causes
                }
                lacks = (whole - sum(own.values())) / len(causes)
                for cause in causes:
                    taken[joint][cause] += own[cause] + lacks
            here, square = end, there
        return taken, here, bool(pieces) or not causes

    def _scorer(self, *, hard: bool, command: CommandTiming) -> Scorer:
        if (hard, command) not in self._scorers:
            robot = replace(self._robot, replay=replace(self._robot.replay, command=command))
            nominal = Nominal(robot, self._model, hard_friction=hard)
            self._scorers[hard, command] = Scorer(nominal, self._logs, jobs=self._jobs, seed=self._seed)
        return self._scorers[hard, command]


def _squares(scores: Scores) -> dict[str, float]:
    return {joint: value**2 for joint, value in scores.pooled.items()}


def _shares(taken: Mapping[Cause, float], before: float, after: float) -> dict[str, float]:
    """Cause -> share of a mean square error, and the rest; NaN where there was none, or one is not known."""
    known = math.isfinite(before) and before > 0.0 and all(map(math.isfinite, [*taken.values(), after]))
    return {
        **{cause: own / before if known else math.nan for cause, own in taken.items()},
        UNEXPLAINED: after / before if known else math.nan,
    }


def _lasting(names: Iterable[str]) -> list[str]:
    """Those of the robot, and not of single recordings."""
    return [name for name in names if quantity(split_name(name)[0]).of != "motion"]


def _unused(
    flagged: Mapping[str, Mapping[str, str]],
    unfitted: Mapping[str, str],
    unscored: Mapping[str, Mapping[str, str]],
) -> dict[str, dict[str, str]]:
    """Split -> motion -> why it was neither fitted nor scored."""
    found = {name: dict(why) for name, why in flagged.items()}
    found.setdefault("train", {}).update(unfitted)
    for name, own in unscored.items():
        found.setdefault(name, {}).update(own)
    return found
