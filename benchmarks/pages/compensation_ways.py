"""The section "Three ways to train" of docs/what-compensation-brings.md, from `benchmarks compensation_ways`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.pages.compensation import cell
from benchmarks.pages.markdown import table

WAYS = {
    "direct": "directly, through rollouts and slopes",
    "delta": "delta action by delta action",
    "ppo": "by reinforcement (PPO)",
}
TEXT = """## Three ways to train

One operator for the stock simulator, trained on the same data in [three ways](compensation.md#how-it-learns); mean
error [mrad] on the unseen motions of an unseen individual, with its 95 % interval over motions. One seed. Energy is
processor time at a stated 8 W a core, nothing measured it; what all three share, the linear models of the train
motions, is left out. `val` are other motions of the individuals that were trained on, all payloads together.

```sh
python -m benchmarks compensation_ways
```

{table}

{verdict}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    payloads = sorted(result["none"]["test"], key=float)
    rows = [["not at all", *_cells(result["none"], payloads), "", "", ""]]
    for way, title in WAYS.items():
        own = result["ways"][way]
        rows.append(
            [
                title,
                *_cells(own["tables"], payloads),
                f"{1e3 * own['val']:.1f}",
                f"{own['cpu_seconds']:.0f}",
                f"{own['joules'] / 1e3:.1f}",
            ]
        )
    heads = ["trained", *(f"{kg} kg" for kg in payloads), "val", "processor time [s]", "energy [kJ]"]
    return TEXT.format(table=table(heads, rows), verdict=_verdict(result, payloads))


def _cells(tables: Mapping[str, Any], payloads: list[str]) -> list[str]:
    return [cell(1e3 * np.array(tables["test"][kg]["mae"]), 1) for kg in payloads]


def _verdict(result: Mapping[str, Any], payloads: list[str]) -> str:
    """What the figures say of the default."""
    means = {
        way: float(np.mean([np.mean(own["tables"]["test"][kg]["mae"]) for kg in payloads]))
        for way, own in result["ways"].items()
    }
    vals = {way: 1e3 * own["val"] for way, own in result["ways"].items()}
    best, chosen = min(means, key=means.__getitem__), min(vals, key=vals.__getitem__)
    times = result["ways"]["ppo"]["cpu_seconds"] / result["ways"]["direct"]["cpu_seconds"]
    said = (
        f"Over all payloads, {means['direct'] * 1e3:.1f} mrad directly, {means['delta'] * 1e3:.1f} delta action by "
        f"delta action, {means['ppo'] * 1e3:.1f} by reinforcement, which takes {times:.1f} times the processor time of "
        "the first. "
    )
    if best == chosen:
        return f"{said}The least error is that of `{best}`, on val too."
    return (
        f"{said}The least error on this individual is that of `{best}`; on val, which chooses, `{chosen}` is ahead "
        f"({vals[chosen]:.1f} to {vals[best]:.1f} mrad), and is the default."
    )
