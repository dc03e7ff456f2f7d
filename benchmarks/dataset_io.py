"""Speed and memory of the dataset on disk, against plain pyarrow on the same bytes in the same run."""

from __future__ import annotations

import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.table import Row, at_most, shown
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter

EPISODES, SAMPLES, JOINTS = 1000, 500, 7
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}  # 3 signals of 7 joints: 21 columns
NAMES = tuple(f"joint{number}" for number in range(JOINTS))
ROUNDS = 5

# Peak resident memory of a process that does nothing but iterate. Not ru_maxrss: a child inherits its parent's peak.
_ITERATE = """
import sys
from trueup.dataset import Dataset
total = sum(len(episode.measured) for episode in Dataset(sys.argv[1]))
assert total == int(sys.argv[2]), total
with open("/proc/self/status") as status:
    print(next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM")))
"""


def run() -> list[Row]:
    """All figures; takes about a minute."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return [*_throughput(folder), *_random_access(folder / "dataset"), *_memory(folder / "many")]


def _episode(number: int, samples: int, units: dict[str, str], rng: np.random.Generator) -> Episode:
    # Noise does not compress: the worst case for both sides.
    signals = {signal: rng.standard_normal((samples, JOINTS), dtype=np.float32) for signal in units}
    measured = TimeSeries(np.arange(samples) * 0.02, NAMES, signals, same_units(units, NAMES))
    return Episode(EpisodeMeta(f"motion_{number:05d}", robot="bench"), measured)


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _throughput(folder: Path) -> list[Row]:
    rng = np.random.default_rng(0)
    episodes = [_episode(number, SAMPLES, UNITS, rng) for number in range(EPISODES)]
    plain, ours = folder / "plain.parquet", folder / "dataset"
    times: dict[str, list[float]] = {name: [] for name in ("plain write", "write", "plain read", "read", "whole file")}
    for _ in range(ROUNDS):  # in alternation: whatever else the machine does falls on both
        shutil.rmtree(ours, ignore_errors=True)
        times["plain write"].append(_seconds(lambda: _write_plain(plain, episodes)))
        times["write"].append(_seconds(lambda: _write(ours, episodes)))
        times["plain read"].append(_seconds(lambda: _read_plain(plain)))
        times["read"].append(_seconds(lambda: _read(ours)))
        times["whole file"].append(_seconds(lambda: _read_plain_at_once(plain)))
    median = {name: statistics.median(values) for name, values in times.items()}
    size = f"{EPISODES} episodes of {SAMPLES} x {JOINTS * len(UNITS)} float32"
    return [
        shown(f"write {size}, plain pyarrow", median["plain write"], "s"),
        shown(f"write {size}", median["write"], "s"),
        at_most("write, over plain pyarrow", median["write"] / median["plain write"], 3.0, "times"),
        shown("read all into (T, J), plain pyarrow, by row group", median["plain read"], "s"),
        shown("read all into (T, J), plain pyarrow, whole file at once", median["whole file"], "s"),
        shown("read all into (T, J)", median["read"], "s"),
        at_most("read, over plain pyarrow by row group", median["read"] / median["plain read"], 2.0, "times"),
        at_most("read, over plain pyarrow at once", median["read"] / median["whole file"], 2.0, "times"),
    ]


def _table(episode: Episode) -> pa.Table:
    columns = {"time_s": episode.measured.time_s}
    for signal in UNITS:
        for joint, values in zip(NAMES, episode.measured[signal].T, strict=True):
            columns[f"{signal}[{joint}]"] = np.ascontiguousarray(values)
    return pa.table(columns)


def _write_plain(path: Path, episodes: list[Episode]) -> None:
    with pq.ParquetWriter(path, _table(episodes[0]).schema) as writer:
        for episode in episodes:
            writer.write_table(_table(episode))


def _write(path: Path, episodes: list[Episode]) -> None:
    with DatasetWriter.create(path, DatasetInfo(robot="bench")) as writer:
        for episode in episodes:
            writer.append(episode)


def _arrays(table: pa.Table) -> list[np.ndarray]:
    columns = [column.to_numpy() for column in table.columns]
    return [columns[0]] + [
        np.stack(columns[1 + JOINTS * signal : 1 + JOINTS * (signal + 1)], axis=1) for signal in range(len(UNITS))
    ]


def _read_plain(path: Path) -> None:
    file = pq.ParquetFile(path)
    for group in range(file.num_row_groups):
        _arrays(file.read_row_group(group))


def _read_plain_at_once(path: Path) -> None:
    arrays = _arrays(pq.read_table(path))
    for start in range(0, EPISODES * SAMPLES, SAMPLES):
        [values[start : start + SAMPLES] for values in arrays]


def _read(path: Path) -> None:
    for episode in Dataset(path):
        assert episode.measured["torque"].shape == (SAMPLES, JOINTS)


def _random_access(path: Path) -> list[Row]:
    order = list(Dataset(path).ids)
    random.Random(0).shuffle(order)
    order = order[:300]
    dataset = Dataset(path)

    def cold_seconds(id: str) -> float:
        dataset.close()  # every shard is closed: its footer is parsed again
        return _seconds(partial(dataset.episode, id))

    # Best of three each: a time slice that goes to another process is 5 ms.
    cold = [min(cold_seconds(id) for _ in range(3)) * 1e3 for id in order]
    warm = [min(_seconds(partial(dataset.episode, id)) for _ in range(3)) * 1e3 for id in order]
    rows = []
    for name, values in (("warm", warm), ("cold", cold)):
        rows += [
            at_most(f"one episode at random, {name} shard, median", statistics.median(values), 2.0, "ms"),
            at_most(f"one episode at random, {name} shard, p95", float(np.quantile(values, 0.95)), 2.0, "ms"),
        ]
    return rows


def _memory(path: Path, episodes: int = 20_000, samples: int = 100) -> list[Row]:
    rng = np.random.default_rng(1)
    start = time.perf_counter()
    with DatasetWriter.create(path, DatasetInfo(robot="bench")) as writer:
        for number in range(episodes):
            writer.append(_episode(number, samples, {"position": "rad"}, rng))
    written_s = time.perf_counter() - start
    opened_ms = statistics.median(_seconds(lambda: Dataset(path)) for _ in range(5)) * 1e3
    command = [sys.executable, "-c", _ITERATE, str(path), str(episodes * samples)]
    start = time.perf_counter()
    peak_mb = float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    iterated_s = time.perf_counter() - start
    files = sum(1 for file in path.rglob("*") if file.is_file())
    size = f"{episodes} episodes of {samples} x {JOINTS}"
    return [
        shown(f"write {size}", written_s, "s"),
        shown(f"files of {size}", files, "files"),
        shown(f"open {size}", opened_ms, "ms"),
        shown(f"iterate {size}", iterated_s, "s"),
        at_most(f"iterate {size}, peak resident memory", peak_mb, 400.0, "MB"),
    ]
