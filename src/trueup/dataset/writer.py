"""Writing a dataset, and the runs of simulators beside it."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
from abc import ABC, abstractmethod
from collections.abc import KeysView, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pyarrow as pa

from trueup.core.atomic import make_folder, read_json, write_json
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries
from trueup.dataset.append import StoreWriter, refuse_elsewhere
from trueup.dataset.index import StoreSpec, is_id
from trueup.dataset.info import DatasetInfo, is_dataset
from trueup.dataset.lock import LOCK_NAME, FolderLock
from trueup.dataset.store import StoreReader
from trueup.errors import ConfigError, DataError, FormatError, MissingSignal, NameMismatch, OutputExists

RUN_SCHEMA = "trueup.run/1"
RUN_NAME = "run.json"
SIMULATED = "simulated"

# Everything that trueup puts into a dataset's folder, and thus all that it ever deletes; dataset.json goes last, so
# that a deletion that was interrupted can be repeated.
_OWNED = ("episodes.parquet", "journal.bin", "measured", "command", SIMULATED, "model")
_RUN_OWNED = ("index.parquet", "journal.bin")
# Columns that datasets of earlier versions do not have.
_LATER = ("kp_setting",)

_LABEL_PART = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+=-]*")


def dataset_spec(folder: Path) -> StoreSpec:
    """The store of measured and commanded series."""
    texts = ("robot", "unit", "condition", "split", "source", "source_hash", "flags")
    fields = [pa.field(name, pa.string(), nullable=False) for name in texts]
    fields[2:2] = [pa.field(name, pa.float64()) for name in ("payload_kg", *_LATER)]
    series = {"measured": "measured", "command": "command"}
    return StoreSpec(folder, "episodes.parquet", series, tuple(fields), later=_LATER)


def is_label_part(text: str) -> bool:
    """Whether a text can stand between the slashes of a run's label."""
    return bool(_LABEL_PART.fullmatch(text)) and ".." not in text


def run_spec(dataset: Path, label: str) -> StoreSpec:
    """The store of one run.

    Raises:
        ConfigError: the label is no label.
    """
    parts = label.split("/")
    if label == "command":
        raise ConfigError(
            "the label 'command' is kept for the command taken as the motion", hint="choose another label"
        )
    if len(parts) > 3 or not all(is_label_part(part) for part in parts):
        raise ConfigError(
            "this is no label for a run", got=repr(label), expected="ENGINE/VARIANT such as mujoco/fitted+realeasy"
        )
    return StoreSpec(dataset / SIMULATED / label, "index.parquet", {"simulated": ""})


def meta_to_row(meta: EpisodeMeta) -> dict[str, Any]:
    """The columns of the index that hold an episode's metadata.

    Raises:
        DataError: the id has other characters than letters, digits and `_ . - /`, or a flag is not JSON.
    """
    if not is_id(meta.id):
        raise DataError("this is no id for an episode", got=repr(meta.id), expected="letters, digits, _ . - /")
    texts = ("robot", "unit", "condition", "split", "source", "source_hash")
    return {
        "id": meta.id,
        **{key: None if (own := getattr(meta, key)) is None else float(own) for key in ("payload_kg", "kp_setting")},
        "flags": flags_to_text(meta),
        # A file name that is not UTF-8 must not stop an import.
        **{name: getattr(meta, name).encode(errors="replace").decode() for name in texts},
    }


def flags_to_text(meta: EpisodeMeta) -> str:
    """The quality flags as JSON.

    Raises:
        DataError: a flag is not JSON.
    """
    try:
        return json.dumps([flag.to_json() for flag in meta.flags], default=_plain)
    except (TypeError, ValueError) as error:
        raise DataError(f"the flags of episode {meta.id!r} are not JSON", got=error) from error


def _plain(value: object) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} {value!r}")


class _Closing(ABC):
    """`with` for a writer: what was appended is kept, also when the block ends with an error.

    Then it stays in the journal, for a writer that resumes and goes on as this one would have.
    """

    @abstractmethod
    def close(self) -> None: ...

    @abstractmethod
    def release(self) -> None: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
            return
        self.release()


