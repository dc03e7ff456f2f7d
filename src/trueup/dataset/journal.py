"""The write-ahead log of a store: whole episodes, one frame each, until they stand in a shard.

    file  = "TRUEUPJ1" frame*
    frame = magic(4) payload_length(u64) crc32(payload)(u32) crc32(of these 16 bytes)(u32) payload
    payload = length(u32) row as JSON, then per series: length(u64) Arrow IPC stream, in the order of row["series"]

A frame counts when it is complete. What a dying process left behind it is torn and not looked at.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import struct
import time
import weakref
import zlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from trueup.errors import DataError

FILE_MAGIC = b"TRUEUPJ1"
_FRAME_MAGIC = b"\xabEPI"
_HEAD = struct.Struct("<4sQI")
_CRC = struct.Struct("<I")
_HEAD_SIZE = _HEAD.size + _CRC.size
_ROW = struct.Struct("<I")
_SERIES = struct.Struct("<Q")
_SYNC_EVERY_S = 1.0
_FLAGS = os.O_CLOEXEC | os.O_NOFOLLOW  # what a link leads to is not ours to write

Row = dict[str, Any]
_log = logging.getLogger(__name__)


def pack(row: Mapping[str, Any], tables: Mapping[str, pa.Table]) -> list[bytes | memoryview]:
    """The payload of one frame, in pieces."""
    text = json.dumps({**row, "series": list(tables)}).encode()
    pieces: list[bytes | memoryview] = [_ROW.pack(len(text)), text]
    for table in tables.values():
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, table.schema) as stream:
            stream.write_table(table)
        buffer = sink.getvalue()
        pieces += [_SERIES.pack(buffer.size), memoryview(buffer)]
    return pieces


def unpack(payload: bytes, known: Collection[str]) -> tuple[Row, dict[str, pa.Table]]:
    """Row and tables of a frame, of which the first of the `known` series must be one, and others may be.

    Raises:
        DataError: the payload is of another version.
    """
    row = unpack_row(payload)
    if row["series"][:1] != [*known][:1] or not all(name in [*known] for name in row["series"]):
        raise _other_version(row["series"])
    tables = {}
    (size,) = _ROW.unpack_from(payload)
    start = _ROW.size + size
    try:
        for name in row.pop("series"):
            (size,) = _SERIES.unpack_from(payload, start)
            start += _SERIES.size
            tables[name] = pa.ipc.open_stream(pa.py_buffer(memoryview(payload)[start : start + size])).read_all()
            start += size
    except (pa.ArrowException, OSError, ValueError, TypeError, struct.error) as error:
        raise _other_version(error) from error
    return row, tables


def unpack_row(payload: bytes) -> Row:
    """The index row of a frame, and under `series` the names of what follows it.

    Raises:
        DataError: the payload is of another version.
    """
    try:
        (size,) = _ROW.unpack_from(payload)
        row = json.loads(payload[_ROW.size : _ROW.size + size])
        known = isinstance(row["id"], str) and isinstance(row["series"], list)
    except (ValueError, KeyError, TypeError, RecursionError, struct.error) as error:
        raise _other_version(error) from error
    if not known:
        raise _other_version(row["id"])
    return dict(row)


def _other_version(error: object) -> DataError:
    return DataError(
        "a frame of the journal is of another version", got=repr(error), hint="read it with a newer trueup"
    )


class Journal:
    """The end of the log that is written to.

    Args:
        path: of the log.
        end: where the frames that are there end; what follows is torn and goes. 0 starts the log anew.

    Raises:
        DataError: the disk is full or not writable; frames that were complete stay so.
    """

    def __init__(self, path: Path, *, end: int = 0) -> None:
        self._path = path
        self._descriptor: int | None = None
        self._size = end
        self._synced_s = time.monotonic()

    def append(self, pieces: list[bytes | memoryview]) -> None:
        """Write one frame."""
        crc = 0
        for piece in pieces:
            crc = zlib.crc32(piece, crc)
        head = _HEAD.pack(_FRAME_MAGIC, sum(len(piece) for piece in pieces), crc)
        frame = [head + _CRC.pack(zlib.crc32(head)), *pieces]
        try:
            if self._descriptor is None:
                self._descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | _FLAGS, 0o644)
                os.ftruncate(self._descriptor, self._size)
                os.lseek(self._descriptor, self._size, os.SEEK_SET)
                if self._size == 0:
                    frame.insert(0, FILE_MAGIC)
            self._size += _write_all(self._descriptor, frame)
            # A killed process loses nothing that it has written; only a power cut does, and is allowed one second.
            if time.monotonic() - self._synced_s > _SYNC_EVERY_S:
                os.fsync(self._descriptor)
                self._synced_s = time.monotonic()
        except OSError as error:
            self._forget_torn_frame()
            raise DataError(
                f"cannot write {self._path}",
                got=error.strerror or str(error),
                hint="make room on the disk and repeat with --resume; what was finished is kept",
            ) from error

    def _forget_torn_frame(self) -> None:
        if self._descriptor is None:
            return
        # A fresh file goes altogether: it has not even its magic for sure.
        with contextlib.suppress(OSError):
            os.ftruncate(self._descriptor, self._size)
            os.lseek(self._descriptor, self._size, os.SEEK_SET)
        if self._size == 0:
            self.remove()

    def remove(self) -> None:
        """Delete the log: its frames are in the shards and in the index. Readers that have it open keep it."""
        self.close()
        self._size = 0
        self._path.unlink(missing_ok=True)

    def close(self) -> None:
        """Close the file and leave its frames."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def _write_all(descriptor: int, pieces: list[bytes | memoryview]) -> int:
    total = 0
    for piece in pieces:
        rest = memoryview(piece)
        while rest:
            written = os.write(descriptor, rest)
            rest = rest[written:]
            total += written
    return total


