"""Judge policies on simulators and virtual hardware, all on the same goals, into a folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trueup.core.atomic import make_folder
from trueup.core.policy_card import PolicyCard
from trueup.core.policy_evaluation import (
    CURVES,
    EPISODES_NAME,
    EVALUATION_NAME,
    JudgedGroup,
    JudgedPolicy,
    PlaceResult,
    PolicyEvaluation,
    save_curves,
)
from trueup.core.provenance import provenance
from trueup.core.results import Estimate, PairedDifference
from trueup.core.sole_writer import writes_alone
from trueup.core.trials import Trial, TrialGroup, alike
from trueup.errors import ConfigError, OutputExists
from trueup.measure.seeds import Statistic, seeds_interval
from trueup.measure.uncertainty import estimate
from trueup.record.limits import stated_rates
from trueup.robots import RobotSpec, find_model

if TYPE_CHECKING:
    from trueup.policy.config import PolicyConfig
    from trueup.policy.evaluation import Episodes
    from trueup.policy.reach import ReachConfig
    from trueup.policy.reaching import Reaching

PLACES = ("mujoco", "dart", "lab")
# Arms side by side in MuJoCo.
_ARMS = 64
# Where values end that intervals of few seeds may leave.
_BOUNDS: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(("success", "torque_at_limit", "velocity_violation"), (0.0, 1.0)),
    **dict.fromkeys(("distance", "distance_median", "overshoot", "smoothness"), (0.0, np.inf)),
}


@dataclass(frozen=True, eq=False)
class Judgment:
    """What policies did.

    Attributes:
        evaluation: all numbers, as in evaluation.json.
        episodes: label of a policy -> place -> its episodes.
    """

    evaluation: PolicyEvaluation
    episodes: Mapping[str, Mapping[str, Episodes]]


@writes_alone()
def judge_policies(
    folders: Sequence[Path | str],
    robot: RobotSpec,
    *,
    places: Sequence[str] = ("mujoco",),
    goals: int = 100,
    units: Sequence[int] = (1,),
    model: Path | None = None,
    seed: int = 0,
    jobs: int | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    on_episodes: Callable[[str, str, int, int], None] = lambda *_: None,
) -> Judgment:
    """Let policies reach for goals in simulators and on virtual hardware; what they see and may do is the same in all.

    Args:
        folders: of the policies; others are compared with the first.
        robot: its description; it follows torques.
        places: `mujoco`, `dart`, or `lab`: virtual hardware.
        goals: how many; the same in all places and for all policies.
        units: individuals of the virtual hardware.
        model: MJCF or URDF.
        seed: of goals and noise.
        jobs: threads; the number of cores if None.
        out: folder for evaluation.json and episodes.npz.
        overwrite: replace what is there.
        on_episodes: told which policy, where, and how many of how many goals are done.

    Returns:
        Numbers and episodes; an individual 2 of the virtual hardware is the place `lab-2`.

    Raises:
        OutputExists: `out` is not empty.
        ConfigError: no such place, a policy that is given twice, policies of different tasks, or a robot that does not
            fit them.
        NameMismatch: a policy is of a robot with other joints.
        DataError: a file of one is broken.
    """
    from trueup.deploy.policy import Policy
    from trueup.policy.evaluation import evaluate

    if strangers := [place for place in places if place not in PLACES]:
        raise ConfigError("--on", got=", ".join(strangers), available=PLACES)
    if goals < 2:
        raise ConfigError("--goals", got=goals, expected="2 or more, for intervals")
    paths = [Path(folder) for folder in folders]
    if len({path.resolve() for path in paths}) < len(paths) or not paths:
        raise ConfigError("policies to judge", got=", ".join(map(str, paths)), expected="one or more, each once")
    if out is not None:
        _refuse_full(out, overwrite=overwrite)
    cards = [PolicyCard.load(path) for path in paths]
    policies = [
        Policy.load(path, joints=robot.joint_names, rate_hz=card.rate_hz)
        for path, card in zip(paths, cards, strict=True)
    ]
    tasks = _tasks(cards, paths)
    task = tasks[0].reach
    if out is not None:
        make_folder(out)
    model_file = find_model(robot, given=model)
    limit = velocity_limit(model_file, robot)
    trials = [Trial.of(card, path) for path, card in zip(paths, cards, strict=True)]
    labels = _labels(trials, paths)
    found: dict[str, dict[str, Episodes]] = {label: {} for label in labels}
    start = (0.0, 0.0, 0.0)
    for label, policy, asked in zip(labels, policies, tasks, strict=True):
        # Made anew for each policy: virtual hardware remembers what was done with it.
        for place, reaching in _worlds(robot, model_file, asked, places, units, goals, jobs or os.cpu_count() or 1):
            found[label][place] = evaluate(
                policy.act,
                reaching,
                reaching.workspace.draw(np.random.default_rng([seed, 21]), goals),
                velocity_limit=limit,
                seed=seed,
                on_episodes=lambda done, count, place=place, label=label: on_episodes(label, place, done, count),  # type: ignore[misc]
            )
            start = tuple(reaching.workspace.start.tolist())
    evaluation = _evaluation(labels, cards, trials, found, start, task, seed)
    if out is not None:
        curves = {
            (label, place): {name: getattr(episodes, name).astype(np.float32) for name in CURVES}
            for label, own in found.items()
            for place, episodes in own.items()
        }
        save_curves(out / EPISODES_NAME, curves, labels)
        evaluation.save(out / EVALUATION_NAME)
    return Judgment(evaluation, found)


def group_estimates(episodes: Sequence[Episodes]) -> dict[str, Estimate]:
    """Metric -> mean over goals and seeds with a 95 % interval over both; as `Episodes.estimates` for a single seed."""
    from trueup.policy.evaluation import UNITS

    if len(episodes) == 1:
        return episodes[0].estimates()
    asked: list[tuple[str, str, Statistic]] = [
        *((name, name, "mean") for name in UNITS),
        ("distance_median", "distance", "median"),
    ]
    found = {}
    for name, metric, statistic in asked:
        value, low, high = seeds_interval(_values(episodes, metric), statistic=statistic)
        found[name] = estimate(value, UNITS[metric], low, high, _BOUNDS.get(name, (-np.inf, np.inf)))
    return found


def group_difference(episodes: Sequence[Episodes], others: Sequence[Episodes], metric: str) -> PairedDifference:
    """Policies minus others on the same goals; as `Episodes.against` for a single seed on both sides."""
    from trueup.policy.evaluation import UNITS, verdict_of

    plain = episodes[0].against(others[0], metric)
    if len(episodes) == len(others) == 1:
        return plain
    own, base = _values(episodes, metric), _values(others, metric)
    value, low, high = seeds_interval(own, base)
    difference = estimate(value, UNITS[metric], low, high)
    mean = float(base.mean())
    return replace(
        plain,
        difference=difference,
        relative=value / mean if mean > 0.0 else np.nan,
        verdict=verdict_of(difference, metric),
    )


def _values(episodes: Sequence[Episodes], metric: str) -> np.ndarray:
    return np.stack([own.values[metric] for own in episodes])


def _evaluation(
    labels: Sequence[str],
    cards: Sequence[PolicyCard],
    trials: Sequence[Trial],
    found: Mapping[str, Mapping[str, Episodes]],
    start: tuple[float, ...],
    task: ReachConfig,
    seed: int,
) -> PolicyEvaluation:
    from trueup.policy.config import task_of
    from trueup.policy.evaluation import NEAR_M, UNITS

    parts = alike([replace(trial, label=label) for trial, label in zip(trials, labels, strict=True)])

    def of(part: TrialGroup, place: str) -> list[Episodes]:
        return [found[labels[row]][place] for row in part.members]

    where = list(found[labels[0]])
    return PolicyEvaluation(
        policies=tuple(
            JudgedPolicy(label, card.name, trial.seed, {place: _place(own) for place, own in found[label].items()})
            for label, card, trial in zip(labels, cards, trials, strict=True)
        ),
        groups=tuple(
            JudgedGroup(
                part.title,
                tuple(labels[row] for row in part.members),
                {place: group_estimates(of(part, place)) for place in where},
            )
            for part in parts
        ),
        differences=tuple(
            replace(
                group_difference(of(part, place), of(parts[0], place), metric),
                run=part.title,
                baseline=parts[0].title,
                split=place,
            )
            for part in parts[1:]
            for place in where
            for metric in UNITS
        ),
        start_m=start,
        control_s=task.control_s,
        near_m=NEAR_M,
        settings={
            "goals": len(next(iter(found[labels[0]].values())).goals),
            "robot": cards[0].robot,
            "friction": {label: task_of(card).friction for label, card in zip(labels, cards, strict=True)},
        },
        provenance=provenance(
            config={label: card.provenance.get("asked", "") for label, card in zip(labels, cards, strict=True)},
            seed=seed,
        ),
    )


def _place(episodes: Episodes) -> PlaceResult:
    return PlaceResult(
        goals=tuple(map(tuple, episodes.goals.tolist())),
        lost=int(episodes.lost.sum()),
        values={name: tuple(values.tolist()) for name, values in episodes.values.items()},
        estimates=episodes.estimates(),
    )


def _refuse_full(out: Path, *, overwrite: bool) -> None:
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not overwrite):
        raise OutputExists(
            f"{out} is {'a file' if out.is_file() else 'not empty'}",
            hint="Give --overwrite, or choose another folder as --out." if out.is_dir() else "--out is a folder.",
        )


def _labels(trials: Sequence[Trial], paths: Sequence[Path]) -> list[str]:
    """Names of the folders where they differ, else the folders as they were given."""
    names = [trial.label for trial in trials]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def _tasks(cards: Sequence[PolicyCard], paths: Sequence[Path]) -> list[PolicyConfig]:
    """What each policy was trained for: one task, with the same or another way of friction.

    Raises:
        ConfigError: there are several tasks.
    """
    from trueup.policy.config import task_of

    tasks = [task_of(card) for card in cards]
    for task, path in zip(tasks, paths, strict=True):
        own, first = asdict(task.reach), asdict(tasks[0].reach)
        if unlike := [name for name in own if own[name] != first[name]]:
            raise ConfigError(
                f"{path} and {paths[0]} are not of one task",
                got=", ".join(f"{name} {own[name]}" for name in unlike),
                expected=", ".join(f"{name} {first[name]}" for name in unlike),
                hint="Judge them one by one.",
            )
    return tasks


def _worlds(
    robot: RobotSpec,
    path: Path,
    asked: PolicyConfig,
    places: Sequence[str],
    units: Sequence[int],
    goals: int,
    threads: int,
) -> list[tuple[str, Reaching]]:
    """Simulators as the policy was trained in, without randomization; hardware as it is."""
    from trueup.lab import LabSpec, VirtualRobot, draw_truth
    from trueup.lab.spec import Controller
    from trueup.policy.arms import HardwareArm
    from trueup.policy.reaching import Reaching
    from trueup.policy.simulated import simulated
    from trueup.policy.thesis_friction import OFFSET
    from trueup.sim import MujocoSimulator

    task, found = asked.reach, []
    for place in places:
        if place != "lab":
            count = min(goals, _ARMS)
            found.append(
                (place, simulated(asked, robot, path, count=count, threads=threads, randomized=False, engine=place))
            )
            continue
        model = MujocoSimulator.from_robot(robot, path).model
        spec = replace(LabSpec(), controller=Controller(kind="torque"))
        for unit in units:
            lab = VirtualRobot(draw_truth(spec, unit=unit))

            def put(pose: Any, rng: np.random.Generator, lab: VirtualRobot = lab) -> None:
                lab.restart(position=pose, seed=int(rng.integers(2**31)))

            offset = np.array(OFFSET) if asked.friction == "thesis" else None
            arm = HardwareArm(lab, task.control_s, place=put)
            found.append((f"lab-{unit}", Reaching(arm, model, task, offset_nm=offset)))
    return found


def velocity_limit(path: Path, robot: RobotSpec) -> np.ndarray | None:
    """The joints' largest velocities, (J,) [rad/s], as the model says them; None where it does not.

    Args:
        path: MJCF or URDF.
        robot: its description.
    """
    from trueup.sim import MujocoSimulator

    model = MujocoSimulator.from_robot(robot, path).model
    stated = stated_rates(model, [model.joint(row).name for row in range(model.njnt)], "velocity")
    return np.array([stated[name] for name in robot.joint_names]) if stated else None
