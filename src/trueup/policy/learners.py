"""The algorithms of Stable-Baselines3 and its contributions, made from a configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from trueup.errors import needing
from trueup.policy.config import Algorithm, PolicyConfig

with needing("training a policy", "rl"):
    from gymnasium import spaces
    from sb3_contrib import TQC
    from stable_baselines3 import DDPG, SAC, TD3
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.noise import ActionNoise, NormalActionNoise, OrnsteinUhlenbeckActionNoise
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.common.vec_env import VecEnv

# Numbers of an observation that say where the goal is: the last ones.
_PLACE = 3
_CLASSES: Mapping[Algorithm, type[OffPolicyAlgorithm]] = {"ddpg": DDPG, "sac": SAC, "td3": TD3, "tqc": TQC}


class Scaled(BaseFeaturesExtractor):
    """What networks are given of an observation: each number times a constant.

    Args:
        space: of observations, (O,).
        scale: (O,).
    """

    def __init__(self, space: spaces.Box, scale: Sequence[float]) -> None:
        super().__init__(space, len(scale))
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float32))

    def forward(self, seen: Tensor) -> Tensor:
        """(B, O)."""
        assert isinstance(self.scale, Tensor)
        return seen * self.scale


def make_learner(config: PolicyConfig, environment: VecEnv, *, device: str, seed: int) -> OffPolicyAlgorithm:
    """An algorithm with fresh networks, in an environment of many arms."""
    own = config.learner
    shape = environment.observation_space.shape
    assert shape is not None
    scale = [1.0] * (shape[0] - _PLACE) + [own.goal_scale] * _PLACE
    networks: dict[str, Any] = {
        "net_arch": list(own.layers),
        "features_extractor_class": Scaled,
        "features_extractor_kwargs": {"scale": scale},
        "optimizer_kwargs": {"fused": True},  # a tenth of an update of small networks
    }
    made = _CLASSES[config.algorithm](
        "MlpPolicy",
        environment,
        learning_rate=own.rate,
        gamma=own.gamma,
        tau=own.tau,
        batch_size=own.batch,
        buffer_size=own.buffer,
        learning_starts=own.starts,
        train_freq=own.every,
        gradient_steps=own.updates,
        n_steps=own.n_steps,
        action_noise=_noise(config, environment),
        policy_kwargs=networks if config.algorithm == "ddpg" else {**networks, "n_critics": 2},
        device=device,
        seed=seed,
    )
    made.set_logger(Logger(folder=None, output_formats=[]))
    return made


def _noise(config: PolicyConfig, environment: VecEnv) -> ActionNoise | None:
    """Noise of actions that are scaled to -1 to 1, as Stable-Baselines3 adds it."""
    shape = environment.action_space.shape
    assert shape is not None
    mean, sigma = np.zeros(shape), np.full(shape, config.learner.sigma)
    match config.learner.noise:
        case "normal":
            return NormalActionNoise(mean, sigma)
        case "ou":
            return OrnsteinUhlenbeckActionNoise(mean, sigma, dt=config.reach.control_s)
        case _:
            return None


def optimizers_of(learner: OffPolicyAlgorithm) -> dict[str, Any]:
    """Name -> optimizer, of all that it has."""
    found = {"actor": learner.policy.actor.optimizer, "critic": learner.policy.critic.optimizer}  # type: ignore[union-attr]
    entropy = getattr(learner, "ent_coef_optimizer", None)
    return found if entropy is None else {**found, "entropy": entropy}
