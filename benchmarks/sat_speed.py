"""What a state augmentation transformer takes: a step of one actuator and of twelve, a batch of training, memory.

Step: history 128, hidden 64, 4 heads, random weights; the alternatives take turns on one core, in blocks. A shared
machine is at times half as fast as at others, for seconds: beside the median over the blocks of each block's median
stands the least of them, and two matrix-vector products say how fast the machine was.

Training: batches of 256 samples of 32 actuators on one thread, in turn with a bare torch loop of the same layers.

Writes `benchmarks/results/sat_speed.json`, from which a section of docs/building-blocks.md is made.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.networks import Made, card_of, corrector_of, motion, written
from benchmarks.pages.sat_speed import BARS, COPIES, NETWORKS
from benchmarks.table import Row, at_most, shown
from trueup.augment.config import preset
from trueup.augment.corrector import Corrector
from trueup.augment.loss import Loss
from trueup.augment.networks import sat
from trueup.augment.networks.fusion import Gated, GatedResidual, VariableSelection
from trueup.augment.pairs import Pairs, write_pairs
from trueup.augment.windows import Windows
from trueup.core.atomic import make_folder, write_json
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.model_card import ANY_JOINT, STEP_NAME, Channel, Input, Output
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.deploy import Network, Stream, StreamSettings
from trueup.deploy.cell import Cell
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "sat_speed.json"
CONFIG = sat.SatConfig(hidden=(64,), history=128, heads=4)
RATE_HZ = 250.0
_BLOCKS, _STEPS, _SLOW_STEPS = 40, 200, 5
_SAMPLES = 400
_CHECKED = 160
# SI units do not matter here.
_UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm", "current": "A", "voltage": "V", "load": "Nm"}

Runner = Callable[[int], Any]


def run() -> list[Row]:
    """Steps, training, memory; ten minutes. Writes the result file."""
    torch.set_num_threads(1)
    load = list(os.getloadavg())
    steps = {name: {str(copies): _steps(name, copies) for copies in COPIES} for name in NETWORKS}
    training, memory = _training(), _memory()
    packages = {name: metadata.version(name) for name in ("onnxruntime", "numba", "torch")}
    machine = {"name": machine_name(), "load_before": load, "load_after": list(os.getloadavg())}
    result = {
        "schema": "trueup.sat-speed/1",
        "steps": steps,
        "training": training,
        "memory": memory,
        "provenance": provenance(config={"packages": packages, "machine": machine}, seed=0),
    }
    make_folder(RESULT.parent)
    write_json(RESULT, result)
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The rows of a result; those with a bar first."""
    rows = []
    for name, by_copies in result["steps"].items():
        for copies, found in by_copies.items():
            for runner, item in found.items():
                title = f"{name}, {copies} actuator{'s' if copies != '1' else ''}: {runner}, p50"
                bar = BARS[int(copies)] if runner == "Stream" else None
                value = item["p50_us"]
                rows.append(shown(title, value, "us") if bar is None else at_most(title, value, bar, "us"))
                rows.append(shown(f"{title} of the quietest block", item["least_us"], "us"))
    training = result["training"]
    rows.append(at_most("training: time over that of a bare torch loop", training["ratio"], BARS["training"], "x"))
    rows += [shown(f"training, {name}: a batch", item["median_s"], "s") for name, item in training["batch"].items()]
    memory = result["memory"]
    ratio = memory["pieces"]["7500"] / memory["pieces"]["1875"]
    rows.append(at_most("memory of a window four times as long", ratio, BARS["memory"], "x"))
    rows += [
        shown(f"memory of a window of {samples} samples, {name}", value, "MB")
        for name, own in memory.items()
        for samples, value in own.items()
    ]
    return rows


def made(folder: Path, name: str) -> Made:
    """A modular network with random weights."""
    reads, commands, corrects = NETWORKS[name]
    simulated = [Input(signal, ANY_JOINT, _UNITS[signal], low=-2.0, high=2.0) for signal in reads]
    asked = [Input(signal, ANY_JOINT, _UNITS[signal], "command", low=-2.0, high=2.0) for signal in commands]
    outputs = tuple(Output(signal, ANY_JOINT, _UNITS[signal], base=reads.index(signal)) for signal in corrects)
    card = card_of(
        joints=(ANY_JOINT,),
        inputs=(*simulated, *asked),
        outputs=outputs,
        modular=True,
        rate_hz=RATE_HZ,
        method="sat",
        warmup_steps=0,
    )
    corrector = corrector_of(card, CONFIG)
    with torch.no_grad():
        corrector.network.dense.weight.normal_(std=0.1)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / STEP_NAME).write_bytes(corrector.step_weights().to_bytes())
    card = replace(card, states=corrector.states)
    return replace(written(folder, card, corrector.exported({})), corrector=corrector)


