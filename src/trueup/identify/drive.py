"""What the actuators of a joint do to it, as torques at the joint: gears and plugins reckoned in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from trueup.sim.actuator_inputs import pid_instance
from trueup.sim.controllers import Channel, torque_limit_of

# As numbers: an enum of MuJoCo's is not equal to an integer of numpy's, though that integer is equal to it.
_FIXED_GAIN = int(mujoco.mjtGain.mjGAIN_FIXED)
_LINEAR_BIAS = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))


@dataclass(frozen=True)
class Drive:
    """The terms of a joint's drive [Nm/rad and so on at the joint; N and m for a slide].

    A term that the drive does not have is None: a velocity servo has no `kp`, a PID plugin takes no `torque_offset`.

    Attributes:
        kp: torque per position error.
        kv: torque per velocity, against it; 0 for a servo that could have one.
        ki: torque per integrated position error.
        torque_offset: torque that acts all the time.
        torque_gain: torque per torque that is followed.
        torque_limit: largest torque, of the joint and of its actuators together.
        plugin: whether a plugin makes the torque.
    """

    kp: float | None = None
    kv: float | None = None
    ki: float | None = None
    torque_offset: float | None = None
    torque_gain: float | None = None
    torque_limit: float | None = None
    plugin: bool = False


def drive_of(spec: mujoco.MjSpec, model: mujoco.MjModel, channels: Sequence[Channel]) -> Drive:
    """The drive behind the channels of one joint.

    Args:
        spec: the model, editable; it alone tells a plugin's numbers by name.
        model: the same, compiled.
        channels: of one joint, one or two.
    """
    names = list(dict.fromkeys(channel.actuator for channel in channels))
    rows = [int(model.actuator(name).id) for name in names]
    limit = torque_limit_of(model, channels[0].joint, names)
    if any(model.actuator_plugin[row] >= 0 for row in rows):
        return _pid_drive(spec, model, channels[0], limit)
    gains, biases = model.actuator_gaintype[rows], model.actuator_biastype[rows]
    gear, bias = model.actuator_gear[rows, 0], model.actuator_biasprm[rows, :3]
    if not (gear.all() and np.all(gains == _FIXED_GAIN) and np.all(np.isin(biases, _LINEAR_BIAS))):
        return Drive(torque_limit=limit)
    kp, kv = -float(gear**2 @ bias[:, 1]), -float(gear**2 @ bias[:, 2])
    gain = float(channels[0].scale * gear[0] * model.actuator_gainprm[rows[0], 0])
    follows_torque = channels[0].signal == "torque"
    has_kv = kv > 0.0 or (kv == 0.0 and not follows_torque and (kp > 0.0 or len(rows) > 1))
    return Drive(
        kp=kp if kp > 0.0 else None,
        kv=abs(kv) if has_kv else None,
        torque_offset=float(gear @ bias[:, 0]),
        torque_gain=gain if follows_torque and kp == 0.0 and gain > 0.0 else None,
        torque_limit=limit,
    )


def _pid_drive(spec: mujoco.MjSpec, model: mujoco.MjModel, channel: Channel, limit: float | None) -> Drive:
    plugin = pid_instance(spec, channel.actuator)
    if plugin is None:
        return Drive(torque_limit=limit, plugin=True)
    gear = float(model.actuator(channel.actuator).gear[0])
    kp, kv, ki = (gear**2 * float(plugin.config.get(key) or 0.0) for key in ("kp", "kd", "ki"))
    return Drive(kp=kp or None, kv=kv, ki=ki or None, torque_limit=limit, plugin=True)
