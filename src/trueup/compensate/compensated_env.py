"""A Gymnasium environment whose position targets are corrected: the simulator of a policy then moves like the robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from trueup.deploy import Compensated, Compensator
from trueup.deploy.compensated_robot import check_direction
from trueup.errors import ConfigError, DataError, MissingSignal, needing

with needing("an environment with a compensation", "rl"):
    import gymnasium

# What position and velocity are after a reset or a step, from the observation and the info.
State = Callable[[Any, Mapping[str, Any]], tuple[Float[np.ndarray, "J"], Float[np.ndarray, "J"]]]
Keys = tuple[str, str]


class CompensatedEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Adds the delta action to each action; observations, rewards and spaces are those of the environment.

    The infos of its steps say what was added, `delta`, and what was wrong, `compensation` (see `deploy.Why`; 0 if
    nothing was).

    Args:
        env: one environment, whose actions are position targets, or can be made of them.
        compensator: at the rate of the environment's steps.
        state: how position and velocity are found: the names of two entries of the info, or a function of observation
            and info.
        target: from an action to the positions of all joints [rad or m]; None where it is one.
        action: from the action and the corrected positions to the corrected action; None where they are one.
        payload: name of the info's entry that says, at a reset, what the robot carries [kg]; None where it is known
            otherwise.
        direction: see `deploy.CompensatedIO`; an environment is a simulator, unless it drives a robot.

    Raises:
        ConfigError: only one of `target` and `action`, actions that are no positions of the joints, or a network that
            was trained for the other direction.
        MissingDependency: gymnasium is not installed.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        compensator: Compensator,
        *,
        state: State | Keys = ("position", "velocity"),
        target: Callable[[Any], Float[np.ndarray, "J"]] | None = None,
        action: Callable[[Any, Float[np.ndarray, "J"]], Any] | None = None,
        payload: str | None = None,
        direction: str = "simulator",
    ) -> None:
        super().__init__(env)
        check_direction(compensator, direction)
        joints = compensator.card.joints
        if (target is None) != (action is None):
            raise ConfigError("target and action of a compensated environment belong together")
        space = env.action_space
        if target is None and not (isinstance(space, gymnasium.spaces.Box) and space.shape == (len(joints),)):
            raise ConfigError(
                "actions are no positions of the joints",
                got=space,
                expected=f"a Box with {len(joints)} numbers",
                hint="Say what they mean: CompensatedEnv(..., target=..., action=...).",
            )
        self.compensator = compensator
        self._read = _by_keys(*state) if isinstance(state, tuple) else state
        self._target, self._action, self._payload = target, action, payload
        self._state: tuple[Any, Any] | None = None

    @property
    def latest(self) -> Compensated:
        """What became of the latest action."""
        return self.compensator.latest

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; corrections begin anew.

        Raises:
            MissingSignal: the info lacks an entry that was named.
        """
        seen, info = self.env.reset(seed=seed, options=options)
        self.compensator.reset()
        if self._payload is not None:
            if self._payload not in info:
                raise MissingSignal(f"the info of the reset has no {self._payload!r}", available=info)
            self.compensator.carry(float(info[self._payload]))
        self._state = self._read(seen, info)
        return seen, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Correct an action, and take it.

        Raises:
            ConfigError: before the first reset.
            DataError: position, velocity or target are not one number per joint.
        """
        if self._state is None:
            raise ConfigError("an environment is reset before its first step")
        wanted = action if self._target is None else self._target(action)
        answer = self.compensator.step(*self._state, wanted)
        if self._action is None:
            space = self.env.action_space
            assert isinstance(space, gymnasium.spaces.Box)
            corrected = np.clip(answer.target, space.low, space.high).astype(space.dtype)
        else:
            corrected = self._action(action, answer.target.copy())
        if not np.isfinite(np.asarray(corrected, float)).all():
            raise DataError("an action", got=action, expected="numbers")
        delta, flags = answer.delta.copy(), answer.flags
        seen, reward, terminated, truncated, info = self.env.step(corrected)
        self._state = self._read(seen, info)
        return seen, reward, terminated, truncated, {**info, "delta": delta, "compensation": flags}


def _by_keys(position: str, velocity: str) -> State:
    def read(_: Any, info: Mapping[str, Any]) -> tuple[Any, Any]:
        if missing := {position, velocity} - info.keys():
            raise MissingSignal(f"the environment's info has no {sorted(missing)}", available=info)
        return np.asarray(info[position], float), np.asarray(info[velocity], float)

    return read
