"""The section "Step and training times" of docs/building-blocks.md, from what `python -m benchmarks sat_speed` says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table

# What is asked: p50 of a step for so many actuators [us]; training over a bare loop; memory of four times the samples.
BARS: dict[int | str, float] = {1: 60.0, 12: 200.0, "training": 1.5, "memory": 4.4}
COPIES = (1, 12)
# What is read of the simulator and of the command, and what is corrected.
NETWORKS: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]] = {
    "4 -> 3": (("position", "velocity", "torque"), ("position",), ("position", "velocity", "torque")),
    "8 -> 2": (
        ("position", "velocity", "current", "voltage", "load"),
        ("position", "velocity", "torque"),
        ("position", "velocity"),
    ),
}
_ABOUT = {"4 -> 3": "the default of `--method sat`", "8 -> 2": "the servo of the paper, all of its states"}
_NAMES = {
    "Stream": "`Stream`",
    "machine code alone": "machine code alone",
    "Stream, onnxruntime": "`Stream`, `compiled=False`",
    "onnxruntime io-binding alone": "onnxruntime alone, io-binding",
    "recompute": "recompute, torch",
    "two products": "two products",
}

TEXT = """## Step and training times

A step of a SAT with a history of 128 samples, 64 units and 4 heads, in microseconds: half of the steps are
done within the first number, which is the median over {blocks} blocks of 200 steps that take turns on one core; in the
quietest block, within the second. The machine is shared ({machine}; load {load:.1f} on its cores while this was
measured) and at times half as fast as at others, so the third compares block by block with two matrix products.

{steps}

*Recompute* sees the present sample and the 128 before it anew at every step. *Two products*: the states and inputs of
both LSTM layers times their weights alone, by numpy, a quarter of all weights. Asked of `Stream`: {one:.0f} us for one
actuator, {twelve:.0f} us for twelve in one call. {verdict}

`Stream` takes the steps of a SAT as [machine code](runtime.md#machine-code). Its time goes into reading the weights
once (one actuator: 0.9 to 1.2 MB, more than the second-level cache holds) and into multiplying by them (twelve); that
of onnxruntime, into a hundred nodes and into copies of keys and values.

Training, {samples} samples of {batch} actuators in a batch, one thread, processor time of a batch beside that of a bare
torch loop of the same layers, in turn:

{training}

The errors that the encoder is told are true in the first epoch, then predicted more and more often: a pass more, and
another one when all of them are. Over the whole schedule a batch takes {ratio:.2f} times as long as in the bare loop;
asked were {bar:.1f}.{trained}

A step of training on windows of two actuators takes, beyond what the process had before:

{memory}

Attention looks at 64 samples and their history at a time, and beyond 1024 samples what lies between the layers is
computed again for the gradients instead of kept; gradients are the same to rounding.

All of this was measured on one core of a CPU. The paper's set, 600 motions of 30 s at 250 Hz with 12 actuators each, is
54 million samples, an epoch of {hours:.0f} hours on that core; it is one for a GPU:

```sh
trueup augment train data/kickbot --config mixed.yaml --device cuda --out models/mixed
```

with `method: sat` and `precision: mixed` in `mixed.yaml`. No GPU was at hand: its times and memory were
not measured, nor was mixed precision tried on one.
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    machine, training = result["provenance"]["config"]["machine"], result["training"]
    batch = training["batch"]
    seconds = 0.5 * batch["half of them predicted"]["median_s"] + 0.5 * batch["all predicted"]["median_s"]
    return TEXT.format(
        blocks=40,
        machine=machine["name"],
        load=machine["load_after"][0],
        steps=_steps(result["steps"]),
        one=BARS[1],
        twelve=BARS[12],
        verdict=_verdict(result["steps"]),
        samples=training["samples"],
        batch=training["batch_size"],
        training=_training(training),
        ratio=training["ratio"],
        bar=BARS["training"],
        trained="" if training["ratio"] <= BARS["training"] else " Missed.",
        memory=_memory(result["memory"]),
        hours=600 * 7500 * 12 / (training["samples"] * training["batch_size"]) * seconds / 3600,
    )


def _steps(steps: Mapping[str, Any]) -> str:
    heads = ("", "1: p50", "quietest", "x products", "12: p50", "quietest", "x products")
    rows: list[tuple[str, ...]] = []
    for name, by_copies in steps.items():
        rows.append((f"**{name}**, {_ABOUT[name]}", *[""] * 6))
        for runner, label in _NAMES.items():
            items = [by_copies[str(copies)][runner] for copies in COPIES]
            cells = [(f"{i['p50_us']:.3g}", f"{i['least_us']:.3g}", f"{i['over_products']:.3g}") for i in items]
            rows.append((label, *cells[0], *cells[1]))
    return table(heads, rows)


def _verdict(steps: Mapping[str, Any]) -> str:
    missed = [
        f"{name} with {copies} ({by_copies[str(copies)]['Stream']['p50_us']:.0f} us"
        f", {by_copies[str(copies)]['Stream']['least_us']:.0f} in the quietest block)"
        for name, by_copies in steps.items()
        for copies in COPIES
        if by_copies[str(copies)]["Stream"]["p50_us"] > BARS[copies]
    ]
    return f"Missed: {', '.join(missed)}." if missed else "Both are kept, by both networks."


def _training(training: Mapping[str, Any]) -> str:
    rows = [
        (name, f"{own['median_s']:.3g}", f"{own['least_s']:.3g}", f"{training['ratios'][name]:.2f}")
        for name, own in training["batch"].items()
    ]
    return table(("the encoder is told", "median [s]", "least [s]", "x bare loop"), rows)


def _memory(memory: Mapping[str, Mapping[str, float]]) -> str:
    names = {"pieces": "as it is", "at once": "all at once, all kept"}
    rows = [(samples, names[how], f"{value:.0f}") for how, own in memory.items() for samples, value in own.items()]
    return table(("samples", "", "memory [MB]"), rows, left=2)