class DatasetWriter(_Closing):
    """Appends episodes to a dataset; made by `create` or `resume`.

    An episode for which `append` returned is in the dataset, also after `kill -9` or on a full disk.

    Attributes:
        path: the dataset's folder.
        info: what dataset.json says; joints and units grow with the episodes.
    """

    def __init__(self, path: Path, info: DatasetInfo, store: StoreWriter) -> None:
        self.path = path
        self.info = info
        self._store = store
        self._runs: dict[str, StoreWriter] = {}

    @classmethod
    def create(cls, path: Path | str, info: DatasetInfo, *, overwrite: bool = False) -> DatasetWriter:
        """Start a dataset in a folder that is missing, empty, or, with `overwrite`, a dataset.

        Raises:
            OutputExists: there is something else, or a dataset and no `overwrite`.
            DataError: another process writes it; the disk is full.
        """
        path = Path(path)
        refuse_occupied(path, overwrite=overwrite)
        make_folder(path)
        lock = FolderLock(path)
        try:
            refuse_occupied(path, overwrite=overwrite)  # another process may have been here before the lock was ours
            _delete(path, _OWNED)
            info.save(path)
            return cls(path, info, StoreWriter(dataset_spec(path), lock))
        except BaseException:
            lock.release()
            raise

    @classmethod
    def resume(cls, path: Path | str, info: DatasetInfo | None = None) -> DatasetWriter:
        """Go on with a dataset; starts one if the folder is missing or empty and `info` is given.

        Raises:
            FormatError: the folder is no dataset.
            NameMismatch: the dataset is of another robot.
            DataError: another process writes it; it is damaged.
        """
        path = Path(path)
        if info is not None and not _occupied(path):
            return cls.create(path, info)
        stored = DatasetInfo.load(path)
        if info is not None and info.robot != stored.robot:
            raise NameMismatch(f"{path} is of another robot", left=[info.robot], right=[stored.robot])
        return cls(path, stored, StoreWriter(dataset_spec(path)))

    def __enter__(self) -> DatasetWriter:
        return self

    @property
    def ids(self) -> KeysView[str]:
        """Ids that are there; follows `append`."""
        return self._store.ids

    def append(self, episode: Episode) -> None:
        """Add one episode, its simulated series included.

        Raises:
            DataError: the id is there or is no id, a series cannot be stored, or the disk is full.
        """
        row = meta_to_row(episode.meta)
        series = {"measured": episode.measured}
        info = self.info.covering("", episode.measured)
        if episode.command is not None:
            series["command"] = episode.command
            info = info.covering("command.", episode.command)
        if info is not self.info:
            info.save(self.path)
            self.info = info
        # Runs first: an episode that is there is there with its runs.
        for label, simulated in episode.simulated.items():
            run = self._run(label)
            if episode.id not in run.ids:
                run.append({"id": episode.id}, {"simulated": simulated})
        self._store.append(row, series)

    def _run(self, label: str) -> StoreWriter:
        if label not in self._runs:
            spec = run_spec(self.path, label)
            if not (spec.folder / RUN_NAME).exists():
                _start_run(self.path, spec, label, {"source": "came with the episodes"})
            self._runs[label] = StoreWriter(spec)
        return self._runs[label]

    def update(self, column: str, values: Mapping[str, Any]) -> None:
        """Set `split` or `flags` of episodes in the index."""
        missing = sorted(values.keys() - self.ids)
        if missing:
            raise MissingSignal(f"{self.path} has no episode {missing[0]!r}", available=sorted(self.ids))
        self._store.update(column, values)

    def close(self) -> None:
        """Move everything into shards and let the next writer in."""
        with contextlib.ExitStack() as stack:
            for store in (self._store, *self._runs.values()):
                stack.callback(store.close)

    def release(self) -> None:
        """Let the next writer in, which goes on where this one was."""
        for store in (self._store, *self._runs.values()):
            store.release()


class RunWriter(_Closing):
    """Writes what one simulator made of the episodes of a dataset.

    Args:
        dataset_path: the dataset's folder.
        label: e.g. `mujoco/stock`.
        run_info: free JSON: provenance, joint map; kept in run.json. A resumed run keeps the one that it has.
        overwrite: delete the run first if it is there.
        resume: go on with the run if it is there.

    Raises:
        OutputExists: the run is there and neither `overwrite` nor `resume` is given.
        ConfigError: the label is no label, or lies inside another run; run_info is not JSON.
        FormatError: there is no dataset.
        DataError: another process writes the run; it is damaged.
    """

    def __init__(
        self,
        dataset_path: Path,
        label: str,
        *,
        run_info: Mapping[str, Any],
        overwrite: bool = False,
        resume: bool = False,
    ) -> None:
        spec = run_spec(dataset_path, label)
        refuse_elsewhere(dataset_path, spec.folder)
        DatasetInfo.load(dataset_path)
        self.label = label
        self._dataset = dataset_path
        self._known = frozenset(StoreReader(dataset_spec(dataset_path)).ids)
        if not (spec.folder / RUN_NAME).exists():
            _start_run(dataset_path, spec, label, run_info)
        elif overwrite:
            lock = FolderLock(spec.folder)
            try:
                _delete(spec.folder, (*_RUN_OWNED, *(path.name for path in spec.shards("simulated"))))
                _save_run(spec, label, run_info)
            finally:
                lock.release()
        else:
            refuse_run(dataset_path, label, allowed=resume)
        self._store = StoreWriter(spec)

    def __enter__(self) -> RunWriter:
        return self

    @property
    def ids(self) -> KeysView[str]:
        """Ids of the episodes that the run has; follows `append`."""
        return self._store.ids

    def append(self, episode_id: str, series: TimeSeries) -> None:
        """Add the answer to one episode.

        Raises:
            MissingSignal: the dataset has no such episode.
            DataError: the run has it already, it cannot be stored, or the disk is full.
        """
        if episode_id not in self._known:
            raise MissingSignal(f"{self._dataset} has no episode {episode_id!r}", available=sorted(self._known))
        self._store.append({"id": episode_id}, {"simulated": series})

    def update_info(self, run_info: Mapping[str, Any]) -> None:
        """Replace what run.json says about the run.

        Raises:
            ConfigError: it is not JSON.
        """
        _save_run(run_spec(self._dataset, self.label), self.label, run_info)

    def close(self) -> None:
        """Move everything into shards and let the next writer in."""
        self._store.close()

    def release(self) -> None:
        """Let the next writer in, which goes on where this one was."""
        self._store.release()


