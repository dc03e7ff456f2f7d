"""How long the 43 SO-101 motions take to load, writing not included: python -m benchmarks.import_sage."""

from __future__ import annotations

import time

from benchmarks.recordings import recording
from benchmarks.table import Row, shown
from trueup.dataset.importers import sage
from trueup.dataset.importers.base import ImportOptions

LIMIT_S = 3.5  # of the 8 s that the whole import may take
REPEATS = 3


def run() -> list[Row]:
    """Best of three runs over files that are in the page cache; nothing without the recording."""
    folder = recording("so101_sage")
    if folder is None:
        return []
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        episodes = sage.scan(folder, ImportOptions()).episodes
        samples = sum(len(episode.load().measured) for episode in episodes)
        seconds.append(time.perf_counter() - start)
    best = min(seconds)
    megabytes = sum(episode.bytes for episode in episodes) / 1e6
    return [
        Row(f"load {len(episodes)} SAGE motions, {samples} samples", best, LIMIT_S, "s", best <= LIMIT_S),
        shown("  rate", megabytes / best, "MB/s"),
    ]
