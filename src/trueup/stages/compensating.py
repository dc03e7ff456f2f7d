"""Compensate: a dataset with commands in, a network out that says what the commands lack; and motions with it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from trueup.align import JointMap
from trueup.core.atomic import as_read_back, json_hash, make_folder
from trueup.core.quality import dropped, left_out, refuse_majority
from trueup.core.sole_writer import writes_alone
from trueup.core.units import joint_unit
from trueup.dataset import Dataset
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, TrueupError, needing
from trueup.robots import RobotSpec, refuse_other_gains
from trueup.stages.model_folder import ModelFolder
from trueup.stages.progress import Track, silent
from trueup.stages.robot_model import model_file

if TYPE_CHECKING:
    from trueup.augment.checkpoint import Epoch
    from trueup.augment.corrector import Corrector
    from trueup.compensate.compensation import Compensation
    from trueup.compensate.config import CompensateConfig
    from trueup.compensate.judging import PayloadErrors
    from trueup.compensate.linear import Linear
    from trueup.compensate.plants import Plants
    from trueup.compensate.rounds import Learned
    from trueup.compensate.tracks import Track as Motion
    from trueup.compensate.training import Teacher
    from trueup.compensate.windows import Windows

# What a network costs that blows the simulation up: more than any other, and a number that JSON has.
_BLOWN_UP = 1e9
# Torques alone soon lead away from the measured motion; where robot.yaml says nothing, one goes back this often [s].
_WINDOW_S = 0.5


@dataclass(frozen=True)
class Compensated:
    """What `compensate` made.

    Attributes:
        compensation: the trained network.
        folder: its folder.
        errors: of the val motions, payload by payload.
        seconds: what training took, without preparing [s].
        notes: what was left out, and what of the model is held.
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
        notes: what was left out, and what of the model is held.
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
    drop_flagged: bool | None = None,
    jobs: int | None = None,
    track: Track = silent,
) -> Prepared:
    """Simulate one control step from every measured state of the train and val motions, and differentiate.

    Args:
        dataset: with commanded and measured positions.
        robot: its description; that of an identified robot where there is one.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        control_hz: rate of the commands; that of the first train motion if None.
        drop_flagged: leave out motions with quality warnings; False leaves out none, None those whose measurement is
            broken.
        jobs: threads; the number of cores if None.
        track: shows progress.

    Raises:
        MissingSignal: no motion in train or val, or no commands.
        ConfigError: the controller or its rate is not one that can be compensated.
        ConfigError: motions were recorded with other position gains than the robot's.
        DataError: no motion can be used, or the measurement of most of the train motions is broken.
    """
    from trueup.compensate.linear import linear_of
    from trueup.compensate.plants import Plants

    ids = {split: dataset.select(split=split, drop_flagged=drop_flagged) for split in ("train", "val")}
    unused = {
        split: dropped((meta for meta in dataset.metas if meta.split == split), drop_flagged=drop_flagged)
        for split in ids
    }
    if drop_flagged is None:
        refuse_majority(unused["train"], len(ids["train"]) + len(unused["train"]), keep="--keep-flagged")
    empty = [split for split, own in ids.items() if not own]
    if empty:
        raise MissingSignal(f"{dataset.path} has no motions in {empty[0]}", hint="Leave --drop-flagged out, or import.")
    refuse_other_gains(robot, (dataset.meta(name) for own in ids.values() for name in own), what="compensate")
    joint_map = JointMap.from_dict(robot.joint_rules())
    control_s = 1.0 / (control_hz or _rate_of(dataset, joint_map, ids["train"][0]))
    path = model_file(robot, dataset, given=model)
    plants = Plants(robot, path, control_s, threads=jobs or os.cpu_count() or 1)
    parts: dict[str, list[Linear]] = {"train": [], "val": []}
    refused: dict[str, TrueupError] = {}
    every = [(split, name) for split, own in ids.items() for name in own]
    for split, name in track(every, "differentiate", len(every)):
        try:
            motion = motion_of(dataset, joint_map, name, robot, control_s)
            kg = motion.payload_kg
            parts[split].append(linear_of(motion, plants(kg), smooth=plants.smooth(kg)))
        except (DataError, MissingSignal) as error:
            refused[name] = error
    for split, own in parts.items():
        if not own:
            name, first = next(iter(refused.items()))
            raise DataError(f"no motion of {split} can be used, {name!r} because: {first.summary}", hint=first.hint)
    notes = [f"{len(refused)} motions were left out, {name} because {error.summary}" for name, error in refused.items()]
    held = plants(parts["train"][0].track.payload_kg).simulator.holding.notes
    said = (*left_out(unused), *notes[:1], *held)
    return Prepared(parts["train"], parts["val"], plants, control_s, dataset.hash, said)