def refuse_run(dataset_path: Path, label: str, *, allowed: bool) -> None:
    """Raise OutputExists if the run is there, unless that is `allowed`.

    Raises:
        ConfigError: the label is no label.
    """
    if (run_spec(dataset_path, label).folder / RUN_NAME).exists() and not allowed:
        raise OutputExists(f"{dataset_path} has a run {label!r}", hint="Give --overwrite, --resume or another --label.")


def read_run_info(spec: StoreSpec) -> dict[str, Any]:
    """The free part of run.json.

    Raises:
        FormatError: it is of another version.
        DataError: what trueup itself reads of it is of another kind.
    """
    path = spec.folder / RUN_NAME
    data = read_json(path)
    found = data.get("schema") if isinstance(data, dict) else type(data).__name__
    if found != RUN_SCHEMA or not isinstance(data.get("info"), dict):
        raise FormatError(f"{path} is of another version", got=found, expected=RUN_SCHEMA)
    info = dict(data["info"])
    for key in ("inputs", "provenance"):
        _check_kind(path, key, info.get(key, {}), dict, "a mapping")
    for key in ("corrects", "robot"):
        _check_kind(path, f"inputs: {key}", info.get("inputs", {}).get(key, {}), dict, "a mapping")
    _check_kind(path, "seconds", info.get("seconds", 0.0), (int, float), "a number")
    return info


def _check_kind(path: Path, key: str, value: object, kind: type | tuple[type, ...], expected: str) -> None:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise DataError(f"{path}: {key}", got=repr(value), expected=expected)


def _start_run(dataset: Path, spec: StoreSpec, label: str, run_info: Mapping[str, Any]) -> None:
    root = dataset / SIMULATED
    above = [folder for folder in spec.folder.parents if folder.is_relative_to(root) and (folder / RUN_NAME).exists()]
    below = list(spec.folder.glob(f"*/**/{RUN_NAME}"))
    if above or below:
        other = (above or [path.parent for path in below])[0].relative_to(root).as_posix()
        raise ConfigError(f"the run {label!r} would lie inside another", got=other, hint="choose another label")
    make_folder(spec.folder)
    _save_run(spec, label, run_info)


def _save_run(spec: StoreSpec, label: str, run_info: Mapping[str, Any]) -> None:
    try:
        write_json(spec.folder / RUN_NAME, {"schema": RUN_SCHEMA, "label": label, "info": dict(run_info)})
    except (TypeError, ValueError, RecursionError) as error:
        raise ConfigError(f"the description of run {label!r} is not JSON", got=error) from error


def refuse_occupied(path: Path, *, overwrite: bool) -> None:
    """Raise OutputExists unless the folder is missing, empty, or, with `overwrite`, a dataset."""
    if not _occupied(path):
        return
    if not path.is_dir():
        raise OutputExists(f"{path} is no folder", hint="--out is a folder: choose another name.")
    if not is_dataset(path):
        raise OutputExists(f"{path} is not empty and is no trueup dataset", hint="choose another folder for --out")
    if not overwrite:
        raise OutputExists(
            f"{path} exists", hint="--resume adds what is missing, --overwrite deletes the dataset first"
        )


def _occupied(path: Path) -> bool:
    """Whether there is anything but a lock, which a writer that died right at the start leaves."""
    if path.is_dir():
        return any(item.name != LOCK_NAME for item in path.iterdir())
    return path.exists() or path.is_symlink()


def _delete(folder: Path, names: tuple[str, ...]) -> None:
    try:
        for name in names:
            path = folder / name
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
    except OSError as error:
        raise DataError(f"cannot delete {error.filename}", got=error.strerror) from error
