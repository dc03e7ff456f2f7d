"""How fast networks are trained, beside a bare torch loop, and in how much memory."""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from torch import nn

from benchmarks.table import Row, at_most, shown
from trueup.augment import Augmentation, AugmentConfig, Task, preset
from trueup.augment.config import WindowConfig
from trueup.augment.corrector import Corrector
from trueup.augment.networks import build_network
from trueup.augment.pairs import Pairs, refuse_overlap, write_pairs
from trueup.augment.scaling import Scaling
from trueup.augment.training import train
from trueup.augment.windows import Windows
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.model_card import Channel
from trueup.core.timeseries import TimeSeries

JOINTS = tuple(f"joint{number}" for number in range(1, 8))
CHANNELS = tuple(
    Channel(signal, joint, unit)
    for signal, unit in (("position", "rad"), ("velocity", "rad/s"), ("torque", "Nm"))
    for joint in JOINTS
)
ROUNDS = 5


def run() -> list[Row]:
    """Both parts; five minutes."""
    with TemporaryDirectory() as name:
        pairs = made(Path(name) / "train.f32", 160)
        val = made(Path(name) / "val.f32", 30, seed=1)
        rows = []
        for method in ("realeasy", "realeasy-rt"):
            config = replace(preset(method, paper=True), window=WindowConfig("half-shortest", draws=4), epochs=1)
            ours, bare = paired(
                lambda config=config: _ours(config, pairs, val, Path(name)),
                lambda config=config: _bare(config, pairs),
            )
            rows.append(at_most(f"{method}, paper: an epoch over that of a bare torch loop", ours / bare, 1.3, "x"))
            rows.append(shown(f"{method}, paper: an epoch of {len(pairs.motions)} motions, 4 draws", ours, "s"))
    return [*rows, *_memory()]


def made(path: Path, motions: int, seed: int = 0) -> Pairs:
    """Random motions of the lengths of the papers', seven joints, three signals."""
    return write_pairs(_episodes(motions, seed), path, run="s", inputs=CHANNELS, outputs=CHANNELS, rate_hz=100.0)


def _episodes(motions: int, seed: int) -> Iterator[Episode]:
    rng = np.random.default_rng(seed)
    units = {"position": ("rad",) * 7, "velocity": ("rad/s",) * 7, "torque": ("Nm",) * 7}
    for number in range(motions):
        samples = int(rng.integers(140, 500))
        clock = np.arange(samples) / 100
        simulated, measured = (
            TimeSeries(clock, JOINTS, {name: rng.normal(size=(samples, 7)) for name in units}, units) for _ in range(2)
        )
        yield Episode(EpisodeMeta(f"m{number}"), measured, simulated={"s": simulated})


def paired(first: Callable[[], float], second: Callable[[], float]) -> tuple[float, float]:
    """Medians of both, taken in turn, since the machine is never quiet."""
    times = [(first(), second()) for _ in range(ROUNDS)]
    return tuple(np.median(times, axis=0))


def corrector_of(config: AugmentConfig) -> Corrector:
    torch.manual_seed(0)
    one = np.ones(21)
    network = build_network(config.network, inputs=21, base=range(21))
    return Corrector(network, Scaling(0 * one, one, 0 * one, one, one), np.arange(21), target="residual")


def _ours(config: AugmentConfig, pairs: Pairs, val: Pairs, folder: Path) -> float:
    started = time.perf_counter()
    train(corrector_of(config), pairs, val, config, seed=0, checkpoint=folder / "checkpoint", inputs="")
    return time.perf_counter() - started


def _bare(config: AugmentConfig, pairs: Pairs) -> float:
    """The same batches, drawn beforehand, through torch's own layers."""
    batches = list(Windows(pairs, config.window, config.batch).epoch(np.random.default_rng([0, 1])))
    both = config.network.bidirectional
    torch.manual_seed(0)
    first = nn.LSTM(21, 100, bidirectional=both)
    second = nn.LSTM(200 if both else 100, 21, bidirectional=both)
    dense = nn.Linear(21, 21)
    parameters = [*first.parameters(), *second.parameters(), *dense.parameters()]
    optimizer = torch.optim.RMSprop(parameters, lr=1e-4)
    started = time.perf_counter()
    for batch in batches:
        x, y = torch.from_numpy(batch.x), torch.from_numpy(batch.y)
        hidden, _ = second(first(x)[0])
        hidden = hidden[..., :21] + hidden[..., 21:] if both else hidden
        loss = nn.functional.mse_loss(x + dense(hidden), y)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return time.perf_counter() - started


def _memory() -> list[Row]:
    """Resident memory of the same training on a data set and on one twenty times as large."""
    small, large = (_peak_mb(motions) for motions in (200, 4000))
    return [
        shown("training on 200 motions: peak of resident memory", small, "MB"),
        at_most("20 times the data: peak of resident memory", large / small, 1.1, "x"),
    ]


def _peak_mb(motions: int) -> float:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.training", str(motions)], capture_output=True, text=True, check=True
    )
    return float(done.stdout.split()[-1])


def _train_and_tell(motions: int) -> None:
    """In a process of its own: pairs, one epoch, gates and intervals, as a user's training; print the peak [MB]."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        pairs, val = made(folder / "train.f32", motions), made(folder / "val.f32", motions // 5, seed=1)
        refuse_overlap(pairs, val)
        config = preset("realeasy-rt")
        task = Task("m", "arm", JOINTS, "s", 100.0, pairs, val, {})
        small = replace(config, window=replace(config.window, draws=1), epochs=1)
        Augmentation.fit(task, small, folder=folder)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


if __name__ == "__main__":
    _train_and_tell(int(sys.argv[1]))
