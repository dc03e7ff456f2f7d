"""Loads of joints and bodies of a rollout in DART, as MuJoCo's sensors have them (see `body_sensors`; SAT, IV-A)."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float64, Int

from trueup.robots import SimulationSpec
from trueup.sim.body_sensors import BODY_SIGNALS, body_wrench, matrices_of
from trueup.sim.dart_model import node_number, skeleton_of


class DartBlocks:
    """Takes motions apart by DART's own kinematics and inverse dynamics, at the accelerations of its steps.

    Args:
        model: compiled.
        dofs: degrees of freedom of the J joints.
        simulation: says whether loads are wanted, and which M bodies.
    """

    def __init__(self, model: mujoco.MjModel, dofs: Int[np.ndarray, "J"], simulation: SimulationSpec) -> None:
        numbers = [model.body(name).id for name in simulation.bodies]
        # What carries a weight does it through the joints, as in MuJoCo: loads and wrenches have all of it in them.
        self._skeleton: Any = skeleton_of(model, compensated=False)
        self._gravity = np.asarray(self._skeleton.getGravity(), np.float64)
        self._nodes = [self._skeleton.getBodyNode(node_number(model, number)) for number in numbers]
        self._mass, self._inertia = model.body_mass[numbers], model.body_inertia[numbers]
        self._inertial = matrices_of(model.body_iquat[numbers])
        self._dofs = dofs if simulation.load else dofs[:0]
        self._step_s = float(model.opt.timestep)

    def read(
        self, position: Float64[np.ndarray, "B N1 V"], velocity: Float64[np.ndarray, "B N1 V"]
    ) -> tuple[dict[str, Float64[np.ndarray, "B N1 J"]], dict[str, Float64[np.ndarray, "B N1 M ..."]]]:
        """`load` and `BODY_SIGNALS` of B motions, as far as they are wanted; the last row repeats the one before.

        Args:
            position: of all V coordinates, (B, N + 1, V).
            velocity: likewise.
        """
        count, rows, _ = position.shape
        load, rotation = np.empty((count, rows, self._dofs.size)), np.empty((count, rows, len(self._nodes), 3, 3))
        vectors = np.empty((5, count, rows, len(self._nodes), 3))
        acceleration = np.diff(velocity, axis=1) / self._step_s
        for motion, row in np.ndindex(count, rows - 1):
            self._skeleton.setPositions(position[motion, row])
            self._skeleton.setVelocities(velocity[motion, row])
            self._skeleton.setAccelerations(acceleration[motion, row])
            if self._dofs.size:
                # With neither outer forces, dampers nor springs: the last two are among what drives a joint.
                self._skeleton.computeInverseDynamics(False, False, False)  # noqa: FBT003
                load[motion, row] = self._skeleton.getForces()[self._dofs]
            for column, node in enumerate(self._nodes):
                vectors[:, motion, row, column] = _moving(node)
                rotation[motion, row, column] = node.getWorldTransform().rotation()
        for values in (load, rotation, *vectors):
            values[:, -1] = values[:, -2]
        place, speed, spin, pull, turning = vectors
        wrench = body_wrench(
            self._mass, self._inertia, rotation @ self._inertial, felt=pull - self._gravity, spin=spin, turning=turning
        )
        bodies = dict(zip(BODY_SIGNALS, (place, rotation, speed, spin, *wrench), strict=True))
        return {"load": load} if self._dofs.size else {}, bodies if self._nodes else {}


def _moving(node: Any) -> Float64[np.ndarray, "5 3"]:
    """Place and velocity of a body's frame, angular velocity, acceleration of its center of mass, angular one."""
    return np.stack(
        [
            np.ravel(node.getWorldTransform().translation()),
            np.ravel(node.getLinearVelocity()),
            np.ravel(node.getAngularVelocity()),
            np.ravel(node.getCOMLinearAcceleration()),
            np.ravel(node.getAngularAcceleration()),
        ]
    )
