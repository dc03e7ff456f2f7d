"""A compiled MuJoCo model as a Pinocchio model, for the regressor of its inverse dynamics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.errors import ConfigError, DataError, NameMismatch, needing
from trueup.identify.inertial import Inertial
from trueup.identify.regression.pseudo_inertia import PARAMETERS, Pose, parameters_of

_KINDS = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "JointModelRevoluteUnaligned",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "JointModelPrismaticUnaligned",
}


@dataclass(frozen=True, eq=False)
class LinkBody:
    """One body of a link.

    Attributes:
        name: of the body in MuJoCo.
        link: number of the link that it belongs to.
        pose: of the body's frame in the link's frame.
        nominal: what the model says about it.
    """

    name: str
    link: int
    pose: Pose
    nominal: Inertial


class Linkage:
    """A robot on a fixed base, as links that move against each other.

    A link is a body with joints together with all bodies that are welded to it. Its frame has the axes of that body
    and its origin on the anchor of the body's last joint, so that the names of parameters mean what they say about
    the joint: `forearm.my` is mass times y-distance from the elbow.

    Args:
        model: hinge and slide joints only. Bodies that are compensated for gravity must all be.
        joints: the joints that are looked at, in the order of the arrays; the others rest at their reference
            position. All joints of the model if None.

    Raises:
        ConfigError: a free or ball joint, partial gravity compensation, or nothing that moves.
        MissingDependency: Pinocchio is not installed.
        NameMismatch: the model lacks a joint.
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[str] | None = None) -> None:
        with needing("inverse-dynamics regression", "dynamics"):
            import pinocchio  # an optional dependency
        self._pin = pinocchio
        self.model = model
        every = tuple(model.joint(number).name for number in range(model.njnt))
        self.joints = tuple(joints) if joints is not None else every
        missing = [name for name in self.joints if name not in every]
        if missing or not self.joints:
            raise NameMismatch(
                f"joints {missing} are not in the model", left=self.joints, right=every, right_name="model has"
            )
        self.columns: Int[np.ndarray, "J"] = np.array([every.index(name) for name in self.joints])
        self.length_units = tuple("m" if model.jnt_type[number] == 2 else "rad" for number in self.columns)
        self._tree = self._pin.Model()
        self._tree.gravity.linear = _gravity(model)
        self.links: list[str] = []
        self.bodies: list[LinkBody] = []
        self._link_joints: list[int] = []
        self._build()
        self._memory = self._tree.createData()

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the 10 L inertial parameters, link by link, e.g. `forearm.m`, `forearm.Ixy`."""
        return tuple(f"{link}.{name}" for link in self.links for name in PARAMETERS)

    @property
    def nominal(self) -> Float64[np.ndarray, "P"]:
        """The inertial parameters of all links as the model has them."""
        total = np.zeros((len(self.links), len(PARAMETERS)))
        for body in self.bodies:
            total[body.link] += parameters_of(body.pose.carried(body.nominal.pseudo_inertia))
        return total.ravel()

    def regressor(
        self,
        position: Float[np.ndarray, "T J"],
        velocity: Float[np.ndarray, "T J"],
        acceleration: Float[np.ndarray, "T J"],
    ) -> Float64[np.ndarray, "T J P"]:
        """Y with Y p = the torques that move the links and carry their weight; no armature, friction or springs.

        Args:
            position: joint positions as in `qpos` [rad or m].
            velocity: [rad/s or m/s].
            acceleration: [rad/s^2 or m/s^2].

        Raises:
            DataError: a value is not finite.
        """
        states = [np.asarray(values, np.float64) for values in (position, velocity, acceleration)]
        if not all(np.all(np.isfinite(values)) for values in states):
            raise DataError("the state of an inverse dynamics has values that are not finite")
        full = np.zeros((3, len(position), self.model.nv))
        full[:, :, self.columns] = states
        full[0][:, self.columns] -= self.model.qpos0[self.columns]
        picked = (10 * (np.array(self._link_joints) - 1)[:, None] + np.arange(10)).ravel()
        index = np.ix_(self.columns, picked)
        result = np.empty((len(position), len(self.joints), picked.size))
        evaluate, tree, memory = self._pin.computeJointTorqueRegressor, self._tree, self._memory
        for row, (q, dq, ddq) in enumerate(zip(*full, strict=True)):
            result[row] = evaluate(tree, memory, q, dq, ddq)[index]
        return result

    def spring(self, position: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "T J"]:
        """Torque of the model's joint springs, which the motors need not bring up."""
        stiffness = self.model.jnt_stiffness[self.columns]
        return np.asarray(stiffness * (self.model.qpos_spring[self.columns] - position), np.float64)

    def sample_states(self, count: int, rng: np.random.Generator) -> Float64[np.ndarray, "3 count J"]:
        """Random positions within the joints' ranges, velocities and accelerations, for questions of structure."""
        ranges = self.model.jnt_range[self.columns]
        limited = self.model.jnt_limited[self.columns].astype(bool)
        widest = np.array([[-math.pi, math.pi] if unit == "rad" else [-0.5, 0.5] for unit in self.length_units])
        low, high = np.where(limited[:, None], ranges, widest).T
        shape = (count, len(self.joints))
        return np.stack([rng.uniform(low, high, shape), *(rng.standard_normal((2, *shape)) * 2.0)])

    def _build(self) -> None:
        model, pin = self.model, self._pin
        # body -> joint that moves it, pose of its frame in the frame of that joint, number of its link
        place: dict[int, tuple[int, Any, int]] = {0: (0, pin.SE3.Identity(), -1)}
        for body in range(1, model.nbody):
            joint, frame, link = place[int(model.body_parentid[body])]
            frame = frame * pin.SE3(_matrix(model.body_quat[body]), model.body_pos[body])
            first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            for number in range(first, first + count):
                joint = self._add_joint(number, joint, frame)
                frame = pin.SE3(np.eye(3), -model.jnt_pos[number])
            name = model.body(body).name or f"body{body}"
            if count:
                link = len(self.links)
                self.links.append(name)
                self._link_joints.append(joint)
            place[body] = (joint, frame, link)
            if link >= 0:
                rotation = _matrix(model.body_iquat[body])
                inertia = rotation @ np.diag(model.body_inertia[body]) @ rotation.T
                nominal = Inertial(float(model.body_mass[body]), model.body_ipos[body].copy(), inertia)
                pose = Pose(frame.rotation.copy(), frame.translation.copy())
                self.bodies.append(LinkBody(name, link, pose, nominal))
        if not self.links:
            raise ConfigError("nothing moves in this model: it has no joints")

    def _add_joint(self, number: int, parent: int, frame: Any) -> int:
        model, pin = self.model, self._pin
        kind = _KINDS.get(int(model.jnt_type[number]))
        name = model.joint(number).name
        if kind is None:
            raise ConfigError(
                f"joint {name!r} is neither a hinge nor a slide",
                hint="Inverse-dynamics regression is for robots on a fixed base.",
            )
        anchor = frame * pin.SE3(np.eye(3), model.jnt_pos[number])
        joint = getattr(pin, kind)(model.jnt_axis[number].copy())
        return int(self._tree.addJoint(parent, joint, anchor, name or f"joint{number}"))


def _gravity(model: mujoco.MjModel) -> Float64[np.ndarray, "3"]:
    """What the motors feel of it: nothing if all that moves is compensated."""
    moving = (model.body_weldid > 0) & (model.body_mass > 0)
    carried = model.body_gravcomp[moving] if model.ngravcomp else np.zeros(int(moving.sum()))
    if np.any(carried != 0.0) and not np.all(carried == 1.0):
        raise ConfigError(
            "gravity is compensated for some bodies only",
            got=sorted({float(value) for value in carried}),
            expected="gravcomp 0 for all, or 1 for all that move",
        )
    off = bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY) or bool(np.any(carried == 1.0))
    return np.zeros(3) if off else np.array(model.opt.gravity, np.float64)


def _matrix(quaternion: np.ndarray) -> Float64[np.ndarray, "3 3"]:
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)
