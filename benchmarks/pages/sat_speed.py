"""The section "Step and training times" of docs/building-blocks.md, from what `python -m benchmarks sat_speed` says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.augment_cells import span
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

TEXT = """## Step and training times

Median time of a SAT step of `Stream` [us] ([machine code](runtime.md#machine-code); history of 128, 64 units, 4 heads)
on one core of {machine} (`python -m benchmarks sat_speed`). With `compiled=False` it takes {slower} times as long.

{steps}

Targets: {one:.0f} and {twelve:.0f} us. {verdict}

Training takes {ratio:.2f} times as long as a bare torch loop (target: {bar:.1f}).{trained} On a GPU, use
`precision: mixed`; its speed was not measured.
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    machine, training = result["provenance"]["config"]["machine"], result["training"]
    return TEXT.format(
        machine=machine["name"],
        slower=span((_p50(own, "Stream, onnxruntime") / _p50(own, "Stream") for own in _each(result["steps"])), 1),
        steps=_steps(result["steps"]),
        one=BARS[1],
        twelve=BARS[12],
        verdict=_verdict(result["steps"]),
        ratio=training["ratio"],
        bar=BARS["training"],
        trained="" if training["ratio"] <= BARS["training"] else " Missed.",
    )


def _each(steps: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [by_copies[str(copies)] for by_copies in steps.values() for copies in COPIES]


def _p50(own: Mapping[str, Any], runner: str) -> float:
    return float(own[runner]["p50_us"])


def _steps(steps: Mapping[str, Any]) -> str:
    rows = [
        (_ABOUT[name], *(f"{_p50(by_copies[str(copies)], 'Stream'):.3g}" for copies in COPIES))
        for name, by_copies in steps.items()
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
