"""How far motions in closed loop are from where they should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from trueup.compensate.closed_loop import Run
from trueup.compensate.config import LossConfig
from trueup.compensate.tracks import Track

# So many motions of each payload suffice to choose a round.
_JUDGED = 12
# Motions are of any length.
_Aim = Float64[np.ndarray, "_ S"]


@dataclass(frozen=True)
class PayloadErrors:
    """Errors of motions with one payload, mean over motions.

    Attributes:
        payload_kg: what is carried [kg].
        motions: how many.
        before: mean absolute error of the positions without compensation [rad or m].
        after: likewise with it.
        p999_before: 99.9 % of the samples are better than this, without.
        p999_after: likewise with it.
    """

    payload_kg: float
    motions: int
    before: float
    after: float
    p999_before: float
    p999_after: float


def judged(motions: Sequence[Track]) -> list[Track]:
    """The first motions of each payload."""
    counts: dict[float, int] = {}
    chosen = []
    for motion in motions:
        counts[motion.payload_kg] = counts.get(motion.payload_kg, 0) + 1
        if counts[motion.payload_kg] <= _JUDGED:
            chosen.append(motion)
    return chosen


def cost(runs: Sequence[Run], aims: Sequence[_Aim], loss: LossConfig) -> float:
    """Mean over motions of what an error of position costs, as in training."""
    squares = [
        (_gaps(run, aim) / loss.position_rad / loss.linear_from) ** 2 for run, aim in zip(runs, aims, strict=True)
    ]
    return float(np.mean([np.mean(loss.cost(own)) for own in squares]))


def payload_errors(
    motions: Sequence[Track], before: Sequence[Run], after: Sequence[Run], aims: Sequence[_Aim]
) -> tuple[PayloadErrors, ...]:
    """Payload by payload, without and with compensation."""
    found = []
    for payload_kg in sorted({motion.payload_kg for motion in motions}):
        own = [number for number, motion in enumerate(motions) if motion.payload_kg == payload_kg]
        means, worst = [], []
        for runs in (before, after):
            gaps = [_gaps(runs[number], aims[number]) for number in own]
            means.append(float(np.mean([part.mean() for part in gaps])))
            worst.append(float(np.quantile(np.concatenate([part.ravel() for part in gaps]), 0.999)))
        found.append(PayloadErrors(payload_kg, len(own), *means, *worst))
    return tuple(found)


def _gaps(run: Run, aim: _Aim) -> Float64[np.ndarray, "T J"]:
    joints = run.delta.shape[1]
    return np.asarray(np.abs(run.state[:, :joints] - aim[:, :joints]))
