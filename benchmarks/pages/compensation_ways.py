"""The section "Three ways to train" of docs/what-compensation-brings.md, from `benchmarks compensation_ways`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.pages.compensation import cell
from benchmarks.pages.markdown import table

WAYS = ("direct", "delta", "ppo")
# Payloads of the table [kg].
SHOWN = ("3",)
TEXT = """## Three ways to train

One operator for the stock simulator, trained in each of the [three ways](compensation.md#how-it-learns) on the same
data, one seed. Mean error [mrad] on the held-out individual with its 95 % interval over motions; `val` are other
motions of the trained individuals.

```sh
python -m benchmarks compensation_ways
```

{table}

{verdict}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    payloads = sorted(result["none"]["test"], key=float)
    rows = [["untrained", *_cells(result["none"], SHOWN), "", ""]]
    for way in WAYS:
        own = result["ways"][way]
        rows.append(
            [
                f"`{way}`",
                *_cells(own["tables"], SHOWN),
                f"{1e3 * own['val']:.1f}",
                f"{own['cpu_seconds']:.0f}",
            ]
        )
    heads = ["way", *(f"{kg} kg" for kg in SHOWN), "val", "processor time [s]"]
    return TEXT.format(table=table(heads, rows), verdict=_verdict(result, payloads))


def _cells(tables: Mapping[str, Any], payloads: Sequence[str]) -> list[str]:
    return [cell(1e3 * np.array(tables["test"][kg]["mae"]), 1) for kg in payloads]


def _verdict(result: Mapping[str, Any], payloads: list[str]) -> str:
    """What the figures say of the default."""
    means = {
        way: float(np.mean([np.mean(own["tables"]["test"][kg]["mae"]) for kg in payloads]))
        for way, own in result["ways"].items()
    }
    vals = {way: 1e3 * own["val"] for way, own in result["ways"].items()}
    best, chosen = min(means, key=means.__getitem__), min(vals, key=vals.__getitem__)
    said = f"Over all payloads: {', '.join(f'`{way}` {1e3 * mean:.1f} mrad' for way, mean in means.items())}. "
    if best == chosen:
        return f"{said}`{best}` has the smallest error, on val too."
    return f"{said}`{best}` is best on this individual; `{chosen}`, best on val, is the default."
