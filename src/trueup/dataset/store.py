"""Reading a store of episodes: what stands in shards and index, and what is still in the journal."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path

import pyarrow as pa

from trueup.core.timeseries import TimeSeries
from trueup.dataset.columns import Layout, content_hash, from_table, parse_layout
from trueup.dataset.index import Index, StoreSpec, read_index
from trueup.dataset.journal import JournalReader, Row, unpack, unpack_row
from trueup.dataset.shards import READ_ERRORS, ShardReader, damaged
from trueup.errors import DataError, TrueupError


class StoreReader:
    """Reads a store lazily, also while it is being written or after its writer died.

    What it lists is the state at the time of opening. Every episode that is read is checked against its hash.
    Threads may share it.

    Raises:
        DataError: the index or the journal is damaged.
    """

    def __init__(self, spec: StoreSpec) -> None:
        self.spec = spec
        self._guard = threading.Lock()
        self._journal: JournalReader | None = None
        self._shards = {series: ShardReader(spec.shard_folder(series)) for series in spec.series}
        self._load()

    def _load(self) -> None:
        # The journal first: what a writer moves from it into the index in between is then seen twice, not never.
        self.signature = store_signature(self.spec)
        with contextlib.suppress(FileNotFoundError):
            self._journal = JournalReader(self.spec.journal_path)
        rows: dict[str, Row] = {}
        self._offsets: dict[str, tuple[int, int]] = {}
        if self._journal is not None:
            for frame in self._journal.frames(salvage=False):
                row = unpack_row(frame.payload)
                if rows.setdefault(row["id"], row) is row:
                    self._offsets[row["id"]] = (frame.offset, len(frame.payload))
        table = read_index(self.spec)
        for id in table.column("id").to_pylist():
            if rows.pop(id, None) is not None:
                del self._offsets[id]
        try:
            self.index = Index(pa.concat_tables([table, self.spec.table(rows.values())]))
        except DataError as error:
            raise damaged(self.spec.index_path, error) from error

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the episodes, in the order in which they were written."""
        return self.index.ids

    def read(self, id: str) -> dict[str, TimeSeries]:
        """All series of one episode, which must be there.

        Raises:
            DataError: its bytes are missing, damaged, or not those that were written.
        """
        with self._guard:
            try:
                return self._read(id)
            except DataError:
                # A writer may have merged a small shard into the next one since we looked.
                if store_signature(self.spec) == self.signature:
                    raise
                self.close()
                self._load()
                if id not in self.index.position:
                    raise
                return self._read(id)

    def _read(self, id: str) -> dict[str, TimeSeries]:
        row = self.index.row(id)
        tables = self._from_journal(id) if id in self._offsets else self._from_shards(row)
        if next(iter(self.spec.series)) not in tables:
            raise damaged(self.spec.index_path, f"episode {id!r} has no samples")
        try:
            series = {name: (from_table(table, layout), layout) for name, (table, layout) in tables.items()}
            found = content_hash(series)
        except (TrueupError, *READ_ERRORS) as error:
            raise damaged(self.spec.folder, f"episode {id!r}: {error}") from error
        if found != row["hash"]:
            raise damaged(self.spec.folder, f"episode {id!r} is not what was written")
        return {name: values for name, (values, _) in series.items()}

    def _from_shards(self, row: Row) -> dict[str, tuple[pa.Table, Layout]]:
        return {
            name: shards.read(row[f"{name}_shard"], row[f"{name}_group"] or 0, row[f"{name}_samples"] or 0)
            for name, shards in self._shards.items()
            if row[f"{name}_shard"] is not None
        }

    def _from_journal(self, id: str) -> dict[str, tuple[pa.Table, Layout]]:
        path = self.spec.journal_path
        if self._journal is None:
            try:
                self._journal = JournalReader(path)
            except FileNotFoundError as error:
                raise damaged(path, error) from error
        offset, size = self._offsets[id]
        payload = self._journal.read(offset, size)
        if len(payload) != size:
            raise damaged(path, "truncated")
        return {
            name: (table, parse_layout(table.schema)) for name, table in unpack(payload, self.spec.series)[1].items()
        }

    def close(self) -> None:
        """Close the open files; reading opens them again."""
        for shards in self._shards.values():
            shards.close()
        if self._journal is not None:
            self._journal.close()
            self._journal = None


def store_signature(spec: StoreSpec) -> tuple[tuple[int, int, int] | None, ...]:
    """Changes whenever the store does."""

    def stamp(path: Path) -> tuple[int, int, int] | None:
        try:
            status = path.stat()
        except OSError:
            return None
        return status.st_ino, status.st_size, status.st_mtime_ns

    return stamp(spec.index_path), stamp(spec.journal_path)
