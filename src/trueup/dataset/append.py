"""Appending to a store: a journal for what is new, Parquet shards and an index for the rest.

Order of every change, so that a crash between two steps loses nothing and doubles nothing:
journal frame; then shards; then the index that names them; then the journal is deleted. Ids in the index win over
the same ids in the journal, and shards that no index names do not exist.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, KeysView, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from trueup.core.atomic import is_inside, make_folder
from trueup.core.timeseries import TimeSeries
from trueup.dataset.columns import Layout, content_hash, from_table, layout_of, parse_layout, to_table
from trueup.dataset.index import StoreSpec, read_index, write_index
from trueup.dataset.journal import Journal, JournalReader, Row, pack, unpack
from trueup.dataset.lock import FolderLock
from trueup.dataset.shards import MAX_BYTES, READ_ERRORS, ShardReader, capacity, damaged, shard_name, write_shard
from trueup.errors import DataError


@dataclass(frozen=True)
class _Pending:
    """An episode that is in the journal and not yet in a shard."""

    row: Row
    tables: Mapping[str, pa.Table]
    layouts: Mapping[str, Layout]


# The index is written as a whole, so a flush must be worth it; what is pending is held in memory.
MAX_PENDING = 1024


def refuse_elsewhere(folder: Path, part: Path) -> None:
    """Refuse to write through a link that leads out of a dataset.

    Raises:
        DataError: the part of the folder lies elsewhere.
    """
    if not is_inside(folder, part):
        raise DataError(f"{part} leads out of {folder}", hint="Link the whole dataset, not a part of it.")


class StoreWriter:
    """Appends episodes to a store; whatever `append` returned from survives a killed process.

    Opening recovers what a writer that died left in the journal.

    Args:
        spec: what is stored where.
        lock: of its folder, if the caller holds it already; released by the writer.

    Raises:
        DataError: another process writes the store, the disk is full, or the index is damaged.
    """

    def __init__(self, spec: StoreSpec, lock: FolderLock | None = None) -> None:
        self.spec = spec
        for series in spec.series:
            refuse_elsewhere(spec.folder, spec.shard_folder(series))
            make_folder(spec.shard_folder(series))
        self._lock = FolderLock(spec.folder) if lock is None else lock
        try:
            self._table = read_index(spec)
            self._ids: dict[str, None] = dict.fromkeys(self._table.column("id").to_pylist())
            if not spec.index_path.exists():
                self._write_index(self._table)
            self._forget_pending()
            self._clean()
            self._journal = Journal(spec.journal_path, end=self._recover())
        except BaseException:
            self._lock.release()
            raise
        self._closed = False

    def _clean(self) -> None:
        """Delete what a writer that died left half-written, or had merged into a later shard.

        Later shards that no index names are left alone: the next flush replaces them.
        """
        for folder in {self.spec.folder, *map(self.spec.shard_folder, self.spec.series)}:
            for temporary in (*folder.glob(".*.parquet.*.tmp"), *folder.glob(".*.json.*.tmp")):
                temporary.unlink(missing_ok=True)
        for series in self.spec.series:
            named = set(self._table.column(f"{series}_shard").drop_null().to_pylist())
            for path in self.spec.shards(series):
                if path.stem.isdecimal() and int(path.stem) < self._last_number(series) and int(path.stem) not in named:
                    path.unlink(missing_ok=True)

    def _recover(self) -> int:
        """Take up the whole frames of a journal that was left behind; where to go on in it, 0 for a new one.

        An undamaged journal is gone on with, so that shards begin and end where they would have without the
        interruption.
        """
        end = 0
        with contextlib.suppress(FileNotFoundError), contextlib.closing(JournalReader(self.spec.journal_path)) as left:
            end = left.begin
            for frame in left.frames(salvage=True):
                row, tables = unpack(frame.payload, self.spec.series)
                end = frame.end if frame.begin == end and row["id"] not in self._ids else 0
                if row["id"] not in self._ids:
                    self.spec.table([row])
                    layouts, found = self._understood(tables)
                    if found != row["hash"]:
                        raise damaged(self.spec.journal_path, f"episode {row['id']!r} is not what was written")
                    self._add(_Pending(row, tables, layouts), len(frame.payload))
        if self._pending and end and not self._full():
            return end
        self._settle()
        self.spec.journal_path.unlink(missing_ok=True)
        return 0

    def _understood(self, tables: Mapping[str, pa.Table]) -> tuple[dict[str, Layout], str]:
        """The layouts of an episode of the journal, and the hash of its content."""
        try:
            layouts = {name: parse_layout(table.schema) for name, table in tables.items()}
            series = {name: (from_table(table, layouts[name]), layouts[name]) for name, table in tables.items()}
            return layouts, content_hash(series)
        except READ_ERRORS as error:
            raise damaged(self.spec.journal_path, error) from error

    def _last_number(self, series: str) -> int:
        number = pc.max(self._table.column(f"{series}_shard")).as_py()
        return -1 if number is None else number

    @property
    def ids(self) -> KeysView[str]:
        """Ids that are there, in the order in which they were written; follows `append`."""
        return self._ids.keys()

    def append(self, row: Row, series: Mapping[str, TimeSeries]) -> None:
        """Append one episode; the first series gives duration and rate.

        Args:
            row: `id` and the owner's columns.
            series: name -> series.

        Raises:
            DataError: the id is taken, a series cannot be stored, the disk is full, the folder was moved meanwhile, or
                the writer is closed.
        """
        if self._closed:
            raise DataError(f"the writer of {self.spec.folder} is closed")
        self._lock.refuse_moved()
        if row["id"] in self._ids:
            raise DataError(f"episode {row['id']!r} is there already", hint="ids are unique; skip those in `.ids`")
        layouts = {name: layout_of(values) for name, values in series.items()}
        tables = {name: to_table(values, layouts[name]) for name, values in series.items()}
        first = next(iter(series.values()))
        row = {
            **row,
            "hash": content_hash({name: (values, layouts[name]) for name, values in series.items()}),
            "duration_s": first.duration_s,
            "rate_hz": first.rate_hz,
            **{f"{name}_samples": len(values) for name, values in series.items()},
        }
        pieces = pack(row, tables)
        self._journal.append(pieces)
        self._add(_Pending(row, tables, layouts), sum(map(len, pieces)))
        if self._full():
            self.flush()

    def _forget_pending(self) -> None:
        self._pending: list[_Pending] = []
        # (series, layout) -> places in the list: one shard holds one series of one layout.
        self._groups: dict[tuple[str, Layout], list[int]] = {}
        self._bytes = 0

    def _add(self, pending: _Pending, size: int) -> None:
        for series, layout in pending.layouts.items():
            self._groups.setdefault((series, layout), []).append(len(self._pending))
        self._bytes += size
        self._pending.append(pending)
        self._ids[pending.row["id"]] = None

    def _full(self) -> bool:
        return self._bytes >= MAX_BYTES or len(self._pending) >= MAX_PENDING

    def flush(self) -> None:
        """Move what is in the journal into shards and the index.

        Raises:
            DataError: the disk is full or not writable, or the folder was moved; the journal still has everything.
        """
        self._lock.refuse_moved()
        if self._pending:
            self._settle()
            self._lock.refuse_moved()
            self._journal.remove()

    def _settle(self) -> None:
        if not self._pending:
            return
        table = self._table
        rows = [dict(pending.row) for pending in self._pending]
        merged = []
        following = {series: self._last_number(series) + 1 for series in self.spec.series}
        for (series, layout), members in self._groups.items():
            folder, size = self.spec.shard_folder(series), capacity(layout)
            old, head = self._small_shard(series, layout)
            if head:
                table = _moved(table, f"{series}_shard", old, following[series])
                merged.append(folder / shard_name(old))
            tables = head + [self._pending[member].tables[series] for member in members]
            for place, member in enumerate(members, start=len(head)):
                number = following[series] + place // size
                rows[member] |= {f"{series}_shard": number, f"{series}_group": place % size}
            for start in range(0, len(tables), size):
                write_shard(folder / shard_name(following[series]), layout, tables[start : start + size])
                following[series] += 1
        table = pa.concat_tables([table, self.spec.table(rows)])
        self._write_index(table)
        self._forget_pending()
        for path in merged:
            with contextlib.suppress(OSError):  # a file that nothing names harms nobody
                path.unlink()

    def _small_shard(self, series: str, layout: Layout) -> tuple[int, list[pa.Table]]:
        """The last shard, if it is less than half full: writing one episode a day must not make a file a day."""
        number = self._last_number(series)
        if number < 0 or self._full():
            return -1, []
        with contextlib.closing(ShardReader(self.spec.shard_folder(series))) as shards:
            return (number, shards.tables(number)) if shards.is_small(number, layout) else (-1, [])

    def _write_index(self, table: pa.Table) -> None:
        write_index(self.spec, table)
        # The new names must be on the disk before the journal's name goes.
        for folder in {self.spec.folder, *map(self.spec.shard_folder, self.spec.series)}:
            # Not every file system can sync a folder; those that cannot keep the order anyway.
            with contextlib.suppress(OSError), _descriptor(folder) as descriptor:
                os.fsync(descriptor)
        self._table = table

    def update(self, column: str, values: Mapping[str, Any]) -> None:
        """Set a column of the index for some ids, which must be there."""
        self.flush()
        ids = self._table.column("id").to_pylist()
        present = self._table.column(column).to_pylist()
        place = self._table.schema.get_field_index(column)
        changed = [values.get(id, value) for id, value in zip(ids, present, strict=True)]
        field = self._table.schema.field(place)
        self._write_index(self._table.set_column(place, field, pa.array(changed, type=field.type)))

    def close(self) -> None:
        """Move everything into shards and let the next writer in.

        Raises:
            DataError: the disk is full; the journal still has everything.
        """
        if self._closed:
            return
        try:
            self.flush()
        finally:
            self.release()

    def release(self) -> None:
        """Let the next writer in, which goes on with the journal as this one would have."""
        if self._closed:
            return
        self._closed = True
        self._journal.close()
        self._lock.release()


@contextlib.contextmanager
def _descriptor(folder: Path) -> Iterator[int]:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _moved(table: pa.Table, column: str, old: int, new: int) -> pa.Table:
    place = table.schema.get_field_index(column)
    numbers = table.column(column)
    moved = pc.if_else(pc.equal(numbers, old), pa.scalar(new, pa.int32()), numbers)
    return table.set_column(place, table.schema.field(place), moved)
