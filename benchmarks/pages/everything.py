"""docs/benchmarks.md: every figure that is held against a limit, from what is kept of all benchmarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from benchmarks.__main__ import LONG, NAMES
from benchmarks.figures import known, rows_of
from benchmarks.pages.grouped import missed, shown
from benchmarks.pages.markdown import table
from benchmarks.table import bound

TEXT = """# All benchmarks

```sh
make bench                      # install the programs to compare with, then measure everything that takes minutes
python -m benchmarks            # the same without installing
python -m benchmarks friction   # one benchmark
python -m benchmarks --anew     # everything: a day
python -m benchmarks --table    # print all stored figures, measure nothing
```

Each run prints figures beside their limits and exits with 1 if one misses its limit. Of the stored figures that have a
limit, {kept} keep it and {missed} miss it. `--table` shows all of them, and those without a limit; they are stored in
`benchmarks/results`. Since machines differ, a limit on speed is a ratio to another program in the same run wherever
there is one to compare with.
{absent}
## Missed limits

{missed_table}

## When they were measured

Benchmarks with a \\* take hours. They are measured only by name or with `--anew`.

{when}
"""
LONG_MARK = "\\*"


def pages() -> dict[str, str]:
    """The page, from all that is kept."""
    found = {name: entry for name in NAMES if (entry := known(name)) is not None}
    rows = [(name, asdict(row)) for name, entry in found.items() for row in rows_of(entry) if row.limit is not None]
    absent = [name for name in NAMES if name not in found]
    return {
        "benchmarks.md": TEXT.format(
            kept=sum(row["ok"] for _, row in rows),
            missed=sum(not row["ok"] for _, row in rows),
            absent=f"\nNot measured yet: {', '.join(f'`{name}`' for name in absent)}.\n" if absent else "",
            missed_table=_missed(found),
            when=_when(found),
        )
    }


def _missed(found: Mapping[str, Mapping[str, Any]]) -> str:
    lines = [
        (f"`{name}`: {row['name']}", shown(row), bound(row))
        for name, entry in found.items()
        for row in missed(map(asdict, rows_of(entry)))
    ]
    return table(("figure", "found", "limit"), lines)


def _when(found: Mapping[str, Mapping[str, Any]]) -> str:
    """Date and commit -> benchmarks."""
    runs: dict[tuple[str, str], list[str]] = {}
    for name, entry in found.items():
        runs.setdefault((entry["created"][:10], entry["git"]), []).append(f"`{name}`{LONG_MARK * (name in LONG)}")
    return "\n".join(f"- {date}, `{commit}`: {', '.join(names)}" for (date, commit), names in sorted(runs.items()))
