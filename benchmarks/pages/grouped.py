"""Figures that are held against a limit: those that miss it, and of the others those that are nearest to theirs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any


def missed(rows: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Those that miss their limit."""
    return [row for row in rows if row["limit"] is not None and not row["ok"]]


def kept(rows: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Those that keep their limit, by how near they are to it, as a share of it; those with the limit 0 come last."""
    return sorted((row for row in rows if row["limit"] is not None and row["ok"]), key=_distance)


def _distance(row: Mapping[str, Any]) -> float:
    return abs(row["value"] - row["limit"]) / abs(row["limit"]) if row["limit"] else math.inf


def shown(row: Mapping[str, Any]) -> str:
    """The figure with its unit."""
    return f"{row['value']:.4g} {row['unit']}".strip()
