"""HDF5 files from strangers: no link is followed, no size is believed, every failure becomes a DataError."""

from __future__ import annotations

import contextlib
import math
import mmap
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Shaped

from trueup.core import unpacking
from trueup.errors import DataError, TrueupError

# Deflate, the best of the usual filters, cannot shrink data further than about 1030 to 1.
_LARGEST_RATIO = 1100
_LONGEST_TEXT = 4096
_MOST_TEXTS = 10_000
# lzf stays below 100 to 1; what others unpack to stands in the file, whatever they hold.
_DEFLATE, _LZF = h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_LZF
_FILTERS = frozenset({_DEFLATE, _LZF, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32})
_FILTER_OVERHEAD = 64
# A global heap: signature and version, then its size; each object in it begins with its index and size.
_HEAP = b"GCOL\x01"
_HEAP_HEADER = 16
_OBJECT_HEADER = 16


class H5File:
    """An open file. Made by `open_h5`."""

    def __init__(self, file: Any, source: Path, *, longest: int) -> None:
        self._file = file
        self._longest = longest  # of the texts of variable length, however often they are referred to [bytes]
        self._size = source.stat().st_size
        self.source = source

    def names(self, group: str = "/") -> tuple[str, ...]:
        """Names in a group, as text for people where they are none; empty if there is no such group."""
        found = self._find(group)
        if not isinstance(found, h5py.Group):
            return ()
        return tuple(name if isinstance(name, str) else name.decode(errors="replace") for name in found)

    def arrays(self, deepest: int, most: int) -> tuple[str, ...]:
        """Paths of all datasets.

        A group is entered once, whatever leads to it: groups that lead to each other have paths without end.

        Args:
            deepest: groups in groups that are entered.
            most: names that are looked at.

        Raises:
            DataError: there are more, or one is a link.
        """
        found: list[str] = []
        entered: set[int] = set()
        waiting = [("", 0)]
        count = 0
        while waiting:
            above, depth = waiting.pop()
            group = self._find(above)
            address = h5py.h5o.get_info(group.id).addr
            if address in entered:
                continue
            entered.add(address)
            inside = []
            for name in self.names(above or "/"):
                count += 1
                if count > most:
                    raise DataError(f"{self.source} has too many arrays and groups", expected=f"at most {most}")
                path = f"{above}/{name}" if above else name
                one = self._find(path)
                if isinstance(one, h5py.Dataset) and one.shape is not None:
                    found.append(path)
                elif isinstance(one, h5py.Group) and depth < deepest:
                    inside.append((path, depth + 1))
            waiting += reversed(inside)
        return tuple(found)

    def shape(self, name: str) -> tuple[int, ...] | None:
        """The shape that a dataset claims to have; None if there is no such dataset."""
        dataset = self._find(name)
        return dataset.shape if isinstance(dataset, h5py.Dataset) else None

    def fields(self, name: str) -> tuple[str, ...]:
        """Names of the fields of a structured dataset; empty for any other."""
        dataset = self._find(name)
        return tuple(dataset.dtype.names or ()) if isinstance(dataset, h5py.Dataset) else ()

    def numbers(self, name: str, field: str = "") -> Shaped[np.ndarray, "..."] | None:
        """A numeric dataset, or a field of a structured one, as it is stored; None if there is no such dataset.

        Raises:
            DataError: it is no array of real numbers, lies in another file, or claims more data than the file holds.
        """
        dataset = self._find(name)
        if dataset is None:
            return None
        where = f"{self.source}: {name}"
        if not isinstance(dataset, h5py.Dataset):
            raise DataError(f"{where} is no dataset", got=type(dataset).__name__)
        kind = dataset.dtype[field] if field else dataset.dtype
        if kind.kind not in "fiu":
            raise DataError(f"{where} holds no numbers", got=kind, expected="an array of floats or integers")
        self._check_storage(dataset, where)
        return np.asarray(dataset[field] if field else dataset[()])

    def texts(self, name: str) -> tuple[str, ...]:
        """Texts of a dataset, or of an attribute of the group before the last `/`; empty if there are none.

        Raises:
            DataError: it is there, but holds no text.
        """
        where = f"{self.source}: {name}"
        found = self._find(name)
        if isinstance(found, h5py.Dataset):
            self._check_texts(found, where)
            self._check_storage(found, where)
            value = found[()] if found.shape is not None else ()
        else:
            group, _, attribute = name.rpartition("/")
            holder = self._find(group or "/")
            if holder is None or attribute not in holder.attrs:
                return ()
            self._check_texts(holder.attrs.get_id(attribute), where)
            value = holder.attrs[attribute]
        return tuple(_text(item, where) for item in np.atleast_1d(np.asarray(value)).ravel())

    def scalar(self, name: str) -> str:
        """A single text or number as text, from a dataset or attribute; empty if there is none."""
        try:
            texts = self.texts(name)
        except DataError:
            texts = ()
        if texts:
            return texts[0]
        found = self._find(name)
        if isinstance(found, h5py.Dataset) and found.dtype.kind in "fiu" and found.size == 1:
            self._check_storage(found, f"{self.source}: {name}")
            return f"{float(np.asarray(found[()]).ravel()[0]):g}"
        return ""

    def number(self, name: str) -> float | None:
        """A single number from a dataset or an attribute of the file; None if there is none of this name.

        Raises:
            DataError: it is there, but is no single number.
        """
        found, where = self._find(name), f"{self.source}: {name}"
        is_dataset = isinstance(found, h5py.Dataset)
        if not is_dataset and name not in self._file.attrs:
            return None
        about = found if is_dataset else self._file.attrs.get_id(name)
        if about.dtype.kind not in "fiu" or about.shape is None or math.prod(about.shape) != 1:
            raise DataError(f"{where} is no single number", got=about.dtype, expected="such as 1.5")
        if is_dataset:
            self._check_storage(found, where)
        return float(np.asarray(found[()] if is_dataset else self._file.attrs[name]).ravel()[0])

    def _find(self, name: str) -> Any:
        """The object of a path, link by link: only hard links lead to bytes of this file."""
        here = self._file
        for part in (part for part in name.split("/") if part):
            if not isinstance(here, h5py.Group):
                return None
            link = here.get(part, getlink=True)
            if link is None:
                return None
            if not isinstance(link, h5py.HardLink):
                raise DataError(
                    f"{self.source}: {name} is a link, which is not followed",
                    got=f"{type(link).__name__} to {getattr(link, 'path', '')} {getattr(link, 'filename', '')}".strip(),
                    hint="Copy the data into the file, e.g. with `h5repack` or `h5py.Group.copy`.",
                )
            here = here[part]
        return here

    def _check_texts(self, about: Any, where: str) -> None:
        """Refuse what is no text, and a text that is referred to until it fills the memory.

        Args:
            about: a dataset or an attribute, not read yet.
            where: how messages call it.
        """
        if h5py.check_string_dtype(about.dtype) is None:
            raise DataError(f"{where} holds no text", got=about.dtype)
        count = math.prod(about.shape or ())
        longest = self._longest if about.dtype.hasobject else about.dtype.itemsize
        if count > _MOST_TEXTS or count * longest > unpacking.FEW_BYTES:
            raise DataError(
                f"{where} claims more text than names can have", got=f"{count} texts of up to {longest} bytes"
            )

    def _check_storage(self, dataset: Any, where: str) -> None:
        if dataset.is_virtual or dataset.external:
            raise DataError(f"{where} lies in other files, which are not opened")
        stored = dataset.id.get_storage_size()
        packed = min(stored * _LARGEST_RATIO, unpacking.most_bytes(self._size))
        most = stored if dataset.chunks is None else packed
        if dataset.nbytes > most or stored > self._size:
            raise DataError(
                f"{where} claims more data than the file holds",
                got=f"{dataset.shape} of {dataset.dtype}",
                expected=f"at most {most} bytes",
                hint="The file is truncated or corrupt.",
            )
        if dataset.chunks is not None:
            _check_chunks(dataset, where)


