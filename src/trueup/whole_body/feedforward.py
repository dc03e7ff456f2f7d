"""A compensator that needs no training: the weight of arms and payload, as the stock model has it, fed forward."""

from __future__ import annotations

import mujoco
import numpy as np

from trueup.robots import find_model, load_robot
from trueup.robots.model import compile_spec, load_spec
from trueup.sim.payload import attach_payload
from trueup.whole_body.bodies import Arms
from trueup.whole_body.model import ROBOT


class GravityFeedForward:
    """Targets moved by what gravity takes: `target + weight(target) / kp`, for a waist that is upright.

    A PD with gain `kp` then carries arms and payload where the target is, up to friction, springs, delay, and what the
    model does not know of the individual.

    Args:
        arms: whether the arms' own weight too; else they hang as with empty hands.
    """

    def __init__(self, *, arms: bool = True) -> None:
        self._arms = arms
        self._robot = load_robot(ROBOT)
        names = self._robot.joint_names
        self._gains = np.array([self._robot.controller.gain("kp", name) for name in names])
        self._models: dict[float, tuple[mujoco.MjModel, mujoco.MjData, np.ndarray, np.ndarray]] = {}

    def __call__(self, position: Arms, velocity: Arms, target: Arms, payload_kg: float) -> Arms:  # noqa: ARG002 - feed-forward
        """The target to send instead [rad]."""
        weight = self._weight(target, payload_kg)
        if not self._arms:
            weight = weight - self._weight(target, 0.0)
        return np.asarray(target + weight / self._gains)

    def _weight(self, pose: Arms, payload_kg: float) -> Arms:
        """Torques that hold arms and payload in a pose [Nm]."""
        if payload_kg not in self._models:
            self._models[payload_kg] = self._loaded(payload_kg)
        model, data, places, freedoms = self._models[payload_kg]
        data.qpos[places] = pose
        mujoco.mj_forward(model, data)
        return np.asarray(data.qfrc_bias[freedoms])

    def _loaded(self, payload_kg: float) -> tuple[mujoco.MjModel, mujoco.MjData, np.ndarray, np.ndarray]:
        path = find_model(self._robot)
        spec = load_spec(path)
        attach_payload(spec, self._robot, payload_kg)
        model = compile_spec(spec, path)
        joints = [model.joint(name).id for name in self._robot.joint_names]
        return model, mujoco.MjData(model), model.jnt_qposadr[joints], model.jnt_dofadr[joints]
