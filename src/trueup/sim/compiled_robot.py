"""A robot's model with its controller, compiled: what every engine reads from it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float, Float64

from trueup.errors import ConfigError, MissingSignal
from trueup.robots import AS_DESCRIBED, RobotSpec, Setup, SimulationSpec
from trueup.robots.holding import Holding, driven_inputs
from trueup.robots.model import compile_spec
from trueup.sim.body_sensors import add_body_sensors
from trueup.sim.controllers import Channel, attach_controller, scale_kp, torque_limit_of
from trueup.sim.friction import set_friction
from trueup.sim.payload import PREFIX, attach_payload

# A motion beyond this has diverged [rad, m, rad/s or m/s]; MuJoCo itself gives up at accelerations of 1e10.
ABSURD = 1e6

# No motion of a robot is simulated in steps like these: what comes out is a straight line, without a word.
_LONGEST_STEP_S = 1.0


class CompiledRobot:
    """The base of simulators: the same model, channels and limits, whichever engine steps it.

    Args:
        model: compiled model with the controller's actuators and one `jointactuatorfrc` sensor per joint.
        robot: its description.
        channels: how commands reach the actuators.
        holding: what of the robot's model is held still in this one.
    """

    def __init__(
        self, model: mujoco.MjModel, robot: RobotSpec, channels: tuple[Channel, ...], holding: Holding | None = None
    ) -> None:
        self.model = model
        self.robot = robot
        self.channels = channels
        self.holding = holding or Holding()
        columns = {joint: index for index, joint in enumerate(robot.joint_names)}
        self._controls = tuple(
            (
                int(model.actuator_ctrladr[model.actuator(channel.actuator).id]) + channel.number,
                columns[channel.joint],
                channel.signal,
                channel.scale,
            )
            for channel in channels
        )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J controlled joints."""
        return self.robot.joint_names

    @property
    def timestep_s(self) -> float:
        """Physics step [s]."""
        return float(self.model.opt.timestep)

    @property
    def command_signals(self) -> tuple[str, ...]:
        """Command signals that the controller follows; the first is required."""
        return tuple(dict.fromkeys(channel.signal for channel in self.channels))

    @property
    def notes(self) -> tuple[str, ...]:
        """What is done with commands that might be meant otherwise."""
        scaled: dict[float, list[str]] = {}
        amplified: dict[float, list[str]] = {}
        for channel in self.channels:
            row = self.model.actuator(channel.actuator).id
            gain = float(self.model.actuator_gear[row, 0] * self.model.actuator_gainprm[row, 0])
            if channel.scale != 1.0:
                scaled.setdefault(channel.scale, []).append(channel.joint)
            elif channel.signal == "torque" and gain != 1.0:
                amplified.setdefault(gain, []).append(channel.joint)
        return (
            *(
                f"commands of {', '.join(dict.fromkeys(joints))} go into the model's actuators times {scale:g} "
                "(gear and gains), so that the joints follow them"
                for scale, joints in scaled.items()
            ),
            *(
                f"commanded torques of {', '.join(joints)} go into the model's motors as they are, which give the "
                f"joint {gain:g} times as much (gear and gain); if the logs hold torques of the joint, write "
                "controller: {kind: torque} in robot.yaml"
                for gain, joints in amplified.items()
            ),
        )

    @property
    def torque_limits(self) -> dict[str, float]:
        """Joint name -> largest torque of its actuators [Nm or N]; joints without a limit are left out."""
        own = {
            joint: torque_limit_of(
                self.model, joint, [channel.actuator for channel in self.channels if channel.joint == joint]
            )
            for joint in self.joints
        }
        return {joint: limit for joint, limit in own.items() if limit is not None}

    def control_of(self, command: Mapping[str, Float[np.ndarray, "B N J"]]) -> Float64[np.ndarray, "B N U"]:
        """Commands as the U inputs of the actuators.

        Raises:
            MissingSignal: the controller needs a signal that the command lacks.
        """
        required = self.command_signals[0]
        if required not in command:
            raise MissingSignal(
                f"the controller of {self.robot.name!r} follows {required!r}, which the command lacks",
                available=command,
            )
        control = np.zeros((*command[required].shape[:2], self.model.nu))
        for row, column, signal, scale in self._controls:
            if signal in command:  # PD without a velocity command damps towards standstill
                control[:, :, row] = scale * command[signal][:, :, column]
        return control

    def electrics(
        self, torque: Float64[np.ndarray, "*B J"], velocity: Float64[np.ndarray, "*B J"]
    ) -> dict[str, Float64[np.ndarray, "*B J"]]:
        """Current [A] and voltage [V] of the motors; nothing where the robot's motor is not known."""
        motor = self.robot.motor
        if motor is None:
            return {}
        current = torque / motor.torque_constant_nm_a
        return {"current": current, "voltage": motor.resistance_ohm * current + motor.back_emf_v_s_rad * velocity}

    def digest(self, versions: str) -> str:
        """SHA-256 of the compiled model, controller and options with it, and of the engines' versions."""
        buffer = np.empty(mujoco.mj_sizeModel(self.model), dtype=np.uint8)
        mujoco.mj_saveModel(self.model, None, buffer)
        # Beside what the model says, where that does not decide alone.
        scales = [channel.scale for channel in self.channels]
        told = repr(scales).encode() if any(scale != 1.0 for scale in scales) else b""
        return hashlib.sha256(versions.encode() + buffer.tobytes() + told).hexdigest()


