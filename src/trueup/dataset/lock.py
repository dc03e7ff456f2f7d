"""The lock that keeps a second writer out of a folder."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from trueup.errors import DataError

LOCK_NAME = ".lock"


class FolderLock:
    """An exclusive lock on a folder, held until `release`; the system drops it when the process dies.

    Raises:
        DataError: another writer holds it, or the file system has no locks.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK_NAME
        try:
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        except OSError as error:
            raise DataError(f"cannot write into {folder}", got=error.strerror) from error
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._descriptor)
            if isinstance(error, BlockingIOError):
                raise DataError(f"another process is writing {folder}", hint="wait until it has ended") from None
            raise DataError(f"{folder} cannot be locked", got=error.strerror) from error

    def refuse_moved(self) -> None:
        """Refuse to go on in a folder that is not the one that was locked.

        Raises:
            DataError: it was moved, replaced or deleted meanwhile.
        """
        own = os.fstat(self._descriptor)
        try:
            there = self._path.stat()
        except OSError:
            there = None
        if there is None or (own.st_dev, own.st_ino) != (there.st_dev, there.st_ino):
            raise DataError(
                f"{self._path.parent} was moved or deleted while it was being written",
                hint="Leave the folder where it is until the command has ended, and begin again.",
            )

    def release(self) -> None:
        """Let the next writer in."""
        if self._descriptor >= 0:
            # Explicitly, since a forked child may still hold a copy of the descriptor.
            fcntl.flock(self._descriptor, fcntl.LOCK_UN)
            os.close(self._descriptor)
            self._descriptor = -1
