"""The section "For an hour" of docs/ros2.md, from what `python -m benchmarks ros2_hour` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table
from benchmarks.ros2_hour import BAR_MB

TEXT = """## For an hour

The same publisher and bridge for {minutes:g} minutes at {rate_hz:g} Hz on {machine} (`python -m benchmarks ros2_hour`):

{table}

{answer}
Memory rises and falls with Cyclone's receive buffer (256 kB), and keeps what waiting messages once took.
"""


def part(result: Mapping[str, Any]) -> str:
    """The part of the page that belongs to a result."""
    bridge, memory_mb = result["bridge"], result["memory_mb"]
    rows = [
        ["messages published", str(result["published"])],
        ["of these delivered to the bridge", str(bridge["received"])],
        ["of these answered", str(bridge["sent"])],
        ["of these corrected", str(bridge["counts"].get("ok", 0))],
        ["most waiting at a time", str(bridge["most_waiting"])],
        ["time in the bridge, 99 %", f"{bridge['added']['p99_us'] / 1e3:.2f} ms"],
        ["longest", f"{bridge['added']['max_us'] / 1e3:.2f} ms"],
        ["memory of the bridge after a minute", f"{memory_mb[0]:.1f} MB"],
        ["memory at the end", f"{memory_mb[-1]:.1f} MB"],
    ]
    return TEXT.format(
        answer=_answer(result),
        minutes=result["seconds"] / 60.0,
        rate_hz=result["rate_hz"],
        machine=result["provenance"]["config"]["machine"]["name"],
        table=table(["", ""], rows),
    )


def _answer(result: Mapping[str, Any]) -> str:
    memory_mb = result["memory_mb"]
    lost = result["published"] - result["bridge"]["sent"]
    grown, left = (end - memory_mb[0] for end in (max(memory_mb), memory_mb[-1]))
    verdict = "met" if grown <= BAR_MB else "missed"
    said = _uncorrected(result["bridge"]["counts"])
    return (
        f"It lost {lost or 'nothing'}.{said} "
        f"Its memory grew by {grown:.2f} MB at most, and by {left:.2f} MB at the end; "
        f"the limit of {BAR_MB:g} MB is {verdict}."
    )


def _uncorrected(counts: Mapping[str, int]) -> str:
    """What the answers say that the network has not corrected; nothing if there are none."""
    warming, fallback, held = (counts.get(name, 0) for name in ("warming", "fallback", "held"))
    said = ""
    if own := warming + fallback:
        mostly = ", mostly while the network warmed up again" if warming > fallback else ""
        said += f" {own} answers carried the simulator's own values{mostly}."
    return said + (f" {held} repeated the values before." if held else "")