@dataclass(frozen=True)
class Frame:
    """A complete frame: where its payload starts in the file, and the payload."""

    offset: int
    payload: bytes

    @property
    def begin(self) -> int:
        """Where the frame begins in the file."""
        return self.offset - _HEAD_SIZE

    @property
    def end(self) -> int:
        """Where it ends."""
        return self.offset + len(self.payload)


class JournalReader:
    """Reads a log. What it has listed stays readable when a writer deletes the file.

    Raises:
        FileNotFoundError: there is no log, which is the normal state.
        DataError: it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe must not block
        except FileNotFoundError:
            raise
        except OSError as error:
            raise DataError(f"cannot read {path}", got=error.strerror) from error
        self.close = weakref.finalize(self, os.close, self._descriptor)

    @property
    def begin(self) -> int:
        """Where the first frame of an undamaged log begins; 0 if the log is none."""
        return len(FILE_MAGIC) if self.read(0, len(FILE_MAGIC)) == FILE_MAGIC else 0

    def read(self, offset: int, size: int) -> bytes:
        """Bytes of the file; fewer than `size` where it ends.

        Raises:
            DataError: the disk refuses.
        """
        pieces = []
        try:
            while size > 0 and (piece := os.pread(self._descriptor, size, offset)):
                pieces.append(piece)
                offset += len(piece)
                size -= len(piece)
        except OSError as error:
            raise DataError(f"cannot read {self._path}", got=error.strerror) from error
        return b"".join(pieces)

    def frames(self, *, salvage: bool) -> Iterator[Frame]:
        """The complete frames; a torn tail is ignored.

        Args:
            salvage: step over damage in the middle (with a warning) instead of raising.

        Raises:
            DataError: there is damage before the last complete frame: episodes that were finished are lost.
        """
        size = os.fstat(self._descriptor).st_size
        start = self.read(0, len(FILE_MAGIC))
        position = len(FILE_MAGIC)
        damaged = start != FILE_MAGIC[: len(start)]
        if damaged and not salvage:
            raise self._damage(0)
        while position < size:
            payload = self._payload_at(position, size)
            if payload is not None:
                if damaged and not salvage:
                    raise self._damage(position)
                yield Frame(position + _HEAD_SIZE, payload)
                position += _HEAD_SIZE + len(payload)
                continue
            following = self._next_frame(position + 1, size)
            if following is None:
                return
            damaged = True
            _log.warning("%s: stepped over damage at byte %d", self._path, position)
            position = following

    def _damage(self, position: int) -> DataError:
        return DataError(
            f"{self._path} is damaged",
            got=f"bytes that are no frame before byte {position + _HEAD_SIZE}",
            hint="repeat the import or replay with --resume: whole episodes are kept, the damaged ones are done again",
        )

    def _payload_at(self, position: int, size: int) -> bytes | None:
        """The payload of the frame at `position`, None if there is no complete frame."""
        head = self.read(position, _HEAD_SIZE)
        if len(head) < _HEAD_SIZE or _CRC.unpack_from(head, _HEAD.size)[0] != zlib.crc32(head[: _HEAD.size]):
            return None
        magic, length, crc = _HEAD.unpack_from(head)
        if magic != _FRAME_MAGIC or length > size - position - _HEAD_SIZE:
            return None
        payload = self.read(position + _HEAD_SIZE, length)
        return payload if len(payload) == length and zlib.crc32(payload) == crc else None

    def _next_frame(self, position: int, size: int) -> int | None:
        """Where the next complete frame starts at or after `position`."""
        rest = self.read(position, size - position)
        found = rest.find(_FRAME_MAGIC)
        while found >= 0:
            if self._payload_at(position + found, size) is not None:
                return position + found
            found = rest.find(_FRAME_MAGIC, found + 1)
        return None