@writes_alone()
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
    drop_flagged: bool | None = None,
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
        drop_flagged: leave out motions with quality warnings; False leaves out none, None those whose measurement is
            broken.
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
        from trueup.compensate.correctors import SIZE, blank, scale
        from trueup.compensate.judging import PayloadErrors, cost, payload_errors
        from trueup.compensate.plants import Plants
        from trueup.compensate.rounds import learn
        from trueup.compensate.windows import Windows

    if config is None:
        config = METHODS["operator-robot" if twin else "torques" if robot.controller.signal == "torque" else "operator"]
    out = Path(out)
    name = name or config.method
    make_folder(out)
    if not (overwrite or resume):
        ModelFolder.refuse_full(out)
    config = _fitting(config, robot, twin=twin is not None)
    signal = robot.controller.signal
    known = None if twin is None or twin[0] is None else network_for_simulator(Path(twin[0]), robot)
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
        corrector = blank(config, len(robot.joint_names), 1.0 / control_s, seed)
        twin_net = None if known is None else known.corrector
        past = max(net.network.past for net in (corrector, twin_net) if net is not None)
        windows = Windows(prepared.train, past, references=references)
        scale(corrector, config, windows, 2 * config.loss.torque_nm if signal == "torque" else SIZE)
        teacher = _teacher(windows, prepared, config, robot, twin_net)
        motions = _to_judge(prepared, robot)
        if follow is None:
            aims: list[Float64[np.ndarray, "T S"]] = [motion.state.astype(np.float64) for motion in motions]
        else:
            aims = [item.state for item in closed_loop(motions, follow, None)]

        def judge(network: Corrector) -> float:
            try:
                return cost(closed_loop(motions, plants, network, twin=twin_net), aims, config.loss)
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
        errors = payload_errors(
            motions,
            closed_loop(motions, plants, None, twin=twin_net),
            closed_loop(motions, plants, corrector, twin=twin_net),
            aims,
        )
        compensation = Compensation.of(
            corrector,
            config,
            windows,
            name=name,
            robot=robot.name,
            joints=robot.joint_names,
            units=units_of(dataset, robot),
            run=run or "mujoco/stock",
            rate_hz=1.0 / control_s,
            direction="simulator" if twin is None else "robot",
            signal=signal,
            commanded=[joint_unit("Nm", unit) for unit in units_of(dataset, robot)] if signal == "torque" else None,
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


def _fitting(config: CompensateConfig, robot: RobotSpec, *, twin: bool) -> CompensateConfig:
    """The configuration as it is for this robot.

    Raises:
        ConfigError: it is none for this robot, or for what is to be corrected.
    """
    from trueup.augment.networks.operator import OperatorConfig

    if isinstance(config.network, OperatorConfig) and config.network.senses == "true":
        raise ConfigError(
            "a compensation has no simulator to ask in each control step",
            got="network: {senses: true}",
            expected="predicted, or none",
        )
    if config.training.way == "ppo" and twin:
        raise ConfigError(
            "reinforcement corrects simulators",
            got="--twin-robot",
            expected="training: {way: direct}",
            hint="Leave it out.",
        )
    if config.training.way == "ppo" and robot.simulation.base_sensor:
        raise ConfigError(
            "reinforcement knows no base that moves",
            got=f"simulation: base_sensor: {robot.simulation.base_sensor}",
            expected="training: {way: direct}",
        )
    if robot.controller.signal == "torque":
        config = replace(config, relative=False)
        if twin or config.training.way == "ppo" or isinstance(config.network, OperatorConfig):
            raise ConfigError(
                f"robot {robot.name!r} takes torques: its simulator can be corrected, by a network without sensors",
                got=f"method {config.method}, way {config.training.way}{', a twin' if twin else ''}",
                hint="Give --method torques, and leave --twin-robot out.",
            )
    return config


def _to_judge(prepared: Prepared, robot: RobotSpec) -> Sequence[Motion]:
    """The motions of val, in pieces where torques are all that the simulator is told."""
    from trueup.compensate.judging import judged

    motions = judged([part.track for part in prepared.val])
    if robot.controller.signal != "torque":
        return motions
    # It drifts away from the motion within a second or two.
    rows = round((robot.replay.window_s or _WINDOW_S) / prepared.control_s)
    return [piece for motion in motions for piece in motion.pieces(rows)]


def _teacher(
    windows: Windows, prepared: Prepared, config: CompensateConfig, robot: RobotSpec, twin: Corrector | None
) -> Teacher:
    """What a training asks for costs, with what the method needs besides the windows."""
    import torch

    from trueup.augment.networks.operator import OperatorConfig
    from trueup.compensate.sensors import Sensors
    from trueup.compensate.training import Teacher

    sensors = wanted = None
    if isinstance(config.network, OperatorConfig) and config.network.senses == "predicted":
        sensors = Sensors.of(windows, config.network.sensors, len(robot.joint_names))
    if config.training.way == "delta":
        deltas = [part.delta(config.training.damping) for part in prepared.train]
        wanted = torch.from_numpy(np.concatenate([np.concatenate([part, part[-1:]]) for part in deltas]))
    signal = robot.controller.signal
    return Teacher(windows, config, prepared.plants.simulate, twin, sensors, wanted=wanted, signal=signal)


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


def network_for_simulator(folder: Path, robot: RobotSpec) -> Compensation:
    """A trained network that makes this robot's simulator move like the robot.

    Raises:
        ConfigError: it was trained for the robot itself.
        NameMismatch: it has other joints.
        DataError: it is broken.
        MissingDependency: torch is not installed.
    """
    with needing("a network that corrects commands", "learn"):
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
    return round(joint_map.of_episode(dataset.episode(name)).commanded().rate_hz, 3)


def motion_of(dataset: Dataset, joint_map: JointMap, name: str, robot: RobotSpec, control_s: float) -> Motion:
    """One episode, seen once every control step [s]."""
    from trueup.compensate.tracks import track_of

    episode = joint_map.of_episode(dataset.episode(name))
    return track_of(
        episode,
        robot.joint_names,
        control_s,
        signal=robot.controller.signal,
        base_sensor=robot.simulation.base_sensor,
    )


def units_of(dataset: Dataset, robot: RobotSpec) -> tuple[str, ...]:
    """`rad` or `m` for each of the robot's joints."""
    joint_map = JointMap.from_dict(robot.joint_rules())
    measured = joint_map.of_episode(dataset.episode(dataset.ids[0])).measured.select(robot.joint_names)
    return measured.units["position"]
