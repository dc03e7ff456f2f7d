"""A folder of results that one process at a time writes to."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from trueup.core.atomic import make_folder
from trueup.errors import DataError

_held: set[tuple[int, int]] = set()


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Nobody else writes to this folder meanwhile; it is made if it is not there.

    The lock is on the folder itself: it leaves no file behind, and the system drops it when the process dies. Who holds
    it already may take it again, as steps do that are commands of their own.

    Raises:
        DataError: another process writes there, or the folder cannot be made or locked.
    """
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
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DataError(
                f"another process writes into {folder}", hint="Wait until it has ended, or choose another --out."
            ) from None
        except OSError as error:
            raise DataError(f"{folder} cannot be locked", got=error.strerror) from error
        _held.add(own)
        try:
            yield
        finally:
            _held.discard(own)
    finally:
        os.close(descriptor)  # and the lock with it
