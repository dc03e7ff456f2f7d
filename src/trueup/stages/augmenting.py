"""Augment: datasets with a simulated run in, a trained correction of that run out."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trueup.align import JointMap
from trueup.augment.config import FEWEST_FOR_CHANCE, SIGNALS, AugmentConfig
from trueup.core.atomic import json_hash, make_folder
from trueup.core.episode import Episode
from trueup.core.model_card import CARD_NAME, Channel
from trueup.dataset import Dataset
from trueup.dataset.writer import is_label_part
from trueup.deploy.agreement import RATE_TOLERANCE
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch
from trueup.record.limits import stated_rates
from trueup.record.urdf import urdf_velocity_limits
from trueup.robots import RobotSpec, find_model
from trueup.stages.model_folder import ModelFolder
from trueup.stages.progress import Track, silent
from trueup.stages.replaying import in_robot_names

if TYPE_CHECKING:
    from trueup.augment import Augmentation, Progress
    from trueup.augment.pairs import Pairs

_LONGEST_NAME = 100
# Why outputs are switched off, line by line, unless there are more reasons than this.
_MOST_REASONS = 4


@dataclass(frozen=True)
class Augmented:
    """What `augment` made.

    Attributes:
        augmentation: the trained correction; its card says how good it is on val.
        folder: the model's folder.
        notes: what was left out or switched off, and what must be known besides.
    """

    augmentation: Augmentation
    folder: Path
    notes: tuple[str, ...]


def augment(
    datasets: Sequence[Dataset],
    out: Path | str,
    *,
    run: str,
    config: AugmentConfig | None = None,
    robot: RobotSpec | None = None,
    name: str = "",
    description: str = "",
    drop_flagged: bool = False,
    train_motions: int | None = None,
    seed: int = 0,
    jobs: int | None = None,
    device: str = "cpu",
    overwrite: bool = False,
    resume: bool = False,
    track: Track = silent,
    on_progress: Callable[[Progress], None] | None = None,
) -> Augmented:
    """Train a network that turns a simulated run into what the robot would have measured.

    Fits on the train splits, chooses the epoch, the outputs that may correct, and intervals on the val splits; never
    reads test. Writes `model.onnx`, `weights.safetensors` and `model.json` into `out`.

    Args:
        datasets: with the run in each; several for several units of one robot.
        out: the model's folder.
        run: label of the run that is corrected, e.g. `mujoco/stock`.
        config: method, network, loss, optimizer; the real-time Realeasy network if None.
        robot: its description, for limits of positions and velocities; what the run says of it if None.
        name: of the model; the method if empty.
        description: for people, kept in the card.
        drop_flagged: leave out motions with quality warnings.
        train_motions: train on no more than so many motions, drawn from the train split; to see what more data bring.
        seed: of all draws.
        jobs: threads; torch's own choice if None.
        device: `cpu` or `cuda`.
        overwrite: replace the model that is in `out`; it stays until the new one is trained.
        resume: go on where an earlier call was interrupted; a finished model of the same inputs is loaded.
        track: shows progress of reading.
        on_progress: called after every batch and epoch.

    Raises:
        OutputExists: `out` holds a model, or the training of another one.
        MissingSignal: there is no such run, or no motion in train or val.
        DataError: a sample is not finite, val overlaps train, or motions have different rates.
        ConfigError: the name makes no label, a dataset comes twice, there is nothing to choose from or no epoch to
            train, or training diverges in its first epoch.
        NameMismatch: the robot has other joints than the run.
        MissingDependency: torch is not installed, or finds no GPU.
    """
    config, out = config or AugmentConfig(), Path(out)  # without torch there is no configuration either
    from trueup.augment import Augmentation, Task
    from trueup.augment.pairs import channels_of, refuse_overlap, write_pairs
    from trueup.augment.training import find_device

    find_device(device)
    name = name or config.method
    _refuse_bad_name(name)
    _refuse_no_training(config)
    make_folder(out)
    if not (overwrite or resume):
        ModelFolder.refuse_full(out)
    sources = _sources(datasets, run)
    origin = _Origin.of(sources, run)
    data_hash = _joint_hash(sources, run)
    limits = _limits(robot, origin, sources[0], config)
    asked = json_hash(
        {
            "data": data_hash,
            "run": run,
            "config": config.to_json(),
            "limits": sorted([*key, *value] for key, value in limits.items()),
            "name": name,
            "drop_flagged": drop_flagged,
            "train_motions": train_motions,
            "seed": seed,
        }
    )
    folder = ModelFolder(out, asked)
    if not overwrite and folder.is_finished():
        folder.clean()
        finished = Augmentation.load(out)
        return Augmented(finished, out, ("was finished already", *_notes(finished)))
    ids = {split: _ids(sources, run, split, drop_flagged=drop_flagged) for split in ("train", "val")}
    if train_motions is not None:
        ids["train"] = _drawn(ids["train"], train_motions, seed)
    first = next(_episodes(sources, ids["train"][:1], run, origin.joint_map))
    data = config.data
    inputs, outputs = channels_of(
        first, run, signals=data.signals, reads=data.reads, command=data.command, known=SIGNALS
    )
    outputs = tuple(channel for channel in outputs if channel.joint in origin.scored)
    rate_hz = config.data.rate_hz or _rate(first, run)
    with folder.scratch() as scratch, contextlib.ExitStack() as stack:
        made: dict[str, Pairs] = {}
        for split, chosen in ids.items():
            episodes = _at_rate(
                _episodes(sources, chosen, run, origin.joint_map), run, rate_hz, given=config.data.rate_hz is not None
            )
            pairs = write_pairs(
                track(episodes, split, len(chosen)),
                scratch / f"{split}.f32",
                run=run,
                inputs=inputs,
                outputs=outputs,
                rate_hz=rate_hz,
            )
            made[split] = stack.enter_context(pairs)
        refuse_overlap(made["train"], made["val"])
        task = Task(
            name=name,
            robot=origin.robot,
            joints=origin.joints,
            run=run,
            rate_hz=rate_hz,
            train=made["train"],
            val=made["val"],
            limits=limits,
            data_hash=data_hash,
            asked=asked,
            description=description,
        )
        if overwrite:
            folder.begin_anew()
        augmentation = Augmentation.fit(
            task,
            config,
            folder=out,
            seed=seed,
            resume=resume,
            device=device,
            threads=jobs,
            on_progress=on_progress,
        )
        augmentation.save(out)
    # Only here is nothing left that an interruption could cost.
    folder.clean()
    return Augmented(augmentation, out, (*_unknown_limits(limits, inputs, config), *_notes(augmentation)))


def _refuse_bad_name(name: str) -> None:
    """Corrected runs are called after their network: what makes no label must not be found out after the training."""
    if not is_label_part(name) or len(name) > _LONGEST_NAME:
        raise ConfigError("--name", got=repr(name), expected=f"letters, digits, _ . + = -, at most {_LONGEST_NAME}")


def _refuse_no_training(config: AugmentConfig) -> None:
    if config.epochs == 0 and config.network.trained:
        raise ConfigError("epochs: 0 leaves the network untrained", expected="at least 1")


@dataclass(frozen=True)
class _Origin:
    """What the runs of all datasets say of the robot."""

    robot: str
    joints: tuple[str, ...]
    scored: tuple[str, ...]
    joint_map: JointMap
    info: Mapping[str, Any]

    @staticmethod
    def of(sources: Sequence[Dataset], run: str) -> _Origin:
        infos = [source.run_info(run) for source in sources]
        for source, info in zip(sources, infos, strict=True):
            if "joint_map" not in info:
                raise ConfigError(
                    f"the run {run!r} of {source.path} came with the logs: it is on a clock of its own",
                    hint="Replay the commands with trueup replay, and correct that run.",
                )
            if info["joints"] != infos[0]["joints"]:
                raise NameMismatch(
                    f"the run {run!r} has other joints in {source.path}",
                    left=info["joints"],
                    right=infos[0]["joints"],
                )
            if _physics(info) != _physics(infos[0]):
                raise ConfigError(
                    f"the run {run!r} of {source.path} was simulated with another model or other settings",
                    hint="Replay all datasets with the same robot and model.",
                )
        info = infos[0]
        robot = str(info.get("inputs", {}).get("robot", {}).get("name", ""))
        joints = tuple(info["joints"])
        return _Origin(
            robot, joints, tuple(info.get("scored_joints", joints)), JointMap.from_dict(info["joint_map"]), info
        )


def _physics(info: Mapping[str, Any]) -> tuple[Any, ...]:
    return info.get("inputs", {}).get("model_sha256"), info.get("settings")


def _sources(datasets: Sequence[Dataset], run: str) -> list[Dataset]:
    if not datasets:
        raise ConfigError("there is no dataset to train on")
    for dataset in datasets:
        if run not in dataset.runs:
            raise MissingSignal(
                f"{dataset.path} has no run {run!r}",
                available=dataset.runs,
                hint="Make one with trueup replay, or name one with --run.",
            )
    _refuse_twins(datasets)
    return list(datasets)


def _refuse_twins(datasets: Sequence[Dataset]) -> None:
    """A motion that comes twice counts twice in all that is asked about chance."""
    for number, dataset in enumerate(datasets):
        for other in datasets[:number]:
            if dataset.path.resolve() == other.path.resolve() or dataset.hash == other.hash:
                raise ConfigError(
                    "a dataset is given twice",
                    got=f"{other.path} and {dataset.path} hold the same motions",
                    hint="Give each unit's dataset once.",
                )


def _joint_hash(sources: Sequence[Dataset], run: str) -> str:
    parts = [
        [source.hash, source.run_info(run).get("inputs", {}), source.splits, source.run_ids(run)] for source in sources
    ]
    return json_hash(parts)


def _ids(sources: Sequence[Dataset], run: str, split: str, *, drop_flagged: bool) -> list[tuple[int, str]]:
    """Number of the dataset and id of each motion of a split that the run has too."""
    found = []
    for number, source in enumerate(sources):
        if split in source.splits.values():
            there = set(source.run_ids(run))  # without those that could not be replayed
            chosen = source.select(split=split, drop_flagged=drop_flagged)
            found += [(number, name) for name in chosen if name in there]
    if not found:
        raise MissingSignal(
            f"no motion of the run {run!r} is in the split {split!r}",
            available=sorted({item for source in sources for item in source.splits.values()}),
            hint="Training needs train and val: give --splits 80/15/5 when you import, or a split.json.",
        )
    return found


def _drawn(ids: list[tuple[int, str]], count: int, seed: int) -> list[tuple[int, str]]:
    """So many of them, at random; a smaller draw is part of a larger one."""
    if count < 1:
        raise ConfigError("train_motions", got=count, expected="at least 1")
    order = np.random.default_rng(seed).permutation(len(ids))[:count]
    return [ids[number] for number in sorted(order)]


def _episodes(
    sources: Sequence[Dataset], chosen: Sequence[tuple[int, str]], run: str, joint_map: JointMap
) -> Iterator[Episode]:
    several = len(sources) > 1
    for number, name in chosen:
        source = sources[number]
        episode = in_robot_names(source.episode(name, runs=[run]), joint_map)
        if several:
            episode = replace(episode, meta=replace(episode.meta, id=f"{number}/{name}"))
        yield episode


def _rate(episode: Episode, run: str) -> float:
    rate = episode.run(run).rate_hz
    whole = round(rate)
    return float(whole) if whole and abs(rate / whole - 1) < 0.01 else rate


def _at_rate(episodes: Iterable[Episode], run: str, rate_hz: float, *, given: bool) -> Iterator[Episode]:
    """Refuse motions of another rate, or, where a rate is given, of a lower one: nobody simulated what is between."""
    for episode in episodes:
        rate = min(episode.run(run).rate_hz, episode.measured.rate_hz)
        if given and rate < rate_hz * (1 - RATE_TOLERANCE):
            raise DataError(
                f"episode {episode.id!r} has fewer samples per second than data.rate_hz",
                got=f"{rate:.4g} Hz",
                expected=f"at least {rate_hz:.4g} Hz",
            )
        if not given and abs(rate / rate_hz - 1) > RATE_TOLERANCE:
            raise DataError(
                f"episode {episode.id!r} has another rate than the first one",
                got=f"{rate:.4g} Hz",
                expected=f"{rate_hz:.4g} Hz",
                hint="Give data.rate_hz in the configuration to bring all motions to one rate.",
            )
        yield episode


Limits = dict[tuple[str, str], tuple[float, float]]


def _limits(robot: RobotSpec | None, origin: _Origin, source: Dataset, config: AugmentConfig) -> Limits:
    """(signal, joint) -> limits of positions, velocities and torques, where robot, model or run say them."""
    if robot is not None and set(robot.joint_names) != set(origin.joints):
        raise NameMismatch(
            f"--robot {robot.name} is not the robot of the run",
            left=robot.joint_names,
            right=origin.joints,
            left_name="robot has",
            right_name="run has",
        )
    limits: Limits = {}
    for joint in origin.info.get("inputs", {}).get("robot", {}).get("joints", []):
        if joint.get("position_limits"):
            limits["position", joint["name"]] = tuple(joint["position_limits"])
    for spec in robot.joints if robot else ():
        if spec.position_limits:
            limits["position", spec.name] = spec.position_limits
    for name, torque in (origin.info.get("torque_limits") or {}).items():
        limits["torque", name] = (-float(torque), float(torque))
    if robot is not None and config.data.normalization == "limits":
        limits |= {("velocity", name): (-speed, speed) for name, speed in _speeds(robot, source).items()}
    return limits


def _unknown_limits(limits: Limits, inputs: Sequence[Channel], config: AugmentConfig) -> Iterator[str]:
    if config.data.normalization == "limits" and config.network.trained:
        missing = sorted({f"{c.signal} of {c.joint}" for c in inputs if (c.signal, c.joint) not in limits})
        if missing:
            yield f"no limits are known for {', '.join(missing)}: normalized by the range of the train split"


def _speeds(robot: RobotSpec, source: Dataset) -> dict[str, float]:
    """Velocity limits that the model states; none where there is no model."""
    from trueup.sim.model import compile_spec, load_spec

    try:
        path = find_model(robot, folder=source.info.model_path(source.path) or source.path / "model")
    except ConfigError:
        return {}
    model = compile_spec(load_spec(path), path)
    names = [model.joint(row).name for row in range(model.njnt)]
    return urdf_velocity_limits(path) | stated_rates(model, names, "velocity")


def _notes(augmentation: Augmentation) -> Iterator[str]:
    card = augmentation.card
    training = card.provenance["training"]
    if training["status"] == "diverged":
        done, best = len(training["history"]), training["best_epoch"]
        yield f"training diverged after epoch {done}; the weights of epoch {best} are kept"
    reasons: dict[str, list[str]] = {}
    signals: dict[str, list[str]] = {}
    for output in card.outputs:
        if output.gate == 0:
            reasons.setdefault(output.reason, []).append(f"{output.signal} of {output.joint}")
            signals.setdefault(output.signal, []).append(output.joint)
    if len(reasons) > _MOST_REASONS:
        names = "; ".join(f"{signal} of {', '.join(joints)}" for signal, joints in signals.items())
        reasons = {f"{next(iter(reasons))}; {len(reasons) - 1} other reasons are in {CARD_NAME}": [names]}
    for reason, names_of in reasons.items():
        yield f"switched off, so that the simulator's value stays: {', '.join(names_of)} ({reason})"
    if 0 < training["motions"]["val"] < FEWEST_FOR_CHANCE:
        count = training["motions"]["val"]
        yield f"{count} val motions cannot tell help from chance: outputs are used if they help there"
    if card.coverage_note:
        yield f"intervals: {card.coverage_note}"
