"""The virtual robot with all effects: compiled trajectories and the face of a driver, beside MuJoCo's bare step."""

from __future__ import annotations

import time
from statistics import median

import mujoco
import numpy as np

from benchmarks.table import Row, at_least, shown
from trueup.lab import LabSpec, VirtualRobot, draw_truth
from trueup.robots import find_model, load_robot

_ROUNDS = 5
_STEPS, _DRIVEN = 10_000, 2_000  # control steps


def run() -> list[Row]:
    """Physics steps per second of one core, in alternation with `mj_step` on the same arm from a Python loop.

    Processor time is counted: other work on the machine does not enter.
    """
    robots = {
        "all effects": VirtualRobot(),
        "all effects, rigid joints": VirtualRobot(draw_truth(LabSpec().without("elasticity"))),
        "no effects": VirtualRobot(draw_truth(LabSpec().only())),
    }
    command = _motion(robots["all effects"].read()["position"])
    for robot in robots.values():
        robot.execute({"position": command[:100]})  # compiles
    rates = np.array(
        [[*(_executed(r, command) for r in robots.values()), _driven(command), _bare()] for _ in range(_ROUNDS)]
    )
    rate = {name: median(rates[:, column]) / 1e3 for column, name in enumerate([*robots, "driven", "bare"])}
    return [
        shown("panda, mj_step in a Python loop", rate["bare"], "1000 steps/s"),
        at_least("lab, all effects, a trajectory at once", rate["all effects"], 100.0, "1000 steps/s"),
        shown("lab, all effects, rigid joints", rate["all effects, rigid joints"], "1000 steps/s"),
        shown("lab, no effects", rate["no effects"], "1000 steps/s"),
        shown("lab, all effects / mj_step", median(rates[:, 0] / rates[:, -1]), "x"),
        shown("lab, write, wait, read at every control step", rate["driven"], "1000 control steps/s"),
    ]


def _motion(home: np.ndarray) -> np.ndarray:
    time_s = np.arange(_STEPS)[:, None] * 1e-3
    return home + 0.2 * (1 - np.cos(np.linspace(1.0, 3.0, 7) * time_s))


def _executed(robot: VirtualRobot, command: np.ndarray) -> float:
    robot.place(command[0])
    started = time.process_time()
    robot.execute({"position": command}, every=10)
    spec = robot.truth.spec
    return len(command) * spec.control_step_s / spec.physics_step_s / (time.process_time() - started)


def _driven(command: np.ndarray) -> float:
    robot = VirtualRobot(position=command[0])
    robot.wait_until_s(0.01)
    start = robot.now_s()
    started = time.process_time()
    for row in range(_DRIVEN):
        robot.write({"position": command[row]})
        robot.wait_until_s(start + (row + 1) * robot.control_step_s)
        robot.read()
    return _DRIVEN / (time.process_time() - started)


def _bare() -> float:
    model = mujoco.MjModel.from_xml_path(str(find_model(load_robot("panda"))))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    model.body_gravcomp[:] = 1.0
    started = time.process_time()
    for _ in range(_STEPS):
        mujoco.mj_step(model, data)
    return _STEPS / (time.process_time() - started)
