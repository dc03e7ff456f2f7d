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
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from attack.harness import Writer, forking
from attack.kill import WRITERS, forked, prepare
from trueup.errors import TrueupError

SAID = "No space left on device"


class Disk:
    """Full as soon as a file of some name is to be on it, and from then on; keeps the names that were synced.

    Args:
        full_at: the name; never full if None.
    """

    def __init__(self, full_at: str | None = None) -> None:
        self.names: dict[str, None] = {}
        self._full_at, self._sync = full_at, os.fsync

    def fsync(self, descriptor: int) -> None:
        """In place of `os.fsync`."""
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        name = re.sub(r"^\.(.*)\.\w+\.tmp$", r"\1", path.name)
        if path.is_file():
            self.names[name] = None
        if self._full_at in self.names:
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
    context = forking()
    mine, other = context.Pipe()
    process = context.Process(target=_fill, args=(name, base, other))
    process.start()
    other.close()
    wrong = dict(mine.recv())
    process.join()
    return wrong


def _fill(name: str, base: Path, answer: Connection) -> None:
    answer.send(fill(WRITERS[name], base))


def fill(writer: Writer, base: Path) -> dict[str, str]:
    """As `filled`, here and now."""
    base.mkdir(parents=True)
    complaint, _ = forked(writer.prepare or prepare, base)
    assert not complaint, complaint
    backup, names = base.with_name("backup"), base.with_name("names")
    shutil.copytree(base, backup)
    complaint, _ = forked(_watched(writer.write, names), base)
    assert not complaint, complaint
    files = names.read_text().splitlines()
    wrong: dict[str, str] = {}
    for name in dict.fromkeys((files[0], files[len(files) // 2], files[-1])):
        shutil.rmtree(base)
        shutil.copytree(backup, base)
        steps = (_refused(writer.write, name), writer.check_part, writer.write, writer.check_whole)
        complaint = next((said for step in steps if (said := forked(step, base)[0])), "")
        if complaint:
            wrong[name] = complaint
    return wrong
