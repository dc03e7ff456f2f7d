"""Rows of a LeRobot dataset: which file holds an episode, and its frames."""

from __future__ import annotations

import contextlib
import itertools
import json
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Float

from trueup.core.atomic import regular
from trueup.dataset.importers.files import files_hash, read_text
from trueup.dataset.importers.lerobot_info import LeRobotInfo
from trueup.dataset.parquet_tables import believable, is_list, read_table
from trueup.errors import DataError, TrueupError

EPISODES, LINES = "meta/episodes", "meta/episodes.jsonl"
OWN = "trueup/"

_NEEDED = ("episode_index", "data/chunk_index", "data/file_index", "length")
_OPTIONAL = ("tasks", f"{OWN}id", f"{OWN}unit", f"{OWN}payload_kg", f"{OWN}kp_setting", f"{OWN}condition")


@dataclass(frozen=True)
class EpisodeRow:
    """Where an episode is, and what is said about it.

    Attributes:
        number: episode_index.
        file: the file with its frames.
        start: row of the file at which they begin, if the file holds its episodes in order and nothing else.
        length: number of frames.
        about: optional columns -> value.
    """

    number: int
    file: Path
    start: int
    length: int
    about: dict[str, Any]


def read_episodes(root: Path, info: LeRobotInfo) -> list[EpisodeRow]:
    """All episodes of the dataset, by number.

    Raises:
        DataError: the table of episodes is missing or damaged, or an episode occurs twice.
    """
    rows = _rows_of_lines(root, info) if info.version == 2 else _rows_of_tables(root, info)
    rows.sort(key=lambda row: row.number)
    twice = [row.number for row, following in itertools.pairwise(rows) if row.number == following.number]
    if twice:
        raise DataError(f"{root / EPISODES} lists episodes twice", got=twice[:8])
    ends: dict[Path, int] = {}
    for k, row in enumerate(rows):
        rows[k] = replace(row, start=ends.get(row.file, 0))
        ends[row.file] = rows[k].start + row.length
    return rows


