"""What stands between a policy's torques and a robot: limits at every tick of its loop, and a stop that holds."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from trueup.deploy.machine_code import machine_code
from trueup.errors import ConfigError

Phase = Literal["running", "stopping", "stopped"]
# What a limit did in a tick, in the order of `Guard.acted`.
LIMITS = ("torque", "rate", "position", "velocity")


@dataclass(frozen=True)
class GuardSettings:
    """Limits of an arm that a policy drives by torques.

    Attributes:
        torque_nm: largest torque of each joint, (J,) [Nm].
        torque_rate: fastest change of a torque, (J,) [Nm/s].
        low: smallest positions, (J,) [rad].
        high: largest positions, (J,) [rad].
        velocity: largest velocities, (J,) [rad/s].
        workspace_m: where the end of the arm must stay: lowest and highest x, y, z, (3,) and (3,) [m].
        margin_rad: so far before a joint's end torques towards it begin to be taken back [rad];
        ahead_s: from where the joint will be after this long at its velocity [s].
        braking_rad_s: velocity from which on a joint is braked with its largest torque; below, in proportion [rad/s].
        too_fast: a joint that exceeds its largest velocity by this factor stops the arm.
        beyond_rad: so does one that is this far beyond its end [rad].
        deaf_s: a policy that has not said a sound torque for longer than this stops the arm [s].
        silent_s: so do readings that have not changed at all for longer than this, though a torque is sent [s].
        late_s: a tick that comes so much too late does, too [s].
        rest_rad_s: an arm whose joints are all slower than this stands [rad/s].

    Raises:
        ConfigError: limits that leave nothing, or numbers that are none.
    """

    torque_nm: tuple[float, ...]
    torque_rate: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    velocity: tuple[float, ...]
    workspace_m: tuple[tuple[float, float, float], tuple[float, float, float]] = (
        (-np.inf, -np.inf, -np.inf),
        (np.inf, np.inf, np.inf),
    )
    margin_rad: float = 0.1
    ahead_s: float = 0.2
    braking_rad_s: float = 0.25
    too_fast: float = 1.2
    beyond_rad: float = 0.02
    deaf_s: float = 0.2
    silent_s: float = 0.5
    late_s: float = 0.02
    rest_rad_s: float = 0.02

    def __post_init__(self) -> None:
        """Refuse limits that leave nothing."""
        joints = len(self.torque_nm)
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name == "workspace_m":
                continue
            if isinstance(value, tuple):
                if len(value) != joints:
                    raise ConfigError(f"guard: {entry.name} has one number per joint", got=len(value), expected=joints)
                bad = not all(np.isfinite(value)) or (entry.name not in ("low", "high") and min(value) <= 0)
            else:
                bad = not 0 < value < np.inf
            if bad:
                raise ConfigError(f"guard: {entry.name}", got=value, expected="positive numbers")
        if any(high - low <= 2 * self.margin_rad for low, high in zip(self.low, self.high, strict=True)):
            raise ConfigError("guard: margin_rad leaves nothing of a joint's range", got=self.margin_rad)
        if not all(low < high for low, high in zip(*self.workspace_m, strict=True)):
            raise ConfigError("guard: workspace_m is empty", got=self.workspace_m)


class Guard:
    """Limits torques at every tick, and stops the arm for good where limits are not enough.

    A stop brakes every joint against its velocity, with its largest torque from `braking_rad_s` on, until the arm
    stands; from then on no torque is sent, and the arm carries its own weight. Torques change as fast as they may at
    most, then too. A stopped guard stays so: a new one is made for a new run.

    Args:
        settings: limits.
        tick_s: from one tick to the next [s].
    """

    def __init__(self, settings: GuardSettings, tick_s: float) -> None:
        if not 0 < tick_s < np.inf:
            raise ConfigError("a guard's tick must be positive", got=tick_s)
        self.settings, self.tick_s = settings, tick_s
        self.phase: Phase = "running"
        self.reason = ""
        self.sent: Float64[np.ndarray, "J"] = np.zeros(len(settings.torque_nm))
        self.acted = np.zeros(len(LIMITS), np.int64)
        self.ticks = 0
        self._limits = np.array(
            (settings.torque_nm, settings.torque_rate, settings.low, settings.high, settings.velocity), np.float64
        )
        self._sizes = np.array([settings.margin_rad, settings.ahead_s, settings.braking_rad_s, tick_s])
        self._box = tuple(np.array(corner, np.float64) for corner in settings.workspace_m)
        self._deaf_s = self._silent_s = 0.0
        self._before: Float64[np.ndarray, "2 J"] = np.full((2, self.sent.size), np.nan)
        self._guarded = compiled()

    def stop(self, reason: str) -> None:
        """Brake from the next tick on; the first reason stays."""
        if self.phase == "running":
            self.phase, self.reason = "stopping", reason

    def tick(
        self,
        said: Float64[np.ndarray, "J"],
        position: Float64[np.ndarray, "J"],
        velocity: Float64[np.ndarray, "J"],
        place: Float64[np.ndarray, "3"],
        *,
        sound: bool = True,
        late_s: float = 0.0,
    ) -> Float64[np.ndarray, "J"]:
        """The torque to send now, (J,) [Nm]; the array is written anew at the next tick.

        Args:
            said: what the policy said last [Nm].
            position: measured [rad].
            velocity: measured [rad/s].
            place: of the end of the arm [m].
            sound: whether the policy has said numbers when it was asked last.
            late_s: how much too late this tick comes [s].
        """
        self.ticks += 1
        well = bool(np.isfinite(position).all() and np.isfinite(velocity).all())
        if not well:
            # Nobody knows how the arm moves: braking blindly could drive it.
            self.stop("readings that are no numbers")
            position, velocity = np.where(np.isfinite(position), position, self._middle), np.zeros_like(self.sent)
        elif self.phase == "running":
            self._look(position, velocity, place, sound=sound, late_s=late_s)
        self._guarded(
            said if self.phase == "running" else self._nothing,
            position,
            velocity,
            self._limits,
            self._sizes,
            self.phase == "stopping",
            self.sent,
            self.acted,
        )
        if self.phase == "stopping" and well and np.abs(velocity).max() < self.settings.rest_rad_s:
            self.phase = "stopped"
        return self.sent

    @property
    def shares(self) -> dict[str, float]:
        """Limit -> share of the ticks in which it changed a torque."""
        return {name: float(count) / max(self.ticks, 1) for name, count in zip(LIMITS, self.acted, strict=True)}

    @property
    def _nothing(self) -> Float64[np.ndarray, "J"]:
        return np.zeros_like(self.sent)

    @property
    def _middle(self) -> Float64[np.ndarray, "J"]:
        return np.asarray(0.5 * (self._limits[2] + self._limits[3]))

    def _look(
        self,
        position: Float64[np.ndarray, "J"],
        velocity: Float64[np.ndarray, "J"],
        place: Float64[np.ndarray, "3"],
        *,
        sound: bool,
        late_s: float,
    ) -> None:
        """Stop where limits are not enough."""
        settings, (_, _, low, high, fastest) = self.settings, self._limits
        self._deaf_s = 0.0 if sound else self._deaf_s + self.tick_s
        same = bool((position == self._before[0]).all() and (velocity == self._before[1]).all())
        self._silent_s = self._silent_s + self.tick_s if same else 0.0
        self._before[0], self._before[1] = position, velocity
        beyond = np.maximum(low - position, position - high)
        if not ((place >= self._box[0]) & (place <= self._box[1])).all():
            self.stop(f"the end of the arm left its workspace at {np.round(place, 3).tolist()} m")
        elif beyond.max() > settings.beyond_rad:
            self.stop(f"joint {int(beyond.argmax()) + 1} is {beyond.max():.3f} beyond its end")
        elif (np.abs(velocity) > settings.too_fast * fastest).any():
            joint = int((np.abs(velocity) / fastest).argmax())
            self.stop(f"joint {joint + 1} is too fast: {abs(velocity[joint]):.2f} of {fastest[joint]:.2f} rad/s")
        elif self._deaf_s > settings.deaf_s:
            self.stop(f"the policy has said no number for {self._deaf_s:.2f} s")
        elif self._silent_s > settings.silent_s and np.abs(self.sent).max() > 0:
            self.stop(f"readings have not changed for {self._silent_s:.2f} s")
        elif late_s > settings.late_s:
            self.stop(f"the control loop was {1e3 * late_s:.1f} ms late")


@cache
def compiled() -> Any:
    """`_guarded` as machine code."""
    return machine_code(_guarded)


def _guarded(said, position, velocity, limits, sizes, stops, sent, acted):  # type: ignore[no-untyped-def] # noqa
    """Torques within all limits.

    Near its end, and near its largest velocity, a joint keeps less and less of the torque that drives it there: from
    all of it where the margin begins (at 0.8 of the velocity) over none half-way to its largest torque back at the end.

    Args:
        said: what is asked for, (J,) [Nm].
        position: (J,) [rad].
        velocity: (J,) [rad/s].
        limits: largest torques [Nm], fastest changes [Nm/s], smallest, largest positions, velocities, (5, J).
        sizes: margin before the ends [rad], how far ahead a position is looked at [s], velocity of full braking
            [rad/s], tick [s], (4,).
        stops: brake, whatever is asked for.
        sent: the torque of the tick before, and of this one, written, (J,) [Nm].
        acted: ticks in which each of `LIMITS` changed something, written, (4,).
    """
    most, rate, low, high, fastest = limits
    margin, ahead_s, braking, tick_s = sizes
    by_torque = by_rate = by_position = by_velocity = False
    for j in range(said.size):
        q, dq, top = position[j], velocity[j], most[j]
        asked = -top * min(max(dq / braking, -1.0), 1.0) if stops else said[j]
        if not np.isfinite(asked):
            asked = 0.0
        torque = min(max(asked, -top), top)
        by_torque = by_torque or torque != asked
        # How far into the margins, 0 to 1.
        above = min(max((q + max(dq, 0.0) * ahead_s - high[j]) / margin + 1.0, 0.0), 1.0)
        below = min(max((low[j] - q - min(dq, 0.0) * ahead_s) / margin + 1.0, 0.0), 1.0)
        kept = max(min(torque, top * (1.0 - 2.0 * above)), -top * (1.0 - 2.0 * below))
        by_position = by_position or kept != torque
        torque = kept
        fast = min(max((abs(dq) / fastest[j] - 0.8) / 0.2, 0.0), 1.0)
        left = top * (1.0 - 2.0 * fast)
        kept = min(torque, left) if dq > 0 else max(torque, -left)
        by_velocity = by_velocity or kept != torque
        step = rate[j] * tick_s
        torque = min(max(kept, sent[j] - step), sent[j] + step)
        by_rate = by_rate or torque != kept
        sent[j] = torque
    acted[0] += by_torque
    acted[1] += by_rate
    acted[2] += by_position
    acted[3] += by_velocity
