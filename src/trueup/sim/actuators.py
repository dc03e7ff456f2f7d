"""MuJoCo's actuators as plain arithmetic, for engines that have none: the same gains, limits and saturation."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Bool, Float64, Int

from trueup.errors import ConfigError
from trueup.robots import JointFriction, RobotSpec

_NONE, _INTEGRATOR = int(mujoco.mjtDyn.mjDYN_NONE), int(mujoco.mjtDyn.mjDYN_INTEGRATOR)


@dataclass(frozen=True)
class JointTorque:
    """What the actuators do in one step, for B copies and V joints.

    Attributes:
        asked: torque of the actuators as MuJoCo's sensor reports it, (B, V) [Nm or N].
        given: the part of it that reaches the joint: dead band and static threshold taken off, (B, V).
        damping: how much of `given` is a viscous brake that the step may take implicitly, (B, V) [Nm s/rad]; zero
            where a limit holds.
    """

    asked: Float64[np.ndarray, "B V"]
    given: Float64[np.ndarray, "B V"]
    damping: Float64[np.ndarray, "B V"]


class Actuators:
    """The actuators of a compiled model that act on joints: affine ones, integrators, and the PID of a robot.yaml.

    Args:
        model: compiled.
        robot: its description; gains of a PID are taken from here.
        laws: degree of freedom -> friction law, of which dead band and static thresholds are used.

    Raises:
        ConfigError: an actuator is of another kind.
    """

    def __init__(self, model: mujoco.MjModel, robot: RobotSpec, laws: dict[int, JointFriction]) -> None:
        _refuse_others(model, robot)
        count, self._joints = int(model.nactuator), int(model.nv)
        rows = range(count)
        targets = model.actuator_trnid[:, 0]
        self._dof: Int[np.ndarray, "A"] = model.jnt_dofadr[targets]
        # Row k says which joint actuator k turns.
        self._onto = np.zeros((count, self._joints))
        self._gear = np.array([float(model.actuator_gear[model.actuator_outadr[row], 0]) for row in rows])
        self._onto[rows, self._dof] = self._gear
        affine = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
        self._gain = model.actuator_gainprm[:, 0].copy()
        bias = np.where(affine[:, None], model.actuator_biasprm[:, :3], 0.0)
        self._input: Int[np.ndarray, "A"] = model.actuator_ctrladr.copy()
        clamped = model.actuator_ctrllimited.astype(bool)[self._input]
        if int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL):
            clamped[:] = False
        self._clamp = _range(clamped, model.actuator_ctrlrange[self._input])
        self._limit = _range(model.actuator_forcelimited.astype(bool), model.actuator_forcerange)
        # A joint without actuators of its own has no limit to keep.
        limits = np.full((2, self._joints), np.inf) * np.array([[-1.0], [1.0]])
        for joint in range(model.njnt):
            if model.jnt_actfrclimited[joint]:
                limits[:, model.jnt_dofadr[joint]] = model.jnt_actfrcrange[joint]
        self._joint_limit = limits
        self._offset, self._by_length, self._by_speed = bias.T.copy()
        # Per position, the state at which a servo asks for no torque.
        self._hold = -self._by_length * self._gear / np.where(self._gain == 0.0, np.inf, self._gain)
        self._integrates: Bool[np.ndarray, "A"] = model.actuator_dyntype == _INTEGRATOR
        self._step_s = float(model.opt.timestep)
        self._pid(model, robot)
        chosen = [laws.get(int(dof), JointFriction()) for dof in self._dof]
        self._band = np.abs(self._gear) * [law.dead_band for law in chosen]
        self._still = np.array([[-law.static_negative, law.static_positive] for law in chosen]).reshape(-1, 2).T
        self._still_velocity = np.array([law.static_velocity for law in chosen])
        # What is not there costs nothing in a step.
        self._clamps = bool(clamped.any())
        self._direct = bool((self._gear == 1.0).all())
        self._integrating, self._plugins = bool(self._integrates.any()), bool(self._plugin.any())
        self._lossy = bool(self._band.any() or self._still.any())
        # A negative brake would have to be taken explicitly.
        self._viscous = np.where(self._plugin, 0.0, np.maximum(-self._by_speed * np.abs(self._gear), 0.0))
        self._viscous *= np.sign(self._gear)

    def _pid(self, model: mujoco.MjModel, robot: RobotSpec) -> None:
        self._plugin: Bool[np.ndarray, "A"] = model.actuator_plugin >= 0
        names = [model.joint(int(model.actuator_trnid[row, 0])).name for row in range(model.nactuator)]
        controller = robot.controller
        gains = np.zeros((3, model.nactuator))
        unit = robot.motor.torque_per_volt if controller.kind == "servo" and robot.motor else 1.0
        for row in np.flatnonzero(self._plugin):
            gains[:, row] = [unit * controller.gain(gain, names[row]) for gain in ("kp", "ki", "kv")]
        self._kp, self._ki, self._kd = gains
        largest = np.inf if controller.integral_limit is None else unit * controller.integral_limit
        # The limit is a torque, the state an integral of the error.
        self._windup = np.divide(largest, self._ki, out=np.full(model.nactuator, np.inf), where=self._ki > 0)

    def start(self, position: Float64[np.ndarray, "B V"]) -> Float64[np.ndarray, "B A"]:
        """The actuators' states at the start: integrators hold these positions, integrals of errors are zero."""
        return np.where(self._integrates, self._hold * position[:, self._dof], 0.0)

    def torque(
        self,
        state: Float64[np.ndarray, "B A"],
        control: Float64[np.ndarray, "B U"],
        position: Float64[np.ndarray, "B V"],
        velocity: Float64[np.ndarray, "B V"],
    ) -> tuple[JointTorque, Float64[np.ndarray, "B A"]]:
        """The torques of one step, and the actuators' states after it."""
        told = control[:, self._input]
        if self._clamps:
            told = _within(told, self._clamp)
        q, v = position[:, self._dof], velocity[:, self._dof]
        length, speed = (q, v) if self._direct else (self._gear * q, self._gear * v)
        aim, after = told, state
        if self._integrating:
            aim = np.where(self._integrates, state, told)
            after = np.where(self._integrates, state + told * self._step_s, state)
        full = self._gain * aim + self._offset + self._by_length * length + self._by_speed * speed
        if self._plugins:
            error = told - length
            integral = np.clip(state + error * self._step_s, -self._windup, self._windup)
            by_pid = self._kp * error + self._ki * integral - self._kd * speed
            full, after = np.where(self._plugin, by_pid, full), np.where(self._plugin, integral, after)
        force = _within(full, self._limit)
        total = force @ self._onto
        asked = given = _within(total, self._joint_limit)
        if self._lossy:
            less = _within(self._without_losses(full, aim, length, speed), self._limit)
            given = _within(less @ self._onto, self._joint_limit)
        damping = np.where(force == full, self._viscous, 0.0) @ self._onto
        return JointTorque(asked, given, np.where(total == asked, damping, 0.0)), after

    def _without_losses(
        self,
        full: Float64[np.ndarray, "B A"],
        aim: Float64[np.ndarray, "B A"],
        length: Float64[np.ndarray, "B A"],
        speed: Float64[np.ndarray, "B A"],
    ) -> Float64[np.ndarray, "B A"]:
        """The forces with the dead band of servos and the static threshold of motors (see `JointFriction`)."""
        stiffness = -self._by_length
        servo = (stiffness > 0) & (self._band > 0)
        error = np.divide(self._gain * aim, stiffness, out=np.zeros_like(full), where=servo) - length
        less = np.where(servo, full - stiffness * np.clip(error, -self._band, self._band), full)
        motor = (self._by_length == 0) & (self._by_speed == 0) & ~self._plugin
        resting = np.abs(speed) < self._still_velocity * np.abs(self._gear)
        torque = self._gear * full
        held = motor & resting & (self._still[0] < torque) & (torque < self._still[1])
        return np.where(held, 0.0, less)


