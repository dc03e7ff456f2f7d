"""A tenth of the papers' data set by the commands of docs/panda.md, each in a process of its own."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.table import Row, at_least, shown

PAGE = Path(__file__).parent.parent / "docs" / "panda.md"


def run() -> list[Row]:
    """Seconds of each command, and whether a report stands at the end."""
    rows = []
    with TemporaryDirectory() as folder:
        for command in _commands():
            began = time.perf_counter()
            program, *options = shlex.split(command)
            subprocess.run([Path(sys.executable).with_name(program), *options], cwd=folder, check=True)
            rows.append(shown(command, time.perf_counter() - began, "s"))
        written = (Path(folder) / "runs" / "panda" / "report.html").is_file()
    return [*rows, at_least("reports written", int(written), 1, "")]


def _commands() -> list[str]:
    """What the page tells its reader to type."""
    block = re.search(r"```sh\n(.*?)```", PAGE.read_text(), re.DOTALL)
    if block is None:
        raise ValueError(f"{PAGE} has no commands")
    return block[1].splitlines()
