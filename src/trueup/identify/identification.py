"""Identification of one robot: motions in, fit result out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from trueup.core.episode import Episode
from trueup.core.fit_result import FitResult
from trueup.core.parameters import ParameterSet
from trueup.core.provenance import provenance
from trueup.core.ray_workers import Cluster
from trueup.core.time_limit import TimeLimit
from trueup.errors import ConfigError
from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.config import IdentifyConfig
from trueup.identify.model_search import ModelSearch
from trueup.identify.problem import Problem
from trueup.identify.scoring import CROSS_VALIDATION, Scorer, judged
from trueup.identify.solution import OnModel
from trueup.identify.suspects import strange_masses
from trueup.identify.uncertainty import (
    Posterior,
    fitted_parameters,
    open_directions,
    relabelled,
    whiteness_of,
)
from trueup.identify.verdict import Evidence, correlations, doubt, verdict
from trueup.robots import RobotSpec


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
    limit: TimeLimit | None = None,
    cluster: Cluster | None = None,
) -> Identification:
    """Estimate what the simulator has wrong.

    Fits on `train`, chooses among models on `val`, and looks at `test` once, with the chosen one and, for the table,
    with the others. Parameters of the default choice that the motions do not show stay as the model has them. Where
    the robot says no `replay.window_s`, models are judged by the windows of the fit.

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
        limit: when searches have to end; richer models that would begin too late are not tried, which is said.
        cluster: where the several starts of each search are searched from; its machines find model and checkpoints in
            the same folders. The result is the same.

    Raises:
        NotIdentifiable: there is nothing to learn from these motions.
        ConfigError: the configuration does not fit the robot, it has one start and there is a cluster, no cluster
            answers, or a worker of it was killed again and again.
        DataError: no motion can be simulated.
    """
    if cluster is not None:
        refuse_one_start(config)
    robot = judged(robot, config)
    nominal = Nominal(robot, model)
    search = ModelSearch(
        nominal,
        episodes,
        config,
        jobs=jobs,
        seed=seed,
        checkpoints=checkpoints,
        on_progress=on_progress,
        limit=limit,
        cluster=cluster,
    )
    best, tried = search.climb()
    solution, problem = best.solution, search.problem_of(best)
    posterior = search.certain_posterior(best).of_model()
    parameters = fitted_parameters(posterior)
    rows = tuple(search.scored_row(item, chosen=item is best) for item in tried)
    soft = Scorer(Nominal(robot, model, hard_friction=False), search.usable, jobs=jobs, seed=seed)
    errors = {
        "nominal": {split: soft.score(ParameterSet(()), {}, split).estimate(soft.unit) for split in search.judged},
        "fitted": dict(next(row for row in rows if row.chosen).splits),
    }
    if (crossed := search.cross_validated(best)) is not None:
        errors["fitted"][CROSS_VALIDATION] = crossed
    commanded = {split: error for split in soft.splits if (error := soft.command(split)) is not None}
    errors |= {"command": commanded} if commanded else {}
    seen = "train" if "train" in search.judged else next(iter(search.judged))
    if seen in commanded and not errors["fitted"][seen].value < commanded[seen].value:
        nothing = "not determined: the fitted model does not explain these motions"
        parameters = relabelled(parameters, ("yes", "effective", "weakly"), "no", nothing)
    judge = "val" if "val" in soft.splits else next(iter(soft.splits))
    before, after = soft.signals(ParameterSet(()), {}, judge, search.logs.weights.torque), search.signals(best, judge)
    signals = {
        signal: {joint: (error, after[signal][joint]) for joint, error in own.items()} for signal, own in before.items()
    }
    whiteness = whiteness_of(problem, solution.residual)
    suspects = search.suspects(best, posterior)
    evidence = Evidence(
        solution,
        parameters,
        whiteness,
        errors,
        signals,
        soft.size(judge),
        search.chosen_by_user,
        search.torque_seen,
        suspects,
        strange_masses(solution.parameters, solution.values),
    )
    beforehand = (*search.ways_in_words, *search.seen.statements, *search.notes, *_untried(search.untried))
    status, statements = verdict(evidence, beforehand)
    if why := doubt(evidence):
        parameters = relabelled(parameters, ("yes",), "effective", f"effective value: the data determine it, but {why}")
    result = FitResult(
        status=status,
        statements=statements,
        solver={**solution.solver, "why": search.why, **_short_of_time([*search.short_of_time, *search.untried])},
        parameters=parameters,
        correlation=correlations(posterior),
        directions=open_directions(posterior),
        whiteness=whiteness,
        models=rows,
        errors=errors,
        signals=signals,
        suspects=suspects or (),
        data={**search.data, "encoder_zeros": search.encoder_zeros(best)},
        provenance=provenance(
            config={"robot": robot.to_dict(), "model": model.name, "identify": search.config.to_json()},
            seed=seed,
            data_hash=data_hash,
        ),
    )
    return Identification(result, search.logs.exported, posterior.parameters, posterior)


def refuse_one_start(config: IdentifyConfig | None) -> None:
    """A cluster works on several starts at a time; one of them has nothing to share.

    Raises:
        ConfigError: the configuration has one.
    """
    starts = (config or IdentifyConfig()).solver.starts
    if starts < 2:
        raise ConfigError(
            "a Ray cluster searches from several starts side by side",
            got=f"solver: {{starts: {starts}}}",
            expected="2 or more",
            hint="Write solver: {starts: 8} into the file that you give as --config, or leave --ray out.",
        )


def _short_of_time(models: Sequence[str]) -> dict[str, list[str]]:
    """Which searches a time limit has ended or kept from beginning: without it, another fit may come of it."""
    return {"short_of_time": list(models)} if models else {}


def _untried(models: Sequence[str]) -> tuple[str, ...]:
    return (f"no time was left to try richer models: {', '.join(models)}",) if models else ()
