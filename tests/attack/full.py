"""Writers whose disk is full from some moment on: said, nothing that was finished is lost, and room completes it.

A disk says so when a file is synced, and this one goes on saying so, until there is room. Each writer runs in a fork, as
in `kill`.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from attack.harness import apart
from attack.kill import WRITERS, forked, prepared
from trueup.errors import TrueupError

SAID = "No space left on device"


class Disk:
    """Full when a file of some name is to be on it; keeps the names of the files that were synced.

    Args:
        full_at: the name; never full if None.
        for_good: whether it stays full from then on, and not for this file alone.
    """

    def __init__(self, full_at: str | None = None, *, for_good: bool = True) -> None:
        self.names: dict[str, None] = {}
        self.full_at, self._for_good, self._sync = full_at, for_good, os.fsync

    def fsync(self, descriptor: int) -> None:
        """In place of `os.fsync`."""
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        name = re.sub(r"^\.(.*)\.\w+\.tmp$", r"\1", path.name)
        if path.is_file():
            self.names[name] = None
        if self.full_at in (self.names if self._for_good else (name,)):
            raise OSError(errno.ENOSPC, SAID)
        self._sync(descriptor)


def _watched(write: Callable[[Path], object], names: Path) -> Callable[[Path], None]:
    """Write, and leave the names of what was synced."""

    def call(base: Path) -> None:
        disk = Disk()
        os.fsync = disk.fsync  # of this fork only
        write(base)
        names.write_text("\n".join(disk.names))

    return call


def _refused(write: Callable[[Path], object], full_at: str) -> Callable[[Path], None]:
    """Write where there is not enough room, and look at how that is said."""

    def call(base: Path) -> None:
        os.fsync = Disk(full_at).fsync
        with pytest.raises(TrueupError, match=SAID):
            write(base)

    return call


def filled(name: str, base: Path) -> dict[str, str]:
    """Fill the disk of a writer at its first, middle and last file; what went wrong, by the name of the file.

    In a process that is free to be forked.
    """
    return dict(apart(fill, name, base))


def fill(name: str, base: Path) -> dict[str, str]:
    """As `filled`, here and now."""
    writer, names = WRITERS[name], base.with_name("names")
    backup = prepared(writer, base)
    complaint, _ = forked(_watched(writer.write, names), base)
    assert not complaint, complaint
    files = names.read_text().splitlines()
    wrong: dict[str, str] = {}
    for file in dict.fromkeys((files[0], files[len(files) // 2], files[-1])):
        shutil.rmtree(base)
        shutil.copytree(backup, base)
        steps = (_refused(writer.write, file), writer.check_part, writer.write, writer.check_whole)
        complaint = next((said for step in steps if (said := forked(step, base)[0])), "")
        if complaint:
            wrong[file] = complaint
    return wrong
