"""How well each model of a growing regression predicts, per split and payload, and what its last block is worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int

from trueup.core.graybox_result import HELD_OUT, Score
from trueup.identify.regression.samples import Motion
from trueup.measure.uncertainty import bootstrap_interval, estimate

_SPLITS = ("train", "val", "test")
Scores = tuple[dict[str, Score], dict[str, dict[str, Score]]]


class Sums(NamedTuple):
    """What the torque errors of E motions sum up to, without and with a block.

    Attributes:
        size: number of samples.
        without: sum of squares without the block.
        included: sum of squares with it.
    """

    size: Int[np.ndarray, "E"]
    without: Float64[np.ndarray, "E"]
    included: Float64[np.ndarray, "E"]


def sums_of(
    motion: Int[np.ndarray, "N"], without: Float64[np.ndarray, "N"], included: Float64[np.ndarray, "N"], *, motions: int
) -> Sums:
    """Add up the squares of two residuals motion by motion.

    Args:
        motion: number of the motion of each row.
        without: residual without the block; NaN in rows that have none.
        included: residual with it; NaN in the same rows.
        motions: number of motions.
    """
    known = np.isfinite(included)
    motion = motion[known]
    squares = (np.bincount(motion, weights=item[known] ** 2, minlength=motions) for item in (without, included))
    return Sums(np.bincount(motion, minlength=motions), *squares)


def block_scores(
    motions: Sequence[Motion], splits: Sequence[str], fitted: Sequence[Sums], held_out: Sequence[Sums], *, unit: str
) -> Scores:
    """Score a model against the one before it, as the mean over joints of their RMSE.

    Args:
        motions: the E motions.
        splits: the split of each motion.
        fitted: one item per joint, of a model that was fitted to the train motions.
        held_out: one item per joint, each motion predicted by a model that was fitted without it.
        unit: unit of the residuals.

    Returns:
        split -> score, and split -> payload in kg, as text -> score; without splits that have no rows.
    """
    loads = np.array([item.payload_kg for item in motions])
    _, group = np.unique([item.executed for item in motions], return_inverse=True)
    of_split: Mapping[str, tuple[Sequence[Sums], Bool[np.ndarray, "E"]]] = {
        **{split: (fitted, np.array([own == split for own in splits])) for split in _SPLITS},
        HELD_OUT: (held_out, np.ones(len(motions), dtype=bool)),
    }
    by_split: dict[str, Score] = {}
    by_payload: dict[str, dict[str, Score]] = {}
    for split, (sums, inside) in of_split.items():
        inside = inside & np.any([item.size > 0 for item in sums], axis=0)
        if not inside.any():
            continue
        by_split[split] = score_of(sums, inside, group, unit)
        by_payload[split] = {
            f"{load:g}": score_of(sums, inside & (loads == load), group, unit) for load in np.unique(loads[inside])
        }
    return by_split, by_payload


def score_of(joints: Sequence[Sums], inside: Bool[np.ndarray, "E"], group: Int[np.ndarray, "E"], unit: str) -> Score:
    """RMSE over all samples; intervals from the linearized contribution of each motion, which sums to the value.

    Repetitions of a motion are no news: they are added up before motions are drawn.

    Args:
        joints: one item per joint; their RMSEs are averaged.
        inside: which of the E motions count.
        group: the same number for repetitions of a motion.
        unit: of the residuals.
    """
    there = [item for item in joints if item.size[inside].any()]
    count = int(inside.sum())
    rmse, columns = np.zeros(2), np.zeros((count, 2))
    for sums in there:
        size = sums.size[inside].astype(np.float64)
        share = count / size.sum()
        for number, square in enumerate((sums.without[inside], sums.included[inside])):
            mean = float(square.sum() / size.sum())
            root = float(np.sqrt(mean))
            rmse[number] += root / len(there)
            if root > 0.0:
                columns[:, number] += (root + share * (square - mean * size) / (2.0 * root)) / len(there)
    _, executed = np.unique(group[inside], return_inverse=True)
    runs = int(executed.max()) + 1
    parts = np.stack(
        [
            np.bincount(executed, weights=values, minlength=runs) * (runs / count)
            for values in (columns[:, 1], columns[:, 0] - columns[:, 1])
        ],
        axis=1,
    )
    low, high = bootstrap_interval(parts)
    return Score(
        rmse=estimate(float(rmse[1]), unit, float(low[0]), float(high[0]), (0.0, np.inf)),
        reduction=estimate(float(rmse[0] - rmse[1]), unit, float(low[1]), float(high[1])),
        motions=count,
        samples=int(max(item.size[inside].sum() for item in there)),
    )
