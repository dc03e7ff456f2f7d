"""How much a packed file may unpack to: some kilobytes of one byte repeated are terabytes."""

from __future__ import annotations

FEW_BYTES = 256 << 20
EXPANSION = 100


def most_bytes(packed: int) -> int:
    """How many bytes so many may unpack to: samples hardly shrink to a tenth, and small files hurt nobody."""
    return max(FEW_BYTES, EXPANSION * packed)
