"""Compensate: a dataset with commands in, a network out that says what the commands lack; and motions with it."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float64

from trueup.align import JointMap
from trueup.core.atomic import as_read_back, json_hash, make_folder
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, RunWriter, refuse_run
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, TrueupError, needing
from trueup.robots import RobotSpec
from trueup.stages.model_folder import ModelFolder
from trueup.stages.progress import Track, silent
from trueup.stages.replaying import ReplaySummary
from trueup.stages.robot_model import model_file

if TYPE_CHECKING:
    from trueup.augment.checkpoint import Epoch
    from trueup.augment.corrector import Corrector
    from trueup.compensate.closed_loop import Run
    from trueup.compensate.compensation import Compensation
    from trueup.compensate.config import CompensateConfig
    from trueup.compensate.linear import Linear
    from trueup.compensate.plants import Plants
    from trueup.compensate.rounds import Learned
    from trueup.compensate.tracks import Track as Motion
    from trueup.compensate.training import Teacher

# Errors of val motions that choose the round are counted like in training; this many motions of each payload suffice.
_JUDGED = 12
# A first delta action is this large, in units of what is to be corrected.
_SIZE = 0.02
# What a network costs that blows the simulation up: more than any other, and a number that JSON has.
_BLOWN_UP = 1e9


@dataclass(frozen=True)
class PayloadErrors:
    """Errors of val motions with one payload, mean over motions.

    Attributes:
        payload_kg: what is carried [kg].
        motions: how many.
        before: mean absolute error of the positions without compensation [rad or m].
        after: likewise with it.
        p999_before: 99.9 % of the samples are better than this, without.
        p999_after: likewise with it.
    """

    payload_kg: float
    motions: int
    before: float
    after: float
    p999_before: float
    p999_after: float


@dataclass(frozen=True)
class Compensated:
    """What `compensate` made.

    Attributes:
        compensation: the trained network.
        folder: its folder.
        errors: of the val motions, payload by payload.
        seconds: what training took, without preparing [s].
        notes: what was left out.
    """

    compensation: Compensation
    folder: Path
    errors: tuple[PayloadErrors, ...]
    seconds: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Prepared:
    """Motions with their linear models, from which any number of networks can be trained.

    Attributes:
        train: motions that are fitted.
        val: motions that choose.
        plants: the simulators.
        control_s: control step [s].
        data_hash: of the dataset.
        notes: what was left out.
    """

    train: Sequence[Linear]
    val: Sequence[Linear]
    plants: Plants
    control_s: float
    data_hash: str
    notes: tuple[str, ...] = ()


def prepare(
    dataset: Dataset,
    robot: RobotSpec,
    *,
    model: Path | None = None,
    control_hz: float | None = None,
    drop_flagged: bool = False,
    jobs: int | None = None,
    track: Track = silent,
) -> Prepared:
    """Simulate one control step from every measured state of the train and val motions, and differentiate.

    Args:
        dataset: with commanded and measured positions.
        robot: its description; that of an identified robot where there is one.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        control_hz: rate of the commands; that of the first train motion if None.
        drop_flagged: leave out motions with quality warnings.
        jobs: threads; the number of cores if None.
        track: shows progress.

    Raises:
        MissingSignal: no motion in train or val, or no commands.
        ConfigError: the controller or its rate is not one that can be compensated.
        DataError: no motion can be used.
    """
    from trueup.compensate.linear import linear_of
    from trueup.compensate.plants import Plants

    ids = {split: dataset.select(split=split, drop_flagged=drop_flagged) for split in ("train", "val")}
    empty = [split for split, own in ids.items() if not own]
    if empty:
        raise MissingSignal(f"{dataset.path} has no motions in {empty[0]}", hint="Leave --drop-flagged out, or import.")
    joint_map = JointMap.from_dict(robot.joint_rules())
    control_s = 1.0 / (control_hz or _rate_of(dataset, joint_map, ids["train"][0]))
    path = model_file(robot, dataset, given=model)
    plants = Plants(robot, path, control_s, threads=jobs or os.cpu_count() or 1)
    parts: dict[str, list[Linear]] = {"train": [], "val": []}
    refused: dict[str, TrueupError] = {}
    every = [(split, name) for split, own in ids.items() for name in own]
    for split, name in track(every, "differentiate", len(every)):
        try:
            motion = _motion(dataset, joint_map, name, robot, control_s)
            kg = motion.payload_kg
            parts[split].append(linear_of(motion, plants(kg), smooth=plants.smooth(kg)))
        except (DataError, MissingSignal) as error:
            refused[name] = error
    for split, own in parts.items():
        if not own:
            name, first = next(iter(refused.items()))
            raise DataError(f"no motion of {split} can be used, {name!r} because: {first.summary}", hint=first.hint)
    notes = [f"{len(refused)} motions were left out, {name} because {error.summary}" for name, error in refused.items()]
    return Prepared(parts["train"], parts["val"], plants, control_s, dataset.hash, tuple(notes[:1]))


def compensate(
    dataset: Dataset,
    robot: RobotSpec,
    out: Path | str,
    *,
    config: CompensateConfig | None = None,
    prepared: Prepared | None = None,
    model: Path | None = None,
    control_hz: float | None = None,
    twin: tuple[Path | str | None, RobotSpec] | None = None,
    empty_handed: bool = False,
    run: str = "",
    name: str = "",
    drop_flagged: bool = False,
    seed: int = 0,
    jobs: int | None = None,
    overwrite: bool = False,
    resume: bool = False,
    track: Track = silent,
    on_round: Callable[[Epoch, int], None] = lambda *_: None,
) -> Compensated:
    """Train a network that adds to commands: in the simulator, which then moves like the robot, or on the robot.

    Without a twin, the network is for the simulator. With one, it is for the robot: it is trained on the twin, which is
    an identified simulator, or one that a first network has made like the robot. What the twin is to follow is this
    robot's simulator.
    Fits on train, chooses on val, never reads test.

    Args:
        dataset: with commanded and measured positions at the rate of control.
        robot: its description: that of the simulator that is corrected, or that the robot is to move like.
        out: the model's folder.
        config: network, loss, training; the operator if None.
        prepared: what `prepare` made of the same dataset, with this robot, or with the twin's.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        control_hz: rate of the commands; that of the first train motion if None.
        twin: folder of the network for the simulator, None for none, and the robot whose simulator it is.
        empty_handed: the simulator that the robot is to move like carries nothing, whatever the robot carries.
        run: label of the runs of that simulator; `mujoco/stock` if empty.
        name: of the model; the method if empty.
        drop_flagged: leave out motions with quality warnings.
        seed: of all draws.
        jobs: threads; the number of cores if None.
        overwrite: replace the model that is in `out`.
        resume: go on where an earlier call was interrupted; a finished model of the same inputs is loaded.
        track: shows progress.
        on_round: called after each round of the training.

    Raises:
        OutputExists: `out` holds a model, or the training of another one.
        TrueupError: what `prepare` raises.
        ConfigError: a twin that corrects no simulator, or training diverges.
        NameMismatch: the twin has other joints.
        MissingDependency: torch is not installed.
    """
    with needing("training", "learn"):
        import torch

        from trueup.compensate.closed_loop import closed_loop
        from trueup.compensate.compensation import Compensation, made
        from trueup.compensate.config import METHODS
        from trueup.compensate.plants import Plants
        from trueup.compensate.rounds import learn
        from trueup.compensate.sensors import Sensors
        from trueup.compensate.training import Teacher, corrector_for
        from trueup.compensate.windows import Windows

    config, out = config or METHODS["operator" if twin is None else "operator-robot"], Path(out)
    name = name or config.method
    make_folder(out)
    if not (overwrite or resume):
        ModelFolder.refuse_full(out)
    if config.training.way == "ppo" and twin is not None:
        raise ConfigError(
            "reinforcement corrects simulators",
            got="--twin-robot",
            expected="training: {way: direct}",
            hint="Leave it out.",
        )
    known = None if twin is None or twin[0] is None else _twin_of(Path(twin[0]), robot)
    asked = json_hash(
        as_read_back(
            {
                "data": dataset.hash,
                "robot": robot.to_dict(),
                "config": asdict(config),
                "twin": None if twin is None else [known and known.card.to_json()["sha256"], twin[1].to_dict()],
                "empty_handed": empty_handed,
                "control_hz": control_hz,
                "drop_flagged": drop_flagged,
                "name": name,
                "seed": seed,
            }
        )
    )
    folder = ModelFolder(out, asked)
    threads = jobs or os.cpu_count() or 1
    if not overwrite and folder.is_finished():
        folder.clean()
        finished = Compensation.load(out)
        said = finished.card.provenance["training"]
        return Compensated(
            finished,
            out,
            tuple(PayloadErrors(**item) for item in said["val"]),
            said["seconds"],
            ("was finished already",),
        )
    if prepared is None:
        prepared = prepare(
            dataset,
            robot if twin is None else twin[1],
            model=model if twin is None else None,
            control_hz=control_hz,
            drop_flagged=drop_flagged,
            jobs=jobs,
            track=track,
        )
    control_s, plants = prepared.control_s, prepared.plants
    follow, references = None, None
    if twin is not None:
        path = model_file(robot, dataset, given=model)
        follow = Plants(robot, path, control_s, threads=threads, empty=empty_handed)
        references = [run_.state for run_ in closed_loop([part.track for part in prepared.train], follow, None)]
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        past = _past(config, robot, 1.0 / control_s)
        windows = Windows(
            prepared.train, max(past, known.corrector.network.past if known else 0), references=references
        )
        torch.manual_seed(seed)
        corrector = corrector_for(config, windows, rate_hz=1.0 / control_s, size=_SIZE)
        sensors = None
        if getattr(config.network, "senses", "") == "predicted":
            sensors = Sensors.of(windows, config.network.sensors, len(robot.joint_names))  # type: ignore[attr-defined]
        wanted = None
        if config.training.way == "delta":
            deltas = [part.delta(config.training.damping) for part in prepared.train]
            wanted = torch.from_numpy(np.concatenate([np.concatenate([part, part[-1:]]) for part in deltas]))
        teacher = Teacher(windows, config, plants.simulate, None if known is None else known.corrector, sensors, wanted)
        judged = _some([part.track for part in prepared.val])
        twin_net = None if known is None else known.corrector
        if follow is None:
            aims: list[Float64[np.ndarray, "T S"]] = [motion.state.astype(np.float64) for motion in judged]
        else:
            aims = [item.state for item in closed_loop(judged, follow, None)]

        def judge(network: Corrector) -> float:
            try:
                return _cost(closed_loop(judged, plants, network, twin=twin_net), aims, config)
            except DataError:  # a network that blows the simulation up is no good, and the next round may be
                return _BLOWN_UP

        if overwrite:
            folder.begin_anew()
        if config.training.way == "ppo":
            learned = _by_reinforcement(corrector, teacher, prepared, config, seed=seed, checkpoint=folder.checkpoint)
        else:
            learned = learn(
                corrector,
                teacher,
                judge,
                seed=seed,
                checkpoint=folder.checkpoint,
                inputs=asked,
                resume=resume,
                on_round=on_round,
            )
        errors = _errors_of(
            judged,
            closed_loop(judged, plants, None, twin=twin_net),
            closed_loop(judged, plants, corrector, twin=twin_net),
            aims,
        )
        compensation = Compensation.of(
            corrector,
            config,
            windows,
            name=name,
            robot=robot.name,
            joints=robot.joint_names,
            units=_units(dataset, robot),
            run=run or "mujoco/stock",
            rate_hz=1.0 / control_s,
            direction="simulator" if twin is None else "robot",
            metrics={},
            provenance_of={
                **made(seed, prepared.data_hash, config),
                "asked": asked,
                "robot": plants.robot.to_dict(),
                "training": {
                    "seconds": learned.seconds,
                    "cpu_seconds": learned.cpu_seconds,
                    "best_round": learned.best,
                    "history": [asdict(item) for item in learned.history],
                    "val": [asdict(item) for item in errors],
                    "motions": {"train": len(prepared.train), "val": len(prepared.val)},
                },
            },
        ).save(out)
    finally:
        torch.set_num_threads(before)
    folder.clean()
    return Compensated(compensation, out, errors, learned.seconds, prepared.notes)


def _by_reinforcement(
    corrector: Corrector, teacher: Teacher, prepared: Prepared, config: CompensateConfig, *, seed: int, checkpoint: Path
) -> Learned:
    """As the paper trains (GapONet, 4.3)."""
    from trueup.compensate.rounds import Learned
    from trueup.core.effort import Meter

    with needing("training: {way: ppo}", "rl"):
        from trueup.compensate.ppo import train_ppo
    meter = Meter()
    train_ppo(
        corrector,
        [part.track for part in prepared.train],
        prepared.plants,
        config.ppo,
        seed=seed,
        checkpoint=checkpoint,
        auxiliary=lambda generator: teacher.sensor_cost(corrector, generator),
    )
    corrector.eval()
    effort = meter.read()
    return Learned((), 0, effort.seconds, effort.cpu_seconds)


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
        ConfigError: the network corrects the robot, not its simulator.
        NameMismatch: network and robot do not have the same joints.
        DataError: no episode could be replayed.
    """
    from trueup.compensate.plants import Plants

    began = time.perf_counter()
    compensation = _twin_of(Path(network), robot)
    card = compensation.card
    label = label or f"{card.run}+{card.name}"
    refuse_run(dataset.path, label, allowed=overwrite)
    path = model_file(robot, dataset, given=model)
    plants = Plants(robot, path, 1.0 / card.rate_hz, threads=jobs or os.cpu_count() or 1)
    joint_map = JointMap.from_dict(robot.joint_rules())
    names = tuple(dataset.ids if ids is None else ids)
    motions: dict[str, Motion] = {}
    failed: dict[str, TrueupError] = {}
    for name in names:
        try:
            motions[name] = _motion(dataset, joint_map, name, robot, 1.0 / card.rate_hz)
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
    done = 0
    units = _units(dataset, robot)
    with contextlib.ExitStack() as stack:
        writer = None
        for chunk in track(_chunks(list(motions)), "compensate", -(-len(motions) // _AT_ONCE)):
            runs = _simulated({name: motions[name] for name in chunk}, plants, compensation.corrector, failed)
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
    return ReplaySummary(label, done, 0, failed, time.perf_counter() - began)


_AT_ONCE = 64


def _simulated(
    motions: Mapping[str, Motion], plants: Plants, corrector: Corrector, failed: dict[str, TrueupError]
) -> dict[str, Run]:
    """Motions side by side; where one of them cannot be simulated, each by itself."""
    from trueup.compensate.closed_loop import closed_loop

    try:
        return dict(zip(motions, closed_loop(list(motions.values()), plants, corrector), strict=True))
    except TrueupError as error:
        if len(motions) == 1:
            failed |= dict.fromkeys(motions, error)
            return {}
    return {
        name: run for key in motions for name, run in _simulated({key: motions[key]}, plants, corrector, failed).items()
    }


def _chunks(names: Sequence[str]) -> list[list[str]]:
    return [list(names[start : start + _AT_ONCE]) for start in range(0, len(names), _AT_ONCE)]


def _series(
    motion: Motion, run: Run, stamps: Float64[np.ndarray, "M"], joints: Sequence[str], units: Sequence[str]
) -> TimeSeries:
    """What was simulated, at the robot's own stamps; and what was added to the command."""
    rows = (stamps >= motion.time_s[0] - 1e-9) & (stamps <= motion.time_s[-1] + 1e-9)
    count = len(joints)
    position, velocity = (
        np.stack([np.interp(stamps[rows], motion.time_s, column) for column in values.T], axis=1)
        for values in (run.state[:, :count], run.state[:, count:])
    )
    speeds = tuple(f"{unit}/s" for unit in units)
    return TimeSeries(
        stamps[rows],
        tuple(joints),
        {"position": position, "velocity": velocity},
        {"position": tuple(units), "velocity": speeds},
    )


def _twin_of(folder: Path, robot: RobotSpec) -> Compensation:
    from trueup.compensate.compensation import Compensation

    found = Compensation.load(folder)
    if found.direction != "simulator":
        raise ConfigError(
            f"{folder} corrects commands of the robot, not of its simulator", expected="a network for the simulator"
        )
    if found.card.joints != robot.joint_names:
        raise NameMismatch(
            f"the network {found.card.name!r} is of another robot",
            left=found.card.joints,
            right=robot.joint_names,
            left_name="it has",
            right_name="robot has",
        )
    return found


def _rate_of(dataset: Dataset, joint_map: JointMap, name: str) -> float:
    command = joint_map.of_episode(dataset.episode(name)).commanded()
    return float(np.round(1.0 / np.median(np.diff(command.time_s)), 3))


def _motion(dataset: Dataset, joint_map: JointMap, name: str, robot: RobotSpec, control_s: float) -> Motion:
    from trueup.compensate.tracks import track_of

    return track_of(joint_map.of_episode(dataset.episode(name)), robot.joint_names, control_s)


def _units(dataset: Dataset, robot: RobotSpec) -> tuple[str, ...]:
    joint_map = JointMap.from_dict(robot.joint_rules())
    measured = joint_map.of_episode(dataset.episode(dataset.ids[0])).measured.select(robot.joint_names)
    return measured.units["position"]


def _past(config: CompensateConfig, robot: RobotSpec, rate_hz: float) -> int:
    from trueup.compensate.compensation import blank

    return blank(config, len(robot.joint_names), rate_hz).network.past


def _some(motions: Sequence[Motion]) -> list[Motion]:
    """The first motions of each payload."""
    counts: dict[float, int] = {}
    chosen = []
    for motion in motions:
        counts[motion.payload_kg] = counts.get(motion.payload_kg, 0) + 1
        if counts[motion.payload_kg] <= _JUDGED:
            chosen.append(motion)
    return chosen


def _gaps(run: Run, aim: Float64[np.ndarray, "T S"]) -> Float64[np.ndarray, "T J"]:
    count = run.delta.shape[1]
    return np.asarray(np.abs(run.state[:, :count] - aim[:, :count]))


def _cost(runs: Sequence[Run], aims: Sequence[Float64[np.ndarray, "T S"]], config: CompensateConfig) -> float:
    """Mean over motions of what an error of position costs, as in training."""
    far, size = config.loss.linear_from, config.loss.position_rad
    costs = [
        np.mean(2 * far**2 * (np.sqrt(1 + (_gaps(run, aim) / size / far) ** 2) - 1))
        for run, aim in zip(runs, aims, strict=True)
    ]
    return float(np.mean(costs))


def _errors_of(
    motions: Sequence[Motion],
    before: Sequence[Run],
    after: Sequence[Run],
    aims: Sequence[Float64[np.ndarray, "T S"]],
) -> tuple[PayloadErrors, ...]:
    found: list[PayloadErrors] = []
    for payload_kg in sorted({motion.payload_kg for motion in motions}):
        own = [number for number, motion in enumerate(motions) if motion.payload_kg == payload_kg]
        gaps: Mapping[str, list[Any]] = {
            key: [_gaps(runs[number], aims[number]) for number in own]
            for key, runs in (("before", before), ("after", after))
        }
        means = {key: float(np.mean([part.mean() for part in parts])) for key, parts in gaps.items()}
        worst = {
            key: float(np.quantile(np.concatenate([part.ravel() for part in parts]), 0.999))
            for key, parts in gaps.items()
        }
        found.append(
            PayloadErrors(payload_kg, len(own), means["before"], means["after"], worst["before"], worst["after"])
        )
    return tuple(found)
