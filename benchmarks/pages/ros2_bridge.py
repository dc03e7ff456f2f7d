"""The section "What it adds" of docs/ros2.md, from what `python -m benchmarks ros2_bridge` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table

TEXT = """## What it adds

A publisher at {rate_hz:g} Hz, a bridge, and a listener to what is asked and what is answered, each a process, for
{seconds:g} s on {machine}.

{ways}

*Added* is the time between DDS's stamps of message and answer. The requirement was 1 ms at 99 %. The last two rows also
contain this listener's own waiting.

```sh
python -m benchmarks ros2_bridge
```
"""
_WAYS = {
    "states": "Joint states, corrected by a network of Realeasy's size (100, 21 units) that sees every message",
    "commands": "Targets, corrected by the default operator, by joint states that come as often",
}
_QUANTILES = {"p50": "50 % within", "p99": "99 %", "p999": "99.9 %", "max": "all"}


def part(result: Mapping[str, Any]) -> str:
    """The part of the page that belongs to a result."""
    ways = result["ways"]
    first = next(iter(ways.values()))
    return TEXT.format(
        rate_hz=first["rate_hz"],
        seconds=first["seconds"],
        machine=result["provenance"]["config"]["machine"]["name"],
        ways="\n\n".join(f"{_WAYS[way]}: {_counts(own)}\n\n{_times(own)}" for way, own in ways.items()),
    )


def _counts(own: Mapping[str, Any]) -> str:
    lost = "all of these were answered" if not own["lost"] else f"{own['lost']} of these were not answered"
    return f"of {own['published']} messages DDS delivered {own['delivered']}; {lost}."


def _times(own: Mapping[str, Any]) -> str:
    bridge = own["bridge"]
    of_bridge = {key: {name: bridge[key][f"{name}_us"] / 1e3 for name in _QUANTILES} for key in ("added", "way")}
    times = {
        "added, from the message to its answer": own["added_ms"],
        "of this, from the publisher to the bridge": of_bridge["way"],
        "of this, from taken to sent": of_bridge["added"],
        "from the publisher to the listener": own["direct_ms"],
        "from the publisher through the bridge to the listener": own["whole_ms"],
    }
    rows = [[title, *(f"{time_ms[name]:.2f}" for name in _QUANTILES)] for title, time_ms in times.items()]
    return table(["[ms]", *_QUANTILES.values()], rows)
