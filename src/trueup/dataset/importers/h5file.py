"""HDF5 files from strangers: no link is followed, no size is believed, every failure becomes a DataError."""

from __future__ import annotations

import contextlib
import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Shaped

from trueup.errors import DataError, TrueupError

# Deflate, the best of the usual filters, cannot shrink data further than about 1030 to 1.
_LARGEST_RATIO = 1100
_LONGEST_TEXT = 4096
# A global heap: signature and version, then its size; each object in it begins with its index and size.
_HEAP = b"GCOL\x01"
_HEAP_HEADER = 16
_OBJECT_HEADER = 16


class H5File:
    """An open file. Made by `open_h5`."""

    def __init__(self, file: Any, source: Path) -> None:
        self._file = file
        self._size = source.stat().st_size
        self.source = source

    def names(self, group: str = "/") -> tuple[str, ...]:
        """Names in a group, as text for people where they are none; empty if there is no such group."""
        found = self._find(group)
        if not isinstance(found, h5py.Group):
            return ()
        return tuple(name if isinstance(name, str) else name.decode(errors="replace") for name in found)

    def shape(self, name: str) -> tuple[int, ...] | None:
        """The shape that a dataset claims to have; None if there is no such dataset."""
        dataset = self._find(name)
        return dataset.shape if isinstance(dataset, h5py.Dataset) else None

    def numbers(self, name: str) -> Shaped[np.ndarray, "..."] | None:
        """A numeric dataset as it is stored; None if there is no such dataset.

        Raises:
            DataError: it is no array of real numbers, lies in another file, or claims more data than the file holds.
        """
        dataset = self._find(name)
        if dataset is None:
            return None
        where = f"{self.source}: {name}"
        if not isinstance(dataset, h5py.Dataset):
            raise DataError(f"{where} is no dataset", got=type(dataset).__name__)
        if dataset.dtype.kind not in "fiu":
            raise DataError(f"{where} holds no numbers", got=dataset.dtype, expected="an array of floats or integers")
        self._check_storage(dataset, where)
        return np.asarray(dataset[()])

    def texts(self, name: str) -> tuple[str, ...]:
        """Texts of a dataset, or of an attribute of the group before the last `/`; empty if there are none.

        Raises:
            DataError: it is there, but holds no text.
        """
        found = self._find(name)
        if isinstance(found, h5py.Dataset):
            self._check_storage(found, f"{self.source}: {name}")
            value = found[()] if found.shape is not None else ()
        else:
            group, _, attribute = name.rpartition("/")
            holder = self._find(group or "/")
            if holder is None or attribute not in holder.attrs:
                return ()
            value = holder.attrs[attribute]
        return tuple(_text(item, f"{self.source}: {name}") for item in np.atleast_1d(np.asarray(value)).ravel())

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
            return f"{float(np.asarray(found[()]).ravel()[0]):g}"
        return ""

    def number(self, name: str) -> float | None:
        """A single number from a dataset or an attribute of the file; None if there is none of this name.

        Raises:
            DataError: it is there, but is no single number.
        """
        found = self._find(name)
        if isinstance(found, h5py.Dataset):
            self._check_storage(found, f"{self.source}: {name}")
        elif name not in self._file.attrs:
            return None
        value = np.asarray(found[()] if isinstance(found, h5py.Dataset) else self._file.attrs[name])
        if value.dtype.kind not in "fiu" or value.size != 1:
            raise DataError(f"{self.source}: {name} is no single number", got=value.dtype, expected="such as 1.5")
        return float(value.ravel()[0])

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

    def _check_storage(self, dataset: Any, where: str) -> None:
        if dataset.is_virtual or dataset.external:
            raise DataError(f"{where} lies in other files, which are not opened")
        stored = dataset.id.get_storage_size()
        most = stored if dataset.chunks is None else stored * _LARGEST_RATIO
        if dataset.nbytes > most or stored > self._size:
            raise DataError(
                f"{where} claims more data than the file holds",
                got=f"{dataset.shape} of {dataset.dtype}",
                expected=f"at most {min(most, self._size)} bytes",
                hint="The file is truncated or corrupt.",
            )


@contextlib.contextmanager
def open_h5(path: Path) -> Iterator[H5File]:
    """Open an HDF5 file for reading.

    Raises:
        DataError: the file is empty, truncated or corrupt, also while it is read inside the `with` block.
    """
    try:
        _check_heaps(path)
        with h5py.File(path, "r", locking="best-effort") as file:
            yield H5File(file, path)
    except TrueupError:
        raise
    except Exception as error:  # the library lets errors of many kinds through when bytes are damaged
        raise DataError(
            f"{path} cannot be read as HDF5",
            got=str(error) or type(error).__name__,
            hint="The file may be truncated; `h5dump -H FILE` shows more.",
        ) from error


def _check_heaps(path: Path) -> None:
    """Refuse heaps of texts in which the library would step from object to object without ever moving on.

    It walks a heap by the sizes that stand in it; a size of zero where there is free space keeps it in place for
    good, and no signal ends it.

    Raises:
        DataError: there is such a heap.
        ValueError: the file is empty.
    """
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
                at += step
            heap = data.find(_HEAP, heap + 1)


def _text(value: Any, where: str) -> str:
    text = value.decode("utf-8", errors="replace") if isinstance(value, bytes) else value
    if not isinstance(text, str) or len(text) > _LONGEST_TEXT:
        raise DataError(f"{where} holds no text", got=type(value).__name__)
    return text
