"""The index of a store: one row an episode, small enough to be held in memory as Arrow columns."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from trueup.core.atomic import replacing
from trueup.dataset.parquet_tables import read_table
from trueup.dataset.shards import READ_ERRORS, damaged, open_parquet
from trueup.errors import DataError, FormatError

INDEX_SCHEMA = "trueup.index/1"
_INDEX_KEY = b"trueup"
# An id is a path below some folder: parts of letters, digits and `_ . -`, none of them `.` or `..`.
_PART = r"(?!\.{1,2}(?:/|\Z))[\w.\-]+"
_ID = re.compile(rf"{_PART}(?:/{_PART})*")


def is_id(text: str) -> bool:
    """Whether a text can be the id of an episode, and thus a path below a folder."""
    return bool(_ID.fullmatch(text))


@dataclass(frozen=True)
class StoreSpec:
    """What is stored where.

    Attributes:
        folder: the store's folder.
        index_name: file name of its index.
        series: name of a series -> subfolder with its shards.
        fields: columns of the index that only the owner of the store knows.
        later: those of them that earlier versions did not write; empty where they are missing.
    """

    folder: Path
    index_name: str
    series: Mapping[str, str]
    fields: tuple[pa.Field, ...] = ()
    later: tuple[str, ...] = ()

    @property
    def index_path(self) -> Path:
        """The index."""
        return self.folder / self.index_name

    @property
    def journal_path(self) -> Path:
        """The write-ahead log."""
        return self.folder / "journal.bin"

    def shard_folder(self, series: str) -> Path:
        """Where the shards of a series are."""
        return self.folder / self.series[series]

    def shards(self, series: str) -> list[Path]:
        """The shard files of a series that are there, whether the index names them or not."""
        return sorted(self.shard_folder(series).glob("[0-9]*.parquet"))

    @property
    def schema(self) -> pa.Schema:
        """Columns of the index: where a series lies is null while it is still in the journal."""
        places = [
            pa.field(f"{series}_{what}", kind)
            for series in self.series
            for what, kind in (("samples", pa.int64()), ("shard", pa.int32()), ("group", pa.int32()))
        ]
        common = [
            pa.field("hash", pa.string(), nullable=False),
            pa.field("duration_s", pa.float64(), nullable=False),
            pa.field("rate_hz", pa.float64(), nullable=False),
        ]
        fields = [pa.field("id", pa.string(), nullable=False), *self.fields, *common, *places]
        return pa.schema(fields, metadata={_INDEX_KEY: INDEX_SCHEMA})

    def table(self, rows: Iterable[Mapping[str, Any]]) -> pa.Table:
        """Rows as a table with the index's columns; what a row lacks is null.

        Raises:
            DataError: a value is of another kind than its column, or missing where one is needed.
        """
        try:
            table = pa.Table.from_pylist(list(rows), schema=self.schema)
        except READ_ERRORS as error:
            raise damaged(self.folder, f"a row of the index: {error}") from error
        if any(table.column(field.name).null_count for field in self.schema if not field.nullable):
            raise damaged(self.folder, "a row of the index lacks a value")
        _refuse_ids(self.folder, table)
        return table


class Index:
    """The rows of an index.

    Raises:
        DataError: an id occurs twice.
    """

    def __init__(self, table: pa.Table) -> None:
        self.table = table.combine_chunks()
        self.ids: tuple[str, ...] = tuple(self.table.column("id").to_pylist())
        self.position = {id: row for row, id in enumerate(self.ids)}
        if len(self.position) != len(self.ids):
            raise DataError("an id occurs twice in the index", got=len(self.ids), expected=len(self.position))

    def row(self, id: str) -> dict[str, Any]:
        """The row of one episode, which must be there."""
        position = self.position[id]
        return {name: column[position].as_py() for name, column in self._columns.items()}

    @cached_property
    def _columns(self) -> dict[str, Any]:
        # Plain arrays: looking a row up in a chunked column costs several times as much.
        columns = ((name, self.table.column(name)) for name in self.table.column_names)
        return {name: column.chunk(0) if column.num_chunks == 1 else column for name, column in columns}


def read_index(spec: StoreSpec) -> pa.Table:
    """The rows that stand in shards; none if nothing was ever written.

    Raises:
        DataError: the index is damaged, or missing beside data.
        FormatError: it is of another version.
    """
    path = spec.index_path
    if not path.exists():
        # A writer starts with an empty index: without one, nothing else can be there.
        if spec.journal_path.exists() or any(spec.shards(series) for series in spec.series):
            raise damaged(path, "the index is missing, data are there")
        return spec.schema.empty_table()
    with open_parquet(path) as file:
        try:
            version = (file.schema_arrow.metadata or {}).get(_INDEX_KEY, b"none").decode()
            if version != INDEX_SCHEMA:
                raise FormatError(f"{path} is of another version", got=version, expected=INDEX_SCHEMA)
            # A row holds a hash that does not compress below 32 bytes: more rows than this are a damaged footer.
            if file.metadata.num_rows * 32 > path.stat().st_size:
                raise damaged(path, f"{file.metadata.num_rows} rows cannot be in it")
            table = read_table(file, path, spec.schema.names)
            # A row group number of a damaged index must be an error here, not a wrong episode later.
            table.validate(full=True)
            for name in (name for name in spec.later if name not in table.column_names):
                kind = spec.schema.field(name).type
                table = table.append_column(name, pa.nulls(table.num_rows, kind))
            table = table.select(spec.schema.names).cast(spec.schema)
        except READ_ERRORS as error:
            raise damaged(path, error) from error
    _refuse_ids(path, table)
    return table


def _refuse_ids(path: Path, table: pa.Table) -> None:
    """Refuse rows with ids that no writer takes: others make paths of ids, and these would lead anywhere."""
    unfit = next((id for id in table.column("id").to_pylist() if not is_id(id)), None)
    if unfit is not None:
        raise damaged(path, f"a row of the index has the id {unfit!r}")


def write_index(spec: StoreSpec, table: pa.Table) -> None:
    """Replace the index atomically.

    Raises:
        DataError: the disk is full or not writable.
    """
    with replacing(spec.index_path) as temporary:
        pq.write_table(table, temporary, write_statistics=False, write_page_checksum=True)