def _steps(name: str, copies: int) -> dict[str, dict[str, float]]:
    """Medians of each alternative over blocks that take turns; those that are the network agree first."""
    with TemporaryDirectory() as folder:
        network = made(Path(folder), name)
        runners = _runners(network, copies)
        found: dict[str, list[float]] = {key: [] for key in runners}
        tails: dict[str, list[float]] = {key: [] for key in runners}
        at = _CHECKED
        clock = time.perf_counter_ns
        for _ in range(_BLOCKS):
            for key, runner in runners.items():
                steps = _SLOW_STEPS if key == "recompute" else _STEPS
                times = []
                for k in range(at, at + steps):
                    began = clock()
                    runner(k)
                    times.append(clock() - began)
                found[key].append(float(np.median(times)) * 1e-3)
                tails[key].append(float(np.percentile(times, 99)) * 1e-3)
            at += _STEPS
    return {
        key: {
            "p50_us": float(np.median(own)),
            "least_us": min(own),
            "p99_us": float(np.median(tails[key])),
            # Block by block, so that a machine that slows down slows both down.
            "over_products": float(np.median(np.array(own) / np.array(found["two products"]))),
        }
        for key, own in found.items()
    }


def _runners(network: Made, copies: int) -> dict[str, Runner]:
    joints = [f"joint{number}" for number in range(copies)]
    opened = Network.load(network.folder)
    streams = {
        "Stream": Stream(opened, rate_hz=RATE_HZ, joints=joints),
        "Stream, onnxruntime": Stream(opened, rate_hz=RATE_HZ, joints=joints, settings=StreamSettings(compiled=False)),
    }
    card = streams["Stream"].card
    x = motion(card, _SAMPLES)[:, 0]
    rows = [row.astype(float) for row in x]
    answers = [
        np.array([stream.step_vector(rows[k], time_s=k / RATE_HZ).values.copy() for k in range(_CHECKED)])
        for stream in streams.values()
    ]
    np.testing.assert_allclose(*answers, atol=1e-5)
    runners: dict[str, Runner] = {
        name: lambda k, stream=stream: stream.step_vector(rows[k % _SAMPLES], time_s=k / RATE_HZ)
        for name, stream in streams.items()
    }
    own = opened.of_joints(joints)
    for name, compiled in (("machine code alone", True), ("onnxruntime io-binding alone", False)):
        cell = Cell.of(own, compiled=compiled)
        cell.rehearse(x[0])
        runners[name] = lambda _, cell=cell: cell.run()
    runners["recompute"] = _recompute(network, x.reshape(_SAMPLES, copies, -1))
    runners["two products"] = _products(copies)
    return runners


def _recompute(network: Made, x: np.ndarray) -> Runner:
    """Torch over the present sample and the 128 before it, every time, as long as nothing is carried over."""
    corrector = network.corrector
    samples = torch.from_numpy(np.ascontiguousarray(x))
    width = CONFIG.history + 1
    fed = torch.zeros(width, samples.shape[1], corrector.network.outputs)

    @torch.inference_mode()
    def runner(k: int) -> Tensor:
        start = k % (_SAMPLES - width)
        out: Tensor = corrector.network.taught(corrector.read(samples[start : start + width]), fed)[-1]
        return out

    return runner


def _products(copies: int) -> Runner:
    """What no implementation can do without: inputs and states times the weights of both LSTM layers, by numpy."""
    width = CONFIG.hidden[0]
    rng = np.random.default_rng(0)
    matrices = [rng.normal(size=(2 * width, 4 * width)).astype(np.float32) for _ in range(2)]
    given = np.ones((copies, 2 * width), np.float32)
    results = [np.zeros((copies, 4 * width), np.float32) for _ in matrices]

    def runner(_: int) -> None:
        for matrix, result in zip(matrices, results, strict=True):
            np.dot(given, matrix, out=result)

    return runner


