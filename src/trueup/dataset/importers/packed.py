"""Logs that are compressed or in archives, unpacked into a folder that goes when they have been read."""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import shutil
import tarfile
import tempfile
import weakref
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Protocol, runtime_checkable

from trueup.core.atomic import regular
from trueup.core.unpacking import most_bytes
from trueup.dataset.importers.files import inside
from trueup.dataset.importers.hub import local_copy
from trueup.errors import DataError

_PIECE, _MOST_FILES, _DEEPEST = 1 << 20, 100_000, 3
_LARGEST_FOLDER = 200 << 20
# What tar has before the head of a member: long names, and remarks of pax.
_LONGEST_HEAD = 1 << 20
_BEFORE_HEADS = (
    *(tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK),
    *(tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.SOLARIS_XHDTYPE),
)
_LOGS = (
    *(".csv", ".tsv", ".dat", ".jsonl", ".ndjson", ".parquet", ".npz", ".npy", ".mat", ".h5", ".hdf5", ".xlsx"),
    *(".mcap", ".bag", ".db3"),
)
_TEXTS = (".txt", ".log", ".json", ".yaml")  # which lie beside logs as often as they are some
_TARS = (".tar", ".tgz", ".tar.gz", ".tar.xz", ".tar.bz2", ".tar.zst")
_ARCHIVES = (".zip", *_TARS)


@runtime_checkable
class Stream(Protocol):
    """What is read piece by piece."""

    def read(self, size: int, /) -> bytes:
        """The next bytes."""
        ...


def _zstd(path: Path) -> Any:
    from backports import zstd

    return zstd.open(path, "rb")


_OPEN: dict[str, Callable[[Path], Any]] = {
    **dict.fromkeys((".gz", ".tgz"), gzip.open),
    **dict.fromkeys((".zst", ".zstd"), _zstd),
    ".xz": lzma.open,
    ".bz2": bz2.open,
}


class Unpacked:
    """A folder for what is unpacked, which is deleted when nobody holds this any more.

    Messages name files below it, so that it ends in the name of what was packed.
    """

    def __init__(self, source: Path) -> None:
        folder = Path(tempfile.mkdtemp(prefix="trueup-")).resolve()
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.root = folder / source.resolve().name
        self.root.mkdir()


@dataclass(frozen=True)
class Logs:
    """Logs that can be read as they are.

    Attributes:
        path: file or folder.
        kept: what was unpacked for them; None if nothing was.
    """

    path: Path
    kept: Unpacked | None = None


def opened(source: Path) -> Logs:
    """A file or folder of logs without what is packed: `source` itself where nothing is.

    `USER/NAME` is a dataset of the Hugging Face Hub where nothing here is called so.

    A packed file or archive that is given is unpacked. In a folder, packed logs (`run.csv.gz`) stand beside the others;
    archives count only where there are no logs, since beside them they are often copies.

    Raises:
        DataError: something is damaged, or unpacks to far more than logs could have been packed to; or a dataset of the
            Hub cannot be had.
    """
    source = local_copy(source)
    if source.is_file():
        return _of_file(source) if _is_packed(source) else Logs(source)
    if not source.is_dir():
        return Logs(source)
    files = [path for path in _files(source) if path.is_file()]
    if len(files) == 1 and _is_archive(files[0]):
        return _of_file(inside(source, files[0]))
    plain = {path for path in files if not _is_packed(path)}
    packed = [
        path for path in files if path not in plain and not _is_archive(path) and path.with_suffix("") not in plain
    ]
    if not packed and not any(path.name.lower().endswith(_LOGS) for path in plain):
        packed = [path for path in files if _is_archive(path)]
    if not packed:
        return Logs(source)
    kept = Unpacked(source)
    unpacking = _Unpacking(source, sum(path.stat().st_size for path in packed))
    for path in files:
        target = kept.root / path.relative_to(source)
        if path in packed:
            unpacking.add(inside(source, path), target)
        elif path in plain:
            _linked(path, target)
    return Logs(kept.root, kept)


def _of_file(source: Path) -> Logs:
    kept = Unpacked(source)
    root = kept.root
    unpacking = _Unpacking(source, source.stat().st_size)
    if _is_archive(source):
        unpacking.add(source, root / source.name)
        root /= _bare(source.name)
        own = list(root.iterdir()) if root.is_dir() else []
        # An archive of one folder is that folder.
        return Logs(own[0] if len(own) == 1 and own[0].is_dir() else root, kept)
    for path in source.parent.iterdir():
        if path.name in ("mapping.yaml", "split.json", "model") or path.name.upper().startswith(("LICEN", "COPYING")):
            # A link beside the log, to what it leads to: from here it would lead elsewhere.
            _linked(inside(source.parent, path).resolve(), root / path.name)
    unpacking.add(source, root / source.name)
    return Logs(root / _bare(source.name), kept)


