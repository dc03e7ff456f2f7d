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

One step of Realeasy's real-time network (21-100-21 units, seven joints, three signals) through
[`Stream`](runtime.md), with its state and all checks, compared with other ways to compute it. One core of {machine};
onnxruntime {ort}, torch {torch}; {count} steps each, in turns.

```sh
python -m benchmarks streaming
```

Microseconds. *All* is the percentile over all steps; the others are the median over turns, which leaves out the tenths
of a second in which a shared machine slows down.

{steps}

*Two products* is numpy's product of weights and inputs of both recurrent layers. *io-binding* is
onnxruntime with preallocated tensors; `Stream` adds copies, checks of range, time, stalls and outputs, and a histogram.
The paper's step takes {paper:.0f} us (Realeasy, V).

Bars for `Stream`: half of the steps within {p50:.0f} us, 99 % within {p99:.0f}, 99.9 % within {p999:.0f}. {verdict}

In a loop at {rate:.0f} Hz for {seconds:.0f} s on an otherwise idle machine, {by_step} deadlines were missed because of
the step, {by_waiting} because it was interrupted, and {by_wakeup} because the loop woke up late; {skipped} cycles were
skipped. A step took {loop_p50:.0f} us (median), {loop_p999:.0f} (99.9 %), at most {loop_max:.0f}: longer than in a row,
since caches are cold and the CPU slows down in each sleep.
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
    return f"Missed: {', '.join(missed)}." if missed else "All are kept in a typical turn."
