"""What an algorithm has learned, beside its policy: for a training that begins with it, in another simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from trueup.augment.checkpoint import part_of, read_tensors, write_tensors
from trueup.core.policy_card import POLICY_LEARNER, PolicyCard
from trueup.errors import ConfigError, DataError, NameMismatch, OutputExists, needing
from trueup.policy.config import PolicyConfig

with needing("training a policy", "rl"):
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

_ENTROPY = "log_ent_coef"


def write_learned(learner: OffPolicyAlgorithm, folder: Path, config: PolicyConfig, asked: str) -> None:
    """Write its networks, those of the critics too, into a policy's folder.

    Args:
        learner: with the networks of its best round.
        folder: of the policy.
        config: of its training.
        asked: what the card will say that was asked for, so that another policy's networks are not taken for its own.

    Raises:
        DataError: the folder cannot be written.
    """
    write_tensors(folder / POLICY_LEARNER, learned_by(learner), {"inputs": asked, "networks": _networks(config)})


def learned_by(learner: OffPolicyAlgorithm) -> dict[str, Tensor]:
    """A copy of its networks, and of how much it weighs that actions differ."""
    found = {f"policy.{name}": value for name, value in learner.policy.state_dict().items()}
    if (entropy := getattr(learner, _ENTROPY, None)) is not None:
        found[_ENTROPY] = entropy
    return {name: value.detach().clone() for name, value in found.items()}


def read_learned(config: PolicyConfig, joints: Sequence[str]) -> dict[str, Tensor] | None:
    """The networks that a training begins with; None where it begins with fresh ones.

    Args:
        config: of the training; `start` is the folder of a policy.
        joints: of the robot.

    Raises:
        DataError: the folder holds no policy, a file of it is broken or that of another one.
        ConfigError: the policy has other networks, another algorithm, rate, or largest torques.
        NameMismatch: it is of a robot with other joints.
    """
    if not config.start:
        return None
    folder = Path(config.start)
    card = PolicyCard.load(folder)
    if tuple(joints) != card.joints:
        raise NameMismatch(
            f"the policy in {folder} is of another robot",
            left=card.joints,
            right=joints,
            left_name="it has",
            right_name="robot has",
        )
    if not (folder / POLICY_LEARNER).is_file():
        raise DataError(
            f"{folder} does not say what was learned",
            expected=POLICY_LEARNER,
            hint="Policies of the zoo and of earlier releases lack it: train the policy again.",
        )
    try:
        tensors, said = read_tensors(folder / POLICY_LEARNER, str(card.provenance.get("asked")))
    except OutputExists as error:
        raise DataError(f"{folder / POLICY_LEARNER} is of another policy than the card beside it") from error
    here = {**_networks(config), "rate_hz": config.reach.control_hz, "torque_nm": list(config.reach.torque_nm)}
    there = {**said["networks"], "rate_hz": card.rate_hz, "torque_nm": list(card.torque_nm)}
    if differing := [key for key in here if here[key] != there.get(key)]:
        raise ConfigError(
            f"no training can begin with the policy in {folder}",
            got=", ".join(f"{key} {there.get(key)}" for key in differing),
            expected=", ".join(f"{key} {here[key]}" for key in differing),
        )
    return tensors


def begin_with(learner: OffPolicyAlgorithm, learned: Mapping[str, Tensor]) -> None:
    """Put what was learned into an algorithm of the same networks."""
    learner.policy.load_state_dict(part_of(dict(learned), "policy."))
    if (entropy := getattr(learner, _ENTROPY, None)) is not None:
        with torch.no_grad():
            entropy.copy_(learned[_ENTROPY])


def _networks(config: PolicyConfig) -> dict[str, Any]:
    """What has to agree."""
    own = config.learner
    return {"algorithm": config.algorithm, "layers": list(own.layers), "goal_scale": own.goal_scale}
