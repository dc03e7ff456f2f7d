"""Robots side by side as reinforcement sees them, beside bare stepping of the same models; and what PPO makes of it.

The upper body with 0, 1, 2 and 3 kg at 50 Hz, ten physics steps of 2 ms each. Blocks of the environment and of bare
loops take turns: the bare ones begin in the same states and send the same commands. Ratios are medians over the blocks:
a machine that is busy with other things slows both down. Bare are `mujoco.batch`, which keeps the robots' states, and
`mujoco.rollout`, which is given them; the bar is held against the faster one.

Writes `benchmarks/results/compensate_env.json`.

    python -m benchmarks compensate_env
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from mujoco import batch, rollout

from benchmarks.table import Row, at_least, rounded, shown
from trueup.compensate.config import METHODS
from trueup.compensate.correctors import corrector_for
from trueup.compensate.environment import TrackingEnvironment
from trueup.compensate.linear import Linear
from trueup.compensate.ppo import train_ppo
from trueup.compensate.ppo_config import PpoConfig
from trueup.compensate.tracks import Track
from trueup.compensate.windows import Windows
from trueup.core.atomic import make_folder, write_json
from trueup.core.provenance import provenance
from trueup.robots import Setup, find_model, load_robot
from trueup.sim import MujocoSimulator
from trueup.sim.transitions import Transitions
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "compensate_env.json"
BAR = 0.8
ROBOTS, THREADS = (128, 512), (1, 2)
PAYLOADS = (0.0, 1.0, 2.0, 3.0)
CONTROL_S = 0.02
_BLOCKS, _STEPS = 9, 8
_LENGTH, _OF_EACH, _PAST = 300, 3, 4
_SIZE_RAD = 0.03
_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
_ITERATIONS = 4

Block = Callable[[], None]


def run() -> list[Row]:
    """Two minutes. Writes the result file."""
    torch.set_num_threads(1)
    load = list(os.getloadavg())
    tracks = _tracks()
    stepping = {
        str(robots): {str(threads): _stepping(tracks, robots, threads) for threads in THREADS} for robots in ROBOTS
    }
    learning = _learning(tracks)
    machine = {"name": machine_name(), "load_before": load, "load_after": list(os.getloadavg())}
    packages = {name: metadata.version(name) for name in ("mujoco", "stable-baselines3", "torch")}
    result = {
        "schema": "trueup.compensate-env/1",
        "stepping": stepping,
        "learning": learning,
        "provenance": provenance(config={"packages": packages, "machine": machine, "blocks": _BLOCKS}, seed=0),
    }
    make_folder(RESULT.parent)
    write_json(RESULT, rounded(result))
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The rows of a result."""
    rows = []
    for robots, by_threads in result["stepping"].items():
        for threads, found in by_threads.items():
            title = f"{robots} robots, {threads} thread{'s' if threads != '1' else ''}"
            rows.append(at_least(f"{title}: environment over bare stepping", found["ratio"], BAR, "x"))
            rows += [shown(f"{title}: {name}", own, "steps/s") for name, own in found["steps_per_s"].items()]
    learning = result["learning"]
    rows.append(shown("PPO, one thread", learning["samples_per_s"], "samples/s"))
    rows.append(shown("PPO, one thread, of processor time", learning["samples_per_cpu_s"], "samples/s"))
    rows.append(shown("share of the environment in it", learning["environment_share"], ""))
    return rows


@cache
def _transitions(payload_kg: float, threads: int = 1) -> Transitions:
    robot = load_robot("upper_body")
    simulator = MujocoSimulator.from_robot(robot, find_model(robot), setup=Setup(payload_kg), threads=threads)
    return Transitions(simulator, CONTROL_S)


def _tracks() -> list[Track]:
    """Smooth motions of a robot that is the simulator with other commands."""
    made = []
    for number, payload_kg in enumerate(np.repeat(PAYLOADS, _OF_EACH).tolist()):
        own, rng = _transitions(payload_kg), np.random.default_rng(number)
        limits = np.array([own.simulator.position_limits[joint] for joint in own.joints])
        time_s = np.arange(_LENGTH) * CONTROL_S
        waves = np.sin(rng.uniform(0.5, 2.5, len(limits)) * time_s[:, None] + rng.uniform(0, 6, len(limits)))
        command = limits.mean(axis=1) + 0.35 * np.ptp(limits, axis=1) * waves
        sent = command + 0.05 * np.roll(waves, 1, axis=1)
        state = [np.concatenate([sent[0], np.zeros(len(limits))])]
        for row in range(_LENGTH - 1):
            state.append(own.next(state[-1][None], sent[max(row - 1, 0)][None], sent[row][None])[0])
        made.append(Track(f"m{number}", payload_kg, np.array(state, np.float32), command.astype(np.float32), time_s))
    return made


