"""Figures that are held against the same limit, in one row: the one that is nearest to it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from benchmarks.table import bound

_NUMBER = re.compile(r"\d+(\.\d+)?")


def grouped(rows: Iterable[Mapping[str, Any]]) -> list[tuple[Mapping[str, Any], int]]:
    """The figures that have a limit, each with how many are like it; what misses its limit stands alone.

    Alike are figures that keep the same limit in the same unit, and whose names differ only in what stands before the
    last `: ` or in numbers.
    """
    found: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for number, row in enumerate(rows):
        if row["limit"] is not None:
            kind = _NUMBER.sub("#", row["name"].rpartition(": ")[2])
            key = (bound(row), row["unit"], kind) if row["ok"] else (number,)
            found.setdefault(key, []).append(row)
    return [(_nearest(own), len(own)) for own in found.values()]


def _nearest(rows: list[Mapping[str, Any]]) -> Mapping[str, Any]:
    return min(rows, key=lambda row: abs(row["value"] - row["limit"]))


def shown(row: Mapping[str, Any]) -> str:
    """The figure with its unit."""
    return f"{row['value']:.4g} {row['unit']}".strip()
