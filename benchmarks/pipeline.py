"""The commands on the real SO-101 recording: import, replay, gap with report."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from benchmarks.recordings import recording
from benchmarks.table import Row, at_most, shown
from trueup.dataset import Dataset
from trueup.report import write_report
from trueup.robots import load_robot
from trueup.stages import gap, import_logs, replay


def run() -> list[Row]:
    """Seconds for each command on 43 motions; empty without the recording."""
    logs = recording("so101_sage")
    if logs is None:
        return []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        started = time.perf_counter()
        import_logs(logs, out / "data")
        imported = time.perf_counter()
        dataset = Dataset(out / "data")
        replay(dataset, load_robot("so101"))
        replayed = time.perf_counter()
        gap(dataset).save(out / "gap")
        write_report(out / "gap")
        done = time.perf_counter()
    return [
        at_most("trueup import, 43 SO-101 motions", imported - started, 8.0, "s"),
        shown("trueup replay, 43 SO-101 motions", replayed - imported, "s"),
        at_most("trueup gap with report, 43 SO-101 motions", done - replayed, 20.0, "s"),
    ]
