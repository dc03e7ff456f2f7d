"""Gains, delay, torque offset and limits of a joint's drive."""

from __future__ import annotations

import mujoco
import numpy as np

from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.quantities.base import Quantity


def _spec_actuators(candidate: Candidate, joint: str) -> list[mujoco.MjsActuator]:
    return [candidate.spec.actuator(name) for name in candidate.nominal.actuators(joint)]


def _row(nominal: Nominal, joint: str) -> int:
    return int(nominal.model.actuator(nominal.actuators(joint)[0]).id)


def _rows(nominal: Nominal, joint: str) -> list[int]:
    return [int(nominal.model.actuator(name).id) for name in nominal.actuators(joint)]


def _read_kp(nominal: Nominal, joint: str) -> float:
    return float(-nominal.model.actuator_biasprm[_row(nominal, joint), 1])


def _write_kp(candidate: Candidate, joint: str, value: float) -> None:
    actuator = _spec_actuators(candidate, joint)[0]
    # A command that the model scales (gain other than kp) keeps its scale.
    ratio = actuator.gainprm[0] / -actuator.biasprm[1] if actuator.biasprm[1] else 1.0
    actuator.gainprm[0] = ratio * value
    actuator.biasprm[1] = -value


def _read_kv(nominal: Nominal, joint: str) -> float:
    return float(-sum(nominal.model.actuator_biasprm[row, 2] for row in _rows(nominal, joint)))


def _write_kv(candidate: Candidate, joint: str, value: float) -> None:
    actuator = _spec_actuators(candidate, joint)[-1]
    # A damping actuator that follows a commanded velocity keeps following it.
    follows = actuator.biasprm[1] == 0 and actuator.gainprm[0] == -actuator.biasprm[2] != 0
    actuator.biasprm[2] = -value
    if follows:
        actuator.gainprm[0] = value


def _read_torque_offset(nominal: Nominal, joint: str) -> float:
    return float(nominal.model.actuator_biasprm[_row(nominal, joint), 0])


def _write_torque_offset(candidate: Candidate, joint: str, value: float) -> None:
    actuator = _spec_actuators(candidate, joint)[0]
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm[0] = value


def _read_torque_gain(nominal: Nominal, joint: str) -> float:
    row = _row(nominal, joint)
    return float(nominal.model.actuator_gainprm[row, 0] * nominal.model.actuator_gear[row, 0])


def _write_torque_gain(candidate: Candidate, joint: str, value: float) -> None:
    actuator = _spec_actuators(candidate, joint)[0]
    actuator.gainprm[0] = value / actuator.gear[0]


def _read_torque_limit(nominal: Nominal, joint: str) -> float:
    row = _row(nominal, joint)
    limited = bool(nominal.model.actuator_forcelimited[row])
    return float(abs(nominal.model.actuator_forcerange[row]).max()) if limited else 0.0


def _write_torque_limit(candidate: Candidate, joint: str, value: float) -> None:
    for actuator in _spec_actuators(candidate, joint):
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-value, value]


def _read_delay(nominal: Nominal, joint: str) -> float:
    return nominal.given.controller.gain("delay_s", joint)


def _write_delay(candidate: Candidate, joint: str, value: float) -> None:
    candidate.delay_s[joint] = value


def _write_joint_offset(candidate: Candidate, joint: str, value: float) -> None:
    # MuJoCo's `ref` is what the joint reads in the pose that the model draws; stops stay where they are.
    target = candidate.spec.joint(joint)
    change = -value - target.ref
    target.ref += change
    target.range = np.asarray(target.range) + change
    target.springref += change


def _write_encoder_zero(candidate: Candidate, target: str, value: float) -> None:
    candidate.encoder_zeros[target] = value


def _zero(_nominal: Nominal, _target: str) -> float:
    return 0.0


def _read_joint_offset(nominal: Nominal, joint: str) -> float:
    return float(-nominal.spec.joint(joint).ref)


SERVO: tuple[Quantity, ...] = (
    Quantity(
        "delay_s",
        "s",
        "joint",
        "delay",
        _read_delay,
        _write_delay,
        "let {target} start and reverse quickly",
        low=0.0,
        high=0.2,
        scale=0.02,
    ),
    Quantity(
        "kp",
        "Nm/rad",
        "joint",
        "gains",
        _read_kp,
        _write_kp,
        "load {target} by gravity in several poses, or accelerate it hard",
        transform="log",
        start=1.0,
        span=500.0,
        changes_controller=True,
    ),
    Quantity(
        "kv",
        "Nm s/rad",
        "joint",
        "gains",
        _read_kv,
        _write_kv,
        "drive {target} into its torque limit at speed; elsewhere the servo's damping acts as viscous friction does",
        transform="log",
        start=0.1,
        span=500.0,
        changes_controller=True,
    ),
    Quantity(
        "torque_offset",
        "Nm",
        "joint",
        "gravity",
        _read_torque_offset,
        _write_torque_offset,
        "move {target} slowly in both directions through several poses",
        low=-50.0,
        high=50.0,
        scale=0.5,
        prior_std=1.0,
    ),
    Quantity(
        "torque_gain",
        "1",
        "joint",
        "gains",
        _read_torque_gain,
        _write_torque_gain,
        "move {target} against known gravity with large and small torques",
        transform="log",
        start=1.0,
        low=0.05,
        high=20.0,
        span=3.0,
        prior_std=0.3,
    ),
    Quantity(
        "torque_limit",
        "Nm",
        "joint",
        "gains",
        _read_torque_limit,
        _write_torque_limit,
        "command {target} so fast that its drive saturates",
        transform="log",
        start=10.0,
        span=20.0,
    ),
    Quantity(
        "joint_offset",
        "rad",
        "joint",
        "gravity",
        _read_joint_offset,
        _write_joint_offset,
        "let {target} swing on both sides of its hanging position",
        low=-0.3,
        high=0.3,
        scale=0.05,
        prior_std=1.0,
    ),
    Quantity(
        "encoder_zero",
        "rad",
        "motion",
        "gravity",
        _zero,
        _write_encoder_zero,
        "let {target} swing on both sides of its hanging position",
        low=-0.3,
        high=0.3,
        scale=0.05,
        prior_std=1.0,
    ),
)
