"""Training in rounds: arms act, networks improve, and after each round the policy is judged and can be resumed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from trueup.augment.checkpoint import of_this_version, part_of, read_tensors, restore, slots_of, write_tensors
from trueup.augment.draws import draw_from, own_draws
from trueup.core.config import build
from trueup.errors import Diverged, needing
from trueup.policy.config import PolicyConfig
from trueup.policy.environment import ReachVector
from trueup.policy.learned import begin_with, learned_by
from trueup.policy.learners import make_learner, optimizers_of
from trueup.policy.reaching import Reaching

with needing("training a policy", "rl"):
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    from stable_baselines3.common.utils import ConstantSchedule

# What of the replay buffer is remembered.
_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


@dataclass(frozen=True)
class Round:
    """One line of the history.

    Attributes:
        number: from 1.
        steps: control steps of all arms so far.
        updates: of the networks so far.
        reward: of a control step, mean over the judged episodes.
        distance_m: median distance at the end of a judged episode [m].
        worst_m: nine of ten are nearer [m].
        lost: arms whose engine or policy said what is no number, so far.
        seconds: all rounds so far [s].
        cpu_seconds: likewise, all threads together [s].
    """

    number: int
    steps: int
    updates: int
    reward: float
    distance_m: float
    worst_m: float
    lost: int
    seconds: float
    cpu_seconds: float


@dataclass(frozen=True)
class _Stand:
    inputs: str
    history: tuple[Round, ...]
    best: int


def train(
    config: PolicyConfig,
    arms: Reaching,
    judging: Reaching,
    *,
    checkpoint: Path,
    inputs: str,
    seed: int = 0,
    device: str = "cpu",
    resume: bool = False,
    start: Mapping[str, Tensor] | None = None,
    on_round: Callable[[Round, int], None] = lambda *_: None,
    stop: Callable[[Round], bool] = lambda _: False,
) -> tuple[OffPolicyAlgorithm, tuple[Round, ...]]:
    """Train a policy; what is returned has the networks of the best round.

    Round n draws from generators seeded with (seed, n), and its arms begin anew: a training that was interrupted and
    resumed ends with the same weights as one that was not.

    Args:
        config: algorithm and numbers.
        arms: where it learns.
        judging: where it is judged after each round, with the same goals each time; arms of their own.
        checkpoint: file that is written after each round.
        inputs: hash of everything that decides about the training; a checkpoint with another one is refused.
        seed: of all draws.
        device: of the networks, `cpu` or `cuda`.
        resume: go on from the checkpoint, if there is one.
        start: networks to begin with, as `learned.read_learned` has them; fresh ones if None.
        on_round: called after each round with what it did and the number of rounds.
        stop: asked after each round whether that was enough.

    Raises:
        OutputExists: the checkpoint is of another training.
        Diverged: the training came to numbers that are not finite.
        DataError: the checkpoint is broken, or cannot be written.
    """
    vector, trial = ReachVector(arms), ReachVector(judging)
    history: list[Round] = []
    best_number = 0
    best: dict[str, Tensor] = {}
    with own_draws():
        draw_from(seed, 0)
        learner = make_learner(config, vector, device=device, seed=seed)
        if resume and checkpoint.is_file():
            history, best_number, best = _read(checkpoint, inputs, learner)
            arms.lost_episodes = history[-1].lost
        elif start is not None:
            begin_with(learner, start)
        if start is not None:
            learner.learning_starts = 0  # no random torques: it acts by what it has learned
        began, cpu_began = time.perf_counter(), time.process_time()
        earlier, cpu_earlier = (history[-1].seconds, history[-1].cpu_seconds) if history else (0.0, 0.0)
        while len(history) < config.rounds and not (history and stop(history[-1])):
            number = len(history) + 1
            own = draw_from(seed, number)
            vector.seed(own)
            if number > 1:  # random torques of the first round come from the generator that it was made with
                learner.action_space.seed(own)
            end = config.steps * number // config.rounds
            learner._last_obs = None  # noqa: SLF001 - arms begin anew with each round
            learner.lr_schedule = ConstantSchedule(_rate(config, number))
            diverged = Diverged("training diverged", got=f"round {number}", hint="Lower learner: {rate: ...}.")
            try:
                if start is not None and learner.num_timesteps < config.learner.starts:
                    _look_around(learner, min(config.learner.starts, end) - learner.num_timesteps)
                learner.learn(end - learner.num_timesteps, reset_num_timesteps=learner.num_timesteps == 0)
            except ValueError as error:
                if _finite(learner):
                    raise
                raise diverged from error  # torch's, of a distribution without numbers
            if not _finite(learner):
                raise diverged
            _end_episodes(learner)
            reward, median, worst = judged(learner, trial, seed)
            history.append(
                Round(
                    number,
                    learner.num_timesteps,
                    learner._n_updates,  # noqa: SLF001
                    reward,
                    median,
                    worst,
                    arms.lost_episodes,
                    earlier + time.perf_counter() - began,
                    cpu_earlier + time.process_time() - cpu_began,
                )
            )
            if reward >= max(item.reward for item in history):
                best_number, best = number, learned_by(learner)
            _write(checkpoint, _Stand(inputs, tuple(history), best_number), learner, best)
            on_round(history[-1], config.rounds)
        begin_with(learner, best)
    return learner, tuple(history)


def _look_around(learner: OffPolicyAlgorithm, steps: int) -> None:
    """Act without learning: updates from the first few control steps alone would spoil what was learned."""
    updates, learner.gradient_steps = learner.gradient_steps, 0
    learner.learn(steps, reset_num_timesteps=learner.num_timesteps == 0)
    learner.gradient_steps = updates


def _finite(learner: OffPolicyAlgorithm) -> bool:
    return all(bool(value.isfinite().all()) for value in learner.policy.state_dict().values())


def _rate(config: PolicyConfig, number: int) -> float:
    """Learning rate of a round: a straight line to that of the last one."""
    first, last = config.learner.rate, config.learner.last_rate
    return first if last is None else first + (last - first) * (number - 1) / max(config.rounds - 1, 1)


def _end_episodes(learner: OffPolicyAlgorithm) -> None:
    """What is remembered last is followed by the start of another episode: rewards are not counted across."""
    buffer = learner.replay_buffer
    assert buffer is not None
    row = (buffer.pos - 1) % buffer.buffer_size
    buffer.timeouts[row] = np.maximum(buffer.timeouts[row], 1.0 - buffer.dones[row])


def judged(learner: OffPolicyAlgorithm, trial: ReachVector, seed: int) -> tuple[float, float, float]:
    """Mean reward of a control step, median distance at the end, and what nine of ten stay below [m]."""
    trial.seed(seed)
    seen: np.ndarray = trial.reset()
    total, away = 0.0, np.full(trial.num_envs, math.nan)
    steps = trial.reaching.config.steps
    for step in range(steps):
        action, _ = learner.predict(seen, deterministic=True)
        trial.step_async(action)
        now, reward, _, infos = trial.step_wait()
        seen = np.asarray(now)
        total += float(reward.mean())
        if step == steps - 1:
            away = np.array([info["distance_m"] for info in infos])
    median, worst = np.quantile(away, (0.5, 0.9))
    return total / steps, float(median), float(worst)


def rounds_of(checkpoint: Path, inputs: str) -> tuple[Round, ...]:
    """The rounds that a checkpoint of a training comes after; none if there is no checkpoint.

    Raises:
        OutputExists: the checkpoint is of another training.
        DataError: it is broken.
    """
    if not checkpoint.is_file():
        return ()
    with of_this_version(checkpoint):
        return build(_Stand, read_tensors(checkpoint, inputs)[1], str(checkpoint)).history


def _write(path: Path, stand: _Stand, learner: OffPolicyAlgorithm, best: dict[str, Tensor]) -> None:
    tensors = learned_by(learner) | {f"best.{name}": value for name, value in best.items()}
    for name, optimizer in optimizers_of(learner).items():
        tensors |= {f"{name}.{key}": value for key, value in slots_of(optimizer).items()}
    buffer = learner.replay_buffer
    assert buffer is not None
    filled = buffer.buffer_size if buffer.full else buffer.pos
    for name in _BUFFER:
        tensors[f"buffer.{name}"] = torch.from_numpy(getattr(buffer, name)[:filled])
    tensors["count"] = torch.tensor([buffer.pos, int(buffer.full), learner.num_timesteps, learner._n_updates])  # noqa: SLF001
    write_tensors(path, tensors, asdict(stand))


def _read(path: Path, inputs: str, learner: OffPolicyAlgorithm) -> tuple[list[Round], int, dict[str, Tensor]]:
    tensors, tree = read_tensors(path, inputs)
    with of_this_version(path):
        stand = build(_Stand, tree, str(path))
        best = part_of(tensors, "best.")
        for learned in (best, tensors):
            begin_with(learner, learned)
        for name, optimizer in optimizers_of(learner).items():
            slots = part_of(tensors, f"{name}.")
            if slots:  # none before the first update
                restore(optimizer, slots)
        buffer = learner.replay_buffer
        assert buffer is not None
        for name in _BUFFER:
            value = tensors[f"buffer.{name}"].numpy()
            getattr(buffer, name)[: len(value)] = value
        buffer.pos, full, learner.num_timesteps, learner._n_updates = tensors["count"].tolist()  # noqa: SLF001
        buffer.full = bool(full)
    return list(stand.history), stand.best, best
