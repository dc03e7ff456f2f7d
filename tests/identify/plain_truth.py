"""Logs of a servo-driven pendulum, made by plain MuJoCo at a step that its model does not have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries
from trueup.robots import ControllerSpec, JointSpec, RobotSpec

PENDULUM = """
<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="implicitfast" iterations="100"/>
<worldbody><body name="link"><joint name="j" axis="0 1 0" damping="{damping}" frictionloss="{frictionloss}"
  armature="{armature}" solreffriction="0.00001 1" solimpfriction="0.9999 0.9999"/>
  <inertial pos="0 0 -0.2" mass="{mass}" diaginertia="0.004 0.004 0.0005"/></body></worldbody>
<actuator><position name="s" joint="j" kp="{kp}" kv="{kv}"/></actuator></mujoco>
"""
MODEL = {"damping": 0.1, "frictionloss": 0.05, "armature": 0.01, "mass": 0.5, "kp": 30.0, "kv": 0.6}
TRUTH = {"damping": 0.1, "frictionloss": 0.15, "armature": 0.03, "mass": 0.5, "kp": 18.0, "kv": 0.9}
_FINE_S, _RATE_HZ, _NOISE = 2.5e-4, 100, 3e-4


@dataclass(frozen=True)
class Plain:
    """A robot, its model, logs of it by split, and the true numbers by the names of a fit."""

    robot: RobotSpec
    model: Path
    episodes: Mapping[str, list[Episode]]
    truth: Mapping[str, float]


def pendulum_logs(folder: Path, *, seconds: float = 6.0) -> Plain:
    """Four motions for train and two for val: sines, steps, and rests; commands are held as they are logged."""
    path = folder / "pendulum.xml"
    path.write_text(PENDULUM.format(step=0.005, **MODEL))
    robot = RobotSpec("pendulum", (JointSpec("j"),), path.name, controller=ControllerSpec("model", command="position"))
    model = mujoco.MjModel.from_xml_string(PENDULUM.format(step=_FINE_S, **TRUTH))
    logs = [_log(model, number, seconds) for number in range(6)]
    names = {name: f"{name}[{'link' if name == 'mass' else 'j'}]" for name in TRUTH}
    return Plain(
        robot,
        path,
        {"train": logs[:4], "val": logs[4:]},
        {**{names[name]: value for name, value in TRUTH.items()}, "delay_s[j]": 0.0},
    )


def _log(model: mujoco.MjModel, number: int, seconds: float) -> Episode:
    rng = np.random.default_rng(number)
    time_s = np.arange(round(seconds * _RATE_HZ)) / _RATE_HZ
    command = 0.4 + sum(0.25 * np.sin(2 * np.pi * rng.uniform(0.2, 2.0) * time_s + rng.uniform(0, 6)) for _ in range(3))
    for step_s in rng.uniform(1.0, seconds - 1.0, 2):
        command = command + rng.uniform(-0.4, 0.4) * (time_s > step_s)
    data = mujoco.MjData(model)
    data.qpos[0], data.ctrl[0] = command[0], command[0]
    for _ in range(8000):
        mujoco.mj_step(model, data)
    position = np.empty((time_s.size, 1))
    for row, asked in enumerate(command):
        position[row] = data.qpos
        data.ctrl[0] = asked
        mujoco.mj_step(model, data, nstep=round(1 / _RATE_HZ / _FINE_S))
    position += _NOISE * rng.standard_normal(position.shape)
    series = [
        TimeSeries(time_s, ("j",), {"position": own}, {"position": ("rad",)}) for own in (position, command[:, None])
    ]
    return Episode(EpisodeMeta(f"m{number}"), *series)