def _stepping(tracks: list[Track], robots: int, threads: int) -> dict[str, Any]:
    environment = TrackingEnvironment(
        tracks,
        lambda payload_kg: _transitions(payload_kg, threads),
        PpoConfig(robots=robots),
        past=_PAST,
        scale=np.full(10, _SIZE_RAD),
    )
    environment.reset()
    rng = np.random.default_rng(0)
    took: dict[str, list[float]] = {}
    for _ in range(_BLOCKS + 1):
        actions = rng.normal(size=(_STEPS, robots, 10)).astype(np.float32)
        models = [_transitions(kg, threads).simulator.model for kg in environment.payload_kg.tolist()]
        start, commands = _rehearsed(environment, tracks, actions)
        blocks: dict[str, Block] = {
            "mujoco.batch": _batched(models, start, commands, threads),
            "mujoco.rollout": _rolled(models, start, commands, threads),
            "environment": lambda actions=actions: _acted(environment, actions),
        }
        for name, block in blocks.items():
            began = time.perf_counter()
            block()
            took.setdefault(name, []).append(time.perf_counter() - began)
    # The first block of each warms up.
    seconds = {name: np.array(own[1:]) for name, own in took.items()}
    bare = [name for name in seconds if name != "environment"]
    ratios = {name: float(np.median(seconds[name] / seconds["environment"])) for name in bare}
    return {
        "ratio": min(ratios.values()),
        "ratios": ratios,
        "steps_per_s": {name: _STEPS * robots / float(np.median(own)) for name, own in seconds.items()},
    }


def _acted(environment: TrackingEnvironment, actions: np.ndarray) -> None:
    for action in actions:
        environment.step_async(action)
        environment.step_wait()


def _rehearsed(
    environment: TrackingEnvironment, tracks: list[Track], actions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """States of the robots now, (N, 2J), and the commands that these actions will be, (K, N, J)."""
    memory, joints = environment.memory(), actions.shape[2]
    whole = np.concatenate([track.command for track in tracks])
    rows = np.minimum(memory["at"] + np.arange(len(actions))[:, None], len(whole) - 1)
    return memory["window"][:, -1, : 2 * joints], whole[rows] + np.clip(_SIZE_RAD * actions, -0.5, 0.5)


def _batched(models: list[mujoco.MjModel], start: np.ndarray, commands: np.ndarray, threads: int) -> Block:
    """By one call of `mujoco.batch` for all models of the same sizes, nothing else."""
    joints, parts = commands.shape[2], []
    for bodies in dict.fromkeys(model.nbody for model in models):
        rows = np.array([row for row, model in enumerate(models) if model.nbody == bodies])
        own = batch.Batch(models[rows[0]], nsim=len(rows), nthread=threads)
        own.set_models([models[row] for row in rows])
        own.bind("qpos")[:], own.bind("qvel")[:] = start[rows, :joints], start[rows, joints:]
        parts.append((own, own.bind("ctrl"), commands[:, rows]))
    steps = _transitions(0.0).steps

    def block() -> None:
        for step in range(_STEPS):
            for own, control, sent in parts:
                control[:] = sent[step]
                own.step(nstep=steps)

    return block


def _rolled(models: list[mujoco.MjModel], start: np.ndarray, commands: np.ndarray, threads: int) -> Block:
    """By one call of `mujoco.rollout` likewise, into arrays that are there already."""
    joints, steps, parts = commands.shape[2], _transitions(0.0).steps, []
    for bodies in dict.fromkeys(model.nbody for model in models):
        rows = np.array([row for row, model in enumerate(models) if model.nbody == bodies])
        own = [models[row] for row in rows]
        state = np.zeros((len(rows), mujoco.mj_stateSize(own[0], _FULL)))
        state[:, 1 : 1 + 2 * joints] = start[rows]
        after = np.empty((len(rows), steps, state.shape[1]))
        sensors = np.empty((len(rows), steps, own[0].nsensordata))
        parts.append((own, [mujoco.MjData(own[0]) for _ in range(threads)], state, commands[:, rows], after, sensors))

    def block() -> None:
        with rollout.Rollout(nthread=threads if threads > 1 else 0) as pool:
            for step in range(_STEPS):
                for own, data, state, sent, after, sensors in parts:
                    held = np.repeat(sent[step][:, None], steps, axis=1)
                    pool.rollout(own, data, state, held, state=after, sensordata=sensors)
                    state[:] = after[:, -1]

    return block


def _learning(tracks: list[Track]) -> dict[str, float]:
    """Default network and configuration, and how much of it is the environment's."""
    config = METHODS["operator"]
    zeros = (np.zeros((_LENGTH - 1, *shape), np.float32) for shape in ((20,), (20, 20), (20, 10), (20, 10)))
    parts = [Linear(track, *own) for own in [tuple(zeros)] for track in tracks]
    torch.manual_seed(0)
    corrector = corrector_for(config, Windows(parts, _PAST), rate_hz=1 / CONTROL_S, size=_SIZE_RAD)
    own = config.ppo
    own = replace(own, samples=_ITERATIONS * own.robots * own.steps)
    history = train_ppo(corrector, tracks, _transitions, own)[1:]
    seconds, cpu_seconds = (sum(getattr(line.effort, name) for line in history) for name in ("seconds", "cpu_seconds"))
    samples = len(history) * own.robots * own.steps
    environment = TrackingEnvironment(tracks, _transitions, own, past=_PAST, scale=np.full(10, _SIZE_RAD))
    environment.reset()
    actions = np.random.default_rng(0).normal(size=(own.steps, own.robots, 10)).astype(np.float32)
    began = time.process_time()
    _acted(environment, actions)
    alone = (time.process_time() - began) / (own.robots * own.steps)
    return {
        "samples_per_s": samples / seconds,
        "samples_per_cpu_s": samples / cpu_seconds,
        "environment_share": alone * samples / cpu_seconds,
    }
