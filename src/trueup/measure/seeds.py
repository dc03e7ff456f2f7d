"""Intervals over goals and seeds at once: trainings that differ in their seed reach for the same goals.

Which goals they are and which seeds were drawn are two sources of chance, crossed. Goals alone would say how well
these networks do, and not how well a training does. Both are drawn again, goals for all seeds alike (the pigeonhole
bootstrap: Owen 2007, Annals of Applied Statistics 1, 386-411).

There are few seeds, and a bootstrap of three values is too narrow: below ten seeds, or goals, the interval is widened
to Student's t where that is the wider one, with the variances of the two sources added and the degrees of freedom of
their sum (Satterthwaite 1946, Biometrics Bulletin 2, 110-114).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from jaxtyping import Float64
from scipy.special import stdtrit

from trueup.errors import DataError
from trueup.measure.uncertainty import FEW_EPISODES, LEVEL

Statistic = Literal["mean", "median"]


def seeds_interval(
    values: Float64[np.ndarray, "S E"],
    baseline: Float64[np.ndarray, "R G"] | None = None,
    *,
    statistic: Statistic = "mean",
    draws: int = 2000,
    seed: int = 0,
) -> tuple[float, float, float]:
    """The mean over seeds of a statistic over goals, or how far it is from a baseline's, with a 95 % interval.

    Args:
        values: of each of S seeds with each of E goals.
        baseline: likewise of R other seeds with the same G = E goals, which are drawn together; seeds are not.
        statistic: over the goals, `mean` or `median`.
        draws: number of resamples.
        seed: of the resamples.

    Returns:
        Value, lower and upper end; NaN ends for fewer than two goals. A single seed is not drawn: then the interval is
        over goals alone.

    Raises:
        DataError: no draws, or other goals.
    """
    sides = [values] if baseline is None else [values, baseline]
    goals = values.shape[1]
    if draws < 1 or any(side.shape[1] != goals for side in sides):
        raise DataError("intervals over seeds and goals", got=[side.shape for side in sides], expected="the same goals")
    over = np.mean if statistic == "mean" else np.median
    signs = (1.0, -1.0)
    value = sum(sign * float(over(side, axis=1).mean()) for sign, side in zip(signs, sides, strict=False))
    if goals < 2:
        return value, math.nan, math.nan
    rng = np.random.default_rng([seed, goals])
    drawn = rng.integers(goals, size=(draws, goals))
    goals_alone, both = np.zeros((2, draws))
    variances: list[tuple[float, int]] = []
    for sign, side in zip(signs, sides, strict=False):
        found = np.stack([over(row[drawn], axis=1) for row in side], axis=1)
        chosen = rng.integers(len(side), size=(draws, len(side)))
        goals_alone += sign * found.mean(axis=1)
        both += sign * np.take_along_axis(found, chosen, axis=1).mean(axis=1)
        if len(side) > 1:
            variances.append((float(over(side, axis=1).var(ddof=1)) / len(side), len(side) - 1))
    tail = 0.5 * (1.0 - LEVEL)
    low, high = (float(end) for end in np.quantile(both, (tail, 1.0 - tail)))
    if min(goals, *(freedom + 1 for _, freedom in variances), FEW_EPISODES) < FEW_EPISODES:
        variances.append((float(goals_alone.var()) * goals / (goals - 1), goals - 1))
        half = _half(variances)
        low, high = min(low, value - half), max(high, value + half)
    return value, low, high


def _half(variances: list[tuple[float, int]]) -> float:
    """Half the width of Student's t interval of a sum of sources, each with its variance and degrees of freedom."""
    total = sum(variance for variance, _ in variances)
    if total == 0.0:
        return 0.0
    freedom = total**2 / sum(variance**2 / own for variance, own in variances)
    return float(-stdtrit(freedom, 0.5 * (1.0 - LEVEL)) * math.sqrt(total))
