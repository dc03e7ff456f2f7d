"""Files and folders that are either there whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from trueup.errors import DataError, OutputExists


def make_folder(path: Path) -> None:
    """Make a folder and its parents, if they are not there.

    Raises:
        DataError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        there = next((place for place in (path, *path.parents) if os.path.lexists(place)), path)
        what = f"{'it' if there == path else there} is {'a file' if there.is_file() else 'no folder'}"
        raise DataError(
            f"cannot make the folder {path}: {what}", hint="It must be a folder: choose another name."
        ) from error
    except OSError as error:
        raise DataError(f"cannot make the folder {path}", got=error.strerror or str(error)) from error


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place when the block ends without an error.

    The temporary file is synced to disk before the rename, so that after a power cut either the old or the
    new file is there, and the folder after it, so that it is the new one once the block has ended.

    Raises:
        DataError: the disk is full or not writable; it is a folder, or a link to one, whose place the file would take.
    """
    make_folder(path.parent)
    if path.is_dir():
        raise DataError(f"cannot write {path}", got="a folder", expected="a name for a file")
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    except OSError as error:
        raise DataError(f"cannot write {path}", got=error.strerror or str(error)) from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.chmod(0o644)  # mkstemp makes 0600; results are for colleagues too
        temporary.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise DataError(f"cannot write {path}", got=error.strerror or str(error)) from error
    finally:
        temporary.unlink(missing_ok=True)


def left_behind(path: Path) -> list[Path]:
    """What writers of a file that were killed have left beside it, with what SQLite has beside that."""
    return list(path.parent.glob(f".{path.name}.*.tmp*"))


@contextlib.contextmanager
def appearing(folder: Path) -> Iterator[Path]:
    """A temporary folder beside `folder` that takes its place when the block ends without an error.

    Args:
        folder: not there, or empty; through a link, the folder that it leads to.

    Raises:
        DataError: the disk is full or not writable.
        OutputExists: another program made the folder meanwhile.
    """
    folder, temporary = folder.resolve(), None
    make_folder(folder.parent)
    try:
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".tmp", dir=folder.parent))
        yield temporary
        for path in (*sorted(temporary.rglob("*")), temporary):
            _sync(path)
        temporary.chmod(0o755)  # mkdtemp makes 0700; datasets are for colleagues too
        if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
            raise OutputExists(f"{folder} was made by another program meanwhile")
        temporary.rename(folder)
        _sync_folder(folder.parent)
    except OSError as error:
        raise DataError(f"cannot write {folder}", got=error.strerror or str(error)) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_folder(path: Path) -> None:
    """The names in a folder, too; file systems that cannot do that for a folder are left to their own order."""
    try:
        _sync(path)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise


def remove(path: Path) -> None:
    """Remove a file, if it is there.

    Raises:
        DataError: it cannot be removed; it is a folder.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise DataError(f"cannot remove {path}", got=error.strerror or str(error), expected="a file") from error


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, UTF-8."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically, keys in the order in which they come (that of joints means something); no NaN."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def as_read_back(value: Any) -> Any:
    """The value as JSON gives it back: tuples are lists, keys are text."""
    return json.loads(json.dumps(value))


def without_nan(tree: Any) -> Any:
    """The value with null for numbers that are not finite, which JSON has not."""
    if isinstance(tree, Mapping):
        return {key: without_nan(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [without_nan(value) for value in tree]
    return None if isinstance(tree, float) and not math.isfinite(tree) else tree


def json_hash(value: Any) -> str:
    """SHA-256 of a JSON value, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def file_hash(path: Path) -> str:
    """SHA-256 of a file.

    Raises:
        DataError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DataError(f"cannot read {path}", got=error.strerror or str(error)) from error


def regular(path: Path) -> Path:
    """The path of a file, unless it is a pipe, which would be waited for, a device, which never ends, or a folder.

    Raises:
        DataError: it is there, and no regular file.
    """
    if path.exists() and not path.is_file():
        raise DataError(f"cannot read {path}", got="a folder" if path.is_dir() else "no regular file")
    return path


def where_missing(path: Path) -> str:
    """What to do about a path that leads nowhere, for messages: which part of it is not there."""
    nowhere = next((place for place in reversed(path.absolute().parents) if not place.is_dir()), None)
    if nowhere is not None:
        return f"Check the path: there is no folder {nowhere}."
    return f"Check the path: there is no {path.name} in {path.absolute().parent}."


def is_inside(folder: Path, path: Path) -> bool:
    """Whether a path stays inside a folder after links are followed; not if it leads nowhere, as a loop of links."""
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):
        return False


def whole_number(text: str) -> int:
    """The number of a text of digits.

    Raises:
        OverflowError: no float can hold it, which nobody would expect later.
    """
    number = int(text)
    float(number)
    return number


# What may become a number that is not finite, or half a character; few files have any.
_ODD = re.compile(r"NaN|Infinity|\d[eE]\+?\d{3,}\s*[,\]}]|\d{300}|\\u[dD][89a-fA-F]")


def _number(text: str) -> int | float:
    """A number of a file in which one may be too large."""
    if not math.isfinite(float(text)):
        raise ValueError(f"{text} is not a finite number")
    return int(text) if text.lstrip("-").isdigit() else float(text)


def read_json(path: Path) -> Any:
    """Read JSON.

    Raises:
        DataError: the file is missing, not UTF-8 or not JSON, or holds a number that is too large, or none.
    """
    try:
        text = regular(path).read_bytes().decode("utf-8-sig")
        if _ODD.search(text) is None:
            return json.loads(text)
        tree = json.loads(text, parse_float=_number, parse_int=_number, parse_constant=_number)
        json.dumps(tree, ensure_ascii=False).encode()  # half a character could not be written again
    except FileNotFoundError:
        raise DataError(f"{path} does not exist", hint=where_missing(path)) from None
    except (OSError, UnicodeDecodeError, ValueError, OverflowError, RecursionError) as error:
        raise DataError(f"{path} is not readable JSON", got=error) from error
    return tree
