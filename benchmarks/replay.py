"""Replay of logged commands against raw `mujoco.rollout` of the same steps."""

from __future__ import annotations

import time
from statistics import median

import numpy as np
from mujoco import MjData, rollout

from benchmarks.table import Row, at_least, shown
from trueup.lab import record_demo
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator, ReplaySettings, replay

_ROUNDS = 7
_REPEAT = 8  # copies of the demo's twelve motions of 10 s


def run() -> list[Row]:
    """Replay rate as a share of raw rollouts, on one and two threads, in alternation."""
    robot = load_robot("demo_arm")
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    episodes = list(record_demo()) * _REPEAT
    settings = ReplaySettings.of(robot)
    steps = sum(round(episode.measured.duration_s / simulator.timestep_s) for episode in episodes)
    rows = []
    for threads in (1, 2):
        raw, ours = [], []
        for _ in range(_ROUNDS):
            raw.append(_raw(simulator, episodes, threads))
            started = time.perf_counter()
            for _, series in replay(episodes, simulator.clone, settings, jobs=threads):
                assert len(series) > 0
            ours.append(time.perf_counter() - started)
        rows.append(shown(f"replay, {threads} threads", steps / median(ours) / 1e3, "1000 steps/s"))
        share = median(np.divide(raw, ours))
        rows.append(at_least(f"replay / raw mujoco.rollout, {threads} threads", share, 0.9, "x"))
    return rows


def _raw(simulator: MujocoSimulator, episodes: list, threads: int) -> float:
    """Seconds for the same model, motions and steps, as one batch with its commands ready."""
    model = simulator.model
    steps = round(episodes[0].measured.duration_s / simulator.timestep_s)
    data = [MjData(model) for _ in range(threads)]
    states = np.zeros((len(episodes), 1 + model.nq + model.nv + model.na))
    control = np.zeros((len(episodes), steps, model.nu))
    for row, episode in enumerate(episodes):
        states[row, 1 : 1 + model.nq] = episode.measured["position"][0]
        grid = np.arange(steps) * simulator.timestep_s
        held = np.searchsorted(episode.commanded().time_s, grid + 1e-9, side="right") - 1
        control[row] = episode.commanded()["position"][np.maximum(held, 0)]
    started = time.perf_counter()
    rollout.rollout(model, data, states, control)
    return time.perf_counter() - started
