"""The section "What it adds" of docs/ros2.md, from what `python -m benchmarks ros2_bridge` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table

TEXT = """## What it adds

Measured with a publisher at {rate_hz:g} Hz, a bridge and a listener in a process each, for {seconds:g} s on {machine}
(`python -m benchmarks ros2_bridge`). The added time, between DDS's stamps of message and answer, should stay below
1 ms at 99 %.

{ways}

The last two rows include the listener's own waiting.
"""
_WAYS = {
    "states": "Joint states, with a network of Realeasy's size (100, 21 units)",
    "commands": "Targets, with the default operator",
}
_QUANTILES = {"p50": "50 %", "p99": "99 %", "p999": "99.9 %", "max": "all"}


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
    return f"{own['published']} messages published, {own['delivered']} delivered; {lost}."


def _times(own: Mapping[str, Any]) -> str:
    bridge = own["bridge"]
    of_bridge = {key: {name: bridge[key][f"{name}_us"] / 1e3 for name in _QUANTILES} for key in ("added", "way")}
    times = {
        "added": own["added_ms"],
        "of this, publisher to bridge": of_bridge["way"],
        "of this, bridge": of_bridge["added"],
        "publisher to listener": own["direct_ms"],
        "publisher to bridge to listener": own["whole_ms"],
    }
    rows = [[title, *(f"{time_ms[name]:.2f}" for name in _QUANTILES)] for title, time_ms in times.items()]
    return table(["within [ms]", *_QUANTILES.values()], rows)
