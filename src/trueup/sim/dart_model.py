"""A compiled MuJoCo model as a DART skeleton: the very same bodies, joints and numbers, read by both engines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, how_to_install
from trueup.robots.model import gravity_of

_OFF = mujoco.mjtDisableBit
# DART warns of bodies without mass and inertia [kg, kg m2].
_NOTHING = 1e-15
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def load_dart() -> Any:
    """The module `dartpy`.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        import dartpy
    except ImportError as error:
        raise ConfigError("the engine DART is not installed", got=str(error), hint=how_to_install("dart")) from error
    return dartpy


def refuse_unmatched(model: mujoco.MjModel) -> None:
    """Refuse a model of which DART would simulate something else than MuJoCo.

    Raises:
        ConfigError: it names everything that cannot be matched.
    """
    on = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    flags = int(model.opt.disableflags)
    found = {
        "joints other than hinges and slides": not np.isin(model.jnt_type, (_HINGE, _SLIDE)).all(),
        "contacts (simulation.contacts: false leaves them out)": on.size > 1 and not flags & int(_OFF.mjDSBL_CONTACT),
        "equality constraints": model.neq > 0
        and bool(model.eq_active0.any())
        and not flags & int(_OFF.mjDSBL_EQUALITY),
        "tendons": model.ntendon > 0,
        "flexible bodies": model.nflex > 0,
        "a medium (density, viscosity)": model.opt.density > 0 or model.opt.viscosity > 0,
        "mocap bodies": bool((model.body_mocapid >= 0).any()),
        "body plugins": bool((model.body_plugin >= 0).any()),
        "damping or stiffness that is not linear": bool(model.dof_dampingpoly.any() or model.jnt_stiffnesspoly.any()),
        "joints whose actuators carry the weight (actuatorgravcomp)": bool(model.jnt_actgravcomp.any()),
        "actuation switched off": bool(flags & int(_OFF.mjDSBL_ACTUATION)),
        "gravcomp outside 0..1": bool(((model.body_gravcomp < 0) | (model.body_gravcomp > 1)).any()),
    }
    unmatched = [name for name, there in found.items() if there]
    if unmatched:
        raise ConfigError(
            "DART cannot simulate this model as MuJoCo does",
            got=", ".join(unmatched),
            hint="Leave these out of the model, or stay with the engine mujoco.",
        )


@dataclass(frozen=True)
class JointNumbers:
    """What the step needs of each of the V joints, in the order of both engines.

    Attributes:
        damping: (V,) [Nm s/rad].
        armature: (V,) [kg m2].
        frictionloss: (V,) [Nm].
    """

    damping: Float64[np.ndarray, "V"]
    armature: Float64[np.ndarray, "V"]
    frictionloss: Float64[np.ndarray, "V"]

    @staticmethod
    def of(model: mujoco.MjModel) -> JointNumbers:
        """Those of a model; what its options switch off is zero."""
        return JointNumbers(
            damping=model.dof_damping * _kept(model, _OFF.mjDSBL_DAMPER),
            armature=model.dof_armature.copy(),
            frictionloss=model.dof_frictionloss
            * (_kept(model, _OFF.mjDSBL_FRICTIONLOSS) and _kept(model, _OFF.mjDSBL_CONSTRAINT)),
        )


def skeleton_of(model: mujoco.MjModel, *, compensated: bool = True) -> Any:
    """A DART skeleton with the bodies and joints of a compiled model, in its pose of all zeros, at rest.

    Joint k of the skeleton is degree of freedom k of the model, with the same zero, sign and unit. Springs and limits
    are set; damping, armature and friction are not, since how they act depends on the time step (see `DartSimulator`).
    Limits are hard in DART and soft in MuJoCo.

    Args:
        model: compiled, see `refuse_unmatched`.
        compensated: whether `gravcomp` carries weight; DART only knows a weight or none, so that a share of it
            becomes a body of that share.
    """
    dart = load_dart()
    skeleton = dart.dynamics.Skeleton(str(model.body(0).name or "model"))
    bodies: dict[int, Any] = {0: None}
    for body in range(1, model.nbody):
        bodies[body] = _add_body(dart, skeleton, model, body, bodies[int(model.body_parentid[body])], compensated)
    skeleton.setGravity(gravity_of(model))
    return skeleton


