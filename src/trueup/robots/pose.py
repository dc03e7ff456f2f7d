"""Rigid motions, and where they are written in an editable model."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion: of points x, to `rotation x + position`.

    Attributes:
        position: [m].
        rotation: a quaternion w, x, y, z of length 1.
    """

    position: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    rotation: Float64[np.ndarray, "4"] = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))

    def __matmul__(self, other: Pose) -> Pose:
        """First the other one, then this one."""
        turned = np.empty(4)
        mujoco.mju_mulQuat(turned, self.rotation, other.rotation)
        return Pose(self.position + self.turn(other.position), turned)

    @property
    def is_none(self) -> bool:
        """Whether it moves nothing."""
        return not self.position.any() and np.array_equal(self.rotation, [1.0, 0.0, 0.0, 0.0])

    def inverse(self) -> Pose:
        """What undoes it."""
        back = self.rotation * [1.0, -1.0, -1.0, -1.0]
        return Pose(-Pose(rotation=back).turn(self.position), back)

    def turn(self, vector: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
        """A direction after the rotation."""
        out = np.empty(3)
        mujoco.mju_rotVecQuat(out, np.asarray(vector, np.float64), self.rotation)
        return out


def unit(quaternion: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "4"]:
    """A quaternion of length 1; that of no rotation for zeros, as MuJoCo has it."""
    length = float(np.linalg.norm(quaternion))
    return np.asarray(quaternion, np.float64) / length if length else np.array([1.0, 0.0, 0.0, 0.0])


def _own_pose(spec: mujoco.MjSpec, element: mujoco.MjsBody | mujoco.MjsFrame) -> Pose:
    """As it is written, against what it stands in."""
    kind = element.alt.type
    if kind == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        return Pose(np.array(element.pos), unit(np.array(element.quat)))
    compiler = element.compiler
    turned = spec.resolve_orientation(degree=compiler.degree, sequence=compiler.eulerseq, orientation=element.alt)
    return Pose(np.array(element.pos), np.array(turned))


def move(spec: mujoco.MjSpec, body: mujoco.MjsBody, moved: Pose) -> None:
    """Write a body's place where it is after this motion, which is in the axes that the body has before."""
    pose = _own_pose(spec, body) @ moved
    body.pos, body.quat = pose.position, pose.rotation
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def turn(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, turned: Pose) -> None:
    """Write a joint's axis and anchor in the axes that its body has after a motion behind the joint went before it."""
    frame, around = joint.frame, Pose()
    while frame is not None:
        around = _own_pose(spec, frame) @ around
        frame = frame.frame
    back = around.inverse() @ turned.inverse() @ around
    joint.axis = back.turn(np.array(joint.axis))
    joint.pos = back.turn(np.array(joint.pos)) + back.position
