"""MATLAB's .mat files of version 5: plain arrays, texts, cells and structs.

scipy reads them, too, but damaged ones end the process: a kind of number that there is not is looked up unchecked.
Format: MathWorks, "MAT-File Format", level 5.
"""

from __future__ import annotations

import contextlib
import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np

Part: TypeAlias = tuple[int, memoryview]

_HEAD = 128
_PACKED, _ARRAY, _INT32 = 15, 14, 5
# Kind of a part -> how its numbers are stored.
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
# Class of an array.
_CELL, _STRUCT, _CHAR = 1, 2, 4
_NUMBERS = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_COMPLEX = 0x08
_PIECE = 1 << 20  # bytes that are unpacked at a time
_DEEPEST = 16


def is_mat5(data: bytes) -> bool:
    """Whether a file is of version 5."""
    return len(data) >= _HEAD and data[126:128] in (b"IM", b"MI")


def read_mat5(data: bytes, most: int) -> dict[str, Any]:
    """Variables by name: arrays without axes of length 1, texts as arrays of words, structs as mappings.

    What is none of these (objects, tables, complex and sparse arrays) is left out.

    Args:
        data: of the file.
        most: bytes that its packed parts may unpack to.

    Raises:
        ValueError: it is damaged, or unpacks to more.
    """
    order = "<" if data[126:128] == b"IM" else ">"
    found: dict[str, Any] = {}
    for kind, part in _parts(memoryview(data)[_HEAD:], order):
        if kind == _PACKED:
            whole = _unpacked(part, most)
            most -= len(whole)
            inside = list(_parts(memoryview(whole), order))
        else:
            inside = [(kind, part)]
        for own, array in inside:
            if own != _ARRAY:
                raise ValueError(f"a part of kind {own} where an array begins")
            name, value = _array(array, order, 0)
            if name and value is not None:
                found[name] = value
    return found


def _parts(data: memoryview, order: str) -> Iterator[Part]:
    """Kind and contents of parts that follow each other; numbers of up to four bytes stand in the head itself."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:
            kind, size, start, end = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        else:
            start = at + 8
            end = start + size + (0 if kind == _PACKED else -size % 8)
        if start + size > len(data):
            raise ValueError(f"a part of {size} bytes, of which {len(data) - start} are there")
        yield kind, data[start : start + size]
        at = end


def _unpacked(part: memoryview, most: int) -> bytes:
    unpack, pieces, count, rest = zlib.decompressobj(), [], 0, bytes(part)
    with contextlib.suppress(zlib.error):  # what is there already tells where it ends
        while rest:
            pieces.append(unpack.decompress(rest, _PIECE))
            count += len(pieces[-1])
            if count > most:
                raise ValueError(f"it unpacks to more than a file of its size can hold, over {most:.3g} bytes")
            rest = unpack.unconsumed_tail
    return b"".join(pieces)


def _array(data: memoryview, order: str, depth: int) -> tuple[str, Any]:
    """Name and value; None for what is no column and holds none."""
    if not data:  # an empty cell
        return "", None
    parts = list(_parts(data, order))
    if len(parts) < 3 or len(parts[0][1]) < 8:
        raise ValueError("an array without a head")
    flags = struct.unpack_from(f"{order}I", parts[0][1])[0]
    own, marks = flags & 0xFF, flags >> 8
    if own > max(_NUMBERS) or depth > _DEEPEST or parts[1][0] != _INT32:
        return "", None  # objects and functions, whose heads are others
    shape = [int(size) for size in _numbers(parts[1], order)]
    name = bytes(parts[2][1]).decode("latin-1")
    rest = parts[3:]
    if own in _NUMBERS:
        if marks & _COMPLEX or not rest:
            return name, None
        return name, _shaped(_numbers(rest[0], order).astype(_NUMBERS[own]), shape)
    if own == _CHAR:
        return name, _words(rest, shape, order)
    if own == _CELL:
        return name, _of_cell([_array(part, order, depth + 1)[1] for _, part in rest])
    if own == _STRUCT and len(rest) >= 2 and math.prod(shape) > 0:
        structs = _structs(rest, order, depth, math.prod(shape))
        return name, structs[0] if len(structs) == 1 else np.array(structs, dtype=object)
    return name, None


def _numbers(part: Part, order: str) -> np.ndarray:
    kind, data = part
    if kind not in _STORED:
        raise ValueError(f"numbers of kind {kind}")
    stored = np.dtype(f"{order}{_STORED[kind]}")
    return np.frombuffer(data[: len(data) // stored.itemsize * stored.itemsize], stored)


def _shaped(values: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    if min(shape, default=0) < 0 or math.prod(shape) != values.size:
        raise ValueError(f"{values.size} numbers for an array of {' x '.join(map(str, shape))}")
    return np.squeeze(values.reshape(shape, order="F"))


def _words(rest: Sequence[Part], shape: Sequence[int], order: str) -> np.ndarray | None:
    """A text, or the lines of a table of letters."""
    if not rest or rest[0][0] not in _TEXTS:
        return None
    kind, data = rest[0]
    code = _TEXTS[kind]
    ending = "" if code in ("latin-1", "utf-8") else ("-le" if order == "<" else "-be")
    text = bytes(data).decode(code + ending, "replace")
    rows = shape[0] if shape else 1
    if rows <= 1:
        return np.array(text)
    return np.array(["".join(text[row::rows]).rstrip() for row in range(min(rows, len(text)))])


def _of_cell(values: Sequence[Any]) -> np.ndarray | None:
    """Words, if all of a cell array are some."""
    words = [value for value in values if isinstance(value, np.ndarray) and value.dtype.kind == "U"]
    if not words or len(words) != len(values) or any(word.ndim for word in words):
        return None
    # Each text of an array of texts takes as much room as the longest.
    return np.array([str(word) for word in words], dtype=object)


def _structs(rest: Sequence[Part], order: str, depth: int, count: int) -> list[dict[str, Any]]:
    """Structs with the same fields, one after the other."""
    lengths = _numbers(rest[0], order)
    width, letters = int(lengths[0]) if lengths.size else 0, bytes(rest[1][1])
    if width < 1:
        raise ValueError("names of fields without a length")
    names = [letters[at : at + width].split(b"\0")[0].decode("latin-1") for at in range(0, len(letters), width)]
    parts = [part for _, part in rest[2:]]
    if count * len(names) != len(parts):
        raise ValueError(f"{len(parts)} fields of {count} structs with {len(names)} names")
    found = []
    for first in range(0, len(parts), max(len(names), 1)):
        own = zip(names, parts[first : first + len(names)], strict=True)
        values = {name: _array(part, order, depth + 1)[1] for name, part in own}
        found.append({name: value for name, value in values.items() if value is not None})
    return found or [{}]
