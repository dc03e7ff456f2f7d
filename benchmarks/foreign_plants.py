"""What moves in the foreign truths: links in MuJoCo at a fine step, and motors behind a soft or loose gear.

All motions of a case move side by side: positions, velocities and torques are (E, J).
"""

from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np

from benchmarks.foreign_robots import joint_dofs

FINE_S = 0.00025


class Plant(Protocol):
    """Links of a robot under the torques of its joints."""

    q: np.ndarray
    v: np.ndarray

    def step(self, torque: np.ndarray) -> None:
        """Go on by `FINE_S`."""


class MujocoPlant:
    """Links in MuJoCo, with dry friction that is as hard as the step allows.

    Args:
        model: with the true inertias, armature, damping and dry friction.
        joints: which of its joints, (J,) names.
        start: position at rest, (E, J).
    """

    def __init__(self, model: mujoco.MjModel, joints: tuple[str, ...], start: np.ndarray):
        self._model, self._dofs = model, joint_dofs(model, joints)
        self.q, self.v = start.copy(), np.zeros_like(start)
        self._all = [mujoco.MjData(model) for _ in start]
        for data, position in zip(self._all, start, strict=True):
            data.qpos[self._dofs] = position

    def step(self, torque: np.ndarray) -> None:
        """Go on by `FINE_S`."""
        model, dofs = self._model, self._dofs
        for data, own, q, v in zip(self._all, torque, self.q, self.v, strict=True):
            data.qfrc_applied[dofs] = own
            mujoco.mj_step(model, data)
            q[:] = data.qpos[dofs]
            v[:] = data.qvel[dofs]


@dataclass
class Gear:
    """Motors that move their links through a spring with play; both are rigid at joints without.

    Attributes:
        stiffness: of the spring, 0 where the joint is rigid, (J,) [Nm/rad].
        damping: of the spring while it is engaged, (J,) [Nm s/rad].
        play: between the ends of the play, (J,) [rad].
        inertia: of the rotor at the joint, (J,) [kg m2].
        friction: dry friction of the motor, (J,) [Nm].
        viscous: viscous friction of the motor, (J,) [Nm s/rad].
    """

    stiffness: np.ndarray
    damping: np.ndarray
    play: np.ndarray
    inertia: np.ndarray
    friction: np.ndarray
    viscous: np.ndarray

    def attach(self, plant: Plant) -> None:
        """Begin at rest with the links of `plant`."""
        self._plant, self._soft = plant, self.stiffness > 0
        self._q, self._v = plant.q.copy(), plant.v.copy()

    @property
    def q(self) -> np.ndarray:
        """Position of the motors, (E, J)."""
        return np.where(self._soft, self._q, self._plant.q)

    @property
    def v(self) -> np.ndarray:
        """Velocity of the motors, (E, J)."""
        return np.where(self._soft, self._v, self._plant.v)

    def step(self, torque: np.ndarray) -> None:
        """Go on by `FINE_S` under the motors' torques."""
        twist, rate = self._q - self._plant.q, self._v - self._plant.v
        pressed = np.sign(twist) * np.maximum(np.abs(twist) - self.play / 2, 0.0)
        passed = self.stiffness * pressed + np.where(pressed != 0, self.damping * rate, 0.0)
        passed = np.where(pressed * passed > 0, passed, 0.0) if self.play.any() else passed
        free = (self._v + FINE_S / self.inertia * (torque - passed)) / (1 + FINE_S * self.viscous / self.inertia)
        self._v = np.sign(free) * np.maximum(np.abs(free) - FINE_S * self.friction / self.inertia, 0.0)
        self._q = self._q + FINE_S * self._v
        self._plant.step(np.where(self._soft, passed, torque))
