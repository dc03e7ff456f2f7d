"""How late commands act, by how well the drive alone then explains the torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from trueup.core.episode import Episode
from trueup.identify.regression.graybox import GrayboxSettings, fit_graybox

_COARSE_S = (0.0, 0.01, 0.02, 0.03, 0.04)
_FINE_S = (0.005, 0.0025)
_ENOUGH = 12  # motions

T = TypeVar("T")


def spread(items: Sequence[T]) -> Sequence[T]:
    """Some, from the first to the last, that are enough for a delay."""
    return items[:: max(1, len(items) // _ENOUGH)]


def best_delay(episodes: Sequence[Episode], settings: GrayboxSettings, *, joints: Sequence[str] | None) -> float:
    """The delay of the command [s] with the least error of the drive on the motions that are fitted.

    Beside friction, viscous terms can stand for a delay, so that every delay would do.

    Args:
        episodes: as of `fit_graybox`.
        settings: delay and blocks aside.
        joints: to look at; all if None.

    Raises:
        TrueupError: what `fit_graybox` raises.
    """
    errors: dict[float, float] = {}

    def error(delay_s: float) -> float:
        delay_s = round(max(delay_s, 0.0), 6)
        if delay_s not in errors:
            chosen = replace(settings, delay_s=delay_s, blocks=("pd",))
            total = fit_graybox(episodes, settings=chosen, joints=joints).total
            last = [block for block in total if not block.left_out]
            errors[delay_s] = last[-1].splits["train"].rmse.value if last else np.inf
        return errors[delay_s]

    best = min(_COARSE_S, key=error)
    for step in _FINE_S:
        best = min((best, best - step, best + step), key=error)
    return round(max(best, 0.0), 6)