def node_number(model: mujoco.MjModel, body: int) -> int:
    """Which body node of a skeleton that is not compensated is this body of the model: one node per joint before it."""
    return int(np.maximum(model.body_jntnum[1 : body + 1], 1).sum()) - 1


def _add_body(dart: Any, skeleton: Any, model: mujoco.MjModel, body: int, parent: Any, compensated: bool) -> Any:  # noqa: FBT001
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    frame = _frame(model.body_pos[body], model.body_quat[body])
    node = parent
    for joint in range(first, first + count):
        dof = int(model.jnt_dofadr[joint])
        hinge = int(model.jnt_type[joint]) == _HINGE
        make = skeleton.createRevoluteJointAndBodyNodePair if hinge else skeleton.createPrismaticJointAndBodyNodePair
        link, node = make() if node is None else make(node)
        link.setName(model.joint(joint).name or f"joint{joint}")
        anchor = np.eye(4)
        anchor[:3, 3] = model.jnt_pos[joint]
        # qpos0 is the position at which the body is where its frame says.
        start = _motion(model.jnt_axis[joint], -float(model.qpos0[model.jnt_qposadr[joint]]), hinge=hinge)
        link.setTransformFromParentBodyNode(dart.math.Isometry3(frame @ anchor @ start))
        link.setTransformFromChildBodyNode(dart.math.Isometry3(anchor))
        link.setAxis(model.jnt_axis[joint])
        if _kept(model, _OFF.mjDSBL_SPRING):
            link.setSpringStiffness(0, float(model.jnt_stiffness[joint]))
            link.setRestPosition(0, float(model.qpos_spring[model.jnt_qposadr[joint]]))
        if model.jnt_limited[joint] and _kept(model, _OFF.mjDSBL_LIMIT) and _kept(model, _OFF.mjDSBL_CONSTRAINT):
            low, high = model.jnt_range[joint]
            link.setPositionLowerLimit(0, float(low))
            link.setPositionUpperLimit(0, float(high))
            link.setLimitEnforcement(True)
        assert link.getIndexInSkeleton(0) == dof
        frame = np.eye(4)
        # All joints of a body turn the same body; those before the last one move nothing of their own.
        node.setInertia(_inertia(dart, model, body, share=0.0))
    if not count:
        make = skeleton.createWeldJointAndBodyNodePair
        link, node = make() if node is None else make(node)
        link.setTransformFromParentBodyNode(dart.math.Isometry3(frame))
    node.setName(model.body(body).name or f"body{body}")
    carried = float(model.body_gravcomp[body]) if compensated else 0.0
    node.setInertia(_inertia(dart, model, body, share=1.0 if carried in (0.0, 1.0) else 1.0 - carried))
    node.setGravityMode(carried != 1.0)
    if carried not in (0.0, 1.0):
        _, part = skeleton.createWeldJointAndBodyNodePair(node)
        part.setInertia(_inertia(dart, model, body, share=carried))
        part.setGravityMode(False)
    return node


def _inertia(dart: Any, model: mujoco.MjModel, body: int, *, share: float) -> Any:
    turn = _rotation(model.body_iquat[body])
    moment = turn @ np.diag(np.maximum(share * model.body_inertia[body], _NOTHING)) @ turn.T
    return dart.dynamics.Inertia(max(share * float(model.body_mass[body]), _NOTHING), model.body_ipos[body], moment)


def _motion(axis: Float64[np.ndarray, "3"], value: float, *, hinge: bool) -> Float64[np.ndarray, "4 4"]:
    if not hinge:
        return _frame(value * axis, np.array([1.0, 0.0, 0.0, 0.0]))
    quat = np.empty(4)
    mujoco.mju_axisAngle2Quat(quat, axis, value)
    return _frame(np.zeros(3), quat)


def _frame(pos: Float64[np.ndarray, "3"], quat: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "4 4"]:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = _rotation(quat), pos
    return frame


def _rotation(quat: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "3 3"]:
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quat)
    return flat.reshape(3, 3)


def _kept(model: mujoco.MjModel, bit: Any) -> bool:
    return not int(model.opt.disableflags) & int(bit)
