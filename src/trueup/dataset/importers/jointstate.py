"""Raw `sensor_msgs/JointState` messages, decoded many at a time.

The messages of one publisher differ in their stamp and numbers only: the bytes before and between the arrays
(frame, joint names, lengths) repeat. So the layout is read from one message, checked against the bag library's
own deserializer on that message, and every message with the same constant bytes is decoded by slicing one matrix
of bytes. Whatever differs is tried with a layout of its own, and deserialized one by one if that fails too.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64, Shaped, UInt8

from trueup.dataset.importers.samples import NS_PER_S, Collector, Samples, stamp_ns

SIGNALS = ("position", "velocity", "torque")
_BLOCK = 8192
_LAYOUTS_PER_BLOCK = 8
_FEW = 4
_STAMP = 4  # after the encapsulation header (CDR) or `seq` (ROS 1), in both seconds and nanoseconds
_FRAME = 12


class JointStateDecoder:
    """Decodes a topic of joint states, block by block.

    Args:
        deserialize: the bag library's deserializer for one message.
        source: file and topic, for error messages.
        ros1: whether the bytes are ROS 1's, which have no encapsulation header and no alignment.
        joints: names for messages that carry none, as the user stated them.
    """

    def __init__(
        self, deserialize: Callable[[bytes], Any], source: str, *, ros1: bool, joints: Sequence[str] = ()
    ) -> None:
        self._deserialize = deserialize
        self._ros1 = ros1
        self._collector = Collector(source, joints)
        self._raws: list[bytes] = []
        self._logs: list[int] = []
        self._count = 0

    def push(self, log_ns: int, raw: bytes) -> None:
        """Add one message."""
        self._raws.append(raw)
        self._logs.append(log_ns)
        if len(self._raws) == _BLOCK:
            self._decode_block()

    def samples(self) -> list[Samples]:
        """All messages pushed so far.

        Raises:
            DataError: a message is ragged.
            ConfigError: messages have values but no joint names, and none were stated.
        """
        if self._raws:
            self._decode_block()
        return self._collector.samples()

    def _decode_block(self) -> None:
        raws, self._raws = self._raws, []
        log_ns = np.array(self._logs, dtype=np.int64)
        self._logs = []
        lengths = np.fromiter(map(len, raws), dtype=np.int64, count=len(raws))
        remaining: list[int] = []
        for length in np.unique(lengths):
            rows = np.flatnonzero(lengths == length)
            joined = b"".join(raws if rows.size == len(raws) else [raws[row] for row in rows])
            matrix = np.frombuffer(joined, dtype=np.uint8).reshape(rows.size, int(length))
            for _ in range(_LAYOUTS_PER_BLOCK):
                layout = self._layout(raws[rows[0]]) if rows.size >= _FEW else None
                if layout is None:
                    break
                same = layout.matches(matrix)
                chosen = slice(None) if same.all() else same
                index = rows[chosen] + self._count
                self._collector.keep(
                    layout.names,
                    layout.arrays(matrix[chosen]),
                    index,
                    layout.stamps_ns(matrix[chosen]),
                    log_ns[rows[chosen]],
                )
                matrix, rows = matrix[~same], rows[~same]
            remaining += rows.tolist()
        for row in sorted(remaining):
            self._one_by_one(raws[row], row, int(log_ns[row]))
        self._count += len(raws)

    def _one_by_one(self, raw: bytes, row: int, log_ns: int) -> None:
        message = self._deserialize(raw)
        self._collector.keep(
            tuple(message.name),
            {signal: values[np.newaxis] for signal, values in _arrays(message).items()},
            np.array([self._count + row]),
            np.array([stamp_ns(message.header)]),
            np.array([log_ns]),
        )

    def _layout(self, raw: bytes) -> _Layout | None:
        """The layout of a message, if it reads that message as the deserializer does."""
        try:
            layout = _read_layout(raw, ros1=self._ros1)
        except (struct.error, UnicodeDecodeError):
            return None
        if layout is None:
            return None
        message = self._deserialize(raw)
        one = np.frombuffer(raw, dtype=np.uint8)[np.newaxis]
        ours, theirs = layout.arrays(one), _arrays(message)
        equal = (
            layout.names == tuple(message.name)
            and int(layout.stamps_ns(one)[0]) == stamp_ns(message.header)
            and all(np.array_equal(ours[signal][0], theirs[signal], equal_nan=True) for signal in SIGNALS)
        )
        return layout if equal else None


@dataclass(frozen=True)
class _Layout:
    """Where things are in a message: what must repeat (`constant`, start and end) and where the arrays begin."""

    template: bytes
    names: tuple[str, ...]
    constant: tuple[tuple[int, int], ...]
    starts: tuple[int, ...]
    counts: tuple[int, ...]
    ros1: bool

    def matches(self, matrix: UInt8[np.ndarray, "N L"]) -> Bool[np.ndarray, "N"]:
        same = np.ones(len(matrix), dtype=bool)
        for start, end in self.constant:
            template = np.frombuffer(self.template[start:end], dtype=np.uint8)
            same &= (matrix[:, start:end] == template).all(axis=1)
        return same

    def arrays(self, matrix: UInt8[np.ndarray, "N L"]) -> dict[str, Float64[np.ndarray, "N _"]]:
        return {
            signal: _numbers(matrix, start, "<f8", count).astype(np.float64, copy=False)
            for signal, start, count in zip(SIGNALS, self.starts, self.counts, strict=True)
        }

    def stamps_ns(self, matrix: UInt8[np.ndarray, "N L"]) -> Int64[np.ndarray, "N"]:
        seconds = _numbers(matrix, _STAMP, "<u4" if self.ros1 else "<i4", 1)[:, 0].astype(np.int64)
        return seconds * NS_PER_S + _numbers(matrix, _STAMP + 4, "<u4", 1)[:, 0].astype(np.int64)


def _numbers(matrix: UInt8[np.ndarray, "N L"], start: int, dtype: str, count: int) -> Shaped[np.ndarray, "N _"]:
    size = np.dtype(dtype).itemsize * count
    if not size:
        return np.empty((len(matrix), 0), dtype=dtype)
    return np.ascontiguousarray(matrix[:, start : start + size]).view(dtype)


def _read_layout(raw: bytes, *, ros1: bool) -> _Layout | None:
    """Walk through one message; None if it is not little-endian CDR.

    Raises:
        struct.error: the message ends too early.
    """
    if not ros1 and raw[:2] != b"\x00\x01":
        return None

    def aligned(position: int, size: int) -> int:
        return position if ros1 else 4 + -(-(position - 4) // size) * size

    def count_at(position: int) -> int:
        return int(struct.unpack_from("<I", raw, position)[0])

    position = _FRAME + 4 + count_at(_FRAME)
    position = aligned(position, 4)
    number, position = count_at(position), position + 4
    names = []
    for _ in range(number):
        position = aligned(position, 4)
        length = count_at(position)
        names.append(raw[position + 4 : position + 4 + length].decode().removesuffix("" if ros1 else "\x00"))
        position += 4 + length
    constant, starts, counts = [(0 if not ros1 else _FRAME, _STAMP if not ros1 else _FRAME)], [], []
    begin = _FRAME
    for _ in SIGNALS:
        position = aligned(position, 4)
        counts.append(count_at(position))
        position += 4
        constant.append((begin, position))
        if counts[-1]:
            position = aligned(position, 8)
        starts.append(position)
        position = begin = position + 8 * counts[-1]
    if position > len(raw):
        return None
    return _Layout(raw, tuple(names), tuple(constant), tuple(starts), tuple(counts), ros1)


def _arrays(message: Any) -> dict[str, Float64[np.ndarray, "_"]]:
    fields: Iterable[Any] = (message.position, message.velocity, message.effort)
    return {signal: np.asarray(values, dtype=np.float64) for signal, values in zip(SIGNALS, fields, strict=True)}
