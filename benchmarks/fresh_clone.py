"""The README's two commands in a fresh clone, and what the tests on recordings do where there are none."""

from __future__ import annotations

import os
import re
import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.recordings import recording
from benchmarks.table import Row, at_least, at_most, shown

ROOT = Path(__file__).parent.parent
# Whole modules, of which only some tests read recordings.
ON_RECORDINGS = (
    "tests/stages/test_real_recordings.py",
    "tests/align/test_quality_real.py",
    "tests/dataset/test_import_table.py",
    "tests/dataset/test_import_sage.py",
    "tests/dataset/test_store_splits.py",
    "tests/identify/test_inverse_dynamics.py",
)
_TEST_MIN = 15.0


def run() -> list[Row]:
    """Clone, demo, test; a quarter of an hour."""
    with TemporaryDirectory() as name:
        clone = Path(name) / "trueup"
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        demo_s, demo_code, _ = _ran(clone, "make", "demo")
        report = clone / "runs" / "demo" / "report.html"
        _ran(clone, "make", "install")
        _, without_code, without = _ran(clone, ".venv/bin/python", "-m", "pytest", "-q", *ON_RECORDINGS)
        logs = recording("so101_sage")
        if logs is not None:
            (Path(name) / "shared").symlink_to(logs.parent.parent)
        test_s, test_code, tested = _ran(clone, "make", "test")
        return [
            at_least("make demo: reports written", int(report.is_file() and not demo_code), 1, ""),
            shown("make demo, with installation", demo_s, "s"),
            at_most("make test: failed", _failures(tested, test_code), 0, ""),
            shown("make test: passed", _count(tested, "passed"), ""),
            at_most("make test, with installation of what only tests need", test_s / 60, _TEST_MIN, "min"),
            at_most("without recordings: failed", _failures(without, without_code), 0, ""),
            at_least("without recordings: skipped with a message", without.count("real recording"), 1, ""),
            shown("without recordings: passed", _count(without, "passed"), ""),
        ]


def _ran(clone: Path, *command: str) -> tuple[float, int, str]:
    """Seconds, exit code and output of a command, as on a machine that knows nothing of this one."""
    own = ("VIRTUAL_ENV", "PYTHONPATH", "TRUEUP_SHARED", "OMP_NUM_THREADS")
    clean = {name: value for name, value in os.environ.items() if name not in own} | {"CI": "true"}
    began = time.perf_counter()
    done = subprocess.run(command, cwd=clone, env=clean, capture_output=True, text=True)
    if done.returncode:
        print(f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return time.perf_counter() - began, done.returncode, done.stdout


def _failures(output: str, code: int) -> int:
    """How many tests failed; 1 where something else did."""
    return max(_count(output, "failed") + _count(output, "error"), int(code != 0))


def _count(output: str, word: str) -> int:
    """What pytest's last line says: `3545 passed, 2 skipped in ...`."""
    found = re.findall(rf"(\d+) {word}", output)
    return int(found[-1]) if found else 0
