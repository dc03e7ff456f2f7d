"""How well each model of a growing regression predicts, per split and payload, and what its last block is worth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int

from trueup.core.graybox_result import Score
from trueup.identify.regression.samples import Motion
from trueup.measure.uncertainty import bootstrap_interval, estimate

_SPLITS = ("train", "val", "test")


def block_scores(
    motions: Sequence[Motion],
    splits: Sequence[str],
    motion: Int[np.ndarray, "N"],
    residuals: tuple[Float64[np.ndarray, "N"], Float64[np.ndarray, "N"]],
    *,
    unit: str,
) -> tuple[dict[str, Score], dict[str, dict[str, Score]]]:
    """Score a model against the one before it.

    Args:
        motions: the E motions.
        splits: the split of each motion.
        motion: number of the motion of each row.
        residuals: without and with the block.
        unit: unit of the residuals.

    Returns:
        split -> score, and split -> payload in kg, as text -> score; without splits that have no rows.
    """
    count = len(motions)
    sizes = np.bincount(motion, minlength=count)
    squares = [np.bincount(motion, weights=residual**2, minlength=count) for residual in residuals]
    loads = np.array([item.payload_kg for item in motions])
    by_split: dict[str, Score] = {}
    by_payload: dict[str, dict[str, Score]] = {}
    for split in _SPLITS:
        inside = np.array([own == split for own in splits]) & (sizes > 0)
        if not inside.any():
            continue
        by_split[split] = _score(sizes, squares, inside, unit)
        by_payload[split] = {
            f"{load:g}": _score(sizes, squares, inside & (loads == load), unit) for load in np.unique(loads[inside])
        }
    return by_split, by_payload


def _score(
    sizes: Int[np.ndarray, "E"], squares: list[Float64[np.ndarray, "E"]], inside: Bool[np.ndarray, "E"], unit: str
) -> Score:
    """RMSE over all samples; intervals from the linearized contribution of each motion, which sums to the value."""
    size = sizes[inside].astype(np.float64)
    share = size.size / size.sum()
    rmse, parts = [], []
    for square in squares:
        mean = float(square[inside].sum() / size.sum())
        root = np.sqrt(mean)
        rmse.append(float(root))
        parts.append(root + share * (square[inside] - mean * size) / (2.0 * root) if root > 0.0 else 0.0 * size)
    columns = np.stack([parts[1], parts[0] - parts[1]], axis=1)
    low, high = bootstrap_interval(columns)
    return Score(
        rmse=estimate(rmse[1], unit, float(low[0]), float(high[0]), (0.0, np.inf)),
        reduction=estimate(rmse[0] - rmse[1], unit, float(low[1]), float(high[1])),
        motions=size.size,
        samples=int(size.sum()),
    )
