"""Files of a log folder: read inside it only, with errors that name the file."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from pathlib import Path

from trueup.core.atomic import is_inside, regular
from trueup.errors import DataError

_CHUNK = 1 << 20
_TORCH = (".pt", ".pth")
_PICKLES = (*_TORCH, ".pkl", ".pickle")


def files_hash(paths: Iterable[Path]) -> str:
    """SHA-256 of the files' bytes, one after the other, in this order; hexadecimal.

    Raises:
        DataError: a file cannot be read.
    """
    digest = hashlib.sha256()
    for path in paths:
        try:
            with regular(path).open("rb") as file:
                while block := file.read(_CHUNK):
                    digest.update(block)
        except OSError as error:
            raise DataError(f"cannot read {path}", got=error.strerror or str(error)) from error
    return digest.hexdigest()


def bytes_hash(blobs: Iterable[bytes]) -> str:
    """What `files_hash` gives for files with these contents."""
    digest = hashlib.sha256()
    for blob in blobs:
        digest.update(blob)
    return digest.hexdigest()


def inside(root: Path, path: Path) -> Path:
    """`path`, if it stays inside the folder `root` after links are followed.

    Raises:
        DataError: it leads out of the folder, or through a loop of links.
    """
    if not is_inside(root, path):
        raise DataError(f"{path} leads out of the folder, or nowhere", expected=f"a file inside {root}")
    return path


def read_bytes(path: Path) -> bytes:
    """The content of a file.

    Raises:
        DataError: it is missing, a folder, or not readable.
    """
    try:
        return regular(path).read_bytes()
    except OSError as error:
        raise DataError(f"cannot read {path}", got=error.strerror or str(error)) from error


def refuse_pickle(path: Path) -> None:
    """Refuse what Python or PyTorch has pickled, with the line that makes arrays of it: a pickle may run code.

    Raises:
        DataError: its name says that it is one.
    """
    suffix = path.suffix.lower()
    if suffix not in _PICKLES:
        return
    load = "torch.load(FILE)" if suffix in _TORCH else "pickle.load(open(FILE, 'rb'))"
    save = f"numpy.savez('{path.stem}.npz', **{{k: numpy.asarray(v) for k, v in d.items()}})"
    raise DataError(
        f"{path} is a pickle, which may run code: it is not opened",
        expected="arrays, such as .npz",
        hint=f"If you trust it: d = {load}; {save}",
    )


def read_text(path: Path) -> str:
    """The content of a UTF-8 text file, without a byte order mark.

    Raises:
        DataError: it is missing, a folder, or not UTF-8.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"{path} is not UTF-8 text", got=f"byte {error.start}: {error.reason}") from error


def data_files(root: Path, suffix: str) -> tuple[Path, ...]:
    """Files below `root` (or `root` itself) that end in `suffix`, sorted; hidden ones and linked folders are left out.

    Raises:
        DataError: a link leads out of the folder, or the folder cannot be read.
    """
    if root.is_file():
        return (root,) if root.name.lower().endswith(suffix) else ()
    found = []
    try:
        for folder, folders, names in os.walk(root, onerror=_raise):
            here = Path(folder)
            for name in folders:
                if (here / name).is_symlink():
                    inside(root, here / name)
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            visible = (name for name in names if name.lower().endswith(suffix) and not name.startswith("."))
            found += [inside(root, here / name) for name in visible]
    except OSError as error:
        raise DataError(f"cannot read the folder {root}", got=error.strerror or str(error)) from error
    return tuple(sorted(path for path in found if path.is_file()))


def episode_id(name: str) -> str:
    """A file or folder name as an episode id: characters that an id may not hold become `_`.

    Raises:
        DataError: nothing is left, or a part of the path is `.` or `..`.
    """
    parts = [re.sub(r"[^\w.-]+", "_", part) for part in name.split("/") if part]
    if not parts or any(set(part) <= {"."} for part in parts):
        raise DataError("no episode id can be made of this name", got=repr(name))
    return "/".join(parts)


def unique_ids(named: Iterable[tuple[str, str]]) -> None:
    """Refuse episodes that share an id.

    Args:
        named: pairs of id and the file or folder that it stands for.

    Raises:
        DataError: two files would get the same id.
    """
    owner: dict[str, str] = {}
    for name, source in named:
        if name in owner:
            raise DataError(f"two episodes would be called {name!r}", got=f"{owner[name]} and {source}")
        owner[name] = source


def _raise(error: OSError) -> None:
    raise error
