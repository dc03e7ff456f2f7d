"""docs/acceptance.md, from what `make acceptance` has measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from benchmarks.pages.markdown import table
from benchmarks.table import bound

TEXT = """# What was asked, and what is reached

Every promise of the first {count} parts
({names}),
as they stood on {date}, with the command that measures it, the figure and the bar that was set before the part was
built. What came later, and newer figures of these, stand in the [table of all benchmarks](benchmarks.md), which
`python -m benchmarks` makes. All of this was measured on one commit, `{commit}`, in {hours:.1f} hours, by

```sh
make acceptance
```

which writes this page. A figure without a bar is shown for comparison. {verdict}{notes}

{parts}
"""

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
        notes="".join(f"\n\n{note}" for note in result.get("notes", ())),
        parts="\n\n".join(parts),
    )


def _verdict(lines: Sequence[Mapping[str, Any]]) -> str:
    rows = [row for line in lines for row in line["rows"] if row["limit"] is not None]
    missed = sum(not row["ok"] for row in rows)
    if not missed:
        return f"All {len(rows)} bars are kept."
    return f"Of {len(rows)} bars, {len(rows) - missed} are kept; below each table stands why the others are not."


def _table(lines: Sequence[Mapping[str, Any]]) -> str:
    heads = ("asked", "measured by", "figure", "found", "bar", "")
    return table(heads, [cells for line in lines for cells in _cells(line)], left=3)


def _cells(line: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """A line of the table for each figure; what was asked stands at the first."""
    rows = []
    for number, row in enumerate(line["rows"]):
        asked = (f"*{line['kind']}:* {line['asks']}", f"`{line['command']}`") if number == 0 else ("", "")
        verdict = "" if row["limit"] is None else "kept" if row["ok"] else "**missed**"
        rows.append((*asked, row["name"], f"{row['value']:.4g} {row['unit']}".strip(), bound(row), verdict))
    return rows


def _reasons(lines: Sequence[Mapping[str, Any]], part: str) -> str:
    missed: dict[str, list[str]] = {}
    for line in lines:
        for row in line["rows"]:
            if line["part"] == part and not row["ok"]:
                missed.setdefault(row["reason"], []).append(row["name"])
    return "".join(
        f"\n\n**Missed: {'; '.join(names)}.** {reason or 'Nobody knows why: a defect.'}"
        for reason, names in missed.items()
    )
