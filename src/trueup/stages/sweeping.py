"""Sweep: several networks, each with several seeds, trained beside each other; which of them is best on val."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from trueup.augment.config import SIGNALS, AugmentConfig
from trueup.core.atomic import as_read_back, json_hash, remove
from trueup.core.model_card import ModelCard, Output
from trueup.core.provenance import provenance
from trueup.core.ray_workers import connected
from trueup.core.sole_writer import sole_writer
from trueup.core.spread import go_to, here, spread
from trueup.core.sweep_result import SWEEP_NAME, SweepError, SweepResult, SweepTraining, ranked, signal_of
from trueup.dataset import Dataset
from trueup.dataset.writer import is_label_part
from trueup.errors import ConfigError, DataError, MissingDependency, MissingSignal, OutputExists, TrueupError, needing
from trueup.robots import RobotSpec
from trueup.stages.augmenting import augment
from trueup.stages.training_data import TrainingData

MODELS = "models"
_VAL = "val"
# Letters that a candidate's name may have: names of networks, which have its seed, too, have no more than 100.
_LONGEST = 80


@dataclass(frozen=True)
class _Task:
    """One training, and all that `augment` is asked."""

    training: SweepTraining
    datasets: tuple[Path, ...]
    folder: Path
    run: str
    config: AugmentConfig
    robot: RobotSpec | None
    drop_flagged: bool | None
    train_motions: int | None
    device: str


def sweep(
    datasets: Sequence[Path | str],
    out: Path | str,
    *,
    run: str,
    candidates: Mapping[str, AugmentConfig],
    seeds: Sequence[int],
    by: str | None = None,
    robot: RobotSpec | None = None,
    drop_flagged: bool | None = None,
    train_motions: int | None = None,
    jobs: int | None = None,
    ray: str | None = None,
    device: str = "cpu",
    overwrite: bool = False,
    resume: bool = False,
    on_training: Callable[[SweepResult], None] = lambda _: None,
) -> SweepResult:
    """Train every candidate with every seed, and say which is best on the val splits; test is not read.

    Each training is one of `augment`, in one thread, into `out/models/CANDIDATE/seed-SEED`; it does not depend on
    when, where and beside which others it is done. One that fails is noted with its reason, and the others go on.
    `sweep.json` is written anew whenever one has ended.

    Args:
        datasets: folders with the run in each; on a cluster, the same on all its machines.
        out: folder of the sweep; likewise.
        run: label of the run that is corrected.
        candidates: name -> configuration.
        seeds: of each candidate.
        by: signal whose error decides, which all candidates correct; the torque, or the first that all correct, if
            None.
        robot: as of `augment`.
        drop_flagged: likewise.
        train_motions: likewise.
        jobs: trainings at a time; the number of cores, of the cluster if there is one, if None.
        ray: address of a Ray cluster, or `local`; processes of this machine if None.
        device: `cpu` or `cuda`; on a cluster, a GPU for each training.
        overwrite: replace the sweep in `out`.
        resume: go on where an earlier call was interrupted: what is complete is not trained again, what has failed is.
            Candidates and seeds may be added.
        on_training: told whenever a training has ended.

    Raises:
        OutputExists: `out` is not empty, or holds another sweep.
        ConfigError: no candidate, a name that makes no folder, no seed or one that comes twice, no signal that all
            candidates correct, no such cluster, or a worker was killed again and again.
        MissingSignal: there is no such run, or no motion in train or val.
        DataError: no training could be completed, a dataset is broken, or most of the train motions would be left out.
        MissingDependency: torch or Ray is not installed, or there is no GPU.
    """
    out = Path(out).absolute()
    paths = tuple(Path(path).absolute() for path in datasets)
    _refuse(candidates, seeds, by, device if ray is None else None)
    source = TrainingData.of([Dataset(path) for path in paths], run)
    _refuse_data(source, by, drop_flagged=drop_flagged)
    asked = {"run": run, "drop_flagged": drop_flagged, "train_motions": train_motions, "robot": robot and robot.name}
    hashed = json_hash({**asked, "data": source.hash, "robot": robot and robot.to_dict()})
    configs = {name: as_read_back(config.to_json()) for name, config in candidates.items()}
    with connected(ray, jobs), sole_writer(out):
        _prepare(out, hashed, configs, seeds, overwrite=overwrite, resume=resume)
        found = SweepResult(
            tuple(
                SweepTraining(name, config.method, seed, f"{MODELS}/{name}/seed-{seed}")
                for name, config in candidates.items()
                for seed in seeds
            ),
            asked=hashed,
            provenance=provenance(
                config={**asked, "by": by, "seeds": list(seeds), "candidates": configs},
                seed=seeds[0],
                data_hash=source.hash,
            ),
        )
        found.save(out / SWEEP_NAME)
        on_training(found)
        tasks = [
            _Task(
                *(training, paths, out / training.folder, run, candidates[training.candidate], robot),
                *(drop_flagged, train_motions, device),
            )
            for training in found.trainings
        ]
        for training in _ended(tasks, jobs, ray, device):
            found = _with(found, training, by)
            found.save(out / SWEEP_NAME)
            on_training(found)
    _refuse_nothing(found)
    return found


def _refuse(candidates: Mapping[str, AugmentConfig], seeds: Sequence[int], by: str | None, device: str | None) -> None:
    """What can be seen to be wrong before anything is read.

    Raises:
        TrueupError: it is.
    """
    if not candidates:
        raise ConfigError("a sweep needs networks to train", got="none", expected="a method or a file, or several")
    for name in candidates:
        if not is_label_part(name) or len(name) > _LONGEST:
            raise ConfigError(
                "networks are called after their method or file, and this is no name",
                got=repr(name),
                expected=f"letters, digits, _ . + = -, at most {_LONGEST}",
                hint="Rename the file.",
            )
    if not seeds or len(set(seeds)) < len(seeds):
        raise ConfigError("seeds of a sweep", got=list(seeds) or "none", expected="at least one, each once")
    if device is not None:
        with needing("training", "learn"):
            from trueup.augment.training import find_device
        for config in candidates.values():
            find_device(device, config.precision)
    _refuse_other_signals(candidates, by)


def _refuse_data(source: TrainingData, by: str | None, *, drop_flagged: bool | None) -> None:
    """What every training would refuse, and a signal that none of them can correct.

    Raises:
        MissingSignal: no motion in train or val, or nobody measured or simulated the signal.
    """
    ids = {split: source.ids(split, drop_flagged=drop_flagged) for split in ("train", _VAL)}
    if by is not None:
        first = next(source.episodes(ids["train"][:1]))
        there = [name for name in first.measured.signals if name in first.run(source.run)]
        if by not in there:
            raise MissingSignal(f"--by {by} is not both simulated and measured", available=there)


def _refuse_other_signals(candidates: Mapping[str, AugmentConfig], by: str | None) -> None:
    """Networks that correct nothing in common cannot be compared; without `signals`, one corrects all of joints."""
    corrected = {name: set(config.data.signals or SIGNALS) for name, config in candidates.items()}
    common = set.intersection(*corrected.values())
    if not (common if by is None else by in common):
        listed = "; ".join(f"{name}: {', '.join(sorted(signals))}" for name, signals in corrected.items())
        raise ConfigError(
            "networks are compared by a signal that all of them correct",
            got=listed if by is None else f"--by {by}, and {listed}",
            hint="Sweep those of joints and those of bodies apart, or name a signal that they share with --by.",
        )


def _prepare(
    out: Path, asked: str, configs: Mapping[str, object], seeds: Sequence[int], *, overwrite: bool, resume: bool
) -> None:
    """An empty folder, or one of the same sweep.

    Raises:
        OutputExists: neither.
        DataError: what an earlier call has written is broken.
    """
    there = {file.name for file in out.iterdir() if not file.name.startswith(f".{SWEEP_NAME}.")}
    if not there:
        return
    if not (overwrite or resume):
        raise OutputExists(f"{out} is not empty", hint="Give --overwrite or --resume, or choose another --out.")
    if SWEEP_NAME not in there:
        raise OutputExists(f"{out} holds something else than a sweep", hint="Choose another --out.")
    if overwrite:
        # The file last: without it, nothing takes what is left for a sweep.
        for folder in (out / MODELS).glob("*/seed-*"):
            if re.fullmatch(r"seed-\d+", folder.name):
                shutil.rmtree(folder, ignore_errors=True)
        remove(out / SWEEP_NAME)
        return
    earlier = SweepResult.load(out / SWEEP_NAME)
    config = earlier.provenance.get("config")
    begun = config.get("candidates") if isinstance(config, Mapping) else None
    if not isinstance(begun, Mapping):
        raise DataError(f"{out / SWEEP_NAME} is broken", hint="Give --overwrite to begin anew.")
    same = earlier.asked == asked and all(configs.get(name) == config for name, config in begun.items())
    if not same or not {training.seed for training in earlier.trainings} <= set(seeds):
        raise OutputExists(
            f"{out} holds a sweep of other data, or with another run, robot or configuration, or with further networks "
            "or seeds",
            hint="Ask for all that it has, and more if you like; or choose another --out, or give --overwrite.",
        )


def _ended(tasks: Sequence[_Task], jobs: int | None, ray: str | None, device: str) -> Iterator[SweepTraining]:
    if ray is None:
        jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    ended = spread(_trained, tasks, jobs=jobs, ray=ray, gpus=int(device != "cpu"), begin=go_to, with_args=here())
    for task, training in ended:
        if training.state == "complete" and not task.folder.is_dir():
            raise DataError(
                f"what was trained is not in {task.folder}",
                hint="--out must be on a file system that all machines of the Ray cluster share, under the same path.",
            )
        yield training


def _trained(task: _Task) -> SweepTraining:
    """One training, in one thread; what is complete of it is kept."""
    training = task.training
    try:
        made = augment(
            [Dataset(path) for path in task.datasets],
            task.folder,
            run=task.run,
            config=task.config,
            robot=task.robot,
            name=f"{training.candidate}-s{training.seed}",
            drop_flagged=task.drop_flagged,
            train_motions=task.train_motions,
            seed=training.seed,
            jobs=1,
            device=task.device,
            resume=True,
        )
    except (MissingDependency, OutputExists):
        raise
    except TrueupError as error:  # a network that does not fit these motions must not hide the others
        return replace(training, state="failed", reason=error.summary)
    except OSError as error:
        return replace(training, state="failed", reason=f"{task.folder}: {error.strerror or error}")
    card = made.augmentation.card
    spent = card.provenance["training"]
    return replace(
        training,
        state="complete",
        seconds=round(float(spent["seconds"]), 3),
        epochs=len(spent["history"]),
        val=errors_of(card),
    )


def errors_of(card: ModelCard) -> dict[str, SweepError]:
    """Signal -> what a network leaves of its error on val, by its card; outputs that are switched off included."""
    outputs: dict[str, list[Output]] = {}
    for output in card.outputs:
        outputs.setdefault(output.quantity, []).append(output)
    return {signal: _pooled(card, own) for signal, own in outputs.items()}


def _pooled(card: ModelCard, outputs: Iterable[Output]) -> SweepError:
    outputs = list(outputs)
    numbers = [card.metrics[_VAL][output.signal][output.joint] for output in outputs]
    corrected, simulated = (np.array([item[key] for item in numbers], float) for key in ("corrected", "simulated"))
    units = {output.unit for output in outputs}
    if len(units) > 1:  # hinges and slides
        shares = np.divide(corrected, simulated, out=np.ones_like(corrected), where=simulated > 0)
        return SweepError(_root(shares), 1.0, "1")
    return SweepError(_root(corrected), _root(simulated), units.pop())


def _root(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _with(found: SweepResult, training: SweepTraining, by: str | None) -> SweepResult:
    """The result after one more training has ended."""
    place = (training.candidate, training.seed)
    trainings = tuple(training if (item.candidate, item.seed) == place else item for item in found.trainings)
    signal = signal_of(trainings, by)
    ranking = ranked(trainings, signal) if signal else ()
    return replace(
        found, trainings=trainings, signal=signal, ranking=ranking, chosen=ranking[0].best if ranking else ""
    )


def _refuse_nothing(found: SweepResult) -> None:
    """A sweep of which nothing came.

    Raises:
        DataError: no training is complete, or complete ones have no signal in common.
    """
    if all(training.state == "failed" for training in found.trainings):
        raise DataError("no training of the sweep could be completed, the first because", got=found.trainings[0].reason)
    if not found.ranking:
        corrected = sorted({name for training in found.trainings for name in training.val})
        raise DataError(
            "the networks correct no signal in common, by which they could be compared",
            got=", ".join(corrected),
            hint="All are trained; with --resume, --by SIGNAL or --signal names one that every network corrects.",
        )
