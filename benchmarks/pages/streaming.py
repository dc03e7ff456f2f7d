"""docs/step-times.md, from what `python -m benchmarks streaming` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table
from trueup.deploy.latency import PERCENTILES

# The bars of a step of ours [us].
BARS = {"p50_us": 20.0, "p99_us": 40.0, "p999_us": 100.0}
OURS = ("Stream.step", "Stream.step_vector")

TEXT = """# What a step takes

One step of Realeasy's real-time network (21 -> 100 -> 21 units, seven joints, three signals) by
[`Stream`](runtime.md), with its state and all its checks, beside what it could run on instead. On one core of
{machine}; onnxruntime {ort}, torch {torch}; {count} steps of each, the alternatives taking turns. This page is made
from what `python -m benchmarks streaming` measures (`make pages` writes it).

Microseconds; first the median over the turns of each percentile, then the percentile over all steps. A shared machine
slows down now and then for some tenths of a second, which the second shows and the first does not.

{steps}

*Two products*: the products of weights and inputs of both recurrent layers alone, by numpy. *io-binding*: onnxruntime
with all tensors bound beforehand; what `Stream` adds to it is the copying of the sample, checks of range, time and
stalls, and of what comes out, and the histogram. The paper's step takes {paper:.0f} us (Realeasy, V).

Asked of `Stream`: half of the steps within {p50:.0f} us, 99 % within {p99:.0f}, 99.9 % within {p999:.0f}. {verdict}

In a loop at {rate:.0f} Hz for {seconds:.0f} s, with nothing else on the machine: {by_step} deadlines missed by the
step, {by_waiting} because the step was interrupted, {by_wakeup} because the loop was woken late, {skipped} cycles left
out. A step took {loop_p50:.0f} us in the median, 99.9 % took less than {loop_p999:.0f}, the longest {loop_max:.0f}:
longer than in a row, since caches are cold and the CPU has slowed down after each sleep.
"""

NAMES = {
    "two matrix-vector products": "two products",
    "torch eager": "torch, eager",
    "onnxruntime run": "onnxruntime, `run`",
    "onnxruntime io-binding": "onnxruntime, io-binding",
    "Stream.step_vector": "`Stream.step_vector`",
    "Stream.step": "`Stream.step`",
}


def page(result: Mapping[str, Any]) -> str:
    """The page as Markdown."""
    config, loop = result["provenance"]["config"], result["loop"]
    rows = [
        (NAMES[name], *(f"{item['typical'][key]:.3g}" for key in BARS), *(f"{item[key]:.3g}" for key in BARS))
        for name, item in result["step"].items()
    ]
    return TEXT.format(
        machine=config["machine"]["name"],
        ort=config["packages"]["onnxruntime"],
        torch=config["packages"]["torch"],
        count=result["step"]["Stream.step"]["count"],
        steps=table(("", "50 %", "99 %", "99.9 %", "50 %, all", "99 %, all", "99.9 %, all"), rows),
        paper=result["paper_us"],
        p50=BARS["p50_us"],
        p99=BARS["p99_us"],
        p999=BARS["p999_us"],
        verdict=verdict(result),
        rate=loop["rate_hz"],
        seconds=loop["duration_s"],
        by_step=loop["overran_by_step"],
        by_waiting=loop["overran_by_waiting"],
        by_wakeup=loop["overran_by_wakeup"],
        skipped=loop["skipped"],
        loop_p50=loop["step"]["p50_us"],
        loop_p999=loop["step"]["p999_us"],
        loop_max=loop["step"]["max_us"],
    )


def verdict(result: Mapping[str, Any]) -> str:
    """Which of the bars are missed, by typical turns and over all steps."""
    missed = [
        f"{NAMES[name]} {PERCENTILES[key]:g} %"
        for name in OURS
        for key, bar in BARS.items()
        if result["step"][name]["typical"][key] > bar
    ]
    return f"Missed: {', '.join(missed)}." if missed else "In a typical turn all are kept."
