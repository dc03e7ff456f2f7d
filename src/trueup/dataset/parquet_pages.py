"""The pages of a Parquet file, by their own headers: by these a library reads lists, not by the file's description.

A header is a struct of Thrift's compact protocol: `PageHeader` of
https://github.com/apache/parquet-format/blob/master/src/main/thrift/parquet.thrift. Only what is needed of it is read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import pyarrow.parquet as pq

_WINDOWS = (1 << 10, 1 << 20)
_DEEPEST = 8
# Kinds of fields in the compact protocol.
_BOOLEANS, _BYTE, _INTEGERS, _I32, _DOUBLE, _BINARY, _STRUCT = (1, 2), 3, (4, 5, 6), 5, 7, 8, 12
# Numbers of fields in a header: what kind of page it is, its sizes, and the header's part for pages of data.
_KIND, _UNPACKED, _PACKED = (1, _I32), (2, _I32), (3, _I32)
_DATA = {0: (5, _STRUCT), 3: (8, _STRUCT)}
_VALUES = (1, _I32)

Fields = dict[tuple[int, int], Any]


@dataclass(frozen=True)
class Page:
    """A page.

    Attributes:
        values: how many it has, missing ones and empty lists included; 0 if it is no page of data.
        unpacked: its size [bytes] when it is unpacked.
    """

    values: int
    unpacked: int


def pages(raw: BinaryIO, column: pq.ColumnChunkMetaData) -> Iterator[Page]:
    """The pages of a part of a column, up to the one with which it has all values that it claims.

    Raises:
        ValueError: what is there is no header of a page.
    """
    at: int = column.data_page_offset
    if column.has_dictionary_page and 0 < column.dictionary_page_offset < at:
        at = column.dictionary_page_offset
    end, values = at + column.total_compressed_size, 0
    while values < column.num_values:
        fields, size = _header(raw, at, end)
        packed, unpacked, kind = fields.get(_PACKED, -1), fields.get(_UNPACKED, -1), fields.get(_KIND, -1)
        count = fields.get(_DATA[kind], {}).get(_VALUES, -1) if kind in _DATA else 0
        if min(packed, unpacked, count) < 0:
            raise ValueError(f"there is no header of a page at byte {at}")
        yield Page(count, unpacked)
        values += count
        at += size + packed


def _header(raw: BinaryIO, at: int, end: int) -> tuple[Fields, int]:
    """The header at a byte of the file, and its size."""
    for window in _WINDOWS:
        raw.seek(at)
        try:
            return _struct(raw.read(max(0, min(window, end - at))), 0, 0)
        except IndexError:  # it is longer than that
            continue
    raise ValueError(f"there is no header of a page at byte {at}")


def _struct(data: bytes, at: int, depth: int) -> tuple[Fields, int]:
    """The fields of a struct by number and kind, and where it ends."""
    fields: Fields = {}
    number = 0
    while kind := data[at] & 15:
        step = data[at] >> 4
        number, at = (number + step, at + 1) if step else _signed(data, at + 1)
        fields[number, kind], at = _value(data, at, kind, depth)
    return fields, at + 1


def _value(data: bytes, at: int, kind: int, depth: int) -> tuple[Any, int]:
    if kind in _BOOLEANS:
        return kind == _BOOLEANS[0], at
    if kind in _INTEGERS:
        return _signed(data, at)
    if kind == _STRUCT and depth < _DEEPEST:
        return _struct(data, at, depth + 1)
    if kind == _BINARY:
        size, at = _varint(data, at)
        return None, at + size
    if kind in (_BYTE, _DOUBLE):
        return None, at + (1 if kind == _BYTE else 8)
    raise ValueError("a header of a page has neither lists nor such depths")


def _signed(data: bytes, at: int) -> tuple[int, int]:
    value, at = _varint(data, at)
    return value >> 1 ^ -(value & 1), at


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while shift < 64:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise ValueError("a number in a header of a page never ends")
