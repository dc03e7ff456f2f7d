"""docs/benchmarks.md: every figure that is held against a limit, from what is kept of all benchmarks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.__main__ import LONG, NAMES
from benchmarks.figures import cells, known
from benchmarks.pages.markdown import table

TEXT = """# Benchmarks

```sh
python -m benchmarks
```

measures everything that takes minutes, and prints one table of all figures: what was measured, its limit, or the peer
that it is held against, the ratio, the date and the commit. What takes hours ({long}) stands in it as it was kept;
`--anew` measures that again, too, `python -m benchmarks NAME` one alone, and `--table` nothing. `make bench` installs
the peers first. Timings are compared within one run, for machines differ; what was promised is a ratio wherever there
is somebody to stand beside.

Here are the figures that have a limit: {kept} are kept, {missed} missed. Figures without one are in the table of the
command.
{absent}
{tables}
"""


def pages() -> dict[str, str]:
    """The page, from all that is kept."""
    found = {name: entry for name in NAMES if (entry := known(name)) is not None}
    lines = {name: [line for line in cells(name, entry) if line[3]] for name, entry in found.items()}
    words = [line[6] for own in lines.values() for line in own]
    absent = [name for name in NAMES if name not in found]
    return {
        "benchmarks.md": TEXT.format(
            long=", ".join(f"`{name}`" for name in LONG),
            kept=words.count("ok"),
            missed=words.count("MISSED"),
            absent=f"\nNot measured yet: {', '.join(f'`{name}`' for name in absent)}.\n" if absent else "",
            tables="\n\n".join(_section(name, found[name], own) for name, own in lines.items() if own),
        )
    }


def _section(name: str, entry: Mapping[str, Any], lines: list[tuple[str, ...]]) -> str:
    heads = ["what", "figure", "limit", "ratio", "unit", ""]
    rows = [[*line[1:6], _word(line[6])] for line in lines]
    when = f"{entry['created'][:10]}, {entry['git']}"
    return f"## {name}\n\nMeasured on {when}.\n\n{table(heads, rows)}"


def _word(verdict: str) -> str:
    return "kept" if verdict == "ok" else "**missed**"
