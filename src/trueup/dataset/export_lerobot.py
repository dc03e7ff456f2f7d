"""Episodes as a LeRobot dataset, version 3, that LeRobot loads and our importer reads back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float32

from trueup.core.atomic import appearing, write_json
from trueup.core.episode import Episode
from trueup.core.timeseries import TimeSeries
from trueup.dataset.lerobot_files import FILES_PER_CHUNK, NumberedFiles, write_tasks
from trueup.dataset.lerobot_stats import RunningStats, Values, episode_stats, quantiles
from trueup.errors import ConfigError, DataError, NameMismatch, OutputExists

# A stamp may be this far from k / fps [s]: what LeRobot itself accepts.
TOLERANCE_S = 1e-4

_VERSION = "v3.0"
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_FILE_MB = 100
_EPISODES_PER_FILE = 10_000
_EPISODES_PER_GROUP = 200
# Signal -> the feature beside the state that LeRobot datasets keep it in, and the ending of its names.
_MEASURED = {
    "position": "observation.state",
    "velocity": "observation.velocity",
    "acceleration": "observation.acceleration",
    "torque": "observation.effort",
    "current": "observation.current",
    "voltage": "observation.voltage",
    "temperature": "observation.temperature",
}
_ENDINGS = {"position": "pos", "velocity": "vel", "acceleration": "acc"}
_COUNTERS = ("frame_index", "episode_index", "index", "task_index")


def export_lerobot(episodes: Iterable[Episode], folder: Path, *, fps: int, robot_type: str, task: str = "") -> None:
    """Write episodes as a LeRobot v3 dataset; it appears whole or not at all.

    `observation.state` is the measured position, `action` every commanded signal; other measured signals get a
    feature each. Values are stored as float32, LeRobot's type, with their units beside the names. Episodes are
    taken one at a time. Body signals and simulated runs have no place in the format and are left out.

    Args:
        episodes: all with the same joints and signals, command and measured on one grid of 1 / fps.
        folder: is created; its parent may exist.
        fps: frames per second [Hz].
        robot_type: what LeRobot calls the robot, e.g. `so101_follower`.
        task: what the robot does, in words.

    Raises:
        OutputExists: the folder is there.
        ConfigError: fps is not positive.
        DataError: an episode is not on the grid, lacks its position or has missing values; there are no episodes;
            the disk is full.
        NameMismatch: an episode has other joints or signals than the first.
    """
    if fps < 1:
        raise ConfigError("fps is no rate", got=fps, expected="1 or more frames per second")
    if folder.exists():
        raise OutputExists(f"{folder} is already there", hint="Choose another folder, or remove it first.")
    with appearing(folder) as temporary, _Writer(temporary, fps, robot_type, task) as writer:
        for episode in episodes:
            writer.add(episode)
        writer.finish()


@dataclass(frozen=True)
class _Feature:
    """A vector per frame: which signals it holds, how its values are called and what they are measured in."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Float32[np.ndarray, "T W"]