def _check_chunks(dataset: Any, where: str) -> None:
    """Refuse chunks that unpack to more than a chunk of this shape is: the library goes on until they end.

    Raises:
        DataError: there is such a chunk, or a filter that is not one of the usual ones, once each.
    """
    created = dataset.id.get_create_plist()
    filters = [created.get_filter(k)[0] for k in range(created.get_nfilters())]
    if not _FILTERS.issuperset(filters) or len(set(filters)) < len(filters) or {_DEFLATE, _LZF}.issubset(filters):
        raise DataError(
            f"{where} is packed in an unusual way",
            got=f"filters {filters}",
            expected="gzip or lzf, once",
            hint="`h5repack -f GZIP=4 FILE COPY` packs it anew.",
        )
    whole = math.prod(dataset.chunks) * dataset.id.get_type().get_size()
    room = whole + whole // 100 + _FILTER_OVERHEAD
    odd: list[Any] = []

    def note(chunk: Any) -> None:
        if chunk.size > room or (_DEFLATE in filters and chunk.size * _LARGEST_RATIO > unpacking.FEW_BYTES):
            odd.append(chunk)

    dataset.id.chunk_iter(note)
    if whole > max(dataset.nbytes, unpacking.FEW_BYTES) or any(_bursts(dataset, chunk, filters, room) for chunk in odd):
        raise DataError(
            f"{where} unpacks to more than it says", got=f"chunks of {dataset.chunks}", expected=f"{whole} bytes each"
        )


