"""Simulated robots side by side, each following a motion of the real one, as Stable-Baselines3 wants to see them.

An actor sees the samples that the network reads, and what it does is a delta action. What follows in an observation is
for the critic, which is there in training only: how far the simulator is from the measured state, and the delta action
before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Float64, Int

from trueup.augment.side_by_side import SideBySide
from trueup.compensate.ppo_config import PpoConfig
from trueup.compensate.tracks import Track
from trueup.errors import ConfigError, DataError, needing
from trueup.sim.fleet import make_fleet
from trueup.sim.transitions import Transitions

with needing("training by reinforcement", "rl"):
    from gymnasium import spaces
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

# Control steps that a motion must still have where an episode begins, if any motion has as many.
_LEFT = 16
# What the critic sees of errors, in sizes: one robot far away must not decide about its scale.
_SEEN = 20.0


@dataclass(frozen=True)
class Tally:
    """What happened since it was last asked.

    Attributes:
        steps: control steps of all robots.
        reward: mean of a control step.
        error: mean distance of a joint from the measured position [rad or m].
        episodes: that ended.
        left: of them, because the simulator had left the motion.
        lost: because it diverged.
    """

    steps: int
    reward: float
    error: float
    episodes: int
    left: int
    lost: int


class TrackingEnvironment(SideBySide):
    """N robots; a step is a control step of all.

    Args:
        tracks: measured motions.
        transitions: the simulator with a payload [kg].
        config: number of robots, reward, and when episodes end.
        past: samples that the network reads besides the current one.
        scale: of each joint the delta action that an action of 1 is, (J,) [rad or m].
        device: `cpu` or `cuda`.
        seed: of all draws.

    Raises:
        ConfigError: fewer robots than payloads, or robots that cannot be side by side.
        DataError: no motion is long enough.
        MissingDependency: see `make_fleet`.
    """

    def __init__(
        self,
        tracks: Sequence[Track],
        transitions: Callable[[float], Transitions],
        config: PpoConfig,
        *,
        past: int,
        scale: Float[np.ndarray, "J"],
        device: str = "cpu",
        seed: int = 0,
    ) -> None:
        self.config, self.past = config, past
        self._scale = np.asarray(scale, np.float64)
        joints = len(self._scale)
        self._sizes = np.repeat([config.position_rad, config.velocity_rad_s], joints)
        lengths = np.array([len(track) for track in tracks])
        self._state: Float64[np.ndarray, "M S"] = np.concatenate([track.state for track in tracks]).astype(np.float64)
        self._command: Float64[np.ndarray, "M J"] = np.concatenate([track.command for track in tracks]).astype(
            np.float64
        )
        last = np.cumsum(lengths) - 1
        self._last = np.repeat(last, lengths)
        starts, payloads = _starts(tracks, last, past)
        self._payload, self._starts = _shared_out(starts, payloads, config.robots)
        made = {kg: transitions(kg) for kg in np.unique(self._payload).tolist()}
        self._fleet = make_fleet([made[kg] for kg in self._payload.tolist()], device)
        count = config.robots
        self._at: Int[np.ndarray, "N"] = np.zeros(count, int)
        self._age: Int[np.ndarray, "N"] = np.zeros(count, int)
        self._before: Float64[np.ndarray, "N J"] = np.zeros((count, joints))
        self._delta: Float64[np.ndarray, "N J"] = np.zeros((count, joints))
        self._window: Float64[np.ndarray, "N P I"] = np.zeros((count, past + 1, 3 * joints + 1))
        self._window[:, :, -1] = self._payload[:, None]
        self._sum: Float64[np.ndarray, "N"] = np.zeros(count)
        self._action: Float[np.ndarray, "N J"] = np.zeros((count, joints))
        self._clear()
        self._rng = np.random.default_rng(seed)
        wide = (past + 1) * (3 * joints + 1) + 3 * joints
        bound = (config.largest_rad / self._scale).astype(np.float32)
        super().__init__(
            count,
            spaces.Box(-np.inf, np.inf, (wide,), np.float32),
            spaces.Box(-bound, bound, dtype=np.float32),
        )

    @property
    def payload_kg(self) -> Float64[np.ndarray, "N"]:
        """What each robot carries [kg]; as large a share of the robots as of the data."""
        return self._payload

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Draw from here on as from the beginning of this seed."""
        self._rng = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def reset(self) -> Float32[np.ndarray, "N O"]:
        """Let all robots begin somewhere."""
        self._begin(np.arange(self.num_envs))
        return self._observed()

    def step_async(self, actions: Float[np.ndarray, "N J"]) -> None:
        """Take actions for `step_wait`."""
        self._action = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Observations, rewards, which episodes ended, and of those the last observation.

        All ends are ends of what is simulated, not of the task: what would come after is still worth what it is worth.
        """
        config, joints = self.config, len(self._scale)
        bound = config.largest_rad
        delta = np.clip(np.asarray(self._action, np.float64) * self._scale, -bound, bound)
        command = self._command[self._at] + delta
        after = self._fleet.step(self._before, command)
        lost = np.isnan(after[:, 0])
        old = self._window[:, -1, : 2 * joints]
        after[lost] = old[lost]
        reward = self.rewards(old, after, delta)
        # As if every joint were as far away as is allowed.
        reward[lost] = -config.weight * joints * (config.leave_rad / config.position_rad) ** 2
        self._at += 1
        self._age += 1
        self._before, self._delta = command, delta
        self._window[:, :-1] = self._window[:, 1:]
        self._window[:, -1, : 2 * joints] = after
        self._window[:, -1, 2 * joints : -1] = self._command[self._at]
        away = np.abs(after[:, :joints] - self._state[self._at, :joints])
        left = away.max(axis=1) > config.leave_rad
        done = lost | left | (self._age >= config.episode) | (self._at >= self._last[self._at])
        self._sum += reward
        self._steps += self.num_envs
        self._rewards += float(reward.sum())
        self._errors += float(away.mean(axis=1).sum())
        self._ends += np.array([done.sum(), (left & ~lost).sum(), lost.sum()])
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = np.flatnonzero(done)
        if ended.size:
            final = self._observed(ended)
            for place, row in enumerate(ended.tolist()):
                infos[row] = {
                    "terminal_observation": final[place],
                    "TimeLimit.truncated": True,
                    "episode": {"r": float(self._sum[row]), "l": int(self._age[row])},
                }
            self._begin(ended)
        return self._observed(), reward.astype(np.float32), done, infos

    def rewards(
        self,
        before: Float[np.ndarray, "N S"],
        after: Float[np.ndarray, "N S"],
        delta: Float[np.ndarray, "N J"],
    ) -> Float64[np.ndarray, "N"]:
        """Of a control step, with the measured motion of each robot where it is now and the delta action before.

        Args:
            before: states of the simulators before it.
            after: and after it.
            delta: delta actions in it.
        """
        config, joints = self.config, delta.shape[1]
        if config.reward == "change":
            error = (self._state[self._at + 1] - self._state[self._at]) - (after - before)
        else:
            error = self._state[self._at + 1] - after
        scaled = error / self._sizes
        if config.reward == "position":
            scaled = scaled[:, :joints]
        change = (delta - self._delta) / config.position_rad
        cost: Float64[np.ndarray, "N"] = (scaled**2).sum(axis=1) + config.smoothness * (change**2).sum(axis=1)
        return -config.weight * cost

    def tally(self) -> Tally:
        """What happened since it was last asked."""
        steps, ends = max(1, self._steps), self._ends.tolist()
        tally = Tally(self._steps, self._rewards / steps, self._errors / steps, *ends)
        self._clear()
        return tally

    def memory(self) -> dict[str, np.ndarray]:
        """All that decides how it goes on, but what it draws."""
        own = {name: getattr(self, f"_{name}").copy() for name in _MEMORY}
        return {**own, "fleet": self._fleet.memory()}

    def restore(self, memory: dict[str, np.ndarray]) -> Float32[np.ndarray, "N O"]:
        """Go on from there; returns what is observed.

        Raises:
            DataError: it is of another environment.
        """
        for name in _MEMORY:
            mine = getattr(self, f"_{name}")
            if name not in memory or memory[name].shape != mine.shape:
                raise DataError(f"the memory of an environment lacks {name!r} of {mine.shape}")
            mine[:] = memory[name]
        self._fleet.restore(memory["fleet"])
        return self._observed()

    def _begin(self, rows: Int[np.ndarray, "R"]) -> None:
        """Measured states somewhere in a motion, and the history before."""
        joints = len(self._scale)
        share = self._rng.random(rows.size)
        own = [self._starts[kg] for kg in self._payload[rows].tolist()]
        at = np.array([starts[int(where * len(starts))] for starts, where in zip(own, share, strict=True)], int)
        around = at[:, None] + np.arange(-self.past, 1)
        self._at[rows], self._age[rows], self._sum[rows] = at, 0, 0.0
        self._window[rows, :, : 2 * joints] = self._state[around]
        self._window[rows, :, 2 * joints : -1] = self._command[around]
        # Whoever reads no history may begin where nothing was commanded before.
        self._before[rows] = self._command[around[:, -2] if self.past else at]
        self._delta[rows] = 0.0
        self._fleet.place(rows, self._state[at])

    def _observed(self, rows: Int[np.ndarray, "R"] | slice = slice(None)) -> Float32[np.ndarray, "R O"]:
        window, joints = self._window[rows], len(self._scale)
        error = (window[:, -1, : 2 * joints] - self._state[self._at[rows]]) / self._sizes
        told = [window.reshape(len(window), -1), np.clip(error, -_SEEN, _SEEN), self._delta[rows] / self._scale]
        return np.concatenate(told, axis=1).astype(np.float32)

    def _clear(self) -> None:
        self._steps, self._rewards, self._errors = 0, 0.0, 0.0
        self._ends: Int[np.ndarray, "3"] = np.zeros(3, int)


# What of an environment changes from step to step.
_MEMORY = ("at", "age", "before", "delta", "window", "sum")


def _starts(
    tracks: Sequence[Track], last: Int[np.ndarray, "K"], past: int
) -> tuple[list[Int[np.ndarray, "_"]], Float64[np.ndarray, "K"]]:
    """Rows of each motion where episodes may begin, and what is carried in it."""
    longest = max((len(track) for track in tracks), default=0) - past
    least = min(_LEFT, longest - 1)
    if least < 1:
        raise DataError("no motion is long enough", got=f"{longest + past} commands", expected=f"{past + 2} at least")
    found = [np.arange(end + 1 - len(track) + past, end + 1 - least) for track, end in zip(tracks, last, strict=True)]
    return found, np.array([track.payload_kg for track in tracks])


def _shared_out(
    starts: Sequence[Int[np.ndarray, "_"]], payloads: Float64[np.ndarray, "K"], robots: int
) -> tuple[Float64[np.ndarray, "N"], dict[float, Int[np.ndarray, "_"]]]:
    """What each robot carries, and where those that carry it begin; models are not changed between episodes."""
    own = {
        kg: np.concatenate([rows for rows, carried in zip(starts, payloads, strict=True) if carried == kg])
        for kg in np.unique(payloads).tolist()
    }
    own = {kg: rows for kg, rows in own.items() if rows.size}
    if robots < len(own):
        raise ConfigError("ppo: robots: fewer than payloads", got=robots, expected=f"at least {len(own)}")
    shares = np.cumsum([len(rows) for rows in own.values()]) / sum(len(rows) for rows in own.values())
    # One each, the others in proportion.
    more = np.round(shares * (robots - len(own))).astype(int)
    counts = 1 + np.diff(more, prepend=0)
    return np.repeat(np.array(list(own)), counts), own
