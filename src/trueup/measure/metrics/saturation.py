"""How often a torque is at its limit."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from trueup.measure.columns import mean
from trueup.measure.metrics.base import SHARE, Metric, Samples


def saturation_incidence(torque: Float[np.ndarray, "T J"], limit: Float64[np.ndarray, "J"]) -> Float64[np.ndarray, "J"]:
    """Share of samples with |torque| at or above the limit, in [0, 1] (named in GapONet, section 3.2).

    Args:
        torque: shape (T, J) [Nm or N]; samples that are not finite are left out.
        limit: positive, shape (J,), same unit; NaN for a joint without a limit, whose result is NaN.
    """
    size = np.abs(torque.astype(np.float64, copy=False))
    defined = np.isfinite(size) & np.isfinite(limit)
    return mean(np.where(defined, (size >= limit).astype(np.float64), np.nan))


def _entry(side: str) -> Metric:
    def share(s: Samples) -> Float64[np.ndarray, "J"]:
        torque = getattr(s, side)
        return saturation_incidence(torque, np.full(torque.shape[1], np.nan) if s.limit is None else s.limit)

    return Metric(
        f"saturation_{side}",
        share,
        f"share of {side} samples with |torque| ≥ limit",
        "GapONet, section 3.2",
        unit="1",
        signals=("torque",),
        bounds=SHARE,
        needs_limit=True,
    )


METRICS = (_entry("measured"), _entry("simulated"))
