"""Logs of a servo-driven arm of two joints with something that its model lacks, made by plain MuJoCo at a fine step."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries
from trueup.robots import ControllerSpec, JointSpec, RobotSpec

ARM = """
<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="implicitfast" iterations="100"/>
<worldbody><body name="upper" pos="0 0 1"><joint name="a" axis="0 1 0" {a}/>
  <inertial pos="0 0 -0.15" mass="1.2" diaginertia="0.01 0.01 0.001"/>
  <body name="fore" pos="0 0 -0.3"><joint name="b" axis="0 1 0" {b}/>
    <inertial pos="0 0 -0.12" mass="0.7" diaginertia="0.005 0.005 0.0005"/>
    <body name="tip" pos="0 0 -0.25"><inertial pos="0 0 0" mass="{tip}" diaginertia="1e-6 1e-6 1e-6"/></body></body>
</body></worldbody><actuator>{actuators}</actuator></mujoco>
"""
JOINT = 'damping="{damping}" frictionloss="{frictionloss}" armature="{armature}"'
RIGID = ' solreffriction="0.00001 1" solimpfriction="0.9999 0.9999"'
MODEL = {"damping": 0.2, "frictionloss": 0.1, "armature": 0.02, "kp": 60.0, "kv": 1.5}
_FINE_S, _RATE_HZ, _NOISE, _TORQUE_NOISE = 2.5e-4, 100, 3e-4, 0.02
_UNITS = {"position": "rad", "torque": "Nm"}


@dataclass(frozen=True)
class Lack:
    """What the robot has and the model lacks.

    Attributes:
        late_s: age of the state that the drives act on [s].
        ki: integral gain of joint a [Nm/(rad s)].
        play: backlash of joint a [rad].
        stiffness: of the gear of joint a [Nm/rad].
        per_load: friction of joint b per load [Nm/Nm].
        per_s: share by which all friction falls in a second.
        payload_kg: at the tip.
        top_speed: of joint b [rad/s].
        mirrored: whether joint b counts the other way round.
        torque: whether the torques of the drives are logged.
    """

    late_s: float = 0.0
    ki: float = 0.0
    play: float = 0.0
    stiffness: float = 0.0
    per_load: float = 0.0
    per_s: float = 0.0
    payload_kg: float = 0.0
    top_speed: float = 0.0
    mirrored: bool = False
    torque: bool = False


def arm_logs(
    folder: Path, lack: Lack, *, seed: int = 0, seconds: float = 5.0
) -> tuple[RobotSpec, Path, dict[str, list[Episode]]]:
    """A robot, its model, and four motions for train and two for val."""
    path = folder / "arm.xml"
    joints = {name: JOINT.format(**MODEL) for name in "ab"}
    servos = "".join(f'<position name="{name}" joint="{name}" kp="{MODEL["kp"]}" kv="{MODEL["kv"]}"/>' for name in "ab")
    path.write_text(ARM.format(step=0.002, tip=1e-3, actuators=servos, **joints))
    robot = RobotSpec(
        "arm", (JointSpec("a"), JointSpec("b")), path.name, controller=ControllerSpec("model", command="position")
    )
    logs = [_log(lack, seed, number, seconds) for number in range(6)]
    return robot, path, {"train": logs[:4], "val": logs[4:]}


def _log(lack: Lack, seed: int, number: int, seconds: float) -> Episode:
    numbers = np.random.default_rng([seed, 99])
    true = {
        "damping": 0.25 * numbers.uniform(0.7, 1.5, 2),
        "frictionloss": 0.15 * numbers.uniform(0.6, 1.6, 2),
        "armature": 0.03 * numbers.uniform(0.7, 1.5, 2),
    }
    kp, kv = 50.0 * numbers.uniform(0.7, 1.1, 2), 1.2 * numbers.uniform(0.7, 1.2, 2)
    soft = bool(lack.play or lack.stiffness)
    joints = {}
    for index, name in enumerate("ab"):
        own = {key: float(value[index]) for key, value in true.items()}
        if soft and index == 0:  # the motor has them
            own.update(armature=0.0, damping=0.0, frictionloss=0.2 * own["frictionloss"])
        joints[name] = JOINT.format(**own) + RIGID
    model = mujoco.MjModel.from_xml_string(
        ARM.format(step=_FINE_S, tip=lack.payload_kg or 1e-3, actuators="", **joints)
    )
    data = mujoco.MjData(model)
    rng = np.random.default_rng([seed, number])
    rows = round(seconds * _RATE_HZ)
    command = _command(rng, np.arange(rows) / _RATE_HZ, seconds)
    data.qpos[:] = command[0]
    drive = _Drive(lack, kp, kv, data)
    motor = _Motor(lack, true, data) if soft else None
    friction, damping = model.dof_frictionloss.copy(), model.dof_damping.copy()
    position, exerted = np.empty((rows, 2)), np.empty((rows, 2))
    every, settling = round(1 / _RATE_HZ / _FINE_S), 4000
    for step in range(settling + rows * every):
        row = max(step - settling, 0)
        if step >= settling and row % every == 0:
            position[row // every] = data.qpos
        warm = 1.0 - lack.per_s * row * _FINE_S
        model.dof_damping[:] = warm * damping
        model.dof_frictionloss[:] = warm * friction
        if lack.per_load:
            model.dof_frictionloss[1] += lack.per_load * abs(data.qfrc_bias[1])
        q, v = (data.qpos, data.qvel) if motor is None else motor.seen()
        torque = drive.torque(command[min(row // every, rows - 1)], q, v)
        if step >= settling and row % every == 0:
            exerted[row // every] = torque
        if motor is not None:
            torque = motor.step(torque)
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)
    position += _NOISE * rng.standard_normal(position.shape)
    sign = np.array([1.0, -1.0 if lack.mirrored else 1.0])
    time_s = np.arange(rows) / _RATE_HZ
    measured = {"position": sign * position}
    if lack.torque:
        measured["torque"] = sign * (exerted + _TORQUE_NOISE * rng.standard_normal(exerted.shape))
    series = [
        TimeSeries(time_s, ("a", "b"), own, {name: (_UNITS[name],) * 2 for name in own})
        for own in (measured, {"position": sign * command})
    ]
    return Episode(EpisodeMeta(f"m{number}"), *series)


def _command(rng: np.random.Generator, time_s: np.ndarray, seconds: float) -> np.ndarray:
    """Sines, steps and rests about a pose in which gravity loads both joints, (T, 2)."""
    command = np.empty((time_s.size, 2))
    for joint, home in enumerate((0.6, 0.5)):
        pace = 1.0 - ((time_s > 0.45 * seconds) & (time_s < 0.6 * seconds))
        phase = np.cumsum(pace) / _RATE_HZ
        waves = sum(
            0.25 * np.sin(2 * np.pi * rng.uniform(0.2, 1.6) * phase + rng.uniform(0, 2 * np.pi)) for _ in range(3)
        )
        command[:, joint] = home + waves
        for at_s in rng.uniform(0.2 * seconds, 0.8 * seconds, 2):
            command[:, joint] += rng.uniform(-0.3, 0.3) * np.clip((time_s - at_s) / 0.1, 0.0, 1.0)
    return command


class _Drive:
    """A PD servo with what it may have besides."""

    def __init__(self, lack: Lack, kp: np.ndarray, kv: np.ndarray, data: mujoco.MjData) -> None:
        self._lack, self._kp, self._kv = lack, kp, kv
        age = round(lack.late_s / _FINE_S)
        self._seen = deque([(data.qpos.copy(), data.qvel.copy())] * (age + 1), maxlen=age + 1)
        self._sum = 0.0

    def torque(self, command: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Of both joints [Nm]."""
        self._seen.append((q.copy(), v.copy()))
        then, rate = self._seen[0]
        torque = self._kp * (command - then) - self._kv * rate
        if self._lack.ki:
            self._sum += _FINE_S * self._lack.ki * float(command[0] - then[0])
            torque[0] += self._sum
        top = self._lack.top_speed
        if top and abs(v[1]) > top and torque[1] * v[1] > 0:
            torque[1] = -20.0 * (v[1] - np.sign(v[1]) * top)
        return np.clip(torque, -40.0, 40.0)


