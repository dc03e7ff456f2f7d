"""Motions of a dataset in the simulator that a network corrects, stored as a run."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from trueup.align import JointMap
from trueup.core.hold import SAME_INSTANT_S
from trueup.core.interpolation import columns_at
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, RunWriter, refuse_run
from trueup.errors import DataError, TrueupError, needing
from trueup.robots import RobotSpec, refuse_other_gains
from trueup.stages.compensating import motion_of, network_for_simulator, units_of
from trueup.stages.progress import Track, silent
from trueup.stages.replaying import ReplaySummary
from trueup.stages.robot_model import model_file

if TYPE_CHECKING:
    from trueup.augment.corrector import Corrector
    from trueup.compensate.closed_loop import Run
    from trueup.compensate.plants import Plants
    from trueup.compensate.tracks import Track as Motion

# Motions side by side.
_AT_ONCE = 64


def compensated_replay(
    dataset: Dataset,
    robot: RobotSpec,
    network: Path | str,
    *,
    model: Path | None = None,
    label: str | None = None,
    ids: Sequence[str] | None = None,
    jobs: int | None = None,
    overwrite: bool = False,
    track: Track = silent,
) -> ReplaySummary:
    """Replay the commands of a dataset in the simulator that a network corrects, and store what it does as a run.

    Args:
        dataset: logs with commands at the network's rate.
        robot: whose simulator the network was trained to correct.
        network: its folder.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        label: name of the run; that of the simulator with the network's name added if None.
        ids: episodes; all if None.
        jobs: threads; the number of cores if None.
        overwrite: replace the run if it is there.
        track: shows progress.

    Raises:
        OutputExists: the run is there.
        ConfigError: the network corrects the robot, not its simulator, or motions were recorded with other position
            gains than the robot's.
        NameMismatch: network and robot do not have the same joints.
        DataError: no episode could be replayed.
        MissingDependency: torch is not installed.
    """
    with needing("a network that corrects commands", "learn"):
        from trueup.compensate.plants import Plants

    began = time.perf_counter()
    compensation = network_for_simulator(Path(network), robot)
    card = compensation.card
    label = label or f"{card.run}+{card.name}"
    refuse_run(dataset.path, label, allowed=overwrite)
    path = model_file(robot, dataset, given=model)
    plants = Plants(robot, path, 1.0 / card.rate_hz, threads=jobs or os.cpu_count() or 1)
    joint_map = JointMap.from_dict(robot.joint_rules())
    names = tuple(dataset.ids if ids is None else ids)
    refuse_other_gains(robot, (dataset.meta(name) for name in names), what="a replay with a compensation")
    motions: dict[str, Motion] = {}
    failed: dict[str, TrueupError] = {}
    for name in names:
        try:
            motions[name] = motion_of(dataset, joint_map, name, robot, 1.0 / card.rate_hz)
        except TrueupError as error:
            failed[name] = error
    info = {
        "engine": "mujoco",
        "inputs": {
            "robot": robot.to_dict(),
            "model_sha256": plants(0.0).simulator.fingerprint,
            "network": card.to_json()["sha256"],
        },
        "joint_map": robot.joint_rules(),
        "joints": list(robot.joint_names),
        "scored_joints": list(robot.scored_joints),
        "command_signal": robot.controller.signal,
        "torque_limits": plants(0.0).simulator.torque_limits,
        "provenance": provenance(config={"network": card.to_json()["sha256"]}, data_hash=dataset.hash),
    }
    held = plants(0.0).simulator.holding.notes
    if held:
        info["notes"] = list(held)
    # Under torques alone, simulations go their own way: they are gone back as a plain replay does.
    window_s = robot.replay.window_s if robot.controller.signal == "torque" else None
    rows = None if window_s is None else round(window_s * card.rate_hz)
    done = 0
    units = units_of(dataset, robot)
    with contextlib.ExitStack() as stack:
        writer = None
        for chunk in track(_chunks(list(motions)), "compensate", -(-len(motions) // _AT_ONCE)):
            runs = _simulated({name: motions[name] for name in chunk}, plants, compensation.corrector, failed, rows)
            if writer is None and runs:
                writer = stack.enter_context(RunWriter(dataset.path, label, run_info=info, overwrite=overwrite))
            for name, own in runs.items():
                assert writer is not None
                measured = joint_map.of_episode(dataset.episode(name)).measured
                writer.append(name, _series(motions[name], own, measured.time_s, robot.joint_names, units))
                done += 1
        if writer is not None:
            writer.update_info({**info, "seconds": time.perf_counter() - began})
    dataset.reload()
    if not done:
        name, first = next(iter(failed.items()))
        raise DataError(f"no episode could be replayed, {name!r} because: {first.summary}", hint=first.hint)
    return ReplaySummary(label, done, 0, failed, time.perf_counter() - began, model_notes=held)


def _simulated(
    motions: Mapping[str, Motion],
    plants: Plants,
    corrector: Corrector,
    failed: dict[str, TrueupError],
    rows: int | None,
) -> dict[str, Run]:
    """Motions side by side, in pieces of so many control steps, if not whole; each by itself where one goes wrong."""
    from trueup.compensate.closed_loop import Run, closed_loop

    pieces = {name: [motion] if rows is None else motion.pieces(rows) for name, motion in motions.items()}
    try:
        done = iter(closed_loop([piece for own in pieces.values() for piece in own], plants, corrector))
        runs = {name: [next(done) for _ in own] for name, own in pieces.items()}
        return {
            name: Run(
                np.concatenate([*(run.state[:-1] for run in own), own[-1].state[-1:]]),
                np.concatenate([*(run.delta[:-1] for run in own), own[-1].delta[-1:]]),
            )
            for name, own in runs.items()
        }
    except TrueupError as error:
        if len(motions) == 1:
            failed |= dict.fromkeys(motions, error)
            return {}
    return {
        name: run
        for key in motions
        for name, run in _simulated({key: motions[key]}, plants, corrector, failed, rows).items()
    }


def _chunks(names: Sequence[str]) -> list[list[str]]:
    return [list(names[start : start + _AT_ONCE]) for start in range(0, len(names), _AT_ONCE)]


def _series(
    motion: Motion, run: Run, stamps: Float64[np.ndarray, "M"], joints: Sequence[str], units: Sequence[str]
) -> TimeSeries:
    """What was simulated, at the robot's own stamps."""
    rows = (stamps >= motion.time_s[0] - SAME_INSTANT_S) & (stamps <= motion.time_s[-1] + SAME_INSTANT_S)
    count = len(joints)
    position, velocity = np.split(columns_at(stamps[rows], motion.time_s, run.state), [count], axis=1)
    speeds = tuple(f"{unit}/s" for unit in units)
    return TimeSeries(
        stamps[rows],
        tuple(joints),
        {"position": position, "velocity": velocity},
        {"position": tuple(units), "velocity": speeds},
    )
