"""What the figures of episodes show, as numbers: which of them stand for all, their spread, and shares of goals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64, Int64

# Share of the episodes that are better -> what the episode there is called.
_CHOSEN = {0.0: "best", 0.25: "upper quarter", 0.5: "median", 0.75: "lower quarter", 0.9: "lower tenth", 1.0: "worst"}


def chosen_episodes(worth: Float[np.ndarray, "E"]) -> list[tuple[str, int]]:
    """Name and row of the best episode, the median one, the worst and some between; each episode once.

    Args:
        worth: of each episode; more is better.
    """
    order = np.argsort(-worth, kind="stable")
    rows: dict[int, str] = {}
    # Of two names for one episode, the plainer one stays.
    for share in sorted(_CHOSEN, key=lambda share: (share not in (0.0, 1.0), share != 0.5, share)):
        rows.setdefault(int(order[round(share * (len(order) - 1))]), _CHOSEN[share])
    rank = {int(row): place for place, row in enumerate(order)}
    return [(rows[row], row) for row in sorted(rows, key=rank.__getitem__)]


def spread(
    curves: Float[np.ndarray, "E T"], shares: Sequence[float] = (0.1, 0.5, 0.9)
) -> tuple[Int64[np.ndarray, "N"], Float64[np.ndarray, "Q N"]]:
    """Quantiles over episodes at each control step at which any episode has a value; lost arms have none.

    Returns:
        Those N of the T steps, and the quantiles there, one row each.
    """
    steps = np.flatnonzero(np.isfinite(curves).any(axis=0))
    if not steps.size:
        return steps, np.empty((len(shares), 0))
    return steps, np.nanquantile(curves[:, steps].astype(np.float64), shares, axis=0)


def cumulative(values: Float[np.ndarray, "E"]) -> tuple[Float64[np.ndarray, "N"], Float64[np.ndarray, "N"]]:
    """Values by size, and which share of all is no larger: the corners of a staircase from 0 to 1.

    Returns:
        The values, the least of them twice, and the share from there on.
    """
    ordered = np.sort(values.astype(np.float64))
    return np.concatenate([ordered[:1], ordered]), np.arange(len(ordered) + 1) / len(ordered)
