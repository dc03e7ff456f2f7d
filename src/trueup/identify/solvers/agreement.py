"""Whether searches from several starts end in one place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from trueup.identify.solvers.space import Space

Verdict = Literal["agree", "not-unique", "local-minima", "single", "failed"]


@dataclass(frozen=True, eq=False)
class Agreement:
    """Do the searches from different starts end in one place?

    Attributes:
        verdict: `agree` (at least two end where the best does, and none finds an equally good place elsewhere);
            `not-unique` (as good elsewhere: the data do not determine some parameters); `local-minima` (the best
            stands alone and the others are worse); `single` (only one start succeeded); `failed` (none did).
        same: solutions at the best place, the best included.
        elsewhere: solutions as good at other places.
        worse: solutions that cost more.
        failed: searches without a result.
        spread: largest difference among all solutions as good as the best, in typical scales, (P,).
        text: the same as a sentence.
    """

    verdict: Verdict
    same: int
    elsewhere: int
    worse: int
    failed: int
    spread: Float[np.ndarray, "P"]
    text: str


def compare_ends(
    space: Space,
    z: Float[np.ndarray, "S P"],
    cost: Float[np.ndarray, "S"],
    *,
    cost_tolerance: float,
    place_tolerance: float,
) -> Agreement:
    """Sort the ends of S searches into those at the best place, those as good elsewhere, and those that are worse.

    Args:
        space: with the typical scale.
        z: where each search ended.
        cost: there; not finite for a search that failed.
        cost_tolerance: an end is as good as the best when it costs at most this share more.
        place_tolerance: two ends are at one place when no parameter differs by more typical scales.
    """
    good = np.isfinite(cost)
    failed, total = int(np.count_nonzero(~good)), cost.size
    lost = f"; {failed} of {total} failed" if failed else ""
    if not good.any():
        return Agreement("failed", 0, 0, 0, failed, np.full(space.size, np.nan), f"none of {total} starts succeeded")
    z, cost = z[good], cost[good]
    best = int(np.argmin(cost))
    same: Bool[np.ndarray, "C"] = (np.abs(z - z[best]) <= place_tolerance * space.scale).all(axis=1)
    as_good = same | (cost <= cost[best] + cost_tolerance * abs(cost[best]))
    spread = np.ptp(z[as_good], axis=0) / space.scale
    counts = int(same.sum()), int((as_good & ~same).sum()), int((~as_good).sum())
    loose = [space.labels[index] for index in np.flatnonzero(spread > place_tolerance)]
    verdict: Verdict
    if cost.size == 1:
        verdict, text = "single", "only one start led to a result: nothing to compare it with"
    elif counts[1]:
        verdict = "not-unique"
        text = f"{counts[1]} of {total} starts end as good elsewhere: {', '.join(loose)} not determined by the data"
    elif counts[0] > 1:
        verdict, text = "agree", f"{counts[0]} of {total} starts end in the same best place"
    else:
        verdict, text = "local-minima", f"the other {cost.size - 1} starts end in worse places; try more starts"
    return Agreement(verdict, *counts, failed, spread, text + lost)
