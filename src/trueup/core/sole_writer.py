"""A folder of results that one process at a time, of one machine, writes to."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import inspect
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import ParamSpec, TypeVar

from trueup.core.atomic import make_folder
from trueup.errors import DataError

_P = ParamSpec("_P")
_R = TypeVar("_R")
_held: set[tuple[int, int]] = set()


def writes_alone(parameter: str = "out") -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """A function that is the `sole_writer` of the folder that it is given.

    Args:
        parameter: its name. Without a folder (None) nothing is locked.
    """

    def decorated(function: Callable[_P, _R]) -> Callable[_P, _R]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def alone(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            folder = signature.bind(*args, **kwargs).arguments.get(parameter)
            if folder is None:
                return function(*args, **kwargs)
            with sole_writer(Path(folder)):
                return function(*args, **kwargs)

        return alone

    return decorated


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Nobody else writes to this folder meanwhile; it is made if it is not there, and not left empty by an error.

    The lock is on the folder itself: it leaves no file behind, and the system drops it when the process dies. Other
    machines that share the disk do not see it: NFS passes no locks of folders on. Who holds it already may take it
    again, as steps do that are commands of their own.

    Raises:
        DataError: another process writes there, or the folder cannot be made or locked.
    """
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    make_folder(folder)
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        raise DataError(f"cannot write into {folder}", got=error.strerror) from error
    try:
        there = os.fstat(descriptor)
        own = (there.st_dev, there.st_ino)
        if own in _held:
            yield
            return
        _lock(descriptor, folder)
        _held.add(own)
        try:
            yield
        except BaseException:
            _remove_empty(missing)
            raise
        finally:
            _held.discard(own)
    finally:
        os.close(descriptor)  # and the lock with it


def _lock(descriptor: int, folder: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise DataError(
            f"another process writes into {folder}", hint="Wait until it has ended, or choose another --out."
        ) from None
    except OSError as error:
        raise DataError(f"{folder} cannot be locked", got=error.strerror) from error
    if os.fstat(descriptor).st_nlink == 0:  # made by one that has ended with an error since
        raise DataError(f"another process has removed {folder}", hint="Run the command again.")


def _remove_empty(folders: Sequence[Path]) -> None:
    """The innermost first; the lock is still held, so nobody begins to write there meanwhile."""
    with contextlib.suppress(OSError):
        for folder in folders:
            folder.rmdir()