class _Writer:
    """Writes one episode at a time; keeps only counters and statistics."""

    def __init__(self, folder: Path, fps: int, robot_type: str, task: str) -> None:
        self._folder = folder
        self._fps = fps
        self._robot_type = robot_type
        self._task = task
        self._features: dict[str, _Feature] = {}
        self._stats: dict[str, RunningStats] = {}
        self._splits: dict[str, list[list[int]]] = {}
        self._episodes = self._frames = 0
        self._data = NumberedFiles(folder, _DATA)
        self._meta = NumberedFiles(folder, _EPISODES)
        self._rows: list[dict[str, Any]] = []

    def __enter__(self) -> _Writer:
        return self

    def __exit__(self, *_: object) -> None:
        self._data.close()
        self._meta.close()

    def add(self, episode: Episode) -> None:
        features = _features(episode)
        _check_grid(episode, self._fps)
        self._check_same(episode, features)
        if self._data.rows and self._data.bytes >= _FILE_MB << 20:
            self._data.roll()
        frames = len(episode.measured)
        counters = {
            "frame_index": np.arange(frames),
            "episode_index": np.full(frames, self._episodes),
            "index": np.arange(self._frames, self._frames + frames),
            "task_index": np.zeros(frames, dtype=np.int64),
        }
        timestamp = (np.arange(frames) / self._fps).astype(np.float32)
        arrays: dict[str, Values] = {
            **{name: feature.values for name, feature in features.items()},
            "timestamp": timestamp[:, np.newaxis],
            **{name: values[:, np.newaxis] for name, values in counters.items()},
        }
        self._data.write(pa.table({name: _column(values) for name, values in arrays.items()}))
        for name, values in arrays.items():
            self._stats.setdefault(name, RunningStats(values.shape[1])).add(values)
        self._keep_row(episode, frames, arrays)
        self._keep_split(episode.meta.split)
        self._episodes += 1
        self._frames += frames

    def finish(self) -> None:
        if not self._episodes:
            raise DataError("there are no episodes to export")
        self._flush_rows()
        self._data.close()
        self._meta.close()
        write_json(self._folder / "meta/info.json", self._info())
        names = [*self._features, "timestamp", *_COUNTERS]
        within = {name: (self._stats[name].minimum, self._stats[name].maximum) for name in names}
        spread = quantiles(self._data.paths, within)
        write_json(
            self._folder / "meta/stats.json", {name: {**self._stats[name].summary(), **spread[name]} for name in names}
        )
        write_tasks(self._folder / "meta/tasks.parquet", self._task)

    def _check_same(self, episode: Episode, features: Mapping[str, _Feature]) -> None:
        if not self._features:
            self._features = dict(features)
        for what in ("names", "units"):
            left = [f"{key}: {item}" for key, feature in features.items() for item in getattr(feature, what)]
            right = [f"{key}: {item}" for key, feature in self._features.items() for item in getattr(feature, what)]
            if left != right:
                raise NameMismatch(
                    f"episode {episode.id!r} has other {what} than the first, and LeRobot has one table for all",
                    left=left,
                    right=right,
                    right_name="the first has",
                )

    def _keep_row(self, episode: Episode, frames: int, arrays: Mapping[str, Values]) -> None:
        if self._meta.rows + len(self._rows) >= _EPISODES_PER_FILE:
            self._flush_rows()
            self._meta.roll()
        row: dict[str, Any] = {
            "episode_index": self._episodes,
            "tasks": [self._task],
            "length": frames,
            "data/chunk_index": self._data.chunk_index,
            "data/file_index": self._data.file_index,
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + frames,
        }
        for name, values in arrays.items():
            row |= {f"stats/{name}/{key}": value for key, value in episode_stats(values).items()}
        row |= {
            "meta/episodes/chunk_index": self._meta.chunk_index,
            "meta/episodes/file_index": self._meta.file_index,
            "trueup/id": episode.meta.id,
            "trueup/unit": episode.meta.unit,
            "trueup/payload_kg": episode.meta.payload_kg,
            "trueup/kp_setting": episode.meta.kp_setting,
            "trueup/condition": episode.meta.condition,
        }
        self._rows.append(row)
        if len(self._rows) == _EPISODES_PER_GROUP:
            self._flush_rows()

    def _flush_rows(self) -> None:
        if not self._rows:
            return
        numbers = dict.fromkeys(("trueup/payload_kg", "trueup/kp_setting"), pa.float64())
        special = {"tasks": pa.list_(pa.string()), **numbers}
        fields = []
        for name, value in self._rows[0].items():
            if name in special:
                kind = special[name]
            elif isinstance(value, list):
                kind = pa.list_(pa.int64() if name.endswith("/count") else pa.float64())
            else:
                kind = pa.string() if isinstance(value, str) else pa.int64()
            fields.append(pa.field(name, kind))
        self._meta.write(pa.Table.from_pylist(self._rows, schema=pa.schema(fields)))
        self._rows = []

    def _keep_split(self, split: str) -> None:
        ranges = self._splits.setdefault(split, [])
        if ranges and ranges[-1][1] == self._episodes:
            ranges[-1][1] += 1
        else:
            ranges.append([self._episodes, self._episodes + 1])

    def _info(self) -> dict[str, Any]:
        # LeRobot expects a split for all episodes; it does not read the ranges itself.
        assigned = {name: ranges for name, ranges in self._splits.items() if name} or {"train": [[0, self._episodes]]}
        features: dict[str, Any] = {
            name: {
                "dtype": "float32",
                "shape": [len(feature.names)],
                "names": list(feature.names),
                "units": list(feature.units),
            }
            for name, feature in self._features.items()
        }
        features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
        features |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in _COUNTERS}
        return {
            "codebase_version": _VERSION,
            "robot_type": self._robot_type,
            "total_episodes": self._episodes,
            "total_frames": self._frames,
            "total_tasks": 1,
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": _FILE_MB,
            "video_files_size_in_mb": 200,
            "fps": self._fps,
            "splits": {name: ",".join(f"{start}:{end}" for start, end in ranges) for name, ranges in assigned.items()},
            "data_path": _DATA,
            "video_path": None,
            "features": features,
        }


