"""The section "For an hour" of docs/ros2.md, from what `python -m benchmarks ros2_hour` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table

TEXT = """## For an hour

The same publisher and bridge for {minutes:g} minutes at {rate_hz:g} Hz on {machine}: does it lose anything, and does
its memory grow?

{table}

The memory that waiting messages take is kept for the next ones: after the bridge could not run for a moment, because
others had the processor, it stays larger by that much. They are taken a few at a time, so that what waits is small.

```sh
python -m benchmarks ros2_hour
```
"""


def part(result: Mapping[str, Any]) -> str:
    """The part of the page that belongs to a result."""
    bridge, memory_mb = result["bridge"], result["memory_mb"]
    rows = [
        ["messages published", str(result["published"])],
        ["of these delivered to the bridge", str(bridge["received"])],
        ["of these answered", str(bridge["sent"])],
        ["at most waiting at a time", str(bridge["most_waiting"])],
        ["99 % from taken to sent within", f"{bridge['added']['p99_us'] / 1e3:.2f} ms"],
        ["longest", f"{bridge['added']['max_us'] / 1e3:.2f} ms"],
        ["memory of the bridge after a minute", f"{memory_mb[0]:.1f} MB"],
        ["memory at the end", f"{memory_mb[-1]:.1f} MB"],
    ]
    return TEXT.format(
        minutes=result["seconds"] / 60.0,
        rate_hz=result["rate_hz"],
        machine=result["provenance"]["config"]["machine"]["name"],
        table=table(["", ""], rows),
    )
