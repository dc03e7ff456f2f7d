"""Training by reinforcement, as GapONet has it (4.3): the network is the mean of a policy that PPO improves.

The policy's spread and its critic are left behind when training ends; what remains is the network, as after any other
way of training.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from trueup.augment.corrector import Corrector
from trueup.augment.draws import draw_from, own_draws
from trueup.compensate.environment import TrackingEnvironment
from trueup.compensate.ppo_checkpoint import Iteration, Stand, read_checkpoint, save_checkpoint
from trueup.compensate.ppo_config import PpoConfig
from trueup.compensate.tracks import Track
from trueup.compensate.training import delta_of
from trueup.core.effort import Meter
from trueup.errors import DataError, needing
from trueup.sim.transitions import Transitions

with needing("training by reinforcement", "rl"):
    from gymnasium import spaces
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.distributions import DiagGaussianDistribution
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

# Adam's smallest divisor, as PPO is commonly used; gradients are small once advantages are normalized.
_EPSILON = 1e-5


def train_ppo(
    corrector: Corrector,
    tracks: Sequence[Track],
    transitions: Callable[[float], Transitions],
    config: PpoConfig,
    *,
    seed: int = 0,
    device: str = "cpu",
    checkpoint: Path | None = None,
    every: int = 10,
    auxiliary: Callable[[torch.Generator], Tensor] | None = None,
    report: Callable[[Iteration], None] = lambda _: None,
    stop: Callable[[Iteration], bool] = lambda _: False,
) -> tuple[Iteration, ...]:
    """Train a network in place.

    Args:
        corrector: with random weights, or those of an earlier training.
        tracks: measured motions.
        transitions: the simulator with a payload [kg].
        config: robots, reward, optimization.
        seed: of all draws.
        device: where robots and network are, `cpu` or `cuda`.
        checkpoint: a file to go on from, if it is there, and to write.
        every: how often it is written [iterations].
        auxiliary: a further loss of the network for one batch, such as that of its sensor predictor (eq. 7); minimized
            after each iteration, once for each batch.
        report: is told of each iteration.
        stop: asked after each iteration whether that was enough.

    Returns:
        what happened, iterations before an interruption included.

    Raises:
        ConfigError: fewer robots than payloads, or robots that cannot be side by side.
        DataError: no motion is long enough, the checkpoint is broken, or the network has become NaN.
        OutputExists: the checkpoint belongs to another training.
        MissingDependency: see `make_fleet`.
    """
    inputs = _digest(corrector, tracks, transitions, config, seed)
    corrector.to(device)
    environment = TrackingEnvironment(
        tracks,
        transitions,
        config,
        past=corrector.network.past,
        scale=corrector.out_scale.cpu().numpy(),
        device=device,
        seed=seed,
    )
    history: list[Iteration] = []
    with own_draws():
        draw_from(seed, 0)
        learner = Learner(corrector, environment, config, device=device, auxiliary=auxiliary)
        if checkpoint is not None and checkpoint.exists():
            done, memory = read_checkpoint(checkpoint, inputs, learner.policy, learner.policy.optimizer)
            history += done
            learner.go_on(environment.restore(memory), len(history))
        total = -(-config.samples // (config.robots * config.steps))
        enough = bool(history) and stop(history[-1])
        while len(history) < total and not enough:
            meter, number = Meter(), len(history) + 1
            # Draws depend on seed and iteration alone, so that an interrupted training goes on as if it had not been.
            own = draw_from(seed, number)
            environment.seed(own)
            learner.iterate(number, total, torch.Generator().manual_seed(own))
            tally = environment.tally()
            noise = float((learner.policy.log_std.detach().exp() * corrector.out_scale).mean())
            history.append(
                Iteration(
                    number,
                    number * config.robots * config.steps,
                    tally.reward,
                    tally.error,
                    noise,
                    tally.left,
                    tally.lost,
                    meter.read(),
                )
            )
            if not all(bool(value.isfinite().all()) for value in learner.policy.parameters()):
                raise DataError("training diverged", got=f"iteration {number}", hint="Lower ppo.rate.")
            enough = stop(history[-1])
            if checkpoint is not None and (number % every == 0 or number == total or enough):
                state = Stand(inputs, tuple(history))
                save_checkpoint(checkpoint, state, learner.policy, learner.policy.optimizer, environment.memory())
            report(history[-1])
    corrector.to("cpu")
    corrector.eval()
    return tuple(history)


class Policy(ActorCriticPolicy):
    """A normal distribution around what the network says, and a critic that sees more than the network does.

    Args:
        observation_space: of the environment.
        action_space: likewise.
        lr_schedule: learning rate.
        corrector: the network.
        config: sizes of the critic, and the spread at the beginning.
        use_sde: Stable-Baselines3 says so; false.
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        *,
        corrector: Corrector,
        config: PpoConfig,
        use_sde: bool = False,
    ) -> None:
        super().__init__(observation_space, action_space, lr_schedule, net_arch=[], ortho_init=False, use_sde=use_sde)
        self.corrector = corrector
        self._channels = len(corrector.center)
        self._samples = corrector.network.past + 1
        wide = self.features_dim
        layers: list[nn.Module] = []
        for width in config.critic:
            layers += [nn.Linear(wide, width), nn.ELU()]
            wide = width
        self.mlp_extractor = nn.Identity()  # type: ignore[assignment]
        self.action_net = nn.Identity()
        self.value_net = nn.Sequential(*layers, nn.Linear(wide, 1))  # type: ignore[assignment]
        self.log_std = nn.Parameter(torch.full((corrector.network.outputs,), float(np.log(config.noise))))
        self.optimizer = torch.optim.Adam(self.parameters(), lr_schedule(1), eps=_EPSILON)

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:  # noqa: FBT001, FBT002 - theirs
        """Actions, values and the logarithm of the actions' odds."""
        distribution = self.get_distribution(obs)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, self.predict_values(obs), distribution.log_prob(actions)

    def evaluate_actions(self, obs: PyTorchObs, actions: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        """Values, odds of these actions, and entropy."""
        distribution = self.get_distribution(obs)
        return self.predict_values(obs), distribution.log_prob(actions), distribution.entropy()

    def get_distribution(self, obs: PyTorchObs) -> Any:
        """Of actions."""
        assert isinstance(obs, Tensor)
        mean = delta_of(self.corrector, self._window(obs)) / self.corrector.out_scale
        assert isinstance(self.action_dist, DiagGaussianDistribution)
        return self.action_dist.proba_distribution(mean, self.log_std)

    def predict_values(self, obs: PyTorchObs) -> Tensor:
        """What is still to come."""
        assert isinstance(obs, Tensor)
        read = self.corrector.read(self._window(obs)).transpose(0, 1).flatten(1)
        value: Tensor = self.value_net(torch.cat([read, obs[:, read.shape[1] :]], dim=1))
        return value

    def _window(self, obs: Tensor) -> Tensor:
        """The samples that the network reads, (past + 1, B, I)."""
        samples = obs[:, : self._samples * self._channels].reshape(-1, self._samples, self._channels)
        return samples.transpose(0, 1)


class Learner(PPO):
    """PPO that is told when to take which step.

    Args:
        corrector: the network.
        environment: where it learns.
        config: see `PpoConfig`.
        device: where the network is.
        auxiliary: see `train_ppo`.
    """

    def __init__(
        self,
        corrector: Corrector,
        environment: TrackingEnvironment,
        config: PpoConfig,
        *,
        device: str = "cpu",
        auxiliary: Callable[[torch.Generator], Tensor] | None = None,
    ) -> None:
        super().__init__(
            Policy,
            environment,
            learning_rate=lambda left: config.rate * (left if config.decays else 1.0),
            n_steps=config.steps,
            batch_size=config.batch,
            n_epochs=config.epochs,
            gamma=config.gamma,
            gae_lambda=config.trace,
            clip_range=config.clip,
            policy_kwargs={"corrector": corrector, "config": config},
            device=device,
        )
        self.corrector, self.auxiliary = corrector, auxiliary
        self.set_logger(Logger(folder=None, output_formats=[]))
        self._callback = _Silent()

    def go_on(self, observed: np.ndarray, done: int) -> None:
        """Continue after so many iterations, with what is observed now."""
        self._last_obs = observed
        self._last_episode_starts = np.zeros(len(observed), bool)
        self.num_timesteps = done * self.n_steps * self.n_envs
        self._setup_learn(0, self._callback, reset_num_timesteps=False)

    def iterate(self, number: int, total: int, generator: torch.Generator) -> None:
        """Let all robots act, then improve the network; iteration `number` of `total`."""
        assert self.env is not None
        assert self.batch_size is not None
        if self._last_obs is None:
            self._setup_learn(0, self._callback)
        self.collect_rollouts(self.env, self._callback, self.rollout_buffer, self.n_steps)
        self._current_progress_remaining = 1.0 - (number - 1) / total
        self.train()
        if self.auxiliary is not None:
            for _ in range(self.n_steps * self.n_envs // self.batch_size):
                self.policy.optimizer.zero_grad()
                self.auxiliary(generator).backward()  # type: ignore[no-untyped-call]
                nn.utils.clip_grad_norm_(self.corrector.parameters(), self.max_grad_norm)
                self.policy.optimizer.step()


class _Silent(BaseCallback):
    def _on_step(self) -> bool:
        return True


def _digest(
    corrector: Corrector,
    tracks: Sequence[Track],
    transitions: Callable[[float], Transitions],
    config: PpoConfig,
    seed: int,
) -> str:
    """Of everything that decides about a training."""
    digest = hashlib.sha256(json.dumps([asdict(config), seed]).encode())
    for name, value in corrector.state_dict().items():
        digest.update(name.encode() + value.cpu().numpy().tobytes())
    for track in tracks:
        digest.update(repr((track.id, track.payload_kg)).encode() + track.state.tobytes() + track.command.tobytes())
    for payload_kg in sorted({track.payload_kg for track in tracks}):
        own = transitions(payload_kg)
        digest.update(repr((own.simulator.fingerprint, own.control_s)).encode())
        ones = np.ones((1, len(own.joints)))
        digest.update(own.held(ones, 0.0 * ones).tobytes())
    return digest.hexdigest()
