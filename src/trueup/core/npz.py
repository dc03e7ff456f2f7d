"""Arrays of an npz file, refused before anything large is unpacked or anything is unpickled."""

from __future__ import annotations

import io
import lzma
import math
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Shaped

from trueup.core.atomic import regular
from trueup.core.unpacking import most_bytes
from trueup.errors import DataError

_BROKEN = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    tokenize.TokenError,  # numpy tries a Python 2 grammar on headers that Python 3 refuses
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,  # also encrypted entries, unknown compression and recursion
    SyntaxError,
    TypeError,
    ValueError,
)
_NPY = b"\x93NUMPY"
_LARGEST = 1 << 33


def read_arrays(path: Path) -> dict[str, Shaped[np.ndarray, "..."]]:
    """All arrays of a file, by their names.

    Raises:
        DataError: it is missing, no npz file or broken, would unpack to far more than it is, or holds a pickle.
    """
    try:
        data = regular(path).read_bytes()
    except OSError as error:
        raise DataError(f"cannot read {path}", got=error.strerror or error) from error
    return arrays_of(data, path)


def arrays_of(data: bytes, path: Path) -> dict[str, Shaped[np.ndarray, "..."]]:
    """All arrays of a file that was read.

    Args:
        data: the bytes of the file.
        path: for messages.

    Raises:
        DataError: as of `read_arrays`.
    """
    if not data.startswith(b"PK"):
        pickled = data.startswith((b"\x80", _NPY))
        got = "a pickle or a bare npy file" if pickled else "other bytes" if data else "an empty file"
        raise DataError(f"{path} is not an npz file", got=got)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
            if unpacked > most_bytes(len(data)):
                raise DataError(
                    f"{path} claims to unpack to {unpacked} bytes", expected="samples, not one byte repeated"
                )
            for entry in archive.infolist():
                with archive.open(entry) as file:
                    _check_array(path, file, entry.filename, entry.file_size)
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays.files}
    except _BROKEN as error:
        raise DataError(f"{path} is a damaged npz file", got=error) from error


def array_of(data: bytes, path: Path) -> Shaped[np.ndarray, "..."]:
    """The array of an npy file that was read.

    Args:
        data: the bytes of the file.
        path: for messages.

    Raises:
        DataError: as of `read_arrays`.
    """
    try:
        _check_array(path, io.BytesIO(data), path.name, len(data))
        return np.asarray(np.load(io.BytesIO(data), allow_pickle=False))
    except _BROKEN as error:
        raise DataError(f"{path} is a damaged npy file", got=error) from error


def _check_array(path: Path, file: IO[bytes] | io.BufferedIOBase, name: str, size: int) -> None:
    """Refuse a pickle, and a header that promises other bytes than there are."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    if dtype.hasobject:
        raise DataError(
            f"{path} holds a pickle in {name!r}",
            got=f"dtype {dtype}",
            expected="numbers or text",
            hint="Pickles can run code and are never read: save plain arrays, e.g. np.asarray(x, dtype=float).",
        )
    promised = math.prod(shape) * dtype.itemsize
    if promised != size - file.tell() or promised > _LARGEST:
        raise DataError(
            f"{path}: {name!r} is truncated or too large",
            got=f"{size - file.tell()} bytes",
            expected=f"{promised} for shape {shape} of {dtype}",
        )
