"""What `meta/info.json` of a LeRobot dataset says: version, rate, features, splits, where the rows are."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from trueup.core.atomic import read_json
from trueup.core.units import UNITS
from trueup.errors import DataError, FormatError

INFO = "meta/info.json"

# LeRobot's templates are Python format strings; only these fields, so that a template can do nothing else.
_FIELD = re.compile(r"\{(chunk_index|file_index|episode_chunk|episode_index)(?::0?([1-9])d)?\}")
_SPLIT_NAMES = {"train": "train", "val": "val", "valid": "val", "validation": "val", "test": "test"}


@dataclass(frozen=True)
class Feature:
    """A column of the table.

    Attributes:
        name: e.g. `observation.state`.
        dtype: as LeRobot writes it, e.g. `float32`, `video`.
        width: number of values in a frame; 0 if it is no vector of numbers.
        names: one name per value, or empty.
        units: one unit per value, or empty; LeRobot itself states none.
    """

    name: str
    dtype: str
    width: int
    names: tuple[str, ...]
    units: tuple[str, ...]


@dataclass(frozen=True)
class LeRobotInfo:
    """The content of info.json, as far as it is needed here.

    Attributes:
        fps: frames per second [Hz].
        robot: type of robot, or empty.
        features: feature name -> feature.
        data_path: template of the files with the rows.
        splits: split name -> ranges of episode numbers, as written.
        version: 3, or 2, in which each episode has a file of its own.
        chunk_size: of version 2, episodes in a folder.
    """

    fps: float
    robot: str
    features: Mapping[str, Feature]
    data_path: str
    splits: Mapping[str, str]
    version: int = 3
    chunk_size: int = 1000

    def data_file(self, root: Path, chunk: int, number: int) -> Path:
        """The file with the rows of a chunk and a file, or in version 2 of an episode.

        Raises:
            FormatError: the template has other fields, or leads out of the dataset.
        """
        fields = ("chunk_index", "file_index") if self.version == 3 else ("episode_chunk", "episode_index")
        numbers = dict(zip(fields, (chunk, number), strict=True))
        name = _FIELD.sub(
            lambda found: f"{numbers[found[1]]:0{found[2] or 1}d}" if found[1] in numbers else found[0], self.data_path
        )
        path = PurePosixPath(name)
        if "{" in name or "}" in name or "\x00" in name:
            raise FormatError(f"`data_path` in {INFO} cannot be read", got=self.data_path, expected=_FIELD.pattern)
        # Links are followed: the Hub's download cache consists of them.
        if path.is_absolute() or ".." in path.parts or not path.parts or "\\" in name:
            raise FormatError(f"`data_path` in {INFO} leads out of the dataset", got=self.data_path)
        return root / path


def read_info(root: Path) -> LeRobotInfo:
    """Read info.json of the dataset in `root`.

    Raises:
        FormatError: another version than 2 and 3.
        DataError: the file is missing, not JSON, or has values of the wrong kind.
    """
    content = read_json(root / INFO)
    if not isinstance(content, dict):
        raise DataError(f"{root / INFO} holds no object", got=type(content).__name__)
    version = _version(root, content.get("codebase_version"))
    chunk_size = content.get("chunks_size", 1000)
    if type(chunk_size) is not int or not 0 < chunk_size < 1 << 40:
        raise DataError(f"`chunks_size` in {root / INFO} is no count", got=chunk_size)
    fps = content.get("fps")
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not math.isfinite(fps) or fps <= 0:
        raise DataError(f"`fps` in {root / INFO} is no rate", got=fps, expected="frames per second")
    features = content.get("features")
    if not isinstance(features, dict) or not all(isinstance(item, dict) for item in features.values()):
        raise DataError(f"`features` in {root / INFO} is no object of features", got=type(features).__name__)
    splits = content.get("splits") or {}
    if not isinstance(splits, dict) or not all(isinstance(ranges, str) for ranges in splits.values()):
        raise DataError(f"`splits` in {root / INFO} are no ranges", got=splits, expected='{"train": "0:33"}')
    data_path = content.get("data_path")
    if not isinstance(data_path, str) or len(data_path) > 1000:
        raise DataError(f"`data_path` in {root / INFO} is no template", got=data_path)
    robot = content.get("robot_type")
    return LeRobotInfo(
        fps=float(fps),
        robot=robot if isinstance(robot, str) else "",
        features={name: _feature(name, item) for name, item in features.items()},
        data_path=data_path,
        splits=splits,
        version=version,
        chunk_size=chunk_size,
    )


def read_splits(info: LeRobotInfo, episodes: Sequence[int]) -> tuple[dict[int, str], tuple[str, ...]]:
    """Episode number -> split, and notes on what was not understood.

    LeRobot writes `"train": "0:N"` whatever the data are for, so a single split that covers everything assigns
    nothing.

    Raises:
        DataError: a range is not of the form `0:33`, or an episode is in two splits.
    """
    result: dict[int, str] = {}
    notes = []
    for name, text in info.splits.items():
        split = _SPLIT_NAMES.get(name.lower())
        if split is None:
            notes.append(f"split {name!r} is unknown and left out; known are train, val, test")
            continue
        ranges = [re.fullmatch(r"\s*(\d{1,12}):(\d{1,12})\s*", part) for part in text.split(",")]
        for found in ranges:
            if found is None:
                raise DataError(f"split {name!r} in {INFO} is no range", got=text[:80], expected="e.g. 0:33")
            inside = [number for number in episodes if int(found[1]) <= number < int(found[2])]
            if any(result.setdefault(number, split) != split for number in inside):
                raise DataError(f"splits in {INFO} overlap", got=dict(info.splits))
    if result and len(set(result.values())) == 1 and len(result) == len(episodes):
        notes.append(f"every episode is in {next(iter(result.values()))!r}, LeRobot's default: no split is assigned")
        result = {}
    return result, tuple(notes)


def _version(root: Path, version: Any) -> int:
    """2 or 3."""
    found = re.match(r"v?(\d+)(\.\d+)*", version) if isinstance(version, str) else None
    number = 0 if found is None else int(found[1][:9])
    if number in (2, 3):
        return number
    raise FormatError(
        f"{root} is a LeRobot dataset of another version",
        got=version,
        expected="v3.0, v2.1 or v2.0",
        hint="Convert it with LeRobot's own scripts, step by step." if number == 1 else None,
    )


def _feature(name: str, item: Mapping[str, Any]) -> Feature:
    shape = item.get("shape")
    vector = isinstance(shape, list) and len(shape) == 1 and type(shape[0]) is int and 0 < shape[0] < 100_000
    width = shape[0] if vector and shape is not None else 0
    dtype = item.get("dtype")
    units = item.get("units")
    known = isinstance(units, list) and len(units) == width and all(isinstance(u, str) and u in UNITS for u in units)
    return Feature(
        name=name,
        dtype=dtype if isinstance(dtype, str) else "",
        width=width if isinstance(dtype, str) and re.fullmatch(r"(float|u?int)\d+", dtype) else 0,
        names=_names(item.get("names"), width),
        units=tuple(units) if known and units is not None else (),
    )


def _names(names: Any, width: int) -> tuple[str, ...]:
    """Names as a list, or as the only list in an object such as {"motors": [...]}; empty if they do not fit."""
    if isinstance(names, dict) and len(names) == 1:
        names = next(iter(names.values()))
    if not isinstance(names, list) or len(names) != width or not all(isinstance(n, str) and n for n in names):
        return ()
    return tuple(names) if len(set(names)) == len(names) else ()
