"""Reading a dataset lazily."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.timeseries import TimeSeries
from trueup.dataset.info import DatasetInfo
from trueup.dataset.shards import damaged
from trueup.dataset.splits import SPLITS
from trueup.dataset.store import StoreReader, store_signature
from trueup.dataset.writer import (
    RUN_NAME,
    SIMULATED,
    DatasetWriter,
    dataset_spec,
    flags_to_text,
    read_run_info,
    run_spec,
)
from trueup.errors import ConfigError, MissingSignal

_META = tuple(item.name for item in fields(EpisodeMeta))


class Dataset:
    """A dataset on disk. Only the index is held in memory; samples are read when asked for, and checked.

    `dataset[id]` and `dataset[number]` read one episode without its simulated series; iterating reads one after
    the other. What it lists is the state at the time of opening; `reload` looks again.

    Args:
        path: the dataset's folder.

    Raises:
        FormatError: the folder is no dataset, or one of another version.
        DataError: it is damaged.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.info = DatasetInfo.load(self.path)
        self._store = StoreReader(dataset_spec(self.path))
        self._runs: dict[str, StoreReader] = {}

    def __reduce__(self) -> tuple[type[Dataset], tuple[Path]]:
        """A dataset travels to another process as its path."""
        return Dataset, (self.path,)

    def __len__(self) -> int:
        """The number of episodes."""
        return len(self.ids)

    def __contains__(self, id: object) -> bool:
        """Whether there is an episode with this id."""
        return id in self._store.index.position

    def __iter__(self) -> Iterator[Episode]:
        """The episodes in the order in which they were written, one in memory at a time."""
        return self.episodes()

    def __getitem__(self, key: str | int) -> Episode:
        """One episode, by id or by number."""
        return self.episode(key if isinstance(key, str) else self.ids[key])

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the episodes, in the order in which they were written."""
        return self._store.ids

    @property
    def index(self) -> pa.Table:
        """The index: one row an episode; `index.to_pandas()` to look around."""
        return self._store.index.table

    @cached_property
    def metas(self) -> tuple[EpisodeMeta, ...]:
        """Metadata of all episodes, without reading samples."""
        # By column: row by row takes ten times as long, which 100,000 episodes feel.
        columns = {name: self.index.column(name).to_pylist() for name in _META}
        columns["flags"] = [self._flags(text) for text in columns["flags"]]
        return tuple(EpisodeMeta(*values) for values in zip(*columns.values(), strict=True))

    @property
    def splits(self) -> dict[str, str]:
        """Episode id -> `train`, `val` or `test`, of those that have a split."""
        splits = self.index.column("split").to_pylist()
        return {id: split for id, split in zip(self.ids, splits, strict=True) if split}

    @cached_property
    def hash(self) -> str:
        """SHA-256 over ids and samples (measured and command), whatever their order on disk.

        Splits, flags and other metadata do not enter, nor do runs.
        """
        lines = sorted(zip(self.ids, self.index.column("hash").to_pylist(), strict=True))
        return hashlib.sha256("".join(f"{id}\0{digest}\n" for id, digest in lines).encode()).hexdigest()

    def meta(self, id: str) -> EpisodeMeta:
        """Metadata of one episode, without reading samples.

        Raises:
            MissingSignal: there is no such episode.
        """
        self._check(id)
        row = self._store.index.row(id)
        return EpisodeMeta(**{name: row[name] for name in _META} | {"flags": self._flags(row["flags"])})

    def _flags(self, text: str) -> tuple[Flag, ...]:
        if text == "[]":
            return ()
        try:
            return tuple(Flag(**flag) for flag in json.loads(text))
        except (ValueError, TypeError, RecursionError) as error:
            raise damaged(self._store.spec.index_path, f"flags: {error}") from error

    def _check(self, id: str) -> None:
        if id not in self:
            raise MissingSignal(f"{self.path} has no episode {id!r}", available=self.ids)

    def episode(self, id: str, *, runs: Iterable[str] = ()) -> Episode:
        """One episode, with the series of these runs.

        Raises:
            MissingSignal: there is no such episode, or a run is not there or has not got it.
            DataError: its samples are damaged.
        """
        meta = self.meta(id)
        series = self._store.read(id)
        return Episode(
            meta=meta,
            measured=series["measured"],
            command=series.get("command"),
            simulated={label: self._simulated(label, id) for label in runs},
        )

    def episodes(self, ids: Iterable[str] | None = None, *, runs: Sequence[str] = ()) -> Iterator[Episode]:
        """Episodes one after the other: these ids, or all."""
        for id in self.ids if ids is None else ids:
            yield self.episode(id, runs=runs)

    def select(self, *, split: str | None = None, drop_flagged: bool | None = False) -> tuple[str, ...]:
        """Ids of the episodes of a split (or of all).

        Args:
            split: None for all.
            drop_flagged: without those that carry a warning; None: without those whose measurement is broken.

        Raises:
            MissingSignal: no episode has this split.
        """
        splits = self.splits
        if split is not None and split not in splits.values():
            raise MissingSignal(
                f"{self.path} has no split {split!r}",
                available=sorted(set(splits.values())),
                hint="a split.json beside the logs, or `Dataset.set_splits`, assigns them",
            )
        return tuple(
            meta.id
            for meta in self.metas
            if (split is None or meta.split == split) and not meta.why_dropped(drop_flagged=drop_flagged)
        )

    @property
    def runs(self) -> tuple[str, ...]:
        """Labels of the runs that are there now."""
        root = self.path / SIMULATED
        return tuple(sorted(path.parent.relative_to(root).as_posix() for path in root.glob(f"**/{RUN_NAME}")))

    def run_info(self, label: str) -> dict[str, Any]:
        """What the writer of a run said about it.

        Raises:
            MissingSignal: there is no such run.
        """
        return read_run_info(self._run(label).spec)

    def run_ids(self, label: str) -> tuple[str, ...]:
        """Ids of the episodes that a run has.

        Raises:
            MissingSignal: there is no such run.
        """
        return self._run(label).ids

    def _run(self, label: str) -> StoreReader:
        if label not in self._runs and label not in self.runs:
            raise MissingSignal(f"{self.path} has no run {label!r}", available=self.runs)
        spec = run_spec(self.path, label)
        # Runs come and go while a dataset is open: `close` replays into the dataset that it reads.
        if label not in self._runs or self._runs[label].signature != store_signature(spec):
            self._runs[label] = StoreReader(spec)
        return self._runs[label]

    def _simulated(self, label: str, id: str) -> TimeSeries:
        run = self._run(label)
        if id not in run.index.position:
            raise MissingSignal(f"run {label!r} has no episode {id!r}", available=run.ids)
        return run.read(id)["simulated"]

    def set_splits(self, splits: Mapping[str, str]) -> None:
        """Assign splits: episode id -> `train`, `val`, `test`, or empty for none. Rewrites the index only.

        Raises:
            MissingSignal: there is no such episode.
            ConfigError: there is no such split.
            DataError: another process writes the dataset.
        """
        unknown = sorted(set(splits.values()) - {*SPLITS, ""})
        if unknown:
            raise ConfigError("unknown split", got=unknown, expected=SPLITS)
        self._update("split", splits)

    def set_flags(self, flags: Mapping[str, Sequence[Flag]]) -> None:
        """Replace the quality flags of these episodes. Rewrites the index only.

        Raises:
            MissingSignal: there is no such episode.
            DataError: another process writes the dataset.
        """
        self._update("flags", {id: flags_to_text(EpisodeMeta(id, flags=tuple(items))) for id, items in flags.items()})

    def _update(self, column: str, values: Mapping[str, str]) -> None:
        for id in values:
            self._check(id)
        with DatasetWriter.resume(self.path) as writer:
            writer.update(column, values)
        self.reload()

    def reload(self) -> None:
        """Look again at what is on disk."""
        self.close()
        self.__dict__.pop("metas", None)
        self.__dict__.pop("hash", None)
        self.info = DatasetInfo.load(self.path)
        self._store = StoreReader(dataset_spec(self.path))

    def close(self) -> None:
        """Close the open files; reading opens them again."""
        for store in (self._store, *self._runs.values()):
            store.close()
