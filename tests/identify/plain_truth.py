"""Logs of a pendulum, made by plain MuJoCo at a step that its model does not have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries
from trueup.robots import ControllerSpec, JointSpec, RobotSpec

PENDULUM = """
<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="implicitfast" iterations="100"/>
<worldbody><body name="link"><joint name="j" axis="0 1 0" damping="{damping}" frictionloss="{frictionloss}"
  armature="{armature}"{rigid}/>
  <inertial pos="0 0 -0.2" mass="{mass}" diaginertia="{inertia} {inertia} 0.0005"/></body></worldbody>
<actuator>{actuator}</actuator></mujoco>
"""
SERVO, MOTOR = '<position name="s" joint="j" kp="{kp}" kv="{kv}"/>', '<motor name="s" joint="j"/>'
RIGID = ' solreffriction="0.00001 1" solimpfriction="0.9999 0.9999"'
MODEL = {"damping": 0.1, "frictionloss": 0.05, "armature": 0.01, "mass": 0.5, "kp": 30.0, "kv": 0.6}
TRUTH = {"damping": 0.1, "frictionloss": 0.15, "armature": 0.03, "mass": 0.5, "kp": 18.0, "kv": 0.9}
# At a quarter of a millisecond, a truth would be wrong itself by more than intervals are wide.
_FINE_S, _RATE_HZ, _NOISE, _TORQUE_NOISE = 5e-5, 100, 3e-4, 0.02


@dataclass(frozen=True)
class Plain:
    """A robot, its model, logs of it by split, and the true numbers by the names of a fit."""

    robot: RobotSpec
    model: Path
    episodes: Mapping[str, list[Episode]]
    truth: Mapping[str, float]


def pendulum_logs(
    folder: Path,
    *,
    seconds: float = 4.0,
    torque: bool = False,
    driven: bool = False,
    soft: bool = False,
    shaped: bool = True,
    logged_late_s: float = 0.0,
    kp_settings: Sequence[float] = (),
    **true: float,
) -> Plain:
    """Four motions for train and two for val: sines, steps, and rests; commands are held as they are logged.

    Args:
        folder: for the model.
        seconds: of each motion.
        torque: log the servo's torque, too.
        driven: by torques, from a controller that nobody knows.
        soft: friction creeps as MuJoCo's default does.
        shaped: a link of another mass has the model's shape, so that its inertia grows with it; or the model's inertia.
        logged_late_s: stamps of commands are so late.
        kp_settings: of the motions, in turn; kp is that at the first, and the robot says so.
        true: numbers that are otherwise than in `TRUTH`.
    """
    path = folder / "pendulum.xml"
    kind, rigid, truth = MOTOR if driven else SERVO, "" if soft else RIGID, {**TRUTH, **true}

    def written(step_s: float, numbers: Mapping[str, float]) -> str:
        inertia = 0.008 * (numbers["mass"] if shaped else MODEL["mass"])
        actuator = kind.format(**numbers)
        return PENDULUM.format(step=step_s, rigid=rigid, actuator=actuator, inertia=inertia, **numbers)

    path.write_text(written(0.002 if driven else 0.005, MODEL))
    command = "torque" if driven else "position"
    stated = kp_settings[0] if kp_settings else None
    controller = ControllerSpec("model", command=command, kp_setting=stated)
    robot = RobotSpec("pendulum", (JointSpec("j"),), path.name, controller=controller)
    logs = []
    for number in range(6):
        setting = kp_settings[number % len(kp_settings)] if kp_settings else None
        own = {**truth, "kp": truth["kp"] * setting / stated} if setting and stated else truth
        model = mujoco.MjModel.from_xml_string(written(_FINE_S, own))
        log = _log(model, number, seconds, torque=torque, driven=driven)
        logs.append(replace(log, meta=replace(log.meta, kp_setting=setting)))
    if logged_late_s:
        logs = [replace(log, command=_later(log.command, logged_late_s)) for log in logs]
    names = {name: f"{name}[{'link' if name == 'mass' else 'j'}]" for name in TRUTH}
    return Plain(
        robot,
        path,
        {"train": logs[:4], "val": logs[4:]},
        {**{names[name]: value for name, value in truth.items()}, "delay_s[j]": -logged_late_s},
    )


def _later(told: TimeSeries, late_s: float) -> TimeSeries:
    """The same with later stamps; until then, the first command is told."""
    before = np.arange(0.0, late_s - 1e-9, 1 / _RATE_HZ)
    rows = np.concatenate([np.zeros(before.size, dtype=int), np.arange(told.time_s.size)])
    return replace(
        told,
        time_s=np.concatenate([before, told.time_s + late_s]),
        signals={name: own[rows] for name, own in told.signals.items()},
    )


def _log(model: mujoco.MjModel, number: int, seconds: float, *, torque: bool, driven: bool) -> Episode:
    rng = np.random.default_rng(number)
    time_s = np.arange(round(seconds * _RATE_HZ)) / _RATE_HZ
    wanted = 0.4 + sum(0.25 * np.sin(2 * np.pi * rng.uniform(0.2, 2.0) * time_s + rng.uniform(0, 6)) for _ in range(3))
    for step_s in rng.uniform(1.0, seconds - 1.0, 2):
        wanted = wanted + rng.uniform(-0.4, 0.4) * (time_s > step_s)
    data = mujoco.MjData(model)
    data.qpos[0], data.ctrl[0] = wanted[0], 0.0 if driven else wanted[0]
    mujoco.mj_step(model, data, nstep=round(2.0 / _FINE_S))
    position, command, force = (np.empty((time_s.size, 1)) for _ in range(3))
    for row, asked in enumerate(wanted):
        data.ctrl[0] = 18.0 * (asked - data.qpos[0]) - 0.9 * data.qvel[0] if driven else asked
        mujoco.mj_forward(model, data)
        position[row], command[row], force[row] = data.qpos, data.ctrl, data.qfrc_actuator
        mujoco.mj_step(model, data, nstep=round(1 / _RATE_HZ / _FINE_S))
    measured = {"position": position + _NOISE * rng.standard_normal(position.shape)}
    if torque:
        measured["torque"] = force + _TORQUE_NOISE * rng.standard_normal(force.shape)
    units = {"position": ("rad",), "torque": ("Nm",)}
    told = {"torque" if driven else "position": command}
    series = [TimeSeries(time_s, ("j",), own, {name: units[name] for name in own}) for own in (measured, told)]
    return Episode(EpisodeMeta(f"m{number}"), *series)
