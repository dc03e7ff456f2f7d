"""Friction of joints in DART, as forces that hold a joint or brake it.

DART has a Coulomb constraint of its own, but it works with a mass matrix that knows neither armature nor what is taken
implicitly: it would brake a geared joint far too hard.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.robots import JointFriction
from trueup.robots.friction import MARK
from trueup.sim.dart_model import JointNumbers, skeleton_of
from trueup.sim.friction import has_friction


def laws_of(model: mujoco.MjModel) -> dict[int, JointFriction]:
    """Degree of freedom -> the friction law that its joint carries in a compiled model (see `sim.friction`).

    Raises:
        ConfigError: the laws were written by another release.
    """
    if not has_friction(model):
        return {}
    marked = np.flatnonzero(model.jnt_user[:, 0] == MARK)
    return {
        int(model.jnt_dofadr[joint]): JointFriction(*(float(value) for value in model.jnt_user[joint, 1:]))
        for joint in marked
    }


class DartFriction:
    """How much friction each joint may use in a step: `JointFriction`, evaluated where MuJoCo's callback would be.

    Args:
        model: compiled.
        numbers: of its joints.
        laws: degree of freedom -> law.
    """

    def __init__(self, model: mujoco.MjModel, numbers: JointNumbers, laws: Mapping[int, JointFriction]) -> None:
        self._numbers = numbers
        self._laws = {dof: law for dof, law in laws.items() if law.on or law.asymmetry}
        self._asymmetry = np.zeros(model.nv)
        for dof, law in self._laws.items():
            self._asymmetry[dof] = law.asymmetry
        # MuJoCo gives a friction row only to joints with some frictionloss, and so do we.
        self._rows = numbers.frictionloss > 0
        # The load of a transmission is counted as if nothing carried the arm's weight, as MuJoCo's qfrc_bias does. Any
        # law with a formula may ask for it.
        heavy = any(law.on for law in self._laws.values())
        self._heavy: Any = skeleton_of(model, compensated=False) if heavy else None

    @property
    def there(self) -> bool:
        """Whether any joint has friction other than viscous."""
        return bool(self._laws) or bool(self._rows.any())

    def level(
        self, position: Float64[np.ndarray, "B V"], velocity: Float64[np.ndarray, "B V"]
    ) -> Float64[np.ndarray, "B V"]:
        """The most that friction may brake in this step, (B, V) [Nm or N]."""
        level = np.tile(self._numbers.frictionloss, (len(velocity), 1))
        load = self._load(position, velocity) if self._heavy is not None else np.zeros_like(velocity)
        for dof, law in self._laws.items():
            level[:, dof] = law.brake(velocity[:, dof], level[:, dof], load[:, dof], position[:, dof])
        return np.where(self._rows, level, 0.0)

    def force(self, velocity: Float64[np.ndarray, "B V"]) -> Float64[np.ndarray, "B V"]:
        """What the direction adds to viscous damping, as a force, (B, V) [Nm or N]."""
        return np.asarray(-self._asymmetry * self._numbers.damping * np.abs(velocity))

    def _load(
        self, position: Float64[np.ndarray, "B V"], velocity: Float64[np.ndarray, "B V"]
    ) -> Float64[np.ndarray, "B V"]:
        load = np.empty_like(velocity)
        for row in range(len(load)):
            self._heavy.setPositions(position[row])
            self._heavy.setVelocities(velocity[row])
            load[row] = self._heavy.getCoriolisAndGravityForces()
        return load
