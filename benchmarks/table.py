"""What every benchmark returns: a figure beside its limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from trueup.core.atomic import write_json


@dataclass(frozen=True)
class Row:
    """One measured figure.

    Attributes:
        name: what was measured, on what.
        value: the figure.
        limit: what it is held against; None for a figure that is only shown.
        unit: unit of both.
        ok: whether the figure keeps the limit.
    """

    name: str
    value: float
    limit: float | None
    unit: str
    ok: bool = True


def at_most(name: str, value: float, limit: float, unit: str) -> Row:
    """A row for a figure that must not exceed its limit."""
    return Row(name, value, limit, unit, bool(value <= limit))


def at_least(name: str, value: float, limit: float, unit: str) -> Row:
    """A row for a figure that must reach its limit."""
    return Row(name, value, limit, unit, bool(value >= limit))


def shown(name: str, value: float, unit: str) -> Row:
    """A row for a figure without a limit."""
    return Row(name, value, None, unit)


def bound(row: Mapping[str, Any]) -> str:
    """The limit of a row and on which side of it a figure must stay; no side where the figure equals it."""
    value, limit = row["value"], row["limit"]
    if limit is None:
        return ""
    sign = "" if not (value < limit or value > limit) else "≤ " if (value < limit) == row["ok"] else "≥ "
    return f"{sign}{limit:.4g}"


def rounded(tree: Any) -> Any:
    """A result with no more digits than anyone reads: five of every float."""
    if isinstance(tree, Mapping):
        return {key: rounded(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [rounded(value) for value in tree]
    return float(f"{tree:.5g}") if isinstance(tree, float) else tree


def print_table(rows: Sequence[Row], title: str = "") -> None:
    """Print the rows; a figure that misses its limit is marked."""
    table = Table(title=title or None, title_justify="left")
    table.add_column("benchmark")
    for column in ("figure", "limit"):
        table.add_column(column, justify="right")
    table.add_column("unit")
    table.add_column("")
    for row in rows:
        verdict = "" if row.limit is None else "[green]ok[/]" if row.ok else "[bold red]MISSED[/]"
        table.add_row(row.name, f"{row.value:.4g}", bound(asdict(row)), row.unit, verdict)
    Console().print(table)


def write_rows(rows: Mapping[str, Sequence[Row]], path: Path) -> None:
    """Store the rows of each benchmark by its name."""
    write_json(path, {name: [asdict(row) for row in own] for name, own in rows.items()})
