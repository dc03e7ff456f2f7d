"""Friction laws against MuJoCo's own joint friction: the same Panda, commands and threads, side by side."""

from __future__ import annotations

import time
from dataclasses import replace
from statistics import median

import mujoco
import numpy as np

from benchmarks.table import Row, at_least, shown
from trueup.core.protocols import RolloutRequest
from trueup.robots import ControllerSpec, JointFriction, RobotSpec, find_model, load_robot
from trueup.robots.model import load_spec
from trueup.sim import MujocoSimulator

_ROUNDS = 7
_MOTIONS, _STEPS = 32, 500
_POSE = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
_ALL_TERMS = JointFriction(
    stribeck=0.3,
    stribeck_velocity=0.1,
    load=0.02,
    asymmetry=0.1,
    tanh_coulomb=0.2,
    tanh_velocity=0.05,
    sigmoid_level=0.5,
    sigmoid_slope=9.0,
    sigmoid_shift=0.03,
    dead_band=0.001,
    static_positive=0.3,
    static_negative=0.3,
)


def run() -> list[Row]:
    """Steps per second with MuJoCo's friction and with every term of the law, on one and two threads, in alternation.

    A model with laws has no constraint islands, and building them costs about what the laws cost. So the bar is held
    against MuJoCo's friction without islands too; with them, as it comes, is only shown.
    """
    servos = ControllerSpec(kind="position", kp=600.0, kv=50.0)
    plain = replace(load_robot("panda_torque"), controller=servos, friction={})
    law = replace(plain, friction=dict.fromkeys(plain.joint_names, _ALL_TERMS))
    rows = []
    for threads in (1, 2):
        cases = {
            "MuJoCo's own friction": _simulator(plain, threads),
            "MuJoCo's own, no islands": _simulator(plain, threads, islands=False),
            "the full law": _simulator(law, threads),
        }
        seconds = np.array([[_seconds(simulator) for simulator in cases.values()] for _ in range(_ROUNDS)])
        for column, name in enumerate(cases):
            rate = _MOTIONS * _STEPS / median(seconds[:, column]) / 1e3
            rows.append(shown(f"panda, {name}, {threads} threads", rate, "1000 steps/s"))
        as_it_comes, alike = (median(seconds[:, column] / seconds[:, 2]) for column in (0, 1))
        rows.append(shown(f"full law / MuJoCo's own, {threads} threads", as_it_comes, "x"))
        rows.append(at_least(f"full law / MuJoCo's own, no islands, {threads} threads", alike, 0.6, "x"))
    return rows


def _simulator(robot: RobotSpec, threads: int, *, islands: bool = True) -> MujocoSimulator:
    path = find_model(robot)
    spec = load_spec(path)
    for joint in spec.joints:
        joint.frictionloss = 0.5
    if not islands:
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    return MujocoSimulator.from_spec(spec, robot, origin=path, threads=threads)


def _seconds(simulator: MujocoSimulator) -> float:
    rng = np.random.default_rng(0)
    time_s = np.arange(_STEPS)[:, None] * simulator.timestep_s
    rate, phase = rng.uniform(1.0, 6.0, (_MOTIONS, 1, 7)), rng.uniform(0.0, 6.0, (_MOTIONS, 1, 7))
    command = _POSE + 0.3 * (np.sin(rate * time_s + phase) - np.sin(phase))
    request = RolloutRequest(np.tile(_POSE, (_MOTIONS, 1)), np.zeros((_MOTIONS, 7)), {"position": command})
    started = time.perf_counter()
    simulator.rollout(request)
    return time.perf_counter() - started
