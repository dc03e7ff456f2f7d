"""docs/acceptance.md, from what `make acceptance` has measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from benchmarks.acceptance.lines import explained
from benchmarks.pages.grouped import grouped, shown
from benchmarks.pages.markdown import table
from benchmarks.table import bound

TEXT = """# What was asked, and what is reached

Before each part of trueup was built, bars were set for it. This page shows the bars of the first {count} parts
({names})
and what was measured on {date}. Later and newer figures are in the [table of all benchmarks](benchmarks.md).

```sh
make acceptance                 # measure everything on one commit and write this page
python -m benchmarks NAME       # one line; where a line names test files, `python -m pytest FILES`
```

{verdict} Where several figures have the same bar, the
table shows the one nearest to it. Measured on commit `{commit}` in {hours:.1f} hours{notes}

{parts}
"""

TESTS = "tests that failed or were skipped"
_COUNTS = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}


def page(result: Mapping[str, Any]) -> str:
    """The page as Markdown."""
    lines: Sequence[Mapping[str, Any]] = result["lines"]
    made = result["provenance"]
    names = list(dict.fromkeys(line["part"] for line in lines))
    parts = [
        f"## {part}\n\n{_table(list(own))}{_reasons(lines, part)}"
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
        parts="\n\n".join(parts),
    )


def _verdict(lines: Sequence[Mapping[str, Any]]) -> str:
    rows = [row for line in lines for row in line["rows"] if row["limit"] is not None]
    missed = sum(not row["ok"] for row in rows)
    if not missed:
        return f"All {len(rows)} bars are kept."
    return f"Of {len(rows)} bars, {len(rows) - missed} are kept; the reasons for the others are below each table."


def _table(lines: Sequence[Mapping[str, Any]]) -> str:
    return table(("asked", "measured by", "found (bar)"), [_cells(line) for line in lines], left=3)


def _cells(line: Mapping[str, Any]) -> tuple[str, ...]:
    """A row of the table; its last cell has every figure that is held against a bar."""
    command = line["command"].replace("python -m benchmarks ", "").replace("python -m pytest ", "")
    found = "<br>".join(_figure(row, count) for row, count in grouped(line["rows"])) or _best(line["rows"])
    return line["asks"], " ".join(f"`{name}`" for name in command.split()), found


def _figure(row: Mapping[str, Any], count: int) -> str:
    if row["name"] == TESTS:
        return f"{shown(row)} tests failed or were skipped{'' if row['ok'] else ' **missed**'}"
    worst = f", worst of {count}" if count > 1 else ""
    missed = "" if row["ok"] else " **missed**"
    return f"{row['name']}: {shown(row)} ({bound(row)}{worst}){missed}"


def _best(rows: Sequence[Mapping[str, Any]]) -> str:
    """Of a line that sets no bar, the ratios."""
    return "<br>".join(f"{row['name']}: {shown(row)}" for row in rows if row["unit"] == "x")


def _reasons(lines: Sequence[Mapping[str, Any]], part: str) -> str:
    missed: dict[str, list[str]] = {}
    for line in lines:
        for row in line["rows"]:
            if line["part"] == part and not row["ok"]:
                told = explained(row["name"]) or row["reason"] or "Nobody knows why: a defect."
                missed.setdefault(told, []).append(row["name"])
    return "".join(f"\n\n**Missed: {'; '.join(names)}.** {told}" for told, names in missed.items())
