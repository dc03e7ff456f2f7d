"""What a model says about a measured motion: the torques that it takes."""

from __future__ import annotations

import copy
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.robots import RobotSpec
from trueup.robots.model import gravity_of, load_spec
from trueup.sim import MujocoSimulator, attach_payload

_ANYWHERE = 1e3


class Dynamics:
    """Inverse dynamics of a robot's model, without friction, damping and limits.

    Args:
        robot: its description.
        path: MJCF or URDF.
        payload_kg: what it carries [kg].

    Attributes:
        simulator: of the whole model.
        sure: whether the controlled joints say how everything moves; not with a free base, passive joints or loops.
        gravity: of the model [m/s2].
        stiffness: torque per command of each joint's actuators; NaN where it cannot be told, (J,).
        compensated: whether something else than the drives carries weights.
        limits: range of each joint, infinite without, (J, 2).
    """

    def __init__(self, robot: RobotSpec, path: Path, *, payload_kg: float = 0.0) -> None:
        spec = load_spec(path)
        attach_payload(spec, robot, payload_kg)
        self.simulator = MujocoSimulator.from_spec(spec, robot, origin=path)
        self._qpos, self._qvel = self.simulator.places
        model = self.simulator.model
        self.sure = model.nv == len(robot.joints) and model.neq == 0 and not robot.simulation.base_sensor
        self.gravity = gravity_of(model)
        self.stiffness = _stiffness(self.simulator)
        self._bare = _without_losses(copy.copy(model))
        self._data = mujoco.MjData(self._bare)
        self._compensation = np.array(self._bare.body_gravcomp)
        self.compensated = bool(self._compensation.any())
        self.limits = self._limits(robot)

    def torque(
        self,
        position: Float64[np.ndarray, "N J"],
        velocity: Float64[np.ndarray, "N J"] | None = None,
        acceleration: Float64[np.ndarray, "N J"] | None = None,
        *,
        gravity: Float64[np.ndarray, "3"] | None = None,
        uncompensated: bool = False,
    ) -> Float64[np.ndarray, "N J"]:
        """Torques of the joints along a motion [Nm or N].

        Args:
            position: of the joints.
            velocity: zero if None.
            acceleration: zero if None.
            gravity: the model's if None [m/s2].
            uncompensated: nothing else carries the weight, whatever the model says.
        """
        model, data = self._bare, self._data
        model.opt.gravity[:] = self.gravity if gravity is None else gravity
        model.body_gravcomp[:] = 0.0 if uncompensated else self._compensation
        mujoco.mj_resetData(model, data)
        out = np.empty_like(position)
        qpos, qvel = self._qpos, self._qvel
        for row, pose in enumerate(np.clip(position, -_ANYWHERE, _ANYWHERE)):
            data.qpos[qpos] = pose
            if velocity is not None:
                data.qvel[qvel] = velocity[row]
            if acceleration is not None:
                data.qacc[qvel] = acceleration[row]
            mujoco.mj_inverse(model, data)
            out[row] = data.qfrc_inverse[qvel]
        return out

    def _limits(self, robot: RobotSpec) -> Float64[np.ndarray, "J 2"]:
        known = self.simulator.position_limits
        return np.array([known.get(name, (-np.inf, np.inf)) for name in robot.joint_names])


def _without_losses(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model without friction, damping, limits and contacts; in place."""
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    model.dof_damping[:] = 0.0
    model.jnt_user[:] = 0.0  # friction laws stand there
    return model


def _stiffness(simulator: MujocoSimulator) -> Float64[np.ndarray, "J"]:
    """Torque per command of each joint's actuators [Nm/rad, Nm s/rad or 1]; NaN where it cannot be told."""
    model = simulator.model
    data = mujoco.MjData(model)
    _, dofs = simulator.places
    found = np.full(len(simulator.joints), np.nan)
    mujoco.mj_forward(model, data)
    base = data.qfrc_actuator.copy()
    signal = simulator.command_signals[0]
    for channel in simulator.channels:
        actuator = model.actuator(channel.actuator).id
        if channel.signal != signal or model.actuator_plugin[actuator] >= 0 or model.actuator_dyntype[actuator] != 0:
            continue
        mujoco.mj_resetData(model, data)
        data.ctrl[model.actuator_ctrladr[actuator]] = 1e-4
        mujoco.mj_forward(model, data)
        joint = simulator.joints.index(channel.joint)
        found[joint] = (data.qfrc_actuator[dofs[joint]] - base[dofs[joint]]) / 1e-4
    return np.where(found > 0, found, np.nan)