class Bare(nn.Module):
    """The same layers as anybody would write them down with torch: no pieces, no cells of the encoder, no schedule."""

    def __init__(self, inputs: int, outputs: int, samples: int) -> None:
        super().__init__()
        width, self.heads, share = CONFIG.hidden[0], CONFIG.heads, CONFIG.dropout
        self.past, self.now = (VariableSelection(n, width, share) for n in (inputs + outputs, inputs))
        self.encoder, self.decoder = nn.LSTM(width, width), nn.LSTM(width, width)
        self.after_encoder, self.after_decoder = Gated(width, width, share), Gated(width, width, share)
        self.query, self.key = nn.Linear(width, width), nn.Linear(width, width)
        self.value, self.merge = nn.Linear(width, width // self.heads), nn.Linear(width // self.heads, width)
        self.lag = nn.Parameter(torch.zeros(self.heads, CONFIG.history + 1))
        self.after_attention, self.last = Gated(width, width, share), Gated(width, width, share)
        self.process, self.dense = GatedResidual(width, width, dropout=share), nn.Linear(width, outputs)
        rows = torch.arange(samples)
        lags = CONFIG.history - (rows[:, None] - rows)
        self.register_buffer("lags", lags.clamp(0, CONFIG.history))
        self.register_buffer("hidden", (lags < 0) | (lags > CONFIG.history))

    def forward(self, x: Tensor, fed: Tensor) -> Tensor:
        """(T, B, I) and the errors (T, B, K) to (T, B, K)."""
        pair = torch.cat([x, fed], dim=-1)
        past = self.past(torch.cat([torch.zeros_like(pair[:1]), pair[:-1]]))[0]
        now = self.now(x)[0]
        past = self.after_encoder(self.encoder(past)[0], past)
        now = self.after_decoder(self.decoder(now)[0], now)
        query = self.query(now).unflatten(-1, (self.heads, -1)).permute(1, 2, 0, 3)
        key = self.key(past).unflatten(-1, (self.heads, -1)).permute(1, 2, 3, 0)
        bias = self.lag[:, self.lags].masked_fill(self.hidden, -torch.inf)
        weights = torch.softmax(query @ key * query.shape[-1] ** -0.5 + bias, dim=-1).mean(dim=1)
        seen = self.merge((weights @ self.value(past).transpose(0, 1)).transpose(0, 1))
        seen = self.after_attention(seen, now)
        out: Tensor = self.dense(self.last(self.process(seen), now))
        return out


_ROUNDS = 7
_INPUTS = tuple(Channel(name, ANY_JOINT, _UNITS[name]) for name in ("position", "velocity", "torque"))
_COMMAND = Channel("position", ANY_JOINT, "rad", "command")


def _training() -> dict[str, Any]:
    """Time of a batch in each phase of the default schedule, and of the bare loop, in turn; on one thread."""
    config = preset("sat")
    with TemporaryDirectory() as folder:
        pairs = write_pairs(
            _episodes(48),
            Path(folder) / "train.f32",
            run="s",
            inputs=(*_INPUTS, _COMMAND),
            outputs=_INPUTS,
            rate_hz=RATE_HZ,
            joints=("one",),
        )
        ours = {share: _ours(pairs, share) for share in (0.0, 0.5, 1.0)}
        bare = _bare(pairs)
        names = {0.0: "true errors", 0.5: "half of them predicted", 1.0: "all predicted"}
        steps = {**{names[share]: step for share, step in ours.items()}, "bare torch loop": bare}
        times: dict[str, list[float]] = {name: [] for name in steps}
        for _ in range(_ROUNDS):
            for name, step in steps.items():
                began = time.process_time()  # of this process: a neighbour's work on the core is not in it
                step()
                times[name].append(time.process_time() - began)
    seconds = {name: np.array(own[1:]) for name, own in times.items()}
    # The share rises from none to all over the first half of the epochs, and stays there.
    mean = 0.5 * seconds["half of them predicted"] + 0.5 * seconds["all predicted"]
    ratio = np.median(mean / seconds["bare torch loop"])
    return {
        "samples": config.window.samples,
        "batch_size": config.batch,
        "threads": 1,
        "batch": {
            name: {"median_s": float(np.median(own)), "least_s": float(own.min())} for name, own in seconds.items()
        },
        "ratio": float(ratio),
        "ratios": {name: float(np.median(own / seconds["bare torch loop"])) for name, own in seconds.items()},
    }


def _episodes(count: int) -> Iterator[Episode]:
    rng = np.random.default_rng(0)
    units = {name: (_UNITS[name],) for name in ("position", "velocity", "torque")}
    clock = np.arange(512) / RATE_HZ
    for number in range(count):
        series = [
            TimeSeries(clock, ("one",), {name: rng.normal(size=(512, 1)) for name in own}, own)
            for own in (units, units, {"position": ("rad",)})
        ]
        yield Episode(EpisodeMeta(f"m{number}"), series[0], series[2], simulated={"s": series[1]})


def _ours(pairs: Pairs, share: float) -> Callable[[], None]:
    """A batch as training runs it: drawn, read, fed with its own predictions, clipped."""
    config = preset("sat")
    corrector = _corrector(len(pairs.inputs), pairs)
    corrector.train()
    corrector.network.own_share = share
    optimizer = torch.optim.AdamW(corrector.parameters(), lr=1e-3)
    loss = Loss(config.loss, pairs.outputs, pairs.rate_hz)
    windows = Windows(pairs, config.window, config.batch)

    def batches() -> Iterator[Any]:
        epoch = 0
        while True:
            yield from windows.epoch(np.random.default_rng(epoch))
            epoch += 1

    drawn = batches()

    def step() -> None:
        found = loss.of(corrector, next(drawn))
        optimizer.zero_grad(set_to_none=True)
        found.backward()
        nn.utils.clip_grad_norm_(corrector.parameters(), config.optimizer.clip)
        optimizer.step()

    return step


def _corrector(inputs: int, pairs: Pairs) -> Corrector:
    channels = tuple(Input(c.signal, c.joint, c.unit, c.series, low=-2.0, high=2.0) for c in pairs.inputs)
    outputs = tuple(Output(c.signal, c.joint, c.unit, base=number) for number, c in enumerate(pairs.outputs))
    assert inputs == len(channels)
    return corrector_of(card_of(joints=(ANY_JOINT,), inputs=channels, outputs=outputs, rate_hz=RATE_HZ), CONFIG)


def _bare(pairs: Pairs) -> Callable[[], None]:
    """A batch that is in memory, through the same layers."""
    config = preset("sat")
    windows = Windows(pairs, config.window, config.batch)
    batch = next(iter(windows.epoch(np.random.default_rng(0))))
    x, y = torch.from_numpy(batch.x), torch.from_numpy(batch.y)
    torch.manual_seed(0)
    network = Bare(x.shape[-1], y.shape[-1], len(x))
    optimizer = torch.optim.AdamW(network.parameters(), lr=1e-3)

    def step() -> None:
        loss = nn.functional.l1_loss(network(x, y), y)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()

    return step


def _memory() -> dict[str, dict[str, float]]:
    """What one step of training on two actuators needs beyond an idle process; 7500 samples are 30 s at 250 Hz."""
    return {
        "pieces": {str(samples): _peak_mb(samples, "pieces") for samples in (1875, 7500)},
        "at once": {str(samples): _peak_mb(samples, "whole") for samples in (1875,)},
    }


def _peak_mb(samples: int, how: str) -> float:
    arguments = [sys.executable, "-m", "benchmarks.sat_speed", str(samples), how]
    return float(subprocess.run(arguments, capture_output=True, text=True, check=True).stdout.split()[-1])


def _tell_peak(samples: int, how: str) -> None:
    """In a process of its own: forward and backward; print the peak beyond what was there before [MB]."""
    torch.set_num_threads(1)
    if how == "whole":
        sat._WHOLE = sat._PIECE = samples  # noqa: SLF001
    network = sat.Sat(CONFIG, 4, range(3), RATE_HZ).train()
    x, fed = torch.randn(samples, 2, 4), torch.randn(samples, 2, 3)
    before = _peak_kb()
    (network.taught(x, fed) - fed).abs().mean().backward()
    print((_peak_kb() - before) / 1024)


def _peak_kb() -> int:
    """Not by `getrusage`, which begins with the peak of the process that started this one."""
    line = next(own for own in Path("/proc/self/status").read_text().splitlines() if own.startswith("VmHWM"))
    return int(line.split()[1])


if __name__ == "__main__":
    _tell_peak(int(sys.argv[1]), sys.argv[2])
