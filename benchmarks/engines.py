"""DART's step rate beside MuJoCo's: the same Panda, controller, commands and numbers, side by side on one core."""

from __future__ import annotations

import time
from dataclasses import replace
from statistics import median

import numpy as np

from benchmarks.table import Row, shown
from trueup.core.protocols import RolloutRequest
from trueup.robots import ControllerSpec, find_model, load_robot
from trueup.robots.model import load_spec
from trueup.sim import DartSimulator, MujocoSimulator

_ROUNDS = 5
_STEPS = 500
_POSE = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])


def run() -> list[Row]:
    """Steps per second of both engines in alternation: one motion and a batch, without and with dry friction.

    There is no bar: a step of DART goes through Python once, and how much that weighs depends on the batch.
    """
    rows = []
    for friction in (0.0, 0.5):
        dart, mujoco = _engines(friction)
        for motions in (1, 32):
            request = _request(motions)
            seconds = np.array([[_seconds(engine, request) for engine in (dart, mujoco)] for _ in range(_ROUNDS)])
            name = f"panda, {'with' if friction else 'no'} friction, {motions} at once"
            for column, engine in enumerate(("DART", "MuJoCo")):
                rate = motions * _STEPS / median(seconds[:, column]) / 1e3
                rows.append(shown(f"{name}, {engine}", rate, "1000 steps/s"))
            rows.append(shown(f"{name}, DART / MuJoCo", median(seconds[:, 1] / seconds[:, 0]), "x"))
            apart = np.abs(dart.rollout(request).position - mujoco.rollout(request).position).max()
            rows.append(shown(f"{name}, largest difference", apart, "rad"))
    return rows


def _engines(friction: float) -> tuple[DartSimulator, MujocoSimulator]:
    robot = replace(load_robot("panda_torque"), controller=ControllerSpec(kind="position", kp=600.0, kv=50.0))
    path = find_model(robot)
    spec = load_spec(path)
    for joint in spec.joints:
        joint.frictionloss = friction
    mujoco = MujocoSimulator.from_spec(spec, robot, origin=path)
    return DartSimulator(mujoco.model, mujoco.robot, mujoco.channels), mujoco


def _request(motions: int) -> RolloutRequest:
    rng = np.random.default_rng(0)
    time_s = np.arange(_STEPS)[:, None] * 0.001
    rate, phase = rng.uniform(1.0, 6.0, (motions, 1, 7)), rng.uniform(0.0, 6.0, (motions, 1, 7))
    command = _POSE + 0.3 * (np.sin(rate * time_s + phase) - np.sin(phase))
    return RolloutRequest(np.tile(_POSE, (motions, 1)), np.zeros((motions, 7)), {"position": command})


def _seconds(engine: DartSimulator | MujocoSimulator, request: RolloutRequest) -> float:
    started = time.perf_counter()
    engine.rollout(request)
    return time.perf_counter() - started