def compile_robot(
    spec: mujoco.MjSpec, robot: RobotSpec, *, origin: Path, setup: Setup = AS_DESCRIBED, moves: bool = False
) -> tuple[mujoco.MjModel, tuple[Channel, ...], Holding]:
    """The compiled model of a robot with all that its description adds, how commands reach it, and what is held in it.

    For any engine. The editable model is completed in place, and what is held stays in it.

    Args:
        spec: the model.
        robot: its description.
        origin: of the model, for messages.
        setup: what it carries, and how its position gains are set.
        moves: whether somebody else drives a base and joints that the description does not name: nothing is held.

    Raises:
        ConfigError: the model lacks an actuator, holds no payload, has no gains to set, MuJoCo refuses it, or see
            `Holding.of`.
        NameMismatch: a joint is not in the model.
    """
    attach_payload(spec, robot, setup.payload_kg)
    channels = _with_controller(spec, robot, origin)
    for name in robot.joint_names:
        kind = spec.joint(name).type
        if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            raise ConfigError(f"joint {name!r} is neither a hinge nor a slide", got=kind.name)
        spec.add_sensor(
            name=torque_sensor(name),
            type=mujoco.mjtSensor.mjSENS_JOINTACTFRC,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
        if robot.simulation.load:
            _add_load_sensor(spec, name)
    add_body_sensors(spec, robot.simulation.bodies)
    for name, friction in robot.friction.items():
        set_friction(spec, name, friction)
    _set_options(spec, robot.simulation)
    holding = Holding() if moves else Holding.of(spec, robot, origin=origin)
    model = compile_spec(holding.applied(spec), origin)
    if not 0.0 < model.opt.timestep <= _LONGEST_STEP_S:
        raise ConfigError(
            f"{origin}: the time step makes no simulation",
            got=f"{model.opt.timestep} s",
            expected=f"above 0, and at most {_LONGEST_STEP_S:g} s",
            hint="Mend <option timestep> of the model, or state simulation: {timestep_s: 0.002} in robot.yaml.",
        )
    if setup.kp_factor != 1.0:
        scale_kp(spec, channels, setup.kp_factor, model=model)
        model = compile_spec(holding.applied(spec), origin)
    return model, channels, holding


def _with_controller(spec: mujoco.MjSpec, robot: RobotSpec, origin: Path) -> tuple[Channel, ...]:
    """Put the controller into the model, and leave keyframes the inputs of the actuators that are left."""
    if robot.controller.kind == "model":
        return attach_controller(spec, robot)
    kept = driven_inputs(spec, robot, origin=origin)
    channels = attach_controller(spec, robot, keep=kept)
    for number, key in enumerate(spec.keys):
        if len(key.ctrl) or len(key.act):
            inputs = [entries[number] for entries in kept.values()]
            key.act, key.ctrl = [], [*inputs, *[0.0] * (len(spec.actuators) - len(inputs))]
    return channels


def torque_sensor(joint: str) -> str:
    """Name of the sensor of what the actuators do to a joint."""
    return f"trueup.torque.{joint}"


def load_sensor(joint: str) -> str:
    """Name of the sensor of the wrench between a joint's body and its parent, and of the site where it is."""
    return f"trueup.load.{joint}"


def _add_load_sensor(spec: mujoco.MjSpec, name: str) -> None:
    joint = spec.joint(name)
    last = joint.parent.joints[-1].name
    if name != last:  # its axis would move in the body, in which the sensor stands still
        raise ConfigError(
            f"simulation: load: joint {name!r} shares its body with {last!r}, so that its load cannot be read",
            hint="Give each joint a body of its own in the model; the first ones may weigh next to nothing.",
        )
    joint.parent.add_site(name=load_sensor(name), pos=joint.pos)
    hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
    spec.add_sensor(
        name=load_sensor(name),
        type=mujoco.mjtSensor.mjSENS_TORQUE if hinge else mujoco.mjtSensor.mjSENS_FORCE,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname=load_sensor(name),
    )


def _set_options(spec: mujoco.MjSpec, simulation: SimulationSpec) -> None:
    if simulation.timestep_s is not None:
        spec.option.timestep = simulation.timestep_s
    if not simulation.contacts:
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    # A diverged motion must stay visibly diverged instead of starting again from the reset state.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if simulation.gravity_compensation:
        for body in spec.bodies:
            if not body.name.startswith(PREFIX):  # nobody has told the robot what it carries
                body.gravcomp = 1.0
