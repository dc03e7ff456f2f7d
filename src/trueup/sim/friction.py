"""Friction laws beyond MuJoCo's own, inside the engine: compiled callbacks, no Python per step.

The numbers of a joint live in the model itself, as the joint's user data (`<joint user="…">`): a model file carries
its friction, every candidate of a fit has its own, and copies, rollouts and batches need nothing else. MuJoCo calls
`mjcb_control` when positions, velocities and `qfrc_bias` of a step are known and forces are not: there, the friction
is written into the friction rows of the constraint solver. A row holds a joint or brakes it, and never drives it:
however steep a law is, however coarse the time step, it cannot make an arm shake. What is no friction (dead band,
static threshold, the direction-dependent part of `damping`) goes into the passive forces, in `mjcb_passive`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple

import mujoco

from trueup.errors import ConfigError
from trueup.robots import JointFriction
from trueup.robots.friction import LEAST_WIDTH, MARK, WIDTH

# MuJoCo makes a friction row only for joints with some frictionloss.
_LEAST_FRICTIONLOSS = 1e-6
# Rows so hard that they may stop a joint within a step. MuJoCo's default takes some 10 ms and creeps; in that time
# friction would push a joint on that its load brakes faster. The time constant is cut off at two steps by MuJoCo.
_SOLREF, _SOLIMP = 1e-5, 0.9999
_ITERATIONS, _LINE_SEARCHES = 100, 50


def set_friction(spec: mujoco.MjSpec, joint: str, friction: JointFriction) -> None:
    """Give a joint of an editable model its friction law.

    Friction is made hard by that (`solreffriction`, `solimpfriction`, at least 100 solver iterations), and the model's
    constraint islands are switched off.

    Raises:
        ConfigError: there is no such joint, or the model's joints carry user data of another kind, or a dead band or
            static threshold is meant for an actuator that is a plugin, whose torque nobody else knows.
    """
    target = _joint(spec, joint)
    if any(_foreign(list(other.userdata)) for other in spec.joints):
        raise ConfigError(
            "the joints of the model carry user data that are not friction laws",
            hint="Remove the `user` attributes of the joints; trueup keeps friction there.",
        )
    if friction.dead_band or friction.static_positive or friction.static_negative:
        for actuator in spec.actuators:
            if actuator.target == joint and actuator.plugin.active:
                raise ConfigError(
                    f"friction of joint {joint!r}: dead_band and static_… need an actuator of MuJoCo's own",
                    got=f"the plugin of {actuator.name!r}",
                    hint="Take another controller kind than pid, or leave these out.",
                )
    if spec.nuser_jnt != WIDTH:
        spec.nuser_jnt = WIDTH
        for other in spec.joints:  # MuJoCo would fill them up with zeros, which are not what a missing number means
            if any(other.userdata):
                other.userdata = [MARK, *astuple(friction_of(spec, other.name))]
    target.userdata = [MARK, *astuple(friction)]
    if friction.on:
        target.frictionloss = max(float(target.frictionloss), _LEAST_FRICTIONLOSS)
    if friction.on or friction.asymmetry:
        harden_friction(spec, [joint])
    # The solver's copy of the friction rows per island is made before the callback runs.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)


def harden_friction(spec: mujoco.MjSpec, joints: Iterable[str]) -> None:
    """Let the constraint solver hold dry friction of these joints as if it were rigid.

    MuJoCo's default is soft: a joint creeps under a load that it should hold, and standing errors disappear that a
    robot has. Hard rows need enough solver iterations, or they creep again.
    """
    for name in joints:
        target = _joint(spec, name)
        target.solref_friction = [_SOLREF, 1.0]
        target.solimp_friction[:2] = [_SOLIMP, _SOLIMP]
    spec.option.iterations = max(int(spec.option.iterations), _ITERATIONS)
    spec.option.ls_iterations = max(int(spec.option.ls_iterations), _LINE_SEARCHES)


def friction_of(spec: mujoco.MjSpec, joint: str) -> JointFriction:
    """The friction law that a joint of an editable model carries; all zero if none.

    Raises:
        ConfigError: there is no such joint, or its numbers make no friction law.
    """
    data = [float(value) for value in _joint(spec, joint).userdata]
    if not data or data[0] != MARK:
        return JointFriction()
    _refuse_other_width(len(data))
    return JointFriction(*data[1:])


def has_friction(model: mujoco.MjModel) -> bool:
    """Whether a compiled model needs the callbacks.

    Raises:
        ConfigError: its friction laws have numbers that this release does not know.
    """
    if model.nuser_jnt == 0 or not (model.jnt_user[:, 0] == MARK).any():
        return False
    _refuse_other_width(model.nuser_jnt)
    return True


def install() -> None:
    """Let MuJoCo call the friction laws; models without one are left as they are.

    Raises:
        ConfigError: another `mjcb_control` or `mjcb_passive` is installed; MuJoCo has only one of each.
    """
    # Loading numba and compiling takes a second; models without such friction do not need it.
    from trueup.sim.friction_laws import callbacks

    rows, forces, _ = callbacks()
    for name, own, installed in (
        ("mjcb_control", rows, mujoco.get_mjcb_control()),
        ("mjcb_passive", forces, mujoco.get_mjcb_passive()),
    ):
        if installed is not None and installed is not own:
            raise ConfigError(
                f"another callback, {name}, is installed in MuJoCo",
                hint=f"Call mujoco.set_{name}(None) before simulating a model with friction laws.",
            )
    mujoco.set_mjcb_control(rows)
    mujoco.set_mjcb_passive(forces)


def _joint(spec: mujoco.MjSpec, name: str) -> mujoco.MjsJoint:
    found = spec.joint(name)
    if found is None:
        raise ConfigError(f"the model has no joint {name!r}", available=[joint.name for joint in spec.joints])
    return found


def _refuse_other_width(width: int) -> None:
    if not LEAST_WIDTH <= width <= WIDTH:
        raise ConfigError(
            "the model's friction laws were written by another release of trueup",
            got=f"{width - 1} numbers",
            expected=f"{LEAST_WIDTH - 1} to {WIDTH - 1}",
        )


def _foreign(data: list[float]) -> bool:
    return any(data) and data[0] != MARK
