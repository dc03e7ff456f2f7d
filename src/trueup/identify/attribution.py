"""Where the gap comes from: nested fits, each with one more cause, scored on motions they were not fitted to."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from trueup.core.attribution import Attribution, AttributionStep
from trueup.core.episode import Episode
from trueup.core.parameters import ParameterSet
from trueup.core.provenance import provenance
from trueup.errors import NotIdentifiable
from trueup.identify.bench import OnModel, usable
from trueup.identify.candidate import Nominal
from trueup.identify.config import IdentifyConfig, make_parameters
from trueup.identify.excitation import excitation_of, freeze_still
from trueup.identify.problem import Problem, Weights
from trueup.identify.quantities import Cause, quantity
from trueup.identify.scoring import Scorer, judged
from trueup.identify.segments import SegmentRule, left_out, make_segments
from trueup.identify.solution import OnProgress
from trueup.identify.solve import solve
from trueup.identify.start import off_bounds, swept_start
from trueup.robots import RobotSpec

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
    sorted_out = {split: usable(own, keep_flagged=settled.data.keep_flagged) for split, own in episodes.items()}
    logs = {split: own for split, (own, _) in sorted_out.items()}
    first = Scorer(soft, logs, jobs=jobs, seed=seed)
    split = next((name for name in ("test", "val", "train") if name in first.splits), None)
    if split is None or not logs.get("train"):
        raise NotIdentifiable("there is no motion to fit", hint="Give --splits at import.")
    scorers = {id(soft): first, id(hard): Scorer(hard, {split: logs[split]}, jobs=jobs, seed=seed)}
    seen = excitation_of(
        logs["train"], soft.robot.scored_joints, soft.robot.controller.signal, soft.simulator.torque_limits
    )
    data = settled.data
    rule = SegmentRule(data.window_s, data.cut_s, data.budget_s / 2, data.burn_in_s, seed, soft.robot.replay.settle_s)
    segments, refused = make_segments(logs["train"], soft.simulator, rule)
    motions = [segment.episode_id for segment in segments]
    settings = replace(settled.solver.settings(seed), solver="gauss-newton", starts=1)

    scores = first.score(ParameterSet(()), {}, split)
    unit = first.unit
    steps = [AttributionStep("", "the model as it came", (), 0, scores.pooled, scores.estimate(unit))]
    chosen: dict[str, object] = {}
    values: dict[str, float] = {}
    for cause, label in _LABELS.items():
        own = {name: choice for name, choice in fit.items() if quantity(name).cause == cause}
        if not own:
            continue
        began = time.perf_counter()
        chosen |= own
        nominal = soft if cause in ("delay", "gains") else hard
        parameters = freeze_still(make_parameters(chosen, nominal, motions), seen)
        weights = Weights(settled.signals, settled.joints)
        problem = Problem(nominal, off_bounds(parameters.at(values)), segments, weights=weights, jobs=jobs)
        # Only what is new is looked for from afar.
        new = problem.parameters.hold(name for name in problem.parameters.names if name.partition("[")[0] not in own)
        if new.free:
            swept = swept_start(problem.with_parameters(new))
            problem = problem.with_parameters(
                problem.parameters.at({item.name: item.value for item in swept if not item.frozen})
            )
        if problem.parameters.free:
            report = None if on_progress is None else _named(on_progress, label)
            values = solve(problem, settings, on_progress=report).values
        scores = scorers[id(nominal)].score(problem.parameters, values, split)
        steps.append(
            AttributionStep(
                cause,
                label,
                tuple(own),
                len(problem.parameters.free),
                scores.pooled,
                scores.estimate(unit),
                time.perf_counter() - began,
            )
        )
    unused: dict[str, dict[str, str]] = {name: dict(own[1]) for name, own in sorted_out.items()}
    unused["train"] |= {name: error.summary for name, error in refused.items()}
    for name, own_refused in first.refused.items():
        unused[name] |= own_refused
    statements = [
        *left_out(unused),
        *seen.statements,
        "each cause is taken away after those to its left; another order would share the gap differently",
    ]
    if split == "train":
        statements.insert(0, "scored on the motions that it was fitted to: there are no others")
    return Attribution.of(
        split,
        unit,
        steps,
        statements=statements,
        provenance=provenance(
            config={"robot": robot.to_dict(), "model": model.name, "identify": replace(settled, fit=fit).to_json()},
            seed=seed,
            data_hash=data_hash,
        ),
    )


def _named(on_progress: OnModel, label: str) -> OnProgress:
    return lambda progress: on_progress(label, progress)
