"""One step of the real-time network (21 -> 100 -> 21) beside what it could run on instead, and a loop at 1 kHz.

The alternatives take turns on one core. A shared machine slows down now and then for some tenths of a second: what
counts is the median over the turns of each percentile; the percentile over all steps stands beside it.

Writes `benchmarks/results/streaming.json`, from which docs/step-times.md is made.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from benchmarks.networks import HIDDEN, JOINTS, Made, by_signal, motion, real_time
from benchmarks.pages.streaming import BARS, OURS
from benchmarks.table import Row, at_most, shown
from trueup.core.atomic import make_folder, write_json
from trueup.core.provenance import provenance
from trueup.core.step_times import StepTimes
from trueup.deploy import Latency, LoopReport, Network, Predictor, Stream
from trueup.deploy.latency import PERCENTILES
from trueup.stages import time_steps

RESULT = Path(__file__).parent / "results" / "streaming.json"
RATE_HZ = 1000.0
PAPER_US = 390.0  # Realeasy, Sec. V: one step of its real-time network
# The alternatives take turns, so that a change in the machine's speed meets all of them.
_ROUNDS, _STEPS = 40, 4000
_LOOP_S = 60.0
# Of the motion that goes round and round: so few that they stay in the cache, where a simulator has just left them.
_SAMPLES = 200
_CHECKED = 50

Sample = dict[str, np.ndarray]
# A step of an alternative: number of the sample, its signals, the same as one float32 vector; returns the outputs.
Runner = Callable[[int, Sample, np.ndarray], np.ndarray]


def run() -> list[Row]:
    """Measure all alternatives in turns, then the loop; write the result file."""
    torch.set_num_threads(1)
    if hasattr(os, "sched_setaffinity"):  # one core, as docs/runtime.md advises for control loops
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    with TemporaryDirectory() as name:
        made = real_time(Path(name))
        found = _measured(made)
        times, loop = time_steps(made.folder, rate_hz=RATE_HZ, seconds=_LOOP_S)
    make_folder(RESULT.parent)
    result = _result(found, times, loop)
    write_json(RESULT, result)
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    rows = []
    for runner, own in result["step"].items():
        for key, share in PERCENTILES.items():
            value, title = own["typical"][key], f"{runner}, p{share:g}"
            rows.append(at_most(title, value, BARS[key], "us") if runner in OURS else shown(title, value, "us"))
        if runner in OURS:
            rows += [
                shown(f"{runner}, p{share:g} over all turns", own[key], "us") for key, share in PERCENTILES.items()
            ]
    rows.append(shown("the paper's step", PAPER_US, "us"))
    loop = result["loop"]
    title = f"{loop['rate_hz']:g} Hz for {loop['duration_s']:g} s"
    rows += [
        at_most(f"{title}: deadlines missed by the step", loop["overran_by_step"], 0, ""),
        shown(f"{title}: missed because it was interrupted", loop["overran_by_waiting"], ""),
        shown(f"{title}: missed because it was woken late", loop["overran_by_wakeup"], ""),
        shown(f"{title}: cycles left out", loop["skipped"], ""),
        shown(f"{title}: step, p99.9", loop["step"]["p999_us"], "us"),
        shown(f"{title}: step, longest", loop["step"]["max_us"], "us"),
        shown(f"{title}: wake-up too late by, p99.9", loop["wakeup"]["p999_us"], "us"),
    ]
    return rows


def _typical_us(turns: Sequence[Latency], share: float) -> float:
    return float(np.median([turn.percentile_us(share) for turn in turns]))


def _pooled(turns: Sequence[Latency]) -> Latency:
    pooled = Latency()
    for turn in turns:
        pooled.add(turn)
    return pooled


def _measured(made: Made) -> dict[str, list[Latency]]:
    """Latency of each alternative in each of its turns; those that are networks must agree on the outputs first."""
    x = motion(made.card, _SAMPLES)
    vectors = x[:, 0].copy()
    samples = [by_signal(made.card, row) for row in vectors]
    network = Network.load(made.folder)
    runners: dict[str, Runner] = {
        "two matrix-vector products": _products(made),
        "torch eager": _torch(made),
        "onnxruntime run": _plain(network),
        "onnxruntime io-binding": _bound(network),
        "Stream.step_vector": _stream(network, by_vector=True),
        "Stream.step": _stream(network, by_vector=False),
    }
    expected = Predictor(network).run(x[:_CHECKED])[:, 0]
    for name, runner in runners.items():
        outputs = np.array([runner(t, samples[t], vectors[t]).copy() for t in range(_CHECKED)])
        if name != "two matrix-vector products":
            np.testing.assert_allclose(outputs[made.card.warmup_steps :], expected[made.card.warmup_steps :], atol=1e-3)
    found: dict[str, list[Latency]] = {name: [] for name in runners}
    clock = time.perf_counter_ns
    at = _CHECKED
    for _ in range(_ROUNDS):
        for name, runner in runners.items():
            turn = Latency()
            record = turn.record
            for k in range(at, at + _STEPS):
                sample, vector = samples[k % _SAMPLES], vectors[k % _SAMPLES]
                began = clock()
                runner(k, sample, vector)
                record(clock() - began)
            found[name].append(turn)
        at += _STEPS
    return found


def _stream(network: Network, *, by_vector: bool) -> Runner:
    stream = Stream(network, rate_hz=RATE_HZ, joints=JOINTS)
    if by_vector:
        return lambda k, _, vector: stream.step_vector(vector, time_s=k / RATE_HZ).values
    return lambda k, sample, _: stream.step(sample, time_s=k / RATE_HZ).values


def _bound(network: Network) -> Runner:
    """Onnxruntime with everything bound beforehand: what `Stream` adds its rules to."""
    session, card = network.session, network.card
    x, y = (np.zeros((1, 1, len(channels)), np.float32) for channels in (card.inputs, card.outputs))
    before, after = ({state.name: np.zeros(state.shape, np.float32) for state in card.states} for _ in range(2))

    def binding(source: Sample, target: Sample) -> Any:
        made = session.io_binding()
        made.bind_input("x", "cpu", 0, np.float32, x.shape, x.ctypes.data)
        made.bind_output("y", "cpu", 0, np.float32, y.shape, y.ctypes.data)
        for name, tensor in source.items():
            made.bind_input(name, "cpu", 0, np.float32, tensor.shape, tensor.ctypes.data)
            made.bind_output(f"{name}_out", "cpu", 0, np.float32, tensor.shape, target[name].ctypes.data)
        return made

    # A binding does not keep the memory that it was given: it is kept here.
    bindings = [(binding(before, after), before), (binding(after, before), after)]
    turn = 0

    def runner(_: int, __: Sample, vector: np.ndarray) -> np.ndarray:
        nonlocal turn
        x[0, 0] = vector
        session.run_with_iobinding(bindings[turn][0])
        turn = 1 - turn
        return y[0, 0]

    return runner


def _plain(network: Network) -> Runner:
    """Onnxruntime as its first page shows it."""
    session, card = network.session, network.card
    names = ["y", *(f"{state.name}_out" for state in card.states)]
    states = {state.name: np.zeros(state.shape, np.float32) for state in card.states}

    def runner(_: int, __: Sample, vector: np.ndarray) -> np.ndarray:
        y, *after = session.run(names, {"x": vector[None, None], **states})
        states.update(zip(states, after, strict=True))
        return y[0, 0]

    return runner


def _torch(made: Made) -> Runner:
    """The same network in torch, sample by sample."""
    corrector = made.corrector
    network, states = corrector.network, corrector.network.initial(torch.zeros(1, len(made.card.inputs)))
    gate = corrector.gate * corrector.out_scale

    @torch.inference_mode()
    def runner(_: int, __: Sample, vector: np.ndarray) -> np.ndarray:
        nonlocal states
        x = torch.from_numpy(vector)[None, None]
        out, states = network.run(corrector.read(x), states, None)
        y: np.ndarray = (x[..., corrector.base] + gate * out)[0, 0].numpy()
        return y

    return runner


def _products(made: Made) -> Runner:
    """What no implementation can do without: one product per recurrent layer with all of its weights."""
    weights = made.corrector.state_dict()
    layers = [f"network.forwards.{layer}.weight" for layer in range(len(HIDDEN))]
    matrices = [np.hstack([weights[f"{layer}_{part}_l0"].numpy() for part in ("ih", "hh")]) for layer in layers]
    operands = [np.ones(matrix.shape[1], np.float32) for matrix in matrices]
    results = [np.zeros(len(matrix), np.float32) for matrix in matrices]

    def runner(_: int, __: Sample, vector: np.ndarray) -> np.ndarray:
        operands[0][: vector.size] = vector
        for matrix, operand, result in zip(matrices, operands, results, strict=True):
            np.dot(matrix, operand, out=result)
        return results[-1]

    return runner


def _result(found: dict[str, list[Latency]], times: StepTimes, loop: LoopReport) -> dict[str, Any]:
    packages = {name: metadata.version(name) for name in ("onnxruntime", "torch")}
    machine = {"name": times.machine, "load": list(os.getloadavg())}
    return {
        "schema": "trueup.streaming/1",
        "step": {
            name: {
                "typical": {key: _typical_us(turns, share) for key, share in PERCENTILES.items()},
                **_pooled(turns).to_json(),
            }
            for name, turns in found.items()
        },
        "paper_us": PAPER_US,
        "loop": {"duration_s": _LOOP_S, **loop.to_json()},
        "provenance": provenance(config={"packages": packages, "machine": machine}, seed=0),
    }
