"""What is packed in a bag, unpacked no further than samples could have been packed.

The bag library unpacks whatever it is given in one go, so that a bag of some kilobytes could take all memory. It looks
its decompressors up in tables of its modules, and finds these ones there.
"""

from __future__ import annotations

import bz2
import io
import os
from collections.abc import Callable
from typing import IO, Any

import lz4.frame
from rosbags.rosbag1 import reader as reader1
from rosbags.rosbag2 import reader as reader2
from rosbags.rosbag2 import storage_mcap

from trueup.core.unpacking import most_bytes
from trueup.errors import DataError

_PIECE = 1 << 20
_SCHEMAS = ("ros2msg", "ros2idl", "omgidl", "")
_ZSTD = vars(reader2)["zstd"]  # the standard library's, or what stands in for it before Python 3.14


def refuse_more(unpacked: int, packed: int) -> None:
    """Refuse what unpacks to more than samples would.

    Raises:
        DataError: that is so.
    """
    if unpacked > most_bytes(packed):
        raise DataError(
            f"{packed} bytes of a bag unpack to more than {most_bytes(packed)}",
            expected="samples, not one byte repeated",
        )


def _bounded(make: Callable[[], Any]) -> Callable[[bytes], bytes]:
    """A function that unpacks all frames of some bytes.

    Args:
        make: a decompressor of the standard library's form, for one frame.
    """

    def unpack(data: bytes) -> bytes:
        pieces, size, rest = [], 0, data
        while rest:
            frame = make()
            while not frame.eof:
                piece = frame.decompress(rest, max_length=_PIECE)
                rest = b""
                size += len(piece)
                refuse_more(size, len(data))
                if not piece and frame.needs_input and not frame.eof:
                    raise ValueError("packed data that end too soon")
                pieces.append(piece)
            rest = frame.unused_data or b""
        return b"".join(pieces)

    return unpack


unpack_zstd = _bounded(_ZSTD.ZstdDecompressor)
unpack_lz4 = _bounded(lz4.frame.LZ4FrameDecompressor)
unpack_bz2 = _bounded(bz2.BZ2Decompressor)


class _Stream:
    """A packed file that is read; a context manager."""

    def __init__(self, file: IO[bytes], mode: str) -> None:
        self._packed = os.fstat(file.fileno()).st_size
        self._stream, self._size = _ZSTD.open(file, mode), 0

    def read(self, size: int = -1) -> bytes:
        """The next bytes."""
        data: bytes = self._stream.read(size if size >= 0 else most_bytes(self._packed) + 1)
        self._size += len(data)
        refuse_more(self._size, self._packed)
        return data

    def __enter__(self) -> _Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()


class _Zstd:
    """What the bag library takes of its module for zstd."""

    decompress = staticmethod(unpack_zstd)
    open = _Stream


_read_string = storage_mcap.read_string


def _read_profile(file: Any) -> str:
    """A string; of a header, which begins with the profile, that of ROS 2 where none is named."""
    first = isinstance(file, io.BytesIO) and file.tell() == 0
    return _read_string(file) or ("ros2" if first else "")


_definition = storage_mcap.get_msgdef


def _known_definition(schema: Any) -> Any:
    """What a schema says; nothing where it is in another language than ROS's: other topics can be read all the same."""
    return _definition(None if schema is not None and schema.encoding not in _SCHEMAS else schema)


def guard() -> None:
    """Let the bag library unpack with these, and read MCAP files without a profile: their schemas say what they are."""
    vars(storage_mcap)["read_string"] = _read_profile
    vars(storage_mcap)["get_msgdef"] = _known_definition
    storage_mcap.DECOMPRESSORS["zstd"] = lambda data, _: unpack_zstd(data)
    storage_mcap.DECOMPRESSORS["lz4"] = lambda data, _: unpack_lz4(data)
    reader1.decompressors["bz2"] = unpack_bz2
    reader1.decompressors["lz4"] = unpack_lz4
    vars(reader2)["zstd"] = _Zstd
