"""Where the figures of the table come from: benchmarks, and tests."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

from benchmarks.table import Row, at_most, shown

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Benchmark:
    """One of `benchmarks/`, in a process of its own.

    Attributes:
        name: of its module.
    """

    name: str

    @property
    def command(self) -> str:
        """What anybody types for the same figures."""
        return f"python -m benchmarks {self.name}"

    def measure(self) -> list[Row]:
        """Its figures.

        Raises:
            RuntimeError: it ended without any.
        """
        with TemporaryDirectory() as folder:
            file = Path(folder) / "rows.json"
            done = _run(*self.command.split(), "--rows", str(file))
            if not file.is_file():
                raise RuntimeError(f"{self.command} ended with {done} and stored no figures")
            rows: list[dict[str, Any]] = json.loads(file.read_text())[self.name]
        if not rows:
            raise RuntimeError(f"{self.command} has no figures: are the recordings there?")
        return [Row(**row) for row in rows]


@dataclass(frozen=True)
class Tests:
    """Tests that must pass, the slow ones included.

    Attributes:
        paths: files or folders of tests, or single ones, from the root of the project.
    """

    paths: tuple[str, ...]

    @property
    def command(self) -> str:
        """What anybody types to run them."""
        return f"python -m pytest {' '.join(self.paths)}"

    def measure(self) -> list[Row]:
        """How many there are, and how many do not pass; a skipped test shows nothing, and counts as such."""
        with TemporaryDirectory() as folder:
            file = Path(folder) / "junit.xml"
            _run(*self.command.split(), "-q", f"--junitxml={file}")
            counts = next(ET.parse(file).getroot().iter("testsuite")).attrib
        total = int(counts["tests"])
        missing = sum(int(counts[kind]) for kind in ("failures", "errors", "skipped"))
        return [
            at_most("tests that failed or were skipped", missing if total else 1, 0, ""),
            shown("tests that passed", total - missing, ""),
        ]


Source = Benchmark | Tests


def _run(*command: str) -> int:
    own = sys.executable if command[0] == "python" else command[0]
    return subprocess.run([own, *command[1:]], cwd=ROOT).returncode
