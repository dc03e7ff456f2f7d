"""A simulated motion taken apart: each body with the wrench on it, each joint with the load it drives (SAT, IV-A).

MuJoCo simulates in joint coordinates; what holds the bodies together is worked out again from the states of a rollout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import DataError, NameMismatch

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


@dataclass(frozen=True, eq=False)
class Bodies:
    """B rigid bodies over T samples, in the axes of the world.

    Attributes:
        names: of the bodies.
        position_m: of the centers of mass, (T, B, 3).
        rotation: of the bodies' frames, (T, B, 3, 3).
        velocity_m_s: of the centers of mass, (T, B, 3).
        angular_velocity_rad_s: (T, B, 3).
        force_n: what everything but gravity does to a body: joints, actuators, constraints, contacts, (T, B, 3).
        torque_nm: the same, about the center of mass, (T, B, 3).
    """

    names: tuple[str, ...]
    position_m: Float64[np.ndarray, "T B 3"]
    rotation: Float64[np.ndarray, "T B 3 3"]
    velocity_m_s: Float64[np.ndarray, "T B 3"]
    angular_velocity_rad_s: Float64[np.ndarray, "T B 3"]
    force_n: Float64[np.ndarray, "T B 3"]
    torque_nm: Float64[np.ndarray, "T B 3"]


@dataclass(frozen=True, eq=False)
class Blocks:
    """The building blocks of a motion.

    Attributes:
        bodies: with the wrenches on them.
        joints: names of J hinges and slides.
        load: what each joint gives on to the parts that it moves, along its axis: the torque of its motor without what
            friction and the motor's own inertia take, (T, J) [Nm or N].
    """

    bodies: Bodies
    joints: tuple[str, ...]
    load: Float64[np.ndarray, "T J"]


def blocks_of(
    model: mujoco.MjModel,
    states: Float64[np.ndarray, "T S"],
    controls: Float64[np.ndarray, "N U"],
    *,
    bodies: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
) -> Blocks:
    """Take a rollout apart.

    A joint's load is the part of the wrench between a body and its parent that points along the joint's axis; a wrench
    is the difference between what a body gets from its parent and what it gives on to its children, with contacts and
    closed chains added where they act.

    Args:
        model: that was simulated.
        states: full physics states before each step, (T, S).
        controls: of the actuators during the step, (T, U).
        bodies: those that are wanted; all that can move if None.
        joints: those that are wanted; all hinges and slides if None.

    Raises:
        DataError: states or controls are of another model, or nothing moves.
        NameMismatch: there is no such body or joint.
    """
    size = mujoco.mj_stateSize(model, _STATE)
    if states.shape[1] != size or controls.shape != (len(states), model.nu):
        raise DataError(
            "these states are of another model",
            got=f"states {states.shape}, controls {controls.shape}",
            expected=f"(T, {size}) and (T, {model.nu})",
        )
    movable = [model.body(number).name for number in range(1, model.nbody) if model.body_weldid[number] != 0]
    # A body that is welded to its parent moves with it; what the two do to each other is of no motion.
    if not movable:
        raise DataError("nothing moves in this model", hint="A model without joints has no building blocks.")
    chosen = _chosen("bodies", movable, bodies)
    axes = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    turning = [model.joint(number).name for number in range(model.njnt) if int(model.jnt_type[number]) in axes]
    driven = _chosen("joints", turning, joints)
    numbers = np.array([model.body(name).id for name in chosen], int)
    dofs = np.array([model.jnt_dofadr[model.joint(name).id] for name in driven], int)
    data, count = mujoco.MjData(model), len(states)
    vectors = np.empty((5, count, numbers.size, 3))
    rotation, load = np.empty((count, numbers.size, 3, 3)), np.empty((count, dofs.size))
    twist = np.empty(6)
    for row in range(count):
        mujoco.mj_setState(model, data, states[row], _STATE)
        data.ctrl[:] = controls[row]
        mujoco.mj_forward(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        net = data.cfrc_int + data.cfrc_ext
        np.subtract.at(net, model.body_parentid[1:], data.cfrc_int[1:])
        # Spatial vectors of a tree are about the tree's center of mass, torque first.
        lever = data.xipos - data.subtree_com[model.body_rootid]
        vectors[0, row] = data.xipos[numbers]
        for place, number in enumerate(numbers):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, int(number), twist, 0)
            vectors[2, row, place], vectors[1, row, place] = twist[:3], twist[3:]
        vectors[3, row] = net[numbers, 3:]
        vectors[4, row] = (net[:, :3] - np.cross(lever, net[:, 3:]))[numbers]
        rotation[row] = data.xmat[numbers].reshape(-1, 3, 3)
        load[row] = (data.cdof[dofs] * data.cfrc_int[model.dof_bodyid[dofs]]).sum(axis=1)
    return Blocks(Bodies(tuple(chosen), vectors[0], rotation, *vectors[1:]), tuple(driven), load)


def _chosen(what: str, known: Sequence[str], asked: Sequence[str] | None) -> list[str]:
    missing = [name for name in asked or () if name not in known]
    if missing:
        raise NameMismatch(
            f"the model has no movable {what} {missing}", left=asked or (), right=known, left_name="asked for"
        )
    return list(known if asked is None else asked)
