"""Replay: the commands of a dataset through a simulator, the answer stored beside the measurement."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueup.align import JointMap
from trueup.core.atomic import as_read_back
from trueup.core.provenance import other_versions, provenance
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, RunWriter, refuse_run
from trueup.errors import DataError, OutputExists, TrueupError
from trueup.robots import AS_DESCRIBED, RobotSpec, Setup, refuse_unknown_gains, setup_of
from trueup.stages.progress import Track, silent
from trueup.stages.replay_parts import PART, ReplayPart, readable, replayed_on_ray
from trueup.stages.robot_model import model_file

if TYPE_CHECKING:
    from trueup.sim import DartSimulator, MujocoSimulator

STOCK = "mujoco/stock"


@dataclass(frozen=True)
class ReplaySummary:
    """What a replay did.

    Attributes:
        label: the run.
        replayed: number of episodes simulated now.
        kept: number of episodes that the run had already.
        failed: episode id -> why it could not be replayed.
        seconds: wall-clock time that it took to make the run, earlier calls included [s].
        replaced: whether there was a run of this label that was made of something else.
        model_notes: what of the model is held in the simulation, swings in it, or is left out.
        command_notes: what is done with commands that might be meant otherwise, which `gap` does not say.
    """

    label: str
    replayed: int
    kept: int = 0
    failed: Mapping[str, TrueupError] = field(default_factory=dict)
    seconds: float = 0.0
    replaced: bool = False
    model_notes: tuple[str, ...] = ()
    command_notes: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """All that a user should know of how the model is simulated."""
        return (*self.model_notes, *self.command_notes)


def replay(
    dataset: Dataset,
    robot: RobotSpec,
    *,
    model: Path | None = None,
    engine: str = "mujoco",
    label: str | None = None,
    window_s: float | None = None,
    delay_s: float | None = None,
    ids: Sequence[str] | None = None,
    jobs: int | None = None,
    ray: str | None = None,
    overwrite: bool = False,
    resume: bool = False,
    track: Track = silent,
) -> ReplaySummary:
    """Replay the commands of a dataset and store the simulated motions as a run of it.

    Args:
        dataset: logs; any joint names that the robot's joint map knows.
        robot: its description.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        engine: `mujoco`, `dart` or `warp`.
        label: name of the run; `ENGINE/stock` if None.
        window_s: restart from the measured state this often [s]; the robot's own setting if None.
        delay_s: the command acts this much later [s]; the robot's own setting if None.
        ids: episodes; all if None.
        jobs: threads (DART: processes); the number of cores if None. On a cluster, parts of the dataset at a time.
        ray: address of a Ray cluster, `local` for one on this machine, whose machines find dataset and model in the
            same folders; this process if None.
        overwrite: replace the run if it is there.
        resume: keep the run if it was made from the same inputs by the same versions, and add what is missing.
        track: shows progress.

    Raises:
        OutputExists: the run is there, and neither `overwrite` nor a matching `resume` applies.
        NameMismatch: the joints of log, robot and model do not agree.
        ConfigError: motions were recorded at several settings of the position gain, and nobody has said which is the
            robot's; the model is not found, or does not load, or the engine is not there or cannot match it, or no
            cluster answers, or a worker of it has another model or engine.
        DataError: there is no episode, or none could be replayed.
    """
    label = f"{engine}/stock" if label is None else label
    # MuJoCo is loaded by those who simulate, not by everyone who starts the command line.
    from trueup.sim import ReplaySettings, make_simulator
    from trueup.sim import replay as replay_episodes

    started = time.perf_counter()
    path = model_file(robot, dataset, given=model)
    settings = ReplaySettings.of(robot)
    settings = replace(
        settings,
        window_s=settings.window_s if window_s is None else window_s,
        delay_s=settings.delay_s if delay_s is None else delay_s,
    )
    simulator = make_simulator(engine, robot, path)
    inputs = _inputs(robot, simulator, settings.to_dict())
    info = {
        "engine": engine,
        "inputs": inputs,
        "joint_map": robot.joint_rules(),
        "joints": list(robot.joint_names),
        "scored_joints": list(robot.scored_joints),
        "command_signal": robot.controller.signal,
        "torque_limits": simulator.torque_limits,
        "settings": settings.to_dict(),
        "provenance": provenance(config={"robot": robot.to_dict(), "model": path.name}, data_hash=dataset.hash),
    }
    from trueup.robots.model import lost_meshes

    model_notes = (*simulator.holding.notes, *filter(None, [lost_meshes(path)]))
    if model_notes:
        info["notes"] = list(model_notes)
    refuse_run(dataset.path, label, allowed=overwrite or resume)
    earlier_s = 0.0
    keeping = label in dataset.runs and resume and not overwrite
    if keeping:
        _refuse_other_inputs(dataset, label, inputs)
        earlier_s = float(dataset.run_info(label).get("seconds", 0.0))
    joint_map = JointMap.from_dict(robot.joint_rules())
    wanted = tuple(dataset.ids if ids is None else ids)
    if not wanted:
        raise DataError(f"{dataset.path} has no episodes", hint="Record or import some first.")
    failed: dict[str, TrueupError] = {}
    _refuse_other_names(dataset, wanted, joint_map)
    refuse_unknown_gains(robot, (dataset.meta(name) for name in wanted))
    with contextlib.ExitStack() as stack:
        writer = None
        if keeping:
            writer = stack.enter_context(RunWriter(dataset.path, label, run_info=info, resume=True))
        missing = [name for name in wanted if writer is None or name not in writer.ids]
        results: Iterator[tuple[str, TimeSeries | TrueupError]]
        if ray is not None:
            there = path.resolve()
            parts = (
                ReplayPart(
                    *(dataset.path.resolve(), tuple(names[first : first + PART]), robot, there, engine),
                    *(fingerprint, setup, settings),
                )
                for setup, names in by_setup(dataset, robot, missing)
                for fingerprint in (make_simulator(engine, robot, there, setup=setup).fingerprint,)
                for first in range(0, len(names), PART)
            )
            results = replayed_on_ray(parts, ray, jobs)
        else:
            results = chain.from_iterable(
                replay_episodes(
                    readable(dataset, names, joint_map, failed),
                    (simulator if setup == AS_DESCRIBED else make_simulator(engine, robot, path, setup=setup)).clone,
                    settings,
                    jobs=1 if engine == "warp" else jobs or os.cpu_count() or 1,
                    processes=engine == "dart",
                )
                for setup, names in by_setup(dataset, robot, missing)
            )
        for name, result in track(results, "replay", len(missing)):
            if isinstance(result, TrueupError):
                failed[name] = result
                continue
            if writer is None:  # only now, so that a replay of which nothing comes leaves the run that is there alone
                writer = stack.enter_context(RunWriter(dataset.path, label, run_info=info, overwrite=overwrite))
            writer.append(name, result)
        seconds = earlier_s + (time.perf_counter() - started if missing else 0.0)
        if missing and writer is not None:
            writer.update_info({**info, "seconds": seconds})
    dataset.reload()
    done = len(missing) - len(failed)
    if failed and not done and len(missing) == len(wanted):
        name, first = next(iter(failed.items()))
        raise DataError(f"no episode could be replayed, {name!r} because: {first.summary}", hint=first.hint)
    kept = len(wanted) - len(missing)
    return ReplaySummary(label, done, kept, failed, seconds, model_notes=model_notes, command_notes=simulator.notes)


def replay_unless_same(
    dataset: Dataset,
    robot: RobotSpec,
    *,
    model: Path | None,
    label: str,
    jobs: int | None,
    track: Track = silent,
) -> ReplaySummary:
    """The run of this label, kept if nothing that it was made from has changed, and made again otherwise."""
    try:
        return replay(dataset, robot, model=model, label=label, jobs=jobs, resume=True, track=track)
    except OutputExists:
        done = replay(dataset, robot, model=model, label=label, jobs=jobs, overwrite=True, track=track)
        return replace(done, replaced=True)


def by_setup(dataset: Dataset, robot: RobotSpec, ids: Sequence[str]) -> Iterator[tuple[Setup, list[str]]]:
    """How the robot is in simulations -> the episodes in which it is so."""
    known = {meta.id: setup_of(robot, meta) for meta in dataset.metas}
    for setup in sorted({known[name] for name in ids}):
        yield setup, [name for name in ids if known[name] == setup]


def carried_kg(dataset: Dataset, robot: RobotSpec) -> dict[str, float]:
    """What the robot carries in simulations [kg], of the episodes in which it carries anything.

    The hash of the dataset does not say it.
    """
    setups = {meta.id: setup_of(robot, meta) for meta in dataset.metas}
    return {name: setup.payload_kg for name, setup in setups.items() if setup.payload_kg}


def kp_factors(dataset: Dataset, robot: RobotSpec) -> dict[str, float]:
    """Position gains in simulations per those of the description, of the episodes in which they differ; likewise."""
    setups = {meta.id: setup_of(robot, meta) for meta in dataset.metas}
    return {name: setup.kp_factor for name, setup in setups.items() if setup.kp_factor != 1.0}


def _refuse_other_names(dataset: Dataset, ids: Sequence[str], joint_map: JointMap) -> None:
    """Names that fit no episode are said once, before anything is written."""
    first: TrueupError | None = None
    for name in ids:
        try:
            joint_map.of_episode(dataset.episode(name))
        except TrueupError as error:
            first = first or error
            continue
        return
    if first is not None:
        raise first


def _inputs(
    robot: RobotSpec, simulator: MujocoSimulator | DartSimulator, settings: Mapping[str, Any]
) -> dict[str, Any]:
    """What decides about a motion of a run, beside versions: if it is the same, it need not be simulated again."""
    return {"robot": robot.to_dict(), "model_sha256": simulator.fingerprint, "settings": dict(settings)}


def _refuse_other_inputs(dataset: Dataset, label: str, inputs: Mapping[str, Any]) -> None:
    info, plain = dataset.run_info(label), as_read_back(inputs)
    stored = info.get("inputs", {})
    changed = sorted(key for key in plain if stored.get(key) != plain[key])
    changed += [f"{name} {was}" for name, was in other_versions(info.get("provenance")).items()]
    if changed:
        raise OutputExists(
            f"the run {label!r} was made from other inputs ({', '.join(changed)})",
            hint="Give --overwrite to replace it, or another --label to keep both.",
        )
