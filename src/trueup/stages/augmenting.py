"""Augment: datasets with a simulated run in, a trained correction of that run out."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.augment.config import FEWEST_FOR_CHANCE, SIGNALS, AugmentConfig
from trueup.core.atomic import json_hash
from trueup.core.episode import Episode
from trueup.core.model_card import ANY_JOINT, CARD_NAME, Channel
from trueup.core.quality import left_out
from trueup.core.sole_writer import sole_writer
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset
from trueup.dataset.writer import is_label_part
from trueup.errors import ConfigError, NameMismatch, needing
from trueup.record.limits import stated_rates
from trueup.record.urdf import urdf_velocity_limits
from trueup.robots import RobotSpec
from trueup.stages.model_folder import ModelFolder
from trueup.stages.progress import Track, silent
from trueup.stages.robot_model import model_file
from trueup.stages.training_data import TrainingData, rate_of

if TYPE_CHECKING:
    from trueup.augment import Augmentation, Progress

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
    drop_flagged: bool | None = None,
    train_motions: int | None = None,
    seed: int = 0,
    jobs: int | None = None,
    device: str = "cpu",
    overwrite: bool = False,
    resume: bool = False,
    track: Track = silent,
    on_progress: Callable[[Progress], None] | None = None,
    limit: TimeLimit | None = None,
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
        drop_flagged: leave out motions with quality warnings; False leaves out none, None those whose measurement is
            broken.
        train_motions: train on no more than so many motions, drawn from the train split; to see what more data bring.
        seed: of all draws.
        jobs: threads; torch's own choice if None.
        device: `cpu` or `cuda`.
        overwrite: replace the model that is in `out`; it stays until the new one is trained.
        resume: go on where an earlier call was interrupted; a finished model of the same inputs is loaded.
        track: shows progress of reading.
        on_progress: called after every batch and epoch.
        limit: when training has to end, with the best weights so far.

    Raises:
        OutputExists: `out` holds a model, or the training of another one.
        MissingSignal: there is no such run, or no motion in train or val.
        DataError: a sample is not finite, val overlaps train, motions have different rates, or most train motions would
            be left out.
        ConfigError: the name makes no label, a dataset comes twice, there is nothing to choose from or no epoch to
            train, or training diverges in its first epoch.
        NameMismatch: the robot has other joints than the run.
        MissingDependency: torch is not installed, or finds no GPU.
    """
    config, out = config or AugmentConfig(), Path(out)
    with needing("training", "learn"):
        from trueup.augment import Augmentation, Task
        from trueup.augment.loss import Loss
        from trueup.augment.pairs import any_joint, channels_of, refuse_overlap, write_pairs
        from trueup.augment.training import find_device

    find_device(device, config.precision)
    name = name or config.method
    _refuse_bad_name(name)
    _refuse_no_training(config)
    with sole_writer(out):
        if not (overwrite or resume):
            ModelFolder.refuse_full(out)
        source = TrainingData.of(datasets, run)
        limits = _limits(robot, source, config)
        asked = json_hash(
            {
                "data": source.hash,
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
        ids = {split: source.ids(split, drop_flagged=drop_flagged) for split in ("train", "val")}
        unused = {split: source.dropped(split, drop_flagged=drop_flagged) for split in ids}
        if train_motions is not None:
            ids["train"] = _drawn(ids["train"], train_motions, seed)
        first = next(source.episodes(ids["train"][:1]))
        data = config.data
        inputs, outputs = channels_of(
            first,
            run,
            signals=data.signals,
            reads=data.reads,
            command=data.command,
            measured=data.measured,
            known=SIGNALS,
        )
        Loss(config.loss, outputs, 1.0, config.network.quantiles)  # refuses what cannot be minimized, before the data
        joints, bodies = _joints(source, config), _bodies(outputs, config)
        outputs = tuple(channel for channel in outputs if channel.joint in (bodies if channel.of_body else joints))
        blocks = bodies if outputs[0].of_body else joints
        has_bodies = any(channel.of_body for channel in inputs)
        names = tuple(dict.fromkeys(channel.joint for channel in inputs)) if has_bodies else source.joints
        if data.modular:
            inputs, outputs, limits = any_joint(inputs), any_joint(outputs), {}
        rate_hz = data.rate_hz or rate_of(first, run)
        with folder.scratch() as scratch, contextlib.ExitStack() as stack:
            pairs = {
                split: stack.enter_context(
                    write_pairs(
                        track(source.at_rate(chosen, rate_hz, given=data.rate_hz is not None), split, len(chosen)),
                        scratch / f"{split}.f32",
                        run=run,
                        inputs=inputs,
                        outputs=outputs,
                        rate_hz=rate_hz,
                        joints=blocks if data.modular else (),
                        mirrored=data.mirrored and split == "train",
                    )
                )
                for split, chosen in ids.items()
            }
            refuse_overlap(pairs["train"], pairs["val"])
            task = Task(
                name=name,
                robot=source.robot,
                joints=(ANY_JOINT,) if data.modular else names,
                run=run,
                rate_hz=rate_hz,
                train=pairs["train"],
                val=pairs["val"],
                limits=limits,
                data_hash=source.hash,
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
                limit=limit,
            )
            augmentation.save(out)
        # Only here is nothing left that an interruption could cost.
        folder.clean()
        notes = (
            *left_out(unused),
            *_unmeasured(first, run, config),
            *_unreached(augmentation, max(motion.rows for motion in pairs["train"].motions)),
            *_unknown_limits(limits, inputs, config),
            *_notes(augmentation),
        )
        return Augmented(augmentation, out, notes)


def _refuse_bad_name(name: str) -> None:
    """Corrected runs are called after their network: what makes no label must not be found out after the training."""
    if not is_label_part(name) or len(name) > _LONGEST_NAME:
        raise ConfigError("--name", got=repr(name), expected=f"letters, digits, _ . + = -, at most {_LONGEST_NAME}")


def _refuse_no_training(config: AugmentConfig) -> None:
    if config.epochs == 0 and config.network.trained:
        raise ConfigError("epochs: 0 leaves the network untrained", expected="at least 1")


def _drawn(ids: list[tuple[int, str]], count: int, seed: int) -> list[tuple[int, str]]:
    """So many of them, at random; a smaller draw is part of a larger one."""
    if count < 1:
        raise ConfigError("train_motions", got=count, expected="at least 1")
    order = np.random.default_rng(seed).permutation(len(ids))[:count]
    return [ids[number] for number in sorted(order)]


def _joints(source: TrainingData, config: AugmentConfig) -> tuple[str, ...]:
    """The joints that are trained on and corrected."""
    strange = [name for name in config.data.joints if name not in source.joints]
    if strange:
        raise NameMismatch(
            f"data: joints {strange} are not in the run",
            left=config.data.joints,
            right=source.joints,
            right_name="run has",
        )
    return config.data.joints or source.scored


def _bodies(outputs: Sequence[Channel], config: AugmentConfig) -> tuple[str, ...]:
    """The bodies that are trained on and corrected, of those that can be."""
    there = tuple(dict.fromkeys(channel.joint for channel in outputs if channel.of_body))
    strange = [name for name in config.data.bodies if name not in there]
    if strange:
        raise NameMismatch(
            f"data: bodies {strange} are not both simulated and measured",
            left=config.data.bodies,
            right=there,
            right_name="there are",
        )
    return config.data.bodies or there


Limits = dict[tuple[str, str], tuple[float, float]]


def _limits(robot: RobotSpec | None, source: TrainingData, config: AugmentConfig) -> Limits:
    """(signal, joint) -> limits of positions, velocities and torques, where robot, model or run say them."""
    if robot is not None and set(robot.joint_names) != set(source.joints):
        raise NameMismatch(
            f"--robot {robot.name} is not the robot of the run",
            left=robot.joint_names,
            right=source.joints,
            left_name="robot has",
            right_name="run has",
        )
    limits: Limits = {}
    for joint in source.info.get("inputs", {}).get("robot", {}).get("joints", []):
        if joint.get("position_limits"):
            limits["position", joint["name"]] = tuple(joint["position_limits"])
    for spec in robot.joints if robot else ():
        if spec.position_limits:
            limits["position", spec.name] = spec.position_limits
    for name, torque in (source.info.get("torque_limits") or {}).items():
        limits["torque", name] = (-float(torque), float(torque))
    if robot is not None and config.data.normalization == "limits":
        limits |= {("velocity", name): (-speed, speed) for name, speed in _speeds(robot, source.datasets[0]).items()}
    return limits


def _unmeasured(episode: Episode, run: str, config: AugmentConfig) -> Iterator[str]:
    """What the simulator says and no sensor does, where all that can be corrected was asked for."""
    if config.data.signals is None:
        left = [name for name in SIGNALS if name in episode.run(run) and name not in episode.measured]
        if left:
            yield f"the robot did not measure {', '.join(left)}, which stays as simulated"


def _unreached(augmentation: Augmentation, longest: int) -> Iterator[str]:
    """Where a history is longer than any motion: what lies beyond was never seen."""
    reach = augmentation.corrector.network.reach
    if reach >= longest and augmentation.config.network.trained:
        yield (
            f"the history of {reach} samples is longer than every motion of train, the longest has {longest}: "
            "what is further back than that taught nothing"
        )


def _unknown_limits(limits: Limits, inputs: Sequence[Channel], config: AugmentConfig) -> Iterator[str]:
    if config.data.normalization == "limits" and config.network.trained:
        missing = sorted({f"{c.signal} of {c.joint}" for c in inputs if (c.signal, c.joint) not in limits})
        if missing:
            yield f"no limits are known for {', '.join(missing)}: normalized by the range of the train split"


def _speeds(robot: RobotSpec, dataset: Dataset) -> dict[str, float]:
    """Velocity limits that the model states; none where there is no model."""
    from trueup.robots.model import compile_spec, load_spec

    try:
        path = model_file(robot, dataset)
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
