"""The papers' data set, from planning to replay, and what a second process and more motions change."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.table import Row, at_least, at_most, shown

_PART = 0.2


def run() -> list[Row]:
    """Commands as a user gives them, each in a process of its own; about eight minutes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _, part_mb = _record(folder / "part", _PART, jobs=2)
        first_s, whole_mb = _record(folder / "whole", 1.0, jobs=2)
        replay_s, _ = _timed("replay", str(folder / "whole"), "--robot", "panda", "--jobs", "2")
        alone_s, _ = _record(folder / "alone", 1.0, jobs=1)
        second_s, _ = _record(folder / "again", 1.0, jobs=2)
    both_s = (first_s + second_s) / 2
    return [
        at_most("1770 motions planned, recorded, replayed in MuJoCo", (both_s + replay_s) / 60, 15, "min"),
        shown("of this, planning and recording", both_s / 60, "min"),
        shown("of this, replay", replay_s / 60, "min"),
        at_least("planning and recording, 2 processes against 1", alone_s / both_s, 1.7, "x"),
        at_most(f"largest process, all motions against {_PART:.0%} of them", whole_mb / part_mb, 1.2, "x"),
        shown("largest process, all motions", whole_mb, "MB"),
    ]


def _record(out: Path, scale: float, *, jobs: int) -> tuple[float, float]:
    return _timed("record", "--plan", "paper", "--scale", str(scale), "--jobs", str(jobs), "--out", str(out))


def _timed(*arguments: str) -> tuple[float, float]:
    """Seconds of a command, and megabytes of its largest process."""
    code = (
        "import resource, sys\n"
        "from trueup.cli.main import main\n"
        "try:\n"
        "    main(sys.argv[1:])\n"
        "finally:\n"
        "    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)\n"
        "    print(max(resource.getrusage(each).ru_maxrss for each in who))\n"
    )
    started = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code, *arguments], check=True, capture_output=True, text=True)
    return time.perf_counter() - started, int(done.stdout.split()[-1]) / 1024
