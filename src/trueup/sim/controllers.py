"""Controllers as MuJoCo actuators, written once: they run inside the engine, in rollouts and step by step alike."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from trueup.errors import ConfigError, NameMismatch
from trueup.robots import ControllerSpec, MotorSpec, RobotSpec
from trueup.sim.actuator_inputs import PID_PLUGIN, inputs_of, pid_instance

# The actuator of a servo that takes no input.
_BACK_EMF = "back_emf"

# Everything that decides what an actuator does; names, targets and plugins are set where it is made.
_ACTUATOR_FIELDS = tuple(
    name
    for name in dir(mujoco.MjSpec().add_actuator())
    if not name.startswith(("_", "set_to_"))
    and name not in ("classname", "compiler", "id", "info", "name", "plugin", "signature", "target", "trntype", "type")
)


@dataclass(frozen=True)
class Channel:
    """One input of the engine: which actuator takes which command signal of which joint.

    Attributes:
        actuator: its name in the model.
        joint: that it acts on.
        signal: of the command.
        scale: the input per commanded value.
        number: which of the actuator's inputs it is.
    """

    actuator: str
    joint: str
    signal: str
    scale: float = 1.0
    number: int = 0


def attach_controller(spec: mujoco.MjSpec, robot: RobotSpec, *, keep: Collection[int] = ()) -> tuple[Channel, ...]:
    """Put the controller into the model and say how commands reach it.

    Every kind but `model` replaces all actuators of the model, except for those whose numbers are in `keep`.
    `torque_limit` of a joint limits the sum of its actuators.

    Raises:
        NameMismatch: a joint is not in the model; both lists are printed.
        ConfigError: kind `model`, and a joint has no actuator of its own, several, or one that does not follow the
            command.
    """
    controller, joints = robot.controller, robot.joints
    known = {joint.name: joint for joint in spec.joints}
    missing = [joint.name for joint in joints if joint.name not in known]
    if missing:
        raise NameMismatch(
            f"joints {missing} are not in the model",
            left=[joint.name for joint in joints],
            right=known,
            left_name="robot",
            right_name="model",
        )
    for joint in joints:
        if joint.torque_limit is not None:
            known[joint.name].actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
            known[joint.name].actfrcrange = [-joint.torque_limit, joint.torque_limit]
    if controller.kind == "model":
        return tuple(channel for joint in joints for channel in _own_channels(spec, joint.name, controller))
    for number, actuator in enumerate(list(spec.actuators)):
        if number not in keep:
            spec.delete(actuator)
    channels = {joint: _add(spec, robot, joint.name) for joint in joints}
    for joint, own in channels.items():
        # A servo's own limit is its voltage.
        if joint.torque_limit is not None and len(own) == 1 and controller.kind != "servo":
            # The same limit once more, on the actuator: implicit integrators leave out the derivatives of a saturated
            # actuator, not those of a joint at its limit.
            actuator = spec.actuator(own[0].actuator)
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.forcerange = [-joint.torque_limit, joint.torque_limit]
    return tuple(channel for own in channels.values() for channel in own)


def torque_limit_of(model: mujoco.MjModel, joint: str, actuators: Sequence[str]) -> float | None:
    """Largest torque [Nm or N] that reaches a joint: its own limit, or that of all its actuators if that is smaller.

    Args:
        model: compiled.
        joint: its name.
        actuators: names of those that drive it.

    Returns:
        None where nothing is limited.
    """
    index, rows = model.joint(joint).id, [model.actuator(name).id for name in dict.fromkeys(actuators)]
    limits = []
    if model.jnt_actfrclimited[index]:
        limits.append(float(np.abs(model.jnt_actfrcrange[index]).max()))
    if rows and all(model.actuator_forcelimited[rows]):
        forces = np.abs(model.actuator_forcerange[rows]).max(axis=1)
        limits.append(float(forces @ np.abs(model.actuator_gear[rows, 0])))
    return min(limits, default=None)


def scale_kp(spec: mujoco.MjSpec, channels: Sequence[Channel], factor: float, *, model: mujoco.MjModel) -> None:
    """Multiply the position gain of every drive by a factor; what damps and what integrates stays.

    Args:
        spec: the model with its controller; it is changed.
        channels: how commands reach it.
        factor: above 0.
        model: the same, compiled: a `dampratio` becomes the damping that it makes of the gain as it was.

    Raises:
        ConfigError: an actuator's position gain is not a number of the model.
    """
    for name, joint in {own.actuator: own.joint for own in channels if own.signal != "torque"}.items():
        actuator, plugin = spec.actuator(name), pid_instance(spec, name)
        if plugin is not None:
            plugin.config = {**plugin.config, "kp": repr(factor * float(plugin.config.get("kp") or 0.0))}
            continue
        fixed = actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED or (
            actuator.gaintype == mujoco.mjtGain.mjGAIN_AFFINE and not any(actuator.gainprm[1:3])
        )
        if actuator.plugin.active or not fixed or actuator.biastype != mujoco.mjtBias.mjBIAS_AFFINE:
            raise ConfigError(
                f"joint {joint!r}: kp_setting scales position gains, and that of the model's actuator {name!r} is none",
                got="a plugin" if actuator.plugin.active else actuator.gaintype.name,
                expected="a position servo, or MuJoCo's PID plugin",
                hint="Put a controller in its place in robot.yaml: controller: {kind: position, kp: …, kv: …}.",
            )
        if actuator.biasprm[1] == 0:
            continue  # it damps only
        if actuator.biasprm[2] > 0:  # MuJoCo's mark of a damping ratio
            actuator.biasprm[2] = model.actuator_biasprm[model.actuator(name).id, 2]
        actuator.gainprm[0] *= factor
        actuator.biasprm[1] *= factor


def _own_channels(spec: mujoco.MjSpec, joint: str, controller: ControllerSpec) -> list[Channel]:
    own = [
        actuator
        for actuator in spec.actuators
        if actuator.trntype in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
        and actuator.target == joint
    ]
    names = sorted(actuator.name for actuator in own)
    # Two actuators are told apart by the names that `_add` gives them.
    pair = [f"{joint}.position", f"{joint}.velocity"]
    if names == pair:
        return [Channel(actuator=name, joint=joint, signal=name.rpartition(".")[2]) for name in pair]
    if names == [f"{joint}.{_BACK_EMF}", pair[0]]:
        own = [actuator for actuator in own if actuator.name == pair[0]]
    if len(own) != 1:
        raise ConfigError(
            f"joint {joint!r} needs exactly one actuator in the model",
            got=[name or "one without a name" for name in names] or "none",
            hint="Name a controller in robot.yaml (controller: {kind: position, kp: …, kv: …}) to replace the model's.",
        )
    (actuator,) = own
    if not actuator.name:
        taken = {other.name for other in spec.actuators}
        actuator.name = joint if joint not in taken else f"{joint}.actuator"
    found = inputs_of(actuator, joint, controller.signal, measured=controller.source == "measured")
    return [Channel(actuator.name, joint, item.signal, item.scale, item.number) for item in found]


def _add(spec: mujoco.MjSpec, robot: RobotSpec, joint: str) -> list[Channel]:
    controller = robot.controller
    kp, kv, ki = (controller.gain(name, joint) for name in ("kp", "kv", "ki"))
    match controller.kind:
        case "torque":
            return [_motor(spec, f"{joint}.torque", joint, "torque")]
        case "position":
            servo = _motor(spec, f"{joint}.position", joint, "position")
            _affine(spec, servo, gain=kp, bias=(0.0, -kp, -kv))
            return [servo]
        case "velocity":
            servo = _motor(spec, f"{joint}.velocity", joint, "velocity")
            _affine(spec, servo, gain=kv, bias=(0.0, 0.0, -kv))
            return [servo]
        case "pd":
            stiffness = _motor(spec, f"{joint}.position", joint, "position")
            damping = _motor(spec, f"{joint}.velocity", joint, "velocity")
            _affine(spec, stiffness, gain=kp, bias=(0.0, -kp, 0.0))
            _affine(spec, damping, gain=kv, bias=(0.0, 0.0, -kv))
            return [stiffness, damping]
        case "velocity-integrator":
            servo = _motor(spec, f"{joint}.velocity", joint, "velocity")
            _affine(spec, servo, gain=kp, bias=(0.0, -kp, -kv))
            spec.actuator(servo.actuator).dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
            return [servo]
        case "pid":
            return [_pid(spec, f"{joint}.pid", joint, kp=kp, ki=ki, kd=kv, limit=controller.integral_limit)]
        case "servo" if robot.motor is not None:
            return [_servo(spec, robot.motor, joint, kp=kp, ki=ki, kd=kv, limit=controller.integral_limit)]
        case _:
            raise ConfigError(f"unknown controller {controller.kind!r}")


def _motor(spec: mujoco.MjSpec, name: str, joint: str, signal: str) -> Channel:
    _actuator(spec, name, joint)
    return Channel(actuator=name, joint=joint, signal=signal)


def _actuator(spec: mujoco.MjSpec, name: str, joint: str) -> mujoco.MjsActuator:
    """A plain motor: gear 1, no limits, whatever the <default> of the model says about actuators."""
    actuator = spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    plain = mujoco.MjSpec().add_actuator()
    for field in _ACTUATOR_FIELDS:
        setattr(actuator, field, getattr(plain, field))
    return actuator


def _affine(spec: mujoco.MjSpec, channel: Channel, *, gain: float, bias: tuple[float, float, float]) -> None:
    """Force = gain * input + bias[0] + bias[1] * position + bias[2] * velocity."""
    actuator = spec.actuator(channel.actuator)
    actuator.gainprm[0] = gain
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm[:3] = bias


def _servo(
    spec: mujoco.MjSpec, motor: MotorSpec, joint: str, *, kp: float, ki: float, kd: float, limit: float | None
) -> Channel:
    """A voltage within its limits, as the torque that it makes at rest, and what back-EMF takes of that."""
    volt, name = motor.torque_per_volt, f"{joint}.position"
    if ki:
        limit = None if limit is None else volt * limit
        channel = _pid(spec, name, joint, kp=volt * kp, ki=volt * ki, kd=volt * kd, limit=limit)
    else:
        channel = _motor(spec, name, joint, "position")
        _affine(spec, channel, gain=volt * kp, bias=(0.0, -volt * kp, -volt * kd))
    actuator = spec.actuator(name)
    actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    actuator.forcerange = [-volt * motor.voltage_v, volt * motor.voltage_v]
    damper = _motor(spec, f"{joint}.{_BACK_EMF}", joint, "")
    _affine(spec, damper, gain=0.0, bias=(0.0, 0.0, -volt * motor.back_emf_v_s_rad))
    return channel


def _pid(
    spec: mujoco.MjSpec, name: str, joint: str, *, kp: float, ki: float, kd: float, limit: float | None
) -> Channel:
    """MuJoCo's own PID plugin: compiled, so that a rollout needs no Python."""
    spec.activate_plugin(PID_PLUGIN)
    plugin = spec.add_plugin(name=name, plugin_name=PID_PLUGIN, active=True)
    config = {"kp": repr(kp), "ki": repr(ki), "kd": repr(kd)}
    if limit is not None:
        config["imax"] = repr(limit)
    plugin.config = config
    actuator = _actuator(spec, name, joint)
    actuator.plugin = plugin
    actuator.actdim = 1 if ki else 0
    return Channel(actuator=name, joint=joint, signal="position")
