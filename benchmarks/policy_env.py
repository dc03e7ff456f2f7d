"""Reaching as reinforcement sees it, beside bare stepping of the same model.

A control step is 20 physics steps of 1 ms. Blocks take turns, and ratios are medians over them: a machine that is busy
with other things slows both down. Bare is `mujoco.batch` with the same torques for one arm and for many; a loop around
`mujoco.mj_step` stands beside it.

    python -m benchmarks policy_env
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import mujoco
import numpy as np
from mujoco import batch

from benchmarks.table import Row, at_least, shown
from trueup.policy.arms import MujocoArms
from trueup.policy.environment import PandaReach, ReachVector
from trueup.policy.reach import ReachConfig
from trueup.policy.reaching import Reaching
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator

BAR, THREADS_BAR = 0.7, 1.7
ARMS = 16
_BLOCKS, _STEPS = 15, 60
_CONFIG = ReachConfig()

Block = Callable[[], None]


def run() -> list[Row]:
    """Half a minute."""
    robot = load_robot("panda_torque")
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    substeps = round(_CONFIG.control_s / simulator.timestep_s)
    torque = 0.3 * np.array(_CONFIG.torque_nm)
    blocks: dict[str, Block] = {
        "one arm: environment": _single(torque),
        "one arm: mujoco.batch": _bare(simulator, 1, 1, torque, substeps),
        "one arm: mujoco.mj_step": _loop(simulator, torque, substeps),
    }
    for threads in (1, 2):
        said = f"{ARMS} arms, {threads} thread{'s' if threads > 1 else ''}"
        blocks[f"{said}: environment"] = _vector(simulator, threads, torque)
        blocks[f"{said}: mujoco.batch"] = _bare(simulator, ARMS, threads, torque, substeps)
    seconds = _in_turns(blocks)
    rows = []
    for said, arms in (("one arm", 1), (f"{ARMS} arms, 1 thread", ARMS), (f"{ARMS} arms, 2 threads", ARMS)):
        own, bare = seconds[f"{said}: environment"], seconds[f"{said}: mujoco.batch"]
        rows.append(at_least(f"{said}: environment over bare stepping", float(np.median(bare / own)), BAR, "x"))
        rows.append(shown(f"{said}: environment", arms * _STEPS / float(np.median(own)), "steps/s"))
    loop = seconds["one arm: mujoco.mj_step"]
    rows.append(shown("one arm: mujoco.mj_step", _STEPS / float(np.median(loop)), "steps/s"))
    one, two = (seconds[f"{ARMS} arms, {threads}: environment"] for threads in ("1 thread", "2 threads"))
    rows.append(at_least("two threads over one", float(np.median(one / two)), THREADS_BAR, "x"))
    return rows


def _in_turns(blocks: Mapping[str, Block]) -> dict[str, np.ndarray]:
    """Name -> seconds of each block."""
    seconds: dict[str, list[float]] = {name: [] for name in blocks}
    for number in range(_BLOCKS + 2):
        for name, block in blocks.items():
            began = time.perf_counter()
            block()
            if number >= 2:  # after everything is compiled and warm
                seconds[name].append(time.perf_counter() - began)
    return {name: np.array(own) for name, own in seconds.items()}


def _single(torque: np.ndarray) -> Block:
    env = PandaReach()
    action = torque.astype(np.float32)

    def block() -> None:
        env.reset(seed=0)
        for _ in range(_STEPS):
            env.step(action)

    return block


def _vector(simulator: MujocoSimulator, threads: int, torque: np.ndarray) -> Block:
    arms = MujocoArms(simulator, ARMS, _CONFIG.control_s, threads=threads)
    vector = ReachVector(Reaching(arms, simulator.model, _CONFIG), seed=0)
    actions = np.tile(torque, (ARMS, 1))

    def block() -> None:
        vector.reset()
        for _ in range(_STEPS):
            vector.step_async(actions)
            vector.step_wait()

    return block


def _bare(simulator: MujocoSimulator, count: int, threads: int, torque: np.ndarray, substeps: int) -> Block:
    made = batch.Batch(simulator.model, nsim=count, nthread=threads)
    places, _ = simulator.places
    home = simulator.model.key("home").qpos[places]

    def block() -> None:
        made.reset()
        made.bind("qpos")[:, places] = home
        made.bind("ctrl")[:] = torque
        for _ in range(_STEPS):
            made.step(nstep=substeps)

    return block


def _loop(simulator: MujocoSimulator, torque: np.ndarray, substeps: int) -> Block:
    data = mujoco.MjData(simulator.model)
    home = simulator.model.key("home").qpos

    def block() -> None:
        mujoco.mj_resetData(simulator.model, data)
        data.qpos[:], data.ctrl[:] = home, torque
        for _ in range(_STEPS):
            mujoco.mj_step(simulator.model, data, substeps)

    return block
