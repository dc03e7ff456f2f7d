"""What a model says about a measured motion: the torques that it takes."""

from __future__ import annotations

import copy
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.robots import RobotSpec, Setup
from trueup.robots.model import gravity_of, load_spec
from trueup.sim import MujocoSimulator

_ANYWHERE = 1e3
_LITTLE = 1e-4


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
        damping: torque per velocity, against it, that the actuators and the joint's viscous friction make, (J,).
        compensated: whether something else than the drives carries weights.
        end_body: name of the body of the deepest joint.
        end_site: a site there, or the first that carries a payload; empty without.
        limits: range of each joint, infinite without, (J, 2).
    """

    def __init__(self, robot: RobotSpec, path: Path, *, payload_kg: float = 0.0) -> None:
        self.simulator = MujocoSimulator.from_spec(load_spec(path), robot, origin=path, setup=Setup(payload_kg))
        self._qpos, self._qvel = self.simulator.places
        model = self.simulator.model
        self.sure = model.nv == len(robot.joints) and model.neq == 0 and not robot.simulation.base_sensor
        self.gravity = gravity_of(model)
        self.stiffness, self.damping = _gains(self.simulator)
        self._bare = _without_losses(copy.copy(model))
        self._data = mujoco.MjData(self._bare)
        self._compensation = np.array(self._bare.body_gravcomp)
        depths = [_depth(model, int(model.jnt_bodyid[model.joint(name).id])) for name in robot.joint_names]
        self._end = int(model.jnt_bodyid[model.joint(robot.joint_names[int(np.argmax(depths))]).id])
        self._end_kg = float(model.body_mass[self._end])
        self.end_body = model.body(self._end).name
        sites = [model.site(number).name for number in np.flatnonzero(model.site_bodyid == self._end)]
        self.end_site = robot.payload.sites[0] if robot.payload else next((name for name in sites if name), "")
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
        end_mass_kg: float = 0.0,
    ) -> Float64[np.ndarray, "N J"]:
        """Torques of the joints along a motion [Nm or N].

        Args:
            position: of the joints.
            velocity: zero if None.
            acceleration: zero if None.
            gravity: the model's if None [m/s2].
            end_mass_kg: more at the center of mass of the last body.
            uncompensated: nothing else carries the weight, whatever the model says.
        """
        model, data = self._bare, self._data
        model.opt.gravity[:] = self.gravity if gravity is None else gravity
        model.body_gravcomp[:] = 0.0 if uncompensated else self._compensation
        model.body_mass[self._end] = self._end_kg + end_mass_kg
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


def _depth(model: mujoco.MjModel, body: int) -> int:
    depth = 0
    while body:
        body, depth = int(model.body_parentid[body]), depth + 1
    return depth


def _gains(simulator: MujocoSimulator) -> tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "J"]]:
    """Torque per command [Nm/rad, Nm s/rad or 1] and per velocity [Nm s/rad] of each joint; NaN where unknown."""
    model = simulator.model
    data = mujoco.MjData(model)
    _, dofs = simulator.places
    signal = simulator.command_signals[0]
    stiffness, damping = (np.full(len(simulator.joints), np.nan) for _ in range(2))

    def acting(what: str, index: int, dof: int) -> float:
        mujoco.mj_resetData(model, data)
        getattr(data, what)[index] = _LITTLE
        mujoco.mj_forward(model, data)
        return float(data.qfrc_actuator[dof] + data.qfrc_damper[dof])

    for channel in simulator.channels:
        actuator = model.actuator(channel.actuator).id
        if channel.signal != signal or model.actuator_plugin[actuator] >= 0 or model.actuator_dyntype[actuator] != 0:
            continue
        joint = simulator.joints.index(channel.joint)
        dof = int(dofs[joint])
        address = int(model.actuator_ctrladr[actuator])
        base = acting("ctrl", address, dof)
        mujoco.mj_resetData(model, data)
        mujoco.mj_forward(model, data)
        rest = float(data.qfrc_actuator[dof] + data.qfrc_damper[dof])
        stiffness[joint] = (base - rest) / _LITTLE
        damping[joint] = max(0.0, (rest - acting("qvel", dof, dof)) / _LITTLE)
    return np.where(stiffness > 0, stiffness, np.nan), damping
