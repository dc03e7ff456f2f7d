"""Friction laws beyond MuJoCo's own, inside the engine: a compiled callback, no Python per step.

The numbers of a joint live in the model itself, as the joint's user data (`<joint user="…">`): a model file carries
its friction, every candidate of a fit has its own, and copies, rollouts and batches need nothing else. MuJoCo calls
`mjcb_control` when positions, velocities and `qfrc_bias` of a step are known and forces are not: there, smooth laws
are added to the passive forces, and dry friction is written into the friction rows of the constraint solver.
"""

from __future__ import annotations

from dataclasses import astuple, fields

import mujoco

from trueup.errors import ConfigError
from trueup.robots import JointFriction

NAMES = tuple(field.name for field in fields(JointFriction))
# The first number of a joint's user data says that the others are a friction law in the order of NAMES. (MJCF keeps
# six digits.)
MARK = 20261.0
WIDTH = 1 + len(NAMES)

# MuJoCo makes a friction row only for joints with some frictionloss.
_LEAST_FRICTIONLOSS = 1e-6


def set_friction(spec: mujoco.MjSpec, joint: str, friction: JointFriction) -> None:
    """Give a joint of an editable model its friction law.

    Raises:
        ConfigError: the model's joints carry user data of another kind.
    """
    target = spec.joint(joint)
    if any(_foreign(list(other.userdata)) for other in spec.joints):
        raise ConfigError(
            "the joints of the model carry user data that are not friction laws",
            hint="Remove the `user` attributes of the joints; trueup keeps friction there.",
        )
    spec.nuser_jnt = WIDTH
    target.userdata = [MARK, *astuple(friction)]
    if friction.stribeck or friction.load:
        target.frictionloss = max(float(target.frictionloss), _LEAST_FRICTIONLOSS)
    # The solver's copy of the friction rows per island is made before the callback runs.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)


def friction_of(spec: mujoco.MjSpec, joint: str) -> JointFriction:
    """The friction law that a joint of an editable model carries; all zero if none."""
    data = [float(value) for value in spec.joint(joint).userdata]
    if len(data) != WIDTH or data[0] != MARK:
        return JointFriction()
    return JointFriction(*data[1:])


def has_friction(model: mujoco.MjModel) -> bool:
    """Whether a compiled model needs the callback."""
    return bool(model.nuser_jnt == WIDTH and (model.jnt_user[:, 0] == MARK).any())


def install() -> None:
    """Let MuJoCo call the friction laws; models without one are left as they are.

    Raises:
        ConfigError: another `mjcb_control` is installed; MuJoCo has only one.
    """
    # Loading numba and compiling takes a second; models without such friction do not need it.
    from trueup.sim.friction_laws import callback

    installed = mujoco.get_mjcb_control()
    if installed is not None and installed is not callback()[0]:
        raise ConfigError(
            "another control callback is installed in MuJoCo",
            hint="Call mujoco.set_mjcb_control(None) before simulating a model with friction laws.",
        )
    if installed is None:
        mujoco.set_mjcb_control(callback()[0])


def _foreign(data: list[float]) -> bool:
    return any(data) and data[0] != MARK
