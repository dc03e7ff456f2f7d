"""Gains, delay, torque offset and limits of a joint's drive."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from trueup.core.parameters import SearchRange
from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.quantities.base import Quantity
from trueup.sim.actuator_inputs import pid_instance


def spec_actuators(candidate: Candidate, joint: str) -> list[mujoco.MjsActuator]:
    """Those that drive a joint, in the candidate's model."""
    names = dict.fromkeys(channel.actuator for channel in candidate.nominal.channels(joint))
    return [candidate.spec.actuator(name) for name in names]


def _gear(candidate: Candidate, joint: str) -> float:
    """Joint torque per torque of the actuators; those of one joint share it."""
    return float(candidate.nominal.model.actuator(candidate.nominal.channels(joint)[0].actuator).gear[0])


def _term(name: str) -> Callable[[Nominal, str], float | None]:
    """Reader of one term of a joint's `Drive`."""

    def read(nominal: Nominal, joint: str) -> float | None:
        found: float | None = getattr(nominal.drive(joint), name)
        return found

    return read


def _write_pid(candidate: Candidate, joint: str, key: str, value: float) -> bool:
    """Write a gain of a PID plugin; False if the joint's drive is none."""
    plugin = pid_instance(candidate.spec, candidate.nominal.channels(joint)[0].actuator)
    if plugin is None:
        return False
    plugin.config = {**plugin.config, key: repr(value / _gear(candidate, joint) ** 2)}
    return True


def _write_kp(candidate: Candidate, joint: str, value: float) -> None:
    if _write_pid(candidate, joint, "kp", value):
        return
    actuator = spec_actuators(candidate, joint)[0]
    # A command that the model scales (gain other than kp) keeps its scale.
    ratio = actuator.gainprm[0] / -actuator.biasprm[1]
    own = value / _gear(candidate, joint) ** 2
    actuator.gainprm[0] = ratio * own
    actuator.biasprm[1] = -own


def _write_kv(candidate: Candidate, joint: str, value: float) -> None:
    if _write_pid(candidate, joint, "kd", value):
        return
    actuator = spec_actuators(candidate, joint)[-1]
    own = value / _gear(candidate, joint) ** 2
    # A damping actuator that follows a commanded velocity keeps following it.
    if candidate.nominal.channels(joint)[-1].signal == "velocity" and actuator.biasprm[1] == 0:
        ratio = actuator.gainprm[0] / -actuator.biasprm[2] if actuator.biasprm[2] else 1.0
        actuator.gainprm[0] = ratio * own
    actuator.biasprm[2] = -own


def _write_ki(candidate: Candidate, joint: str, value: float) -> None:
    _write_pid(candidate, joint, "ki", value)


def _write_torque_offset(candidate: Candidate, joint: str, value: float) -> None:
    actuator = spec_actuators(candidate, joint)[0]
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm[0] = value / _gear(candidate, joint)


def _write_torque_gain(candidate: Candidate, joint: str, value: float) -> None:
    scale = candidate.nominal.channels(joint)[0].scale
    spec_actuators(candidate, joint)[0].gainprm[0] = value / (scale * _gear(candidate, joint))


def _write_torque_limit(candidate: Candidate, joint: str, value: float) -> None:
    """Move every limit that there is by the same factor: an asymmetric range stays so, and the smallest one rules."""
    model, target = candidate.nominal.model, candidate.spec.joint(joint)
    said = candidate.nominal.drive(joint).torque_limit
    own = spec_actuators(candidate, joint)
    if said is None:
        target.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
        target.actfrcrange = [-value, value]
        if len(own) == 1:
            # Once more, as `attach_controller` does and for its reason.
            own[0].forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            own[0].forcerange = np.array([-value, value]) / abs(_gear(candidate, joint))
        return
    if model.jnt_actfrclimited[model.joint(joint).id]:
        target.actfrcrange = np.asarray(target.actfrcrange) * (value / said)
    for actuator in own:
        if model.actuator_forcelimited[model.actuator(actuator.name).id]:
            actuator.forcerange = np.asarray(actuator.forcerange) * (value / said)


