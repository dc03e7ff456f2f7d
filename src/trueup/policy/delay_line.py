"""Torques that act later than they are told to, by any time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.core.protocols import Simulator
from trueup.errors import ConfigError
from trueup.sim.transitions import late_shares

Delay = float | Sequence[float] | Float64[np.ndarray, "J"]
# Of a delay that ends within this share of a control step, nobody can tell whether it does.
_WHOLE = 1e-9


class DelayLine:
    """What acts on N arms in each of the K physics steps of a control step.

    Where a delay ends within a physics step, a mean of both torques acts in it.

    Args:
        simulator: of J joints.
        control_s: control step [s].
        delay_s: how much later torques act, one number per joint or one for all [s].
        count: N.

    Raises:
        ConfigError: a delay is negative or no number.
    """

    def __init__(self, simulator: Simulator, control_s: float, delay_s: Delay = 0.0, *, count: int = 1) -> None:
        self._simulator, self._control_s = simulator, control_s
        joints = len(simulator.joints)
        self._late = np.zeros((count, late_shares(simulator, control_s, 0.0).shape[0], joints))
        self._whole: Int[np.ndarray, "N J"] = np.zeros((count, joints), np.int64)
        # Torques of earlier control steps, the last one first.
        self._past: Float64[np.ndarray, "S N J"] = np.zeros((1, count, joints))
        self.delayed = False
        self.set(np.arange(count), delay_s)

    def set(self, rows: Int[np.ndarray, "R"], delay_s: Delay) -> None:
        """Let the torques of these arms act so much later [s].

        Raises:
            ConfigError: a delay is negative or no number.
        """
        delays = np.broadcast_to(np.asarray(delay_s, np.float64), self._whole.shape[1:])
        if not (np.isfinite(delays).all() and delays.min() >= 0):
            raise ConfigError("torques act later, not earlier", got=delays.tolist(), expected="delays of 0 s and more")
        whole = np.floor(delays / self._control_s + _WHOLE).astype(np.int64)
        rest = np.maximum(delays - whole * self._control_s, 0.0)
        self._whole[rows], self._late[rows] = whole, late_shares(self._simulator, self._control_s, rest)
        if (lacking := int(self._whole.max()) + 1 - len(self._past)) > 0:
            self._past = np.concatenate([self._past, np.zeros((lacking, *self._past.shape[1:]))])
        self.delayed = bool(self._late.any() or self._whole.any())

    def clear(self, rows: Int[np.ndarray, "R"]) -> None:
        """Nothing acts on these arms from before."""
        self._past[:, rows] = 0.0

    def acting(self, torque: Float[np.ndarray, "N J"]) -> Float64[np.ndarray, "N K J"]:
        """What acts in each physics step of the control step in which these torques are told."""
        told = np.concatenate([np.asarray(torque, np.float64)[None], self._past])
        now, before = (np.take_along_axis(told, own[None], axis=0)[0] for own in (self._whole, self._whole + 1))
        self._past = told[:-1]
        return np.asarray(self._late * before[:, None] + (1.0 - self._late) * now[:, None])
