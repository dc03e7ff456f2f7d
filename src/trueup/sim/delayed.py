"""A simulator that acts late on its commands, as the robot does; a Simulator again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.protocols import RolloutRequest, RolloutResult, Simulator
from trueup.errors import ConfigError

# A rest of a step below this is a rounding error; as in a replay.
_SAME_STEP = 1e-9


class DelayedSimulator:
    """Any simulator whose commands act later, joint by joint.

    A replay delays the commands of a log before it simulates. A loop of steps has nobody who does: give it this, with
    `robot.delay_s`, and it does what the replay of the same commands does. What is left of a delay after whole steps is
    interpolated between two of them; before the first command, the first command acts.

    What is put around it, such as a `ResidualSimulator`, sees the commands as they are given.

    Args:
        simulator: whose controller follows the commands.
        delay_s: how much later they act, >= 0, one per joint or one for all [s].

    Raises:
        ConfigError: a delay is negative or not finite, or there are not as many as joints.
    """

    def __init__(self, simulator: Simulator, delay_s: float | Sequence[float] | Float64[np.ndarray, "J"]) -> None:
        delays, joints = np.asarray(delay_s, np.float64), simulator.joints
        if delays.shape not in ((), (len(joints),)) or not (np.isfinite(delays).all() and (delays >= 0).all()):
            raise ConfigError("delays of commands", got=delays.tolist(), expected=f"one >= 0 for each of {joints}")
        steps = np.broadcast_to(delays, (len(joints),)) / simulator.timestep_s
        self._inner = simulator
        self._whole = np.floor(steps + _SAME_STEP).astype(np.int64)
        rest = np.maximum(steps - self._whole, 0.0)
        self._rest = np.where(rest < _SAME_STEP, 0.0, rest)
        self._kept = int(self._whole.max(initial=0)) + 2
        self._past: dict[str, list[np.ndarray]] = {}

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J controlled joints."""
        return self._inner.joints

    @property
    def timestep_s(self) -> float:
        """Physics step [s]."""
        return self._inner.timestep_s

    @property
    def command_signals(self) -> tuple[str, ...]:
        """Command signals that the controller follows; the first is required."""
        return self._inner.command_signals

    def rollout(self, request: RolloutRequest) -> RolloutResult:
        """Simulate B motions; the commands of the request are those that are given, not yet delayed."""
        late = {name: self._acting(values, np.arange(values.shape[1])) for name, values in request.command.items()}
        return self._inner.rollout(replace(request, command=late))

    def reset(self, position: Float[np.ndarray, "B J"], velocity: Float[np.ndarray, "B J"]) -> None:
        """Put B independent copies of the robot into these states, at time 0, and forget the commands before."""
        self._past = {}
        self._inner.reset(position, velocity)

    def step(self, command: dict[str, Float[np.ndarray, "B J"]]) -> dict[str, Float[np.ndarray, "B J"]]:
        """Advance every copy by one physics step; returns `position`, `velocity` after it and `torque` in it."""
        late = {}
        for name, values in command.items():
            now = np.array(values, np.float64)
            past = self._past.setdefault(name, [now] * self._kept)
            past[:] = [*past[1:], now]
            late[name] = self._acting(np.stack(past, axis=1), np.array([self._kept - 1]))[:, 0]
        return self._inner.step(late)

    def _acting(self, given: Float[np.ndarray, "B N J"], rows: np.ndarray) -> Float64[np.ndarray, "B K J"]:
        """What acts in these steps, of what was given up to them."""
        columns = np.arange(given.shape[2])
        first = rows[:, None] - self._whole
        sooner = given[:, np.maximum(first, 0), columns]
        later = given[:, np.maximum(first - 1, 0), columns]
        return np.asarray((1.0 - self._rest) * sooner + self._rest * later, np.float64)
