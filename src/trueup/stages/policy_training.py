"""Train a policy for a robot into a folder, and judge one on simulators and virtual hardware."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trueup.core.atomic import as_read_back, file_hash, json_hash, make_folder, write_json
from trueup.core.policy_card import PolicyCard
from trueup.core.provenance import provenance
from trueup.core.results import Estimate
from trueup.errors import ConfigError, needing
from trueup.robots import RobotSpec, find_model
from trueup.stages.model_folder import POLICY, ModelFolder

if TYPE_CHECKING:
    from trueup.policy.config import PolicyConfig
    from trueup.policy.evaluation import Episodes
    from trueup.policy.reaching import Reaching
    from trueup.policy.training import Round

EVALUATION_SCHEMA = "trueup.policy-evaluation/1"

PLACES = ("mujoco", "dart", "lab")
# Judged after each round, with the same goals each time.
_JUDGED = 64


@dataclass(frozen=True)
class TrainedPolicy:
    """What a training of a policy has made.

    Attributes:
        card: of the policy.
        folder: where it is.
        history: its rounds.
    """

    card: PolicyCard
    folder: Path
    history: tuple[Round, ...]


def train_policy(
    robot: RobotSpec,
    out: Path | str,
    *,
    config: PolicyConfig | None = None,
    model: Path | None = None,
    name: str = "",
    seed: int = 0,
    jobs: int | None = None,
    device: str = "cpu",
    force: bool = False,
    overwrite: bool = False,
    resume: bool = False,
    on_round: Callable[[Round, int], None] = lambda *_: None,
) -> TrainedPolicy:
    """Train a policy that reaches for goals by torques (ES thesis, 2), and export it.

    Args:
        robot: its description; it follows torques.
        out: folder of the policy.
        config: algorithm, task, friction, randomization; the default if None.
        model: MJCF or URDF; looked for beside the description and in the package if None.
        name: of the policy; robot and algorithm if empty.
        seed: of all draws.
        jobs: threads; the number of cores if None.
        device: of the networks, `cpu` or `cuda`.
        force: randomize by an identification whose status is not ok, too.
        overwrite: replace what is in `out`.
        resume: go on where an earlier call was interrupted; a finished policy of the same inputs is loaded.
        on_round: called after each round with what it did and the number of rounds.

    Raises:
        OutputExists: `out` is not empty, or holds another policy or the training of one.
        ConfigError: the robot follows no torques, or the configuration does not fit it.
        DataError: training diverged, or a file is broken.
        MissingDependency: Stable-Baselines3 is not installed.
    """
    with needing("training a policy", "rl"):
        import torch

        from trueup.identify.export import SAMPLES_FILE
        from trueup.policy.config import PolicyConfig
        from trueup.policy.export import export
        from trueup.policy.simulated import simulated
        from trueup.policy.training import Round, train
        from trueup.sim import MujocoSimulator

    config, out = config or PolicyConfig(), Path(out)
    path = find_model(robot, given=model)
    threads = jobs or os.cpu_count() or 1
    same = MujocoSimulator.from_robot(robot, path).fingerprint
    # The folder of an identification may hold another one by the time that a training goes on.
    samples = Path(config.randomization.posterior) / SAMPLES_FILE
    asked = json_hash(
        as_read_back(
            {
                "robot": robot.to_dict(),
                "model": same,
                "config": asdict(config),
                "posterior": file_hash(samples) if config.randomization.posterior and samples.is_file() else "",
                "name": name,
                "seed": seed,
            }
        )
    )
    make_folder(out)
    if not (overwrite or resume):
        ModelFolder.refuse_full(out)
    folder = ModelFolder(out, asked, POLICY)
    if not overwrite and folder.is_finished():
        folder.clean()
        card = PolicyCard.load(out)
        card.graph(out)
        return TrainedPolicy(card, out, tuple(Round(**item) for item in card.provenance["history"]))
    arms = simulated(config, robot, path, threads=threads, force=force)
    judging = simulated(config, robot, path, count=_JUDGED, threads=threads, randomized=False)
    if overwrite:
        folder.begin_anew()
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        learner, history = train(
            config,
            arms,
            judging,
            checkpoint=folder.checkpoint,
            inputs=asked,
            seed=seed,
            device=device,
            resume=resume,
            on_round=on_round,
        )
        card = export(
            learner,
            judging,
            out,
            name=name or f"{robot.name}-{config.algorithm}",
            robot=robot.name,
            provenance={
                **provenance(config=as_read_back(asdict(config)), seed=seed),
                "asked": asked,
                "history": [asdict(item) for item in history],
            },
        )
    finally:
        torch.set_num_threads(before)
    folder.clean()
    return TrainedPolicy(card, out, history)


def evaluate_policy(
    folder: Path | str,
    robot: RobotSpec,
    *,
    places: Sequence[str] = ("mujoco",),
    goals: int = 100,
    units: Sequence[int] = (1,),
    model: Path | None = None,
    seed: int = 0,
    jobs: int | None = None,
    out: Path | None = None,
    on_episodes: Callable[[str, int, int], None] = lambda *_: None,
) -> dict[str, Episodes]:
    """Let a policy reach for goals in simulators and on virtual hardware, with what it sees and may do the same in all.

    Args:
        folder: of the policy.
        robot: its description; it follows torques.
        places: `mujoco`, `dart`, or `lab`: virtual hardware.
        goals: how many; the same in all places.
        units: individuals of the virtual hardware.
        model: MJCF or URDF.
        seed: of goals and noise.
        jobs: threads; the number of cores if None.
        out: a JSON file for what was found.
        on_episodes: told where, and how many of how many goals are done.

    Returns:
        place, `lab-2` for individual 2, -> its episodes.

    Raises:
        ConfigError: no such place, or a robot that does not fit the policy.
        NameMismatch: the policy is of a robot with other joints.
        DataError: a file of it is broken.
    """
    from trueup.deploy.policy import Policy
    from trueup.policy.evaluation import evaluate
    from trueup.policy.reach import ReachConfig

    if strangers := [place for place in places if place not in PLACES]:
        raise ConfigError("--on", got=", ".join(strangers), available=PLACES)
    if goals < 2:
        raise ConfigError("--goals", got=goals, expected="2 or more, for intervals")
    card = PolicyCard.load(Path(folder))
    policy = Policy.load(folder, joints=robot.joint_names, rate_hz=card.rate_hz)
    path = find_model(robot, given=model)
    said = card.provenance.get("config", {}).get("reach", {})
    task = ReachConfig(card.torque_nm, card.rate_hz, float(said.get("episode_s", ReachConfig.episode_s)), card.site)
    found: dict[str, Episodes] = {}
    for label, reaching in _worlds(robot, path, task, places, units, goals, jobs or os.cpu_count() or 1):
        drawn = reaching.workspace.draw(np.random.default_rng([seed, 21]), goals)
        found[label] = evaluate(
            policy.act,
            reaching,
            drawn,
            velocity_limit=_velocity_limit(path, robot),
            seed=seed,
            on_episodes=lambda done, count, label=label: on_episodes(label, done, count),  # type: ignore[misc]
        )
    if out is not None:
        write_json(out, _saved(card, found, seed))
    return found


def _worlds(
    robot: RobotSpec,
    path: Path,
    task: Any,
    places: Sequence[str],
    units: Sequence[int],
    goals: int,
    threads: int,
) -> list[tuple[str, Reaching]]:
    from trueup.lab import LabSpec, VirtualRobot, draw_truth
    from trueup.lab.spec import Controller
    from trueup.policy.arms import EngineArm, HardwareArm, MujocoArms
    from trueup.policy.reaching import Reaching
    from trueup.sim import MujocoSimulator, make_simulator

    simulator = MujocoSimulator.from_robot(robot, path)
    found: list[tuple[str, Reaching]] = []
    for place in places:
        if place == "mujoco":
            arms = MujocoArms(simulator, min(goals, _JUDGED), task.control_s, threads=threads)
            found.append((place, Reaching(arms, simulator.model, task)))
        elif place == "dart":
            arm = EngineArm(make_simulator("dart", robot, path), task.control_s)
            found.append((place, Reaching(arm, simulator.model, task)))
        else:
            spec = replace(LabSpec(), controller=Controller(kind="torque"))
            for unit in units:
                lab = VirtualRobot(draw_truth(spec, unit=unit))

                def put(pose: Any, rng: np.random.Generator, lab: VirtualRobot = lab) -> None:
                    lab.restart(position=pose, seed=int(rng.integers(2**31)))

                found.append(
                    (f"lab-{unit}", Reaching(HardwareArm(lab, task.control_s, place=put), simulator.model, task))
                )
    return found


def _velocity_limit(path: Path, robot: RobotSpec) -> np.ndarray | None:
    """What the model says of it, where it does."""
    from trueup.robots.model import load_spec

    for numeric in load_spec(path).numerics:
        if numeric.name == "velocity_limit" and len(numeric.data) == len(robot.joints):
            return np.array(numeric.data, np.float64)
    return None


def _saved(card: PolicyCard, found: Mapping[str, Episodes], seed: int) -> dict[str, Any]:
    def numbers(values: Mapping[str, Estimate]) -> dict[str, Any]:
        return {name: value.to_json() for name, value in values.items()}

    return {
        "schema": EVALUATION_SCHEMA,
        "policy": card.name,
        "places": {
            label: {
                "goals": episodes.goals.tolist(),
                "lost": int(episodes.lost.sum()),
                "values": {name: values.tolist() for name, values in episodes.values.items()},
                "estimates": numbers(episodes.estimates()),
            }
            for label, episodes in found.items()
        },
        "provenance": provenance(config={"policy": card.provenance.get("asked", "")}, seed=seed),
    }
