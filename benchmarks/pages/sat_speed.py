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
_ABOUT = {"4 -> 3": "default", "8 -> 2": "the paper's servo"}
_NAMES = {"Stream": "`Stream`", "Stream, onnxruntime": "`compiled=False`"}

TEXT = """## Step and training times

Median time of a SAT step [us] (history of 128, 64 units, 4 heads) on one core of {machine} (`python -m benchmarks
sat_speed`). `Stream` uses [machine code](runtime.md#machine-code), `compiled=False` onnxruntime.

{steps}

Targets for `Stream`: {one:.0f} and {twelve:.0f} us. {verdict}

A training batch of {samples} samples of {batch} servos takes {low:.2g} to {high:.2g} s on one core, {ratio:.2f} times
as long as a bare torch loop (target: {bar:.1f}).{trained} On a GPU, use `precision: mixed`; its speed was not
measured:

```sh
trueup augment train data/kickbot --config mixed.yaml --device cuda --out models/mixed
```
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    machine, training = result["provenance"]["config"]["machine"], result["training"]
    batch = training["batch"]
    return TEXT.format(
        machine=machine["name"],
        steps=_steps(result["steps"]),
        one=BARS[1],
        twelve=BARS[12],
        verdict=_verdict(result["steps"]),
        samples=training["samples"],
        batch=training["batch_size"],
        low=batch["true errors"]["median_s"],
        high=batch["all predicted"]["median_s"],
        ratio=training["ratio"],
        bar=BARS["training"],
        trained="" if training["ratio"] <= BARS["training"] else " Missed.",
    )


def _steps(steps: Mapping[str, Any]) -> str:
    rows = [
        (f"{_ABOUT[name]}, {label}", *(f"{by_copies[str(copies)][runner]['p50_us']:.3g}" for copies in COPIES))
        for name, by_copies in steps.items()
        for runner, label in _NAMES.items()
    ]
    return table(("", "1 servo", "12 servos"), rows)


def _verdict(steps: Mapping[str, Any]) -> str:
    missed = [
        f"{name} with {copies} ({by_copies[str(copies)]['Stream']['p50_us']:.0f} us"
        f", {by_copies[str(copies)]['Stream']['least_us']:.0f} in the quietest block)"
        for name, by_copies in steps.items()
        for copies in COPIES
        if by_copies[str(copies)]["Stream"]["p50_us"] > BARS[copies]
    ]
    return f"Missed: {', '.join(missed)}." if missed else "Both are kept, by both networks."
