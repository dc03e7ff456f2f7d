"""What a compensation takes: a step of the default operator for ten joints, and a batch of 4096 robots.

Step: random weights; the alternatives take turns on one core, in blocks. A shared machine is at times half as fast as
at others, for seconds: beside the median over the blocks of each block's median stands the least of them, and the
products that no implementation can do without say how fast the machine was. Batch: the exported graph on two threads,
which need not wait for one another.

Writes `benchmarks/results/compensate_speed.json`.
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.networks import compensation
from benchmarks.table import Row, at_least, at_most, shown
from trueup.core.atomic import make_folder, write_json
from trueup.core.provenance import provenance
from trueup.deploy import Compensator, Limits, Network, Stream, StreamSettings
from trueup.deploy.cell import Cell
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "compensate_speed.json"
JOINTS = tuple(f"joint{number}" for number in range(10))
RATE_HZ = 50.0
STEP_US, SAMPLES_S = 40.0, 250e3
_BLOCKS, _STEPS, _ROUNDS, _THREADS = 40, 200, 60, 2
_BATCH, _PIECE = 4096, 512

Runner = Callable[[int], Any]


def run() -> list[Row]:
    """Steps and batches; a minute. Writes the result file."""
    load = list(os.getloadavg())
    with TemporaryDirectory() as folder:
        compensation(Path(folder), JOINTS, rate_hz=RATE_HZ)
        steps, batch = _steps(Path(folder)), _batch(Path(folder))
    packages = {name: metadata.version(name) for name in ("onnxruntime", "numba", "torch")}
    machine = {"name": machine_name(), "load_before": load, "load_after": list(os.getloadavg())}
    made_of = provenance(config={"packages": packages, "machine": machine}, seed=0)
    result = {"schema": "trueup.compensate-speed/1", "steps": steps, "batch": batch, "provenance": made_of}
    make_folder(RESULT.parent)
    write_json(RESULT, result)
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    steps, batch = result["steps"], result["batch"]
    rows = [at_most("a step through Stream, 10 joints, p50", steps["Stream"]["p50_us"], STEP_US, "us")]
    rows += [
        shown(f"{name}, {what}", own[key], "us")
        for name, own in steps.items()
        for key, what in (("p50_us", "p50"), ("least_us", "p50 of the quietest block"), ("p99_us", "p99"))
    ]
    rows.append(at_least(f"samples at batch {_BATCH}, two threads", batch["samples_s"], SAMPLES_S, "1/s"))
    rows.append(shown("of its quietest batch", batch["most_samples_s"], "1/s"))
    rows.append(shown("samples per second of one core's time", batch["samples_cpu_s"], "1/s"))
    return rows


def _steps(folder: Path) -> dict[str, dict[str, float]]:
    runners = _runners(folder)
    found: dict[str, list[float]] = {name: [] for name in runners}
    tails: dict[str, list[float]] = {name: [] for name in runners}
    clock, at = time.perf_counter_ns, 0
    for _ in range(_BLOCKS):
        for name, runner in runners.items():
            times = []
            for k in range(at, at + _STEPS):
                began = clock()
                runner(k)
                times.append(clock() - began)
            found[name].append(float(np.median(times)) * 1e-3)
            tails[name].append(float(np.percentile(times, 99)) * 1e-3)
        at += _STEPS
    return {
        name: {
            "p50_us": float(np.median(own)),
            "least_us": min(own),
            "p99_us": float(np.median(tails[name])),
            # Block by block, so that a machine that slows down slows both down.
            "over_products": float(np.median(np.array(own) / np.array(found["the products alone"]))),
        }
        for name, own in found.items()
    }


def _runners(folder: Path) -> dict[str, Runner]:
    time_s = np.arange(500)[:, None] / RATE_HZ
    rate = np.linspace(1.0, 3.0, len(JOINTS))
    position, velocity = np.sin(rate * time_s), rate * np.cos(rate * time_s)
    target = position + 0.05 * velocity
    count = len(time_s)
    runners: dict[str, Runner] = {}
    for name, compiled in (("Stream", True), ("Stream, onnxruntime", False)):
        settings = StreamSettings(compiled=compiled)
        stream = Stream.load(folder, rate_hz=RATE_HZ, joints=JOINTS, settings=settings)
        stream.under(payload=1.5)
        runners[name] = lambda k, stream=stream: stream.step(
            {"position": position[k % count], "velocity": velocity[k % count]},
            {"position": target[k % count]},
            time_s=k / RATE_HZ,
        )
    limits = Limits((-3.0,) * len(JOINTS), (3.0,) * len(JOINTS))
    compensator = Compensator.load(folder, joints=JOINTS, limits=limits, payload_kg=1.5)
    runners["Compensator"] = lambda k: compensator.step(
        position[k % count], velocity[k % count], target[k % count], time_s=k / RATE_HZ
    )
    opened = Network.load(folder)
    for name, compiled in (("machine code alone", True), ("onnxruntime alone", False)):
        cell = Cell.of(opened, compiled=compiled)
        cell.rehearse(np.zeros(len(opened.card.inputs), np.float32))
        runners[name] = lambda _, cell=cell: cell.run()
    runners["the products alone"] = _products(opened)
    return runners


def _products(network: Network) -> Runner:
    """Inputs of each layer times its weights, by numpy."""
    weights = network.step
    assert weights is not None
    rng = np.random.default_rng(0)
    sizes = [pair for own in (weights.branch, weights.trunk) for pair in itertools.pairwise(own)]
    matrices = [rng.normal(size=size).astype(np.float32) for size in sizes]
    given = [np.ones(before, np.float32) for before, _ in sizes]
    results = [np.zeros(after, np.float32) for _, after in sizes]

    def runner(_: int) -> None:
        for x, matrix, out in zip(given, matrices, results, strict=True):
            np.dot(x, matrix, out=out)

    return runner


def _batch(folder: Path) -> dict[str, float]:
    """Pieces that fit into a core's cache, on two threads that need not wait for one another."""
    session = Network.load(folder).session
    rng = np.random.default_rng(0)
    feeds = [
        {name: rng.normal(size=(rows, _PIECE, 31)).astype(np.float32) for name, rows in (("x", 1), ("past", 4))}
        for _ in range(_BATCH // _PIECE)
    ]
    wall, computed = [], []
    with ThreadPoolExecutor(_THREADS) as threads:
        for _ in range(_ROUNDS):
            began, own = time.perf_counter(), time.process_time()
            list(threads.map(lambda feed: session.run(None, feed), feeds))
            wall.append(time.perf_counter() - began)
            computed.append(time.process_time() - own)
    return {
        "samples_s": _BATCH / float(np.median(wall)),
        "most_samples_s": _BATCH / min(wall),
        # What other programs take of the machine is not in it.
        "samples_cpu_s": _BATCH / float(np.median(computed)),
    }