def _features(episode: Episode) -> dict[str, _Feature]:
    measured = episode.measured
    if "position" not in measured:
        raise DataError(f"episode {episode.id!r} has no measured position", available=measured.signals)
    features = {
        feature: _feature(episode, measured, (signal,)) for signal, feature in _MEASURED.items() if signal in measured
    }
    if episode.command is not None:
        signals = tuple(signal for signal in _MEASURED if signal in episode.command)
        if signals:
            features["action"] = _feature(episode, episode.command, signals)
    return features


def _feature(episode: Episode, series: TimeSeries, signals: tuple[str, ...]) -> _Feature:
    values = np.concatenate([series[signal] for signal in signals], axis=1).astype(np.float32)
    if not np.isfinite(values).all():
        frame, column = (int(k) for k in np.argwhere(~np.isfinite(values))[0])
        raise DataError(
            f"episode {episode.id!r} has missing values, which LeRobot cannot hold",
            got=f"{signals[column // len(series.joints)]} of {series.joints[column % len(series.joints)]}, row {frame}",
            hint="Fill them by resampling, or leave the episode out.",
        )
    return _Feature(
        names=tuple(f"{joint}.{_ENDINGS.get(signal, signal)}" for signal in signals for joint in series.joints),
        units=tuple(unit for signal in signals for unit in series.units[signal]),
        values=values,
    )


def _check_grid(episode: Episode, fps: int) -> None:
    measured = episode.measured
    hint = f"Resample command and measured onto one grid of {fps} Hz first."
    away = np.abs(measured.time_s - measured.time_s[0] - np.arange(len(measured)) / fps)
    if away.max() > TOLERANCE_S:
        row = int(np.argmax(away))
        raise DataError(
            f"episode {episode.id!r} is not sampled at {fps} Hz",
            got=f"row {row} is {away[row]:.3g} s away from {row} / {fps} s",
            expected=f"at most {TOLERANCE_S:g} s",
            hint=hint,
        )
    command = episode.command
    if command is not None and (
        len(command) != len(measured) or float(np.abs(command.time_s - measured.time_s).max()) > TOLERANCE_S
    ):
        raise DataError(
            f"command and measured of episode {episode.id!r} have clocks of their own, and LeRobot has one",
            got=f"{len(command)} commands and {len(measured)} samples",
            hint=hint,
        )


def _column(values: Values) -> pa.Array:
    """LeRobot stores a vector as a fixed-size list, and a vector of one as the number itself."""
    flat = pa.array(np.ascontiguousarray(values).ravel())
    return flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
