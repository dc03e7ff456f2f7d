"""docs/acceptance.md, from what `make acceptance` has measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from benchmarks.acceptance.lines import explained
from benchmarks.pages.grouped import kept, missed, shown
from benchmarks.pages.markdown import table
from benchmarks.table import bound

TEXT = """# What was asked, and what is reached

Before each part of trueup was built, bars were set for it. This page has those of the first {count} parts
({names})
and what was measured on {date}. [All benchmarks](benchmarks.md) has newer figures.

```sh
make acceptance                 # measure everything on one commit and write this page
python -m benchmarks friction   # one line, here that of friction
```

{verdict} Each line below says how many of its bars are kept and shows the figure nearest
to its bar (in parentheses); `benchmarks/results/acceptance.json` has all. Measured on commit `{commit}` in
{hours:.1f} hours{notes}

{missed}{parts}
"""
MISSED = """## Missed bars

{table}

"""
PART = """## {part}

{lines}"""

TESTS = "tests that failed or were skipped"
_COUNTS = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}


def page(result: Mapping[str, Any]) -> str:
    """The page as Markdown."""
    lines: Sequence[Mapping[str, Any]] = result["lines"]
    made = result["provenance"]
    names = list(dict.fromkeys(line["part"] for line in lines))
    parts = [
        PART.format(part=part, lines="\n".join(map(_line, own)))
        for part, own in groupby(lines, lambda line: line["part"])
    ]
    return TEXT.format(
        count=_COUNTS.get(len(names), len(names)),
        names=", ".join(names[:1] + [name.lower() for name in names[1:]]),
        commit=made["git"],
        date=made["created"][:10],
        hours=made["config"]["seconds"] / 3600,
        verdict=_verdict(lines),
        notes="".join((".", *(f" {note}" for note in result.get("notes", ())))),
        missed=_missed(lines),
        parts="\n\n".join(parts),
    )


def _verdict(lines: Sequence[Mapping[str, Any]]) -> str:
    rows = [row for line in lines for row in line["rows"] if row["limit"] is not None]
    count = len(missed(rows))
    if not count:
        return f"All {len(rows)} bars are kept."
    return f"Of {len(rows)} bars, {len(rows) - count} are kept and {count} are missed."


def _missed(lines: Sequence[Mapping[str, Any]]) -> str:
    """What misses its bar, and why; empty if nothing does."""
    found: dict[str, list[str]] = {}
    for line in lines:
        for row in missed(line["rows"]):
            why = explained(row["name"]) or row["reason"] or "Nobody knows why: a defect."
            found.setdefault(why, []).append(_figure(row))
    rows = [("<br>".join(figures), why) for why, figures in found.items()]
    return MISSED.format(table=table(("found (bar)", "why"), rows, left=2)) if rows else ""


def _line(line: Mapping[str, Any]) -> str:
    command = line["command"].replace("python -m benchmarks ", "").replace("python -m pytest ", "")
    return f"- {line['asks']} ({', '.join(f'`{name}`' for name in command.split())}): {_found(line['rows'])}"


def _found(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many of the bars of a line are kept; the kept figure that is nearest to its bar where nothing is missed."""
    near, lost = kept(rows), missed(rows)
    if lost:
        return f"{len(near)} of {len(near) + len(lost)}, **{len(lost)} missed**"
    if not near:
        return _ratios(rows)
    count = f"{len(near)} of {len(near)}, nearest " if len(near) > 1 else ""
    return f"{count}{_held(near[0])}"


def _figure(row: Mapping[str, Any]) -> str:
    """What it is, and its bar."""
    return f"{row['name']}: {_held(row)}"


def _held(row: Mapping[str, Any]) -> str:
    return "all tests passed" if row["name"] == TESTS and row["ok"] else f"{shown(row)} ({bound(row)})"


def _ratios(rows: Sequence[Mapping[str, Any]]) -> str:
    """Of a line that sets no bar, the smallest and the largest ratio."""
    values = sorted(row["value"] for row in rows if row["unit"] == "x")
    return f"{values[0]:.4g} to {values[-1]:.4g} x" if values else ""
