"""The algorithms of Stable-Baselines3 and its contributions, made from a configuration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from trueup.errors import needing
from trueup.policy.config import Algorithm, PolicyConfig

with needing("training a policy", "rl"):
    from sb3_contrib import TQC
    from stable_baselines3 import DDPG, SAC, TD3
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.noise import ActionNoise, NormalActionNoise, OrnsteinUhlenbeckActionNoise
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    from stable_baselines3.common.vec_env import VecEnv

_CLASSES: Mapping[Algorithm, type[OffPolicyAlgorithm]] = {"ddpg": DDPG, "sac": SAC, "td3": TD3, "tqc": TQC}


def make_learner(config: PolicyConfig, environment: VecEnv, *, device: str, seed: int) -> OffPolicyAlgorithm:
    """An algorithm with fresh networks, in an environment of many arms."""
    own = config.learner
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
        action_noise=_noise(config, environment),
        policy_kwargs={"net_arch": list(own.layers)} | ({} if config.algorithm == "ddpg" else {"n_critics": 2}),
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
