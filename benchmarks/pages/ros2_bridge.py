"""The section "What it adds" of docs/ros2.md, from what `python -m benchmarks ros2_bridge` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table

TEXT = """## What it adds

A publisher at {rate_hz:g} Hz, a bridge with a network of Realeasy's size (100, 21 units) that sees every message, and
a listener on both topics, each a process, for {seconds:g} s on {machine}. Of {published} messages DDS
delivered {delivered}; {lost}.

{table}

*Added* is how much later the listener has the answer than the message itself; asked was 1 ms for 99 % of them.

```sh
python -m benchmarks ros2_bridge
```
"""
_QUANTILES = {"p50": "50 % within", "p99": "99 %", "p999": "99.9 %", "max": "all"}


def part(result: Mapping[str, Any]) -> str:
    """The part of the page that belongs to a result."""
    bridge = result["bridge"]
    heads = ["[ms]", *_QUANTILES.values()]
    rows = [["added, as the listener sees it", *(f"{result['added_ms'][name]:.2f}" for name in _QUANTILES)]]
    for name, title in (("added", "of this, from taken to sent"), ("way", "from the publisher to the bridge")):
        rows.append([title, *(f"{bridge[name][f'{quantile}_us'] / 1e3:.2f}" for quantile in _QUANTILES)])
    return TEXT.format(
        rate_hz=result["rate_hz"],
        seconds=result["seconds"],
        machine=result["provenance"]["config"]["machine"]["name"],
        published=result["published"],
        delivered=result["delivered"],
        lost="all of these were answered" if not result["lost"] else f"{result['lost']} of these were not answered",
        table=table(heads, rows),
    )