def _read_delay(nominal: Nominal, joint: str) -> float:
    return nominal.given.controller.gain("delay_s", joint) - nominal.given.replay.command_shift_s


def _write_delay(candidate: Candidate, joint: str, value: float) -> None:
    candidate.delay_s[joint] = value


def _write_joint_offset(candidate: Candidate, joint: str, value: float) -> None:
    # MuJoCo's `ref` is what the joint reads in the pose that the model draws; stops stay where they are.
    target = candidate.spec.joint(joint)
    in_degrees = target.compiler.degree and candidate.nominal.length_unit(joint) == "rad"
    change = (np.rad2deg(-value) if in_degrees else -value) - target.ref
    target.ref += change
    target.range = np.asarray(target.range) + change
    target.springref += change


def _write_encoder_zero(candidate: Candidate, target: str, value: float) -> None:
    candidate.encoder_zeros[target] = value


def _zero(_nominal: Nominal, _target: str) -> float:
    return 0.0


def _read_joint_offset(nominal: Nominal, joint: str) -> float:
    model = nominal.model
    return 0.0 - float(model.qpos0[model.joint(joint).qposadr[0]])


SERVO: tuple[Quantity, ...] = (
    Quantity(
        *("delay_s", "delay of the command", "s", "joint", "delay"),
        _read_delay,
        _write_delay,
        "let {target} start and reverse quickly",
        SearchRange(low=-0.02, high=0.2, scale=0.02),
    ),
    Quantity(
        *("kp", "stiffness of the servo", "Nm/rad", "joint", "gains"),
        _term("kp"),
        _write_kp,
        "load {target} by gravity in several poses, or accelerate it hard",
        SearchRange("log", span=500.0),
        needs="a position servo",
    ),
    Quantity(
        *("kv", "damping of the servo", "Nm s/rad", "joint", "gains"),
        _term("kv"),
        _write_kv,
        "drive {target} into its torque limit at speed; elsewhere the servo's damping acts as viscous friction does",
        SearchRange("log", start=0.1, span=500.0),
        needs="a servo",
    ),
    Quantity(
        *("ki", "integral gain of the servo", "Nm/(rad s)", "joint", "gains"),
        _term("ki"),
        _write_ki,
        "hold {target} under different loads for seconds",
        SearchRange("log", span=500.0),
        needs="a PID controller with an integral gain",
    ),
    Quantity(
        *("torque_offset", "constant torque", "Nm", "joint", "gravity"),
        _term("torque_offset"),
        _write_torque_offset,
        "move {target} slowly in both directions through several poses",
        SearchRange(scale=0.1, prior_std=1.0),
        needs="a drive other than a plugin",
        sized=lambda size: size.torque,
    ),
    Quantity(
        *("torque_gain", "torque per commanded torque", "1", "joint", "gains"),
        _term("torque_gain"),
        _write_torque_gain,
        "move {target} against known gravity with large and small torques",
        SearchRange("log", low=0.05, high=20.0, span=3.0, prior_std=0.3),
        needs="a drive that follows torque",
    ),
    Quantity(
        *("torque_limit", "torque limit", "Nm", "joint", "gains"),
        _term("torque_limit"),
        _write_torque_limit,
        "command {target} so fast that its drive saturates",
        SearchRange("log", span=20.0),
        needs="a torque limit in the model, or a `start`",
        addable=True,
    ),
    Quantity(
        *("joint_offset", "zero of the joint", "rad", "joint", "gravity"),
        _read_joint_offset,
        _write_joint_offset,
        "let {target} swing on both sides of its hanging position",
        SearchRange(low=-0.3, high=0.3, scale=0.05, prior_std=1.0),
    ),
    Quantity(
        *("encoder_zero", "zero of the joint, of each recording", "rad", "motion", "gravity"),
        _zero,
        _write_encoder_zero,
        "let {target} swing on both sides of its hanging position",
        SearchRange(low=-0.3, high=0.3, scale=0.05, prior_std=1.0),
    ),
)
