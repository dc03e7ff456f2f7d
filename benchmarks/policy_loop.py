"""A policy in a control loop of 1 kHz: what a tick takes, and how many come in time.

The policy of the zoo on virtual hardware: guard and policy alone, whole ticks as fast as they go, and ten seconds in
real time on whatever machine this is.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

import trueup.zoo
from benchmarks.table import Row, at_most, shown
from trueup.core.policy_card import PolicyCard
from trueup.deploy.guard import Guard
from trueup.deploy.policy import Policy
from trueup.deploy.policy_loop import PolicyLoop
from trueup.lab import LabSpec, VirtualRobot, draw_truth
from trueup.lab.spec import Controller
from trueup.policy.reaching import home_of
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator
from trueup.stages.policy_driving import guard_settings

_POLICY = "panda-reach"
_TICKS, _SECONDS = 5_000, 10.0
_GOAL = np.array([0.4, 0.2, 0.5])
# Of a tick of 1 ms, what computing may take.
BAR_US = 200.0


def run() -> list[Row]:
    """Time the parts, then the whole in real time."""
    robot = load_robot("panda_torque")
    model = MujocoSimulator.from_robot(robot, find_model(robot)).model
    folder = trueup.zoo.folder(_POLICY)
    card = PolicyCard.load(folder)
    policy = Policy.load(folder, joints=robot.joint_names, rate_hz=card.rate_hz)
    settings = replace(guard_settings(card, robot, model), late_s=10.0)
    home, still = home_of(model, robot.joint_names), np.zeros(len(robot.joints))
    guard, place = Guard(settings, 0.001), policy.place(home).copy()
    rows = []
    for name, call in {
        "guard": lambda: guard.tick(still, home, still, place),
        "policy": lambda: policy.step(home, still, _GOAL),
    }.items():
        taken = _taken(call)
        rows.append(shown(f"{name}: p50", float(np.quantile(taken, 0.5)), "us"))
        rows.append(shown(f"{name}: p99", float(np.quantile(taken, 0.99)), "us"))
    spec = replace(LabSpec(), controller=Controller(kind="torque"))
    loop = PolicyLoop(VirtualRobot(draw_truth(spec, unit=1)), policy, settings)
    loop.run(_GOAL, 0.5)
    began = time.perf_counter()
    done = loop.run(_GOAL, 4.0)
    rows.append(shown("as fast as it goes", len(done.time_s) / (time.perf_counter() - began), "ticks/s"))
    real = VirtualRobot(draw_truth(spec, unit=1), real_time=True)
    report = PolicyLoop(real, policy, settings, real_time=True).run(_GOAL, _SECONDS).report
    rows.append(at_most("in real time: a tick, p99", report.step.percentile_us(99.0), BAR_US, "us"))
    rows.append(shown("in real time: ticks not in time", 100 * report.overruns / report.cycles, "%"))
    return rows


def _taken(call: object) -> np.ndarray:
    """Microseconds of each call."""
    assert callable(call)
    for _ in range(100):
        call()
    taken = np.empty(_TICKS)
    for number in range(_TICKS):
        began = time.perf_counter()
        call()
        taken[number] = 1e6 * (time.perf_counter() - began)
    return taken
