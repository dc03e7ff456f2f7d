"""What a correction is trained on: datasets with a run of the same simulated robot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from trueup.align import JointMap
from trueup.core.atomic import json_hash
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.quality import dropped, refuse_majority
from trueup.dataset import Dataset
from trueup.deploy.agreement import RATE_TOLERANCE
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch

# A motion: the number of its dataset, and its id there.
MotionId = tuple[int, str]


@dataclass(frozen=True)
class TrainingData:
    """Datasets, and what their runs say of the robot.

    Attributes:
        datasets: with the run in each; several for several units of one robot.
        run: label of the run that is corrected.
        robot: its name; empty where the run does not say.
        joints: of the run.
        scored: those whose outputs are corrected.
        joint_map: from the logs' joints to the robot's.
        info: how the run was made.
    """

    datasets: tuple[Dataset, ...]
    run: str
    robot: str
    joints: tuple[str, ...]
    scored: tuple[str, ...]
    joint_map: JointMap
    info: Mapping[str, Any]

    @staticmethod
    def of(datasets: Sequence[Dataset], run: str) -> TrainingData:
        """Check that the runs belong together.

        Raises:
            MissingSignal: a dataset has no such run.
            NameMismatch: the runs have different joints.
            ConfigError: there is no dataset, one comes twice, a run came with the logs, or the runs were simulated
                differently.
        """
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
        infos = [dataset.run_info(run) for dataset in datasets]
        for dataset, info in zip(datasets, infos, strict=True):
            if "joint_map" not in info:
                raise ConfigError(
                    f"the run {run!r} of {dataset.path} came with the logs: it is on a clock of its own",
                    hint="Replay the commands with trueup replay, and correct that run.",
                )
            if info["joints"] != infos[0]["joints"]:
                raise NameMismatch(
                    f"the run {run!r} has other joints in {dataset.path}",
                    left=info["joints"],
                    right=infos[0]["joints"],
                )
            if _physics(info) != _physics(infos[0]):
                raise ConfigError(
                    f"the run {run!r} of {dataset.path} was simulated with another model or other settings",
                    hint="Replay all datasets with the same robot and model.",
                )
        info = infos[0]
        joints = tuple(info["joints"])
        return TrainingData(
            datasets=tuple(datasets),
            run=run,
            robot=str(info.get("inputs", {}).get("robot", {}).get("name", "")),
            joints=joints,
            scored=tuple(info.get("scored_joints", joints)),
            joint_map=JointMap.from_dict(info["joint_map"]),
            info=info,
        )

    @cached_property
    def hash(self) -> str:
        """Of the motions, their splits, and what the runs were made from."""
        return json_hash(
            [
                [dataset.hash, dataset.run_info(self.run).get("inputs", {}), dataset.splits, dataset.run_ids(self.run)]
                for dataset in self.datasets
            ]
        )

    def dropped(self, split: str, *, drop_flagged: bool | None) -> dict[str, str]:
        """Motion of a split -> why it is left out, of those that the run has; as `EpisodeMeta.why_dropped` says."""
        return {
            name if len(self.datasets) == 1 else f"{number}/{name}": why
            for number, dataset in enumerate(self.datasets)
            for name, why in dropped(self._metas(dataset, split), drop_flagged=drop_flagged).items()
        }

    def _metas(self, dataset: Dataset, split: str) -> list[EpisodeMeta]:
        there = set(dataset.run_ids(self.run))  # without those that could not be replayed
        return [meta for meta in dataset.metas if meta.split == split and meta.id in there]

    def ids(self, split: str, *, drop_flagged: bool | None) -> list[MotionId]:
        """The motions of a split that the run has too.

        Args:
            split: of the datasets.
            drop_flagged: as of `EpisodeMeta.why_dropped`.

        Raises:
            MissingSignal: there is none.
            DataError: the measurement is broken in most of the train motions, and nobody said what to do with them.
        """
        found: list[MotionId] = []
        count = 0
        for number, dataset in enumerate(self.datasets):
            metas = self._metas(dataset, split)
            count += len(metas)
            found += [(number, meta.id) for meta in metas if not meta.why_dropped(drop_flagged=drop_flagged)]
        if split == "train" and drop_flagged is None:
            refuse_majority(self.dropped(split, drop_flagged=None), count, keep="--keep-flagged")
        if not found:
            raise MissingSignal(
                f"no motion of the run {self.run!r} is in the split {split!r}",
                available=sorted({item for dataset in self.datasets for item in dataset.splits.values()}),
                hint="Training needs train and val: give --splits 80/15/5 when you import, or a split.json.",
            )
        return found

    def episodes(self, chosen: Iterable[MotionId]) -> Iterator[Episode]:
        """Motions in the robot's names with the run beside them; with several datasets, ids begin with a number."""
        for number, name in chosen:
            episode = self.joint_map.of_episode(self.datasets[number].episode(name, runs=[self.run]))
            if len(self.datasets) > 1:
                episode = replace(episode, meta=replace(episode.meta, id=f"{number}/{name}"))
            yield episode

    def at_rate(self, chosen: Iterable[MotionId], rate_hz: float, *, given: bool) -> Iterator[Episode]:
        """Motions of one rate; where one is given, of at least that: nobody simulated what is between.

        Raises:
            DataError: a motion has another rate, or a lower one than was given.
        """
        for episode in self.episodes(chosen):
            rate = min(episode.run(self.run).rate_hz, episode.measured.rate_hz)
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


def rate_of(episode: Episode, run: str) -> float:
    """Samples of the run per second, a whole number where it is nearly one [Hz]."""
    return _whole(episode.run(run).rate_hz)


def lowest_rate(dataset: Dataset, run: str, *, drop_flagged: bool | None) -> float | None:
    """Samples per second of the slowest motion of train and val [Hz]; None where all of them have the same rate.

    Test motions have no say, and neither has a motion of one sample, which has no rate.
    """
    there = set(dataset.run_ids(run))
    rates = [
        rate
        for meta, rate in zip(dataset.metas, dataset.index["rate_hz"].to_pylist(), strict=True)
        if meta.split in ("train", "val")
        and meta.id in there
        and not meta.why_dropped(drop_flagged=drop_flagged)
        and rate > 0.0
    ]
    if not rates:
        return None
    lowest = _whole(min(rates))
    return lowest if max(rates) > lowest * (1 + RATE_TOLERANCE) else None


def _whole(rate_hz: float) -> float:
    whole = round(rate_hz)
    return float(whole) if whole and abs(rate_hz / whole - 1) < RATE_TOLERANCE else rate_hz


def _physics(info: Mapping[str, Any]) -> tuple[Any, ...]:
    return info.get("inputs", {}).get("model_sha256"), info.get("settings")


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
