"""Train a policy for a robot into a folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueup.core.atomic import as_read_back, file_hash, json_hash, make_folder
from trueup.core.model_card import ModelCard
from trueup.core.policy_card import PolicyCard
from trueup.core.provenance import provenance
from trueup.core.sole_writer import writes_alone
from trueup.errors import needing
from trueup.robots import RobotSpec, find_model
from trueup.stages.model_folder import POLICY, ModelFolder

if TYPE_CHECKING:
    from trueup.policy.config import PolicyConfig
    from trueup.policy.training import Round

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


@writes_alone()
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
        ConfigError: the robot follows no torques, or the configuration, or the policy that it begins with, does not
            fit it.
        NameMismatch: the policy that it begins with, or its network, is of a robot with other joints.
        Diverged: the training came to numbers that are not finite.
        DataError: a file is broken, or cannot be written.
        MissingDependency: Stable-Baselines3 is not installed, or torch finds no GPU.
    """
    with needing("training a policy", "rl"):
        import torch

        from trueup.augment.training import find_device
        from trueup.policy.config import PolicyConfig
        from trueup.policy.export import export
        from trueup.policy.learned import read_learned, write_learned
        from trueup.policy.simulated import simulated
        from trueup.policy.training import Round, train

    config, out = config or PolicyConfig(), Path(out)
    find_device(device)
    path = find_model(robot, given=model)
    threads = jobs or os.cpu_count() or 1
    made_from = _made_from(robot, path, config)
    asked = json_hash({**made_from, "name": name, "seed": seed})
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
    start = read_learned(config, robot.joint_names)
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
            start=start,
            on_round=on_round,
        )
        write_learned(learner, out, config, asked)
        card = export(
            learner,
            judging,
            out,
            name=name or f"{robot.name}-{config.algorithm}",
            robot=robot.name,
            provenance={
                **provenance(config=as_read_back(asdict(config)), seed=seed),
                "asked": asked,
                "alike": json_hash(_but_for_seed(made_from, config)),
                "history": [asdict(item) for item in history],
            },
        )
    finally:
        torch.set_num_threads(before)
    folder.clean()
    return TrainedPolicy(card, out, history)


def policy_question(robot: RobotSpec, model: Path, config: PolicyConfig, *, name: str, seed: int) -> str:
    """Hash of everything that decides about a training.

    Args:
        robot: its description.
        model: MJCF or URDF.
        config: algorithm, task, friction, randomization.
        name: of the policy.
        seed: of all draws.

    Raises:
        DataError: the network of the configuration, or the policy that it begins with, is broken.
    """
    return json_hash({**_made_from(robot, model, config), "name": name, "seed": seed})


def _made_from(robot: RobotSpec, model: Path, config: PolicyConfig) -> dict[str, Any]:
    """The same but for name and seed."""
    from trueup.identify.export import SAMPLES_FILE
    from trueup.sim import MujocoSimulator

    # The folder of an identification may hold another one by the time that a training goes on.
    samples = Path(config.randomization.posterior) / SAMPLES_FILE
    made_from: dict[str, Any] = as_read_back(
        {
            "robot": robot.to_dict(),
            "model": MujocoSimulator.from_robot(robot, model).fingerprint,
            "config": asdict(config),
            "posterior": file_hash(samples) if config.randomization.posterior and samples.is_file() else "",
            "network": ModelCard.load(Path(config.network)).to_json()["sha256"] if config.network else "",
            "start": PolicyCard.load(Path(config.start)).provenance.get("asked") if config.start else "",
        }
    )
    return made_from


def _but_for_seed(made_from: Mapping[str, Any], config: PolicyConfig) -> dict[str, Any]:
    """What trainings that differ in their seed share: seeds that begin with policies of several seeds, too."""
    if not config.start:
        return dict(made_from)
    start = PolicyCard.load(Path(config.start)).provenance.get("alike")
    return {**made_from, "config": {**made_from["config"], "start": ""}, "start": start}
