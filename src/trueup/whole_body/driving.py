"""Move the arms of a whole body along a motion while its base is balanced along its profile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from trueup.errors import DataError
from trueup.whole_body.balance import Balance, Lean
from trueup.whole_body.bodies import Arms, WholeBody, whole_steps
from trueup.whole_body.profile import BaseProfile

# Position [rad] and velocity [rad/s] of the arms, their target [rad], and what each hand holds [kg] -> a target to send
# instead [rad]. It is called once per target, in order: it may remember.
Compensator = Callable[[Arms, Arms, Arms, float], Arms]

TARGET_S = 0.02


@dataclass(frozen=True)
class DrivingSettings:
    """How a motion is driven.

    Attributes:
        profile: of the base.
        settle_s: stand with the first target so long before the motion begins [s].
        fallen_rad: who leans so far from upright has fallen [rad].
    """

    profile: BaseProfile = field(default_factory=BaseProfile)
    settle_s: float = 2.0
    fallen_rad: float = 0.6


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What came of it, at each target: T rows, fewer if the body fell, none if it fell before the motion began.

    Attributes:
        time_s: since the motion began [s].
        arms: as their sensors say, (T, J) [rad].
        position: of the base as it is, (T, 3) [m].
        rotation: likewise, (T, 3, 3).
        torque: of the wheels, (T, 2) [Nm].
        lean: aim of the pitch from the beginning of the settling on, (S + T,) [rad].
        fallen_s: when it fell, None if it did not; negative while it settled [s].
    """

    time_s: Float64[np.ndarray, "T"]
    arms: Float64[np.ndarray, "T J"]
    position: Float64[np.ndarray, "T 3"]
    rotation: Float64[np.ndarray, "T 3 3"]
    torque: Float64[np.ndarray, "T 2"]
    lean: Float64[np.ndarray, "L"]
    fallen_s: float | None

    @property
    def way(self) -> Float64[np.ndarray, "T 2"]:
        """How far the base has come since the motion began, ahead and to the left of where it was then [m]."""
        moved, ahead = (self.position - self.position[:1])[:, :2], self.rotation[:1, :2, 0]
        ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        return np.stack([(moved * ahead).sum(axis=1), (moved * left).sum(axis=1)], axis=1)

    @property
    def tilt(self) -> Float64[np.ndarray, "T 2"]:
        """How far the base leans forward and to the left, seen in its own heading [rad]."""
        up, ahead = self.rotation[:, :, 2], self.rotation[:, :2, 0]
        ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        forward = (up[:, :2] * ahead).sum(axis=1)
        left = up[:, 1] * ahead[:, 0] - up[:, 0] * ahead[:, 1]
        return np.stack([np.arctan2(forward, up[:, 2]), np.arctan2(left, up[:, 2])], axis=1)


def drive(
    body: WholeBody,
    balance: Balance,
    targets: Float64[np.ndarray, "T J"],
    *,
    lean: Lean | Float64[np.ndarray, "L"],
    compensator: Compensator | None = None,
    settings: DrivingSettings | None = None,
    seed: int = 0,
) -> Trajectory:
    """Drive a whole body along targets of its arms, one every 20 ms.

    The base knows of the arms how far it should lean for them, and that from simulation: the simulated body's own arms
    say it while they move, and a real body gets what was found there.

    Args:
        body: whose arms and base move.
        balance: keeps it up.
        targets: of the arms [rad].
        lean: finds the lean from the arms as they are, or the aims that a simulated trajectory has.
        compensator: changes the targets before they are sent; plain PD if None.
        settings: profile of the base, settling, when it has fallen.
        seed: of what the body draws.

    Raises:
        DataError: the aims are those of another motion, or a compensator gives what is no target.
    """
    settings = settings or DrivingSettings()
    waits, ticks = whole_steps(settings.settle_s, TARGET_S), whole_steps(TARGET_S, balance.settings.step_s)
    count = waits + len(targets)
    if not isinstance(lean, Lean) and len(lean) != count:
        raise DataError("these aims of the lean are of another motion", got=len(lean), expected=count)
    step_s = balance.settings.step_s
    times = TARGET_S * (np.arange(count) - waits)
    way, speed = settings.profile.way((times[:, None] + step_s * np.arange(ticks)).ravel())
    first = lean(targets[0]) if isinstance(lean, Lean) else float(lean[0])
    body.restart(targets[0], first, seed=seed)
    rows, aims = _Rows(targets.shape[1]), []
    fallen_s = None
    for row in range(count):
        position, velocity = body.arms()
        aims.append(lean(position) if isinstance(lean, Lean) else float(lean[row]))
        target = targets[max(row - waits, 0)]
        sent = target if compensator is None else compensator(position, velocity, target, body.payload_kg)
        if sent.shape != target.shape or not np.isfinite(sent).all():
            raise DataError("a compensator must give one finite target per joint", got=sent)
        torque = np.zeros(2)
        for tick in range(ticks):
            at = row * ticks + tick
            aim = np.array([way[at], aims[-1], 0.0, speed[at], 0.0, 0.0])
            torque = balance.torque(body.reading().stance(balance.axle), aim)
            if tick == 0 and row >= waits:
                rows.add(position, body, torque)
            body.advance(sent, torque, step_s)
        if body.chassis.rotation()[2, 2] < np.cos(settings.fallen_rad):
            fallen_s = float(times[row] + TARGET_S)
            break
    return rows.trajectory(np.array(aims), fallen_s)


class _Rows:
    """What is kept of each target's beginning."""

    def __init__(self, joints: int) -> None:
        self._shapes = ((joints,), (3,), (3, 3), (2,))
        self._kept: tuple[list[np.ndarray], ...] = ([], [], [], [])

    def add(self, arms: Arms, body: WholeBody, torque: Float64[np.ndarray, "2"]) -> None:
        found = (arms, body.chassis.position(), body.chassis.rotation(), torque)
        for kept, own in zip(self._kept, found, strict=True):
            kept.append(own)

    def trajectory(self, lean: Float64[np.ndarray, "L"], fallen_s: float | None) -> Trajectory:
        parts = zip(self._kept, self._shapes, strict=True)
        arms, position, rotation, torque = (np.reshape(own, (len(own), *shape)) for own, shape in parts)
        return Trajectory(TARGET_S * np.arange(len(arms)), arms, position, rotation, torque, lean, fallen_s)
