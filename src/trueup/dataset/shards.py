"""Parquet shards: one row group per episode, all of one layout."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from trueup.core.atomic import regular, replacing
from trueup.dataset.columns import Layout, arrow_schema, parse_layout
from trueup.errors import DataError, FormatError

# What pyarrow raises for a damaged file.
READ_ERRORS = (pa.ArrowException, OSError, ValueError, LookupError, TypeError, ArithmeticError, MemoryError)

MAX_EPISODES = 128
MAX_BYTES = 64 << 20
# Opening a shard parses the description of every column of every episode, about half a microsecond each: 1024 keep
# one episode of a cold shard under 1 ms, so that training in random order over many shards is not held up.
MAX_CHUNKS = 1024
MIN_EPISODES = 16

_OPEN_SHARDS = 16
_MAGIC = b"PAR1"
_FEW_VALUES = 1 << 24
_VALUES_PER_BYTE = 200


def capacity(layout: Layout) -> int:
    """How many episodes of this layout go into one shard."""
    return min(MAX_EPISODES, max(MIN_EPISODES, MAX_CHUNKS // layout.width))


def shard_name(number: int) -> str:
    """File name of a shard."""
    return f"{number:05d}.parquet"


def write_shard(path: Path, layout: Layout, tables: Sequence[pa.Table]) -> None:
    """Write a shard atomically, table k as row group k.

    Raises:
        DataError: the disk is full or not writable.
    """
    with (
        replacing(path) as temporary,
        pq.ParquetWriter(
            temporary,
            arrow_schema(layout),
            # Measured on encoder-like and on random float32 against pyarrow's defaults: half the time to write, less
            # to read, and the smallest files; dictionaries and statistics only swell the footer of 500-row groups.
            compression="lz4",
            use_byte_stream_split=True,
            use_dictionary=False,
            write_statistics=False,
            write_page_checksum=True,
        ) as writer,
    ):
        for table in tables:
            writer.write_table(table, row_group_size=table.num_rows)


def open_parquet(path: Path) -> pq.ParquetFile:
    """Open a Parquet file after a look at its two ends, so that the parser is never fed plain garbage.

    Raises:
        DataError: it is missing, truncated or damaged.
    """
    try:
        with regular(path).open("rb") as file:
            size = file.seek(0, 2)
            file.seek(0)
            head = file.read(4)
            file.seek(max(0, size - 8))
            tail = file.read(8)
        whole = size >= 12 and head == _MAGIC and tail[4:] == _MAGIC
        if not whole or int.from_bytes(tail[:4], "little") > size - 12:
            raise damaged(path, "truncated or no Parquet file")
        # Neither memory map (a truncated file would kill the process) nor read-ahead (slower for one episode).
        opened = pq.ParquetFile(path, pre_buffer=False, page_checksum_verification=True)
        row_groups(opened, path)
    except READ_ERRORS as error:
        raise damaged(path, error) from error
    return opened


def row_groups(file: pq.ParquetFile, path: Path) -> list[pq.RowGroupMetaData]:
    """The row groups of a file, unless they claim values by the million for every kilobyte, or other rows than it.

    Raises:
        DataError: they do.
    """
    metadata = file.metadata
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    rows = [group.num_rows for group in groups]
    if sum(rows) != metadata.num_rows or min(rows, default=0) < 0:
        raise DataError(f"{path} contradicts itself", got=f"{metadata.num_rows} rows, and {sum(rows)} in its parts")
    refuse_values(path, metadata.num_rows * metadata.num_columns)
    return groups


def refuse_values(path: Path, values: int) -> None:
    """Refuse one value that is repeated to fill the memory.

    Raises:
        DataError: there are more values than a file of this size can hold.
    """
    if values > max(_FEW_VALUES, _VALUES_PER_BYTE * path.stat().st_size):
        raise DataError(f"{path} claims more than a file of its size can hold", got=f"{values} values")


def damaged(path: Path, reason: object) -> DataError:
    """The error for a file that is not as it was written."""
    return DataError(
        f"{path} is missing or damaged",
        got=str(reason).strip().split("\n")[0],
        hint="restore it from a copy, or import or replay again with --overwrite",
    )


@dataclass(frozen=True)
class _Shard:
    file: pq.ParquetFile
    layout: Layout


class ShardReader:
    """Reads single episodes from the shards of one folder and keeps the last few shards open."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._open: OrderedDict[int, _Shard] = OrderedDict()

    def read(self, number: int, group: int, samples: int) -> tuple[pa.Table, Layout]:
        """The columns of one episode.

        Args:
            number: the shard's number.
            group: row group in it.
            samples: rows that the index promises; a damaged footer must not make us allocate more.

        Raises:
            DataError: the shard is missing or damaged, or not the one of the index.
        """
        path = self._folder / shard_name(number)
        shard = self._shard(number, path)
        metadata = shard.file.metadata
        if not 0 <= group < metadata.num_row_groups or not _has(metadata.row_group(group), max(samples, 1)):
            raise damaged(path, f"row group {group} is not the one of the index")
        try:
            table = shard.file.read_row_group(group, use_threads=False)
        except READ_ERRORS as error:
            raise damaged(path, error) from error
        if table.num_rows != samples:
            raise damaged(path, f"row group {group} has rows missing")
        return table, shard.layout

    def is_small(self, number: int, layout: Layout) -> bool:
        """Whether a shard has this layout and is less than half full.

        Raises:
            DataError: the shard is missing or damaged.
        """
        path = self._folder / shard_name(number)
        shard = self._shard(number, path)
        episodes = shard.file.metadata.num_row_groups
        small = 2 * episodes < capacity(layout) and 2 * path.stat().st_size < MAX_BYTES
        return small and shard.layout == layout

    def tables(self, number: int) -> list[pa.Table]:
        """All episodes of a shard.

        Raises:
            DataError: the shard is missing or damaged.
        """
        metadata = self._shard(number, self._folder / shard_name(number)).file.metadata
        groups = range(metadata.num_row_groups)
        return [self.read(number, group, metadata.row_group(group).num_rows)[0] for group in groups]

    def _shard(self, number: int, path: Path) -> _Shard:
        shard = self._open.get(number)
        if shard is not None:
            self._open.move_to_end(number)
            return shard
        file = open_parquet(path)
        try:
            shard = _Shard(file, parse_layout(file.schema_arrow))
        except FormatError as error:
            raise damaged(path, error) from error
        except READ_ERRORS as error:
            raise damaged(path, error) from error
        self._open[number] = shard
        if len(self._open) > _OPEN_SHARDS:
            self._open.popitem(last=False)[1].file.close()
        return shard

    def close(self) -> None:
        """Close the open shards."""
        while self._open:
            self._open.popitem()[1].file.close()


def _has(group: pq.RowGroupMetaData, rows: int) -> bool:
    """Whether a row group has so many rows, and each of its columns, too: a reader makes room for what is claimed."""
    return group.num_rows == rows and all(group.column(k).num_values == rows for k in range(group.num_columns))