def _bursts(dataset: Any, chunk: Any, filters: list[int], room: int) -> bool:
    """Whether a chunk is or unpacks to more than there is room for [bytes]."""
    if chunk.size > room:
        return True
    if _DEFLATE not in filters or chunk.filter_mask >> filters.index(_DEFLATE) & 1:
        return False
    packed = dataset.id.read_direct_chunk(chunk.chunk_offset)[1]
    return len(zlib.decompressobj().decompress(packed, room + 1)) > room


@contextlib.contextmanager
def open_h5(path: Path) -> Iterator[H5File]:
    """Open an HDF5 file for reading.

    Raises:
        DataError: the file is empty, truncated or corrupt, also while it is read inside the `with` block.
    """
    try:
        longest = _walk_heaps(path)
        with h5py.File(path, "r", locking="best-effort") as file:
            yield H5File(file, path, longest=longest)
    except TrueupError:
        raise
    except Exception as error:  # the library lets errors of many kinds through when bytes are damaged
        raise DataError(
            f"{path} cannot be read as HDF5",
            got=str(error) or type(error).__name__,
            hint="The file may be truncated; `h5dump -H FILE` shows more.",
        ) from error


def _walk_heaps(path: Path) -> int:
    """The size of the largest text in the heaps [bytes], after a walk through them that ends.

    The library would not end in each: it steps from object to object by the sizes that stand there; a size of zero
    where there is free space keeps it in place for good, and no signal ends it.

    Raises:
        DataError: there is such a heap.
        ValueError: the file is empty.
    """
    longest = 0
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        heap = data.find(_HEAP)
        while heap >= 0:
            at = heap + _HEAP_HEADER
            end = min(heap + int.from_bytes(data[heap + 8 : at], "little"), len(data))
            while at + _OBJECT_HEADER <= end:
                index, size = struct.unpack_from("<H6xQ", data, at)
                step = size if index == 0 else _OBJECT_HEADER + (size + 7) // 8 * 8
                if not 0 < step <= end - at:
                    raise DataError(f"{path} cannot be read as HDF5", got=f"a damaged heap at byte {heap}")
                longest = max(longest, size if index else 0)
                at += step
            heap = data.find(_HEAP, heap + 1)
    return longest


def _text(value: Any, where: str) -> str:
    text = value.decode("utf-8", errors="replace") if isinstance(value, bytes) else value
    if not isinstance(text, str) or len(text) > _LONGEST_TEXT:
        raise DataError(f"{where} holds no text", got=type(value).__name__)
    return text