def _rows_of_lines(root: Path, info: LeRobotInfo) -> list[EpisodeRow]:
    """Version 2: a line of JSON for each episode, which has a file of its own."""
    path = root / LINES
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip():
            continue
        try:
            about = json.loads(line)
            index, length = about["episode_index"], about["length"]
        except (ValueError, RecursionError, LookupError, TypeError) as error:
            raise DataError(f"{path}, line {number} is no episode", got=error) from error
        if not all(type(value) is int and 0 <= value < 1 << 40 for value in (index, length)):
            raise DataError(f"{path} has an episode with numbers that make no sense", got=[index, length])
        file = info.data_file(root, index // info.chunk_size, index)
        known = {name: about[name] for name in _OPTIONAL if about.get(name) is not None}
        rows.append(EpisodeRow(index, file, 0, length, known))
    if not rows:
        raise DataError(f"{path} lists no episode")
    return rows


def _rows_of_tables(root: Path, info: LeRobotInfo) -> list[EpisodeRow]:
    """Version 3: tables of episodes, which share files."""
    files = sorted((root / EPISODES).glob("*/*.parquet"))
    if not files:
        raise DataError(f"{root / EPISODES} holds no table of episodes", expected="chunk-000/file-000.parquet")
    rows = []
    for path in files:
        with reading(path):
            parquet = pq.ParquetFile(path)
            missing = [name for name in _NEEDED if name not in parquet.schema_arrow.names]
            if missing:
                raise DataError(f"{path} has no columns {missing}", available=parquet.schema_arrow.names)
            for row in read_table(parquet, path, [*_NEEDED, *_OPTIONAL]).to_pylist():
                numbers = [row[name] for name in _NEEDED]
                if not all(type(value) is int and 0 <= value < 1 << 40 for value in numbers):
                    raise DataError(f"{path} has an episode with numbers that make no sense", got=numbers)
                number, chunk, file, length = numbers
                about = {name: row[name] for name in _OPTIONAL if row.get(name) is not None}
                rows.append(EpisodeRow(number, info.data_file(root, chunk, file), 0, length, about))
    return rows


class FrameReader:
    """Reads the frames of one episode after the other.

    The file of the last episode stays open and its last row groups in memory, since neighbors often share them.

    Args:
        columns: columns to read besides the indices.
    """

    def __init__(self, columns: Sequence[str]) -> None:
        self._columns = list(dict.fromkeys(("episode_index", "frame_index", "timestamp", *columns)))
        self._lock = threading.Lock()
        self._path: Path | None = None
        self._file: Any = None
        self._ends: list[int] = []
        self._groups: list[int] = []
        self._table: Any = None
        self._hashes: dict[Path, str] = {}

    def hash_of(self, file: Path) -> str:
        """SHA-256 of a file, computed once: it holds many episodes."""
        with self._lock:
            if file not in self._hashes:
                self._hashes[file] = files_hash([file])
            return self._hashes[file]

    def read(self, row: EpisodeRow) -> pa.Table:
        """The frames of an episode, checked to be all there and in order.

        Raises:
            DataError: the file is missing or damaged, a column is not there, or frames are missing.
        """
        if not row.length:
            raise DataError(f"{row.file}: episode {row.number} has no frames")
        with reading(row.file), self._lock:
            self._open(row.file)
            near = [
                k
                for k, (start, end) in enumerate(itertools.pairwise([0, *self._ends]))
                if start < row.start + row.length and row.start < end
            ]
            table = self._frames(near, row.number)
            if len(table) != row.length:  # the file holds more than its episodes, or in another order
                table = self._frames(list(range(len(self._ends))), row.number)
            frames = table["frame_index"].to_numpy()
        if len(frames) != row.length or not np.array_equal(frames, np.arange(row.length)):
            raise DataError(
                f"{row.file}: episode {row.number} is not complete or not in order",
                got=f"{len(frames)} frames",
                expected=f"frames 0 to {row.length - 1}",
            )
        return table

    def _open(self, path: Path) -> None:
        if path == self._path:
            return
        self._path, self._table = None, None
        self._file = believable(pq.ParquetFile(path), path, self._columns)
        missing = [name for name in self._columns if name not in self._file.schema_arrow.names]
        if missing:
            raise DataError(f"{path} has no columns {missing}", available=self._file.schema_arrow.names)
        for name in self._columns:  # a text that is repeated would fill the memory before anybody looks at it
            kind = self._file.schema_arrow.field(name).type
            if not _is_numeric(kind.value_type if is_list(kind) else kind):
                raise DataError(f"{path}: {name} has values that are no numbers", got=str(kind))
        # The statistics would name the row groups of an episode, but damaged ones end the process.
        metadata = self._file.metadata
        counts = (metadata.row_group(k).num_rows for k in range(metadata.num_row_groups))
        self._ends = list(itertools.accumulate(counts))
        self._path = path

    def _frames(self, groups: list[int], number: int) -> pa.Table:
        if self._table is None or groups != self._groups:
            self._table = self._file.read_row_groups(groups, columns=self._columns, use_threads=False)
            self._groups = groups
        return self._table.filter(pc.equal(self._table["episode_index"], number))


def vectors(table: pa.Table, name: str, width: int, source: str) -> Float[np.ndarray, "T W"]:
    """A column of vectors, (T, width); a single number per frame is a vector of one.

    Raises:
        DataError: values are missing, of another kind, or the vectors differ in length.
    """
    column = table[name].combine_chunks()
    kind = column.type
    if is_list(kind):
        lengths = pc.unique(pc.list_value_length(column)).to_pylist()
        if lengths != [width]:
            raise DataError(f"{source}: {name} is ragged", got=f"vectors of {lengths[:4]}", expected=width)
        column = column.flatten()
        kind = column.type
    elif width != 1:
        raise DataError(f"{source}: {name} holds no vectors", got=str(kind), expected=f"vectors of {width}")
    if column.null_count or not _is_numeric(kind):
        got = f"{column.null_count} missing values" if column.null_count else str(kind)
        raise DataError(f"{source}: {name} has values that are no numbers", got=got)
    values = np.asarray(column.to_numpy(zero_copy_only=False)).reshape(-1, width)
    return values if values.dtype in (np.float32, np.float64) else values.astype(np.float64)


def _is_numeric(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turns every failure of the Parquet library into a DataError that names the file."""
    try:
        regular(path)
        yield
    except TrueupError:
        raise
    except FileNotFoundError:
        raise DataError(f"{path} does not exist", hint="The download may be incomplete.") from None
    except Exception as error:  # damaged bytes raise errors of many kinds
        raise DataError(
            f"{path} cannot be read as Parquet",
            got=str(error) or type(error).__name__,
            hint="The file may be truncated.",
        ) from error