class _Unpacking:
    """Files that are written one after the other, with a bound on all of them together."""

    def __init__(self, source: Path, packed: int) -> None:
        self._source, self._left = source, most_bytes(packed)
        self._most, self._files = self._left, 0
        self._left_to_read = self._left

    def passed(self, size: int) -> None:
        """Count bytes of an archive that was unpacked, of members that are left out, too.

        Raises:
            DataError: there are far more than logs could have been packed to.
        """
        self._left_to_read -= size
        if self._left_to_read < 0:
            raise self._too_much()

    def add(self, path: Path, target: Path, depth: int = 0) -> None:
        """Unpack a file to where it would lie if it were not packed; an archive, to a folder of its name."""
        if depth > _DEEPEST:
            raise DataError(f"{path.name} is packed more than {_DEEPEST} times", expected="logs, or an archive of logs")
        target = target.with_name(_bare(target.name))
        try:
            if _is_archive(path):
                for name, file in _members(path, self):
                    place = target / name
                    self._write(file, place)
                    if _is_packed(place):
                        self.add(place, place, depth + 1)
                        place.unlink()
            else:
                self.counted()
                with _OPEN[path.suffix.lower()](regular(path)) as file:
                    self._write(file, target)
        except DataError:
            raise
        except Exception as error:  # damaged bytes raise errors of many kinds
            raise DataError(f"{path.name} cannot be unpacked", got=error, expected="a whole file") from error

    def counted(self) -> None:
        """Count a member; one that is left out, too, since to pass over it takes time.

        Raises:
            DataError: there are more than anybody has logs.
        """
        self._files += 1
        if self._files > _MOST_FILES:
            raise DataError(f"{self._source} holds more than {_MOST_FILES} files")

    def _write(self, file: Stream, target: Path) -> None:
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("xb") as out:
            while piece := file.read(_PIECE):
                self._left -= len(piece)
                if self._left < 0:
                    raise self._too_much()
                out.write(piece)

    def _too_much(self) -> DataError:
        return DataError(
            f"{self._source} unpacks to more than {self._most} bytes", expected="logs, not one byte repeated"
        )


class _Counted:
    """A stream of which each byte counts."""

    def __init__(self, stream: Stream, unpacking: _Unpacking) -> None:
        self._stream, self._unpacking = stream, unpacking

    def read(self, size: int, /) -> bytes:
        piece = self._stream.read(size)
        self._unpacking.passed(len(piece))
        return piece


class _Head(tarfile.TarInfo):
    """A member's head. tarfile reads names that are too long for it, and remarks, in one piece: they are bounded."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> _Head:
        head = super().frombuf(buf, encoding, errors)
        if head.type in _BEFORE_HEADS and head.size > _LONGEST_HEAD:
            raise DataError(f"an archive has a name or a remark of {head.size} bytes", expected="logs")
        return head


def _members(path: Path, unpacking: _Unpacking) -> Iterator[tuple[PurePosixPath, Stream]]:
    """Plain files of an archive; links, devices and names that lead out of it are none."""
    if path.name.lower().endswith(".zip"):
        with zipfile.ZipFile(regular(path)) as archive:
            for item in archive.infolist():
                unpacking.counted()
                if not item.is_dir() and (name := _safe(item.filename)):
                    with archive.open(item) as file:
                        yield name, file
        return
    suffix = path.suffix.lower()
    with regular(path).open("rb") if suffix == ".tar" else _OPEN[suffix](regular(path)) as stream:
        counted: Any = _Counted(stream, unpacking)
        with tarfile.open(fileobj=counted, mode="r|", tarinfo=_Head) as tar:
            for member in tar:
                unpacking.counted()
                if member.isfile() and (name := _safe(member.name)) and (own := tar.extractfile(member)) is not None:
                    yield name, own


def _safe(name: str) -> PurePosixPath | None:
    """The place of a member below its archive; None for what is hidden or leads elsewhere."""
    parts = PurePosixPath(name.replace("\\", "/")).parts
    if not parts or any(part in ("..", "/") or part.startswith((".", "__MACOSX")) or ":" in part for part in parts):
        return None
    return PurePosixPath(*parts)


def _files(root: Path) -> Iterator[Path]:
    """Files below a folder, without hidden ones, and without what a bag has packed itself."""
    for folder, folders, names in os.walk(root):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        own_packing = "metadata.yaml" in names
        for name in sorted(names):
            if not name.startswith(".") and not (own_packing and name.endswith(".zstd")):
                yield Path(folder, name)


def _is_packed(path: Path) -> bool:
    """Whether a name is that of an archive, or of a log that is packed."""
    return _is_archive(path) or (path.suffix.lower() in _OPEN and _bare(path.name).lower().endswith(_LOGS + _TEXTS))


def _is_archive(path: Path) -> bool:
    return path.name.lower().endswith(_ARCHIVES)


def _bare(name: str) -> str:
    """A name without what says how it is packed."""
    ending = next((own for own in sorted(_ARCHIVES, key=len, reverse=True) if name.lower().endswith(own)), None)
    if ending is not None:
        return name[: -len(ending)] or name
    return name.rpartition(".")[0] if Path(name).suffix.lower() in _OPEN else name


def _linked(path: Path, target: Path) -> None:
    """The same file below another folder, or all files of a folder; none of one that no import takes along."""
    if path.is_dir():
        files = [file for file in path.rglob("*") if not file.is_symlink() and file.is_file()]
        if sum(file.stat().st_size for file in files) <= _LARGEST_FOLDER:
            for file in files:
                _linked(file, target / file.relative_to(path))
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(path, target, follow_symlinks=False)
    except OSError:  # another disk
        shutil.copy2(path, target, follow_symlinks=False)
