"""A robot that is off: masses, centers of mass, positions of joints and motors, drawn around those of a model.

For the question how far off a model may be (SAT, VI-C). What is drawn is a robot again: masses are positive, inertias
such as bodies can have, closed chains closed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError
from trueup.robots import RobotSpec
from trueup.robots.model import compile_spec, load_spec
from trueup.sim.closed_chains import open_by

# A factor that is drawn is no less than this: masses and resistances stay positive.
LEAST_FACTOR = 0.05
_MOVABLE = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_BALL)
# What closes a chain may be violated by this much more than in the model as it came [m, or rad].
_CLOSED = 1e-6


@dataclass(frozen=True)
class Perturbation:
    """How far off a robot is drawn: standard deviations of normal distributions; 0 leaves things as they are.

    Attributes:
        mass: of the factor of each body's mass and inertia, around 1.
        com_m: of the shift of each body's center of mass, in each axis [m].
        joint_m: of the shift of each jointed body against its parent, in each axis [m]; its joints go with it.
        resistance: of the factor of the motors' resistance, around 1.

    Raises:
        ConfigError: a size is negative or not finite.
    """

    mass: float = 0.0
    com_m: float = 0.0
    joint_m: float = 0.0
    resistance: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no spread."""
        for name, value in vars(self).items():
            if not 0.0 <= value < math.inf:
                raise ConfigError(f"perturbation: {name}", got=value, expected="a number that is not negative")

    def times(self, share: float) -> Perturbation:
        """A share of it."""
        return Perturbation(**{name: share * value for name, value in vars(self).items()})

    def refuse_without_effect(self, robot: RobotSpec) -> None:
        """Raise ConfigError if the motors are to be off, and no motor moves this robot."""
        if self.resistance and (robot.motor is None or robot.controller.kind != "servo"):
            raise ConfigError(
                f"robot {robot.name!r}: the resistance of its motors moves nothing",
                got=f"controller {robot.controller.kind!r}, {'a' if robot.motor else 'no'} motor",
                expected="controller 'servo' and a motor",
                hint="Describe them in robot.yaml (docs/robot-yaml.md), or leave the resistance as it is.",
            )


def perturbed(robot: RobotSpec, model: Path, size: Perturbation, *, seed: int) -> tuple[RobotSpec, mujoco.MjSpec]:
    """A robot drawn around a model, and its editable model.

    The same seed draws the same directions at every size: a perturbation of half the size is half as far off. A body's
    shape and what it looks like stay where they are; its mass and inertia are scaled together, so that they stay those
    of a possible body. Where chains are closed, their loose ends move along (a rod is as long as it needs to be).

    Args:
        robot: its description.
        model: MJCF or URDF.
        size: how far off.
        seed: of the draw.

    Returns:
        The description, whose motor is another one; and the model, which nobody has completed yet
        (`MujocoSimulator.from_spec`).

    Raises:
        ConfigError: the model does not load, the robot has no motor that could be off, or a chain would come apart.
    """
    size.refuse_without_effect(robot)
    spec, rng = load_spec(model), np.random.default_rng(seed)
    plain = compile_spec(load_spec(model), model)
    if (size.mass or size.com_m or size.joint_m) and len(spec.bodies) != plain.nbody:
        raise ConfigError(
            f"{model}: bodies are merged when it is compiled", hint='<compiler fusestatic="false"/> keeps them apart.'
        )
    for number, body in enumerate(spec.bodies):
        if number == 0:
            continue
        # All are drawn whether they are used or not: what one quantity draws does not depend on the others.
        factor, center, place = rng.standard_normal(), rng.standard_normal(3), rng.standard_normal(3)
        if size.mass or size.com_m:
            _weigh(body, plain, number, drawn_factor(size.mass, factor), size.com_m * center)
        if size.joint_m and any(joint.type in _MOVABLE for joint in body.joints):
            body.pos = np.asarray(body.pos) + size.joint_m * place
    factor = drawn_factor(size.resistance, rng.standard_normal())
    if size.mass or size.com_m:
        # The numbers above are those that these two have led to already.
        spec.compiler.settotalmass = -1.0
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    if size.joint_m and plain.neq:
        _refuse_torn(robot, plain, compile_spec(spec, model))
    if robot.motor is None:
        return robot, spec
    return replace(robot, motor=replace(robot.motor, resistance_ohm=factor * robot.motor.resistance_ohm)), spec


def drawn_factor(spread: float, drawn: float) -> float:
    """A factor from N(1, spread), cut so that it stays positive; `drawn` is from N(0, 1)."""
    return max(LEAST_FACTOR, 1.0 + spread * drawn)


def _weigh(
    body: mujoco.MjsBody, plain: mujoco.MjModel, number: int, factor: float, shift: Float64[np.ndarray, "3"]
) -> None:
    """State the mass of a body, in place of deriving it from its shape."""
    body.explicitinertial = True
    body.mass = factor * plain.body_mass[number]
    body.ipos = plain.body_ipos[number] + shift
    body.iquat = plain.body_iquat[number]
    body.inertia = factor * plain.body_inertia[number]
    body.fullinertia = np.full(6, np.nan)


def _refuse_torn(robot: RobotSpec, plain: mujoco.MjModel, moved: mujoco.MjModel) -> None:
    """Raise ConfigError if what closes chains holds less well in the pose of the model."""
    before, after = (_open_by(model) for model in (plain, moved))
    if not after <= before + _CLOSED:
        raise ConfigError(
            f"robot {robot.name!r}: closed chains would come apart where joints are shifted",
            got=f"{after:.3g} off in the pose of the model",
            expected=f"at most {before + _CLOSED:.3g}",
            hint="Close them by <connect> or <weld> between bodies without relpose, or leave joints where they are.",
        )


def _open_by(model: mujoco.MjModel) -> float:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return open_by(data)