class _Motor:
    """The motor of joint a behind a spring with play; that of joint b is rigid."""

    def __init__(self, lack: Lack, true: dict[str, np.ndarray], data: mujoco.MjData) -> None:
        self._lack, self._data = lack, data
        self._inertia = float(true["armature"][0])
        self._viscous, self._dry = float(true["damping"][0]), 0.8 * float(true["frictionloss"][0])
        self._stiffness = lack.stiffness or 4000.0
        self._damping = 0.3 * np.sqrt(self._stiffness * self._inertia)
        self._q, self._v = float(data.qpos[0]), 0.0

    def seen(self) -> tuple[np.ndarray, np.ndarray]:
        """What the drives measure: the motors."""
        data = self._data
        return np.array([self._q, data.qpos[1]]), np.array([self._v, data.qvel[1]])

    def step(self, torque: np.ndarray) -> np.ndarray:
        """Move the motor; the torques that act on the links."""
        twist, rate = self._q - self._data.qpos[0], self._v - self._data.qvel[0]
        pressed = np.sign(twist) * max(abs(twist) - 0.5 * self._lack.play, 0.0)
        passed = self._stiffness * pressed + (self._damping * rate if pressed else 0.0)
        passed = passed if pressed * passed > 0 else 0.0
        free = (self._v + _FINE_S / self._inertia * (torque[0] - passed)) / (
            1 + _FINE_S * self._viscous / self._inertia
        )
        self._v = float(np.sign(free) * max(abs(free) - _FINE_S * self._dry / self._inertia, 0.0))
        self._q += _FINE_S * self._v
        return np.array([passed, torque[1]])