def _within(values: Float64[np.ndarray, "B N"], ends: Float64[np.ndarray, "2 N"]) -> Float64[np.ndarray, "B N"]:
    return np.asarray(np.minimum(np.maximum(values, ends[0]), ends[1]))


def _range(limited: Bool[np.ndarray, "A"], ends: Float64[np.ndarray, "A 2"]) -> Float64[np.ndarray, "2 A"]:
    return np.where(limited, ends.T, np.array([[-np.inf], [np.inf]]))


def _refuse_others(model: mujoco.MjModel, robot: RobotSpec) -> None:
    """Only what `torque` computes is let through."""
    for row in range(model.nactuator):
        plugin = model.actuator_plugin[row] >= 0
        found = {
            "it does not act on a joint": model.actuator_trntype[row] != int(mujoco.mjtTrn.mjTRN_JOINT),
            "a plugin of the model's own": plugin and robot.controller.kind not in ("pid", "servo"),
            "its gain is not fixed": not plugin and model.actuator_gaintype[row] != int(mujoco.mjtGain.mjGAIN_FIXED),
            "its bias is neither none nor affine": not plugin
            and model.actuator_biastype[row]
            not in (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)),
            "it has dynamics of its own": not plugin and model.actuator_dyntype[row] not in (_NONE, _INTEGRATOR),
            "its activation is limited": bool(model.actuator_actlimited[row]),
            "it acts on its activation early": bool(model.actuator_actearly[row]),
            "it has damping or armature of its own": bool(
                np.any(model.actuator_damping[row]) or np.any(model.actuator_armature[row])
            ),
            "it delays its input": bool(np.any(model.actuator_delay[row])),
            "it has several inputs or outputs": model.actuator_ctrlnum[row] != 1 or model.actuator_outnum[row] != 1,
            "its group is switched off": bool(model.opt.disableactuator >> int(model.actuator_group[row]) & 1),
        }
        reasons = [reason for reason, there in found.items() if there]
        if reasons:
            raise ConfigError(
                f"DART cannot drive the actuator {model.actuator(row).name!r} as MuJoCo does",
                got=", ".join(reasons),
                hint="Name a controller in robot.yaml (controller: {kind: position, kp: …, kv: …}) instead.",
            )
