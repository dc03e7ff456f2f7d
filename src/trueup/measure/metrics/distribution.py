"""How the absolute error is distributed (GapONet, appendix A.6.1, Table 1), and torque saturation.

Every function returns one value per joint, (J,). The paper pools all joints of a run or averages over them ("per
joint and then averaged"); here it is always per joint, and the mean over joints is taken where totals are made.
For the large-gap ratio both are the same number, for IQR and range they are not.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from trueup.measure.columns import mean, quantiles, residual, spread
from trueup.measure.metrics.base import SHARE, Metric, Samples, plain


def large_gap_ratio(
    measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"], *, tau: float = 0.5
) -> Float64[np.ndarray, "J"]:
    """Share of samples with an absolute error of at least `tau`, in [0, 1] (GapONet, eq. 12).

    Args:
        measured: shape (T, J).
        simulated: shape (T, J).
        tau: threshold in the unit of the signal; 0.5 rad in the paper, which is large: state it with the result.
    """
    gap = np.abs(residual(measured, simulated))
    return mean(np.where(np.isnan(gap), np.nan, (gap >= tau).astype(np.float64)))


def gap_iqr(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Interquartile range of the absolute error, unit of the signal (GapONet, eq. 13)."""
    lower, upper = quantiles(np.abs(residual(measured, simulated)), (0.25, 0.75))
    return np.asarray(upper - lower)


def gap_range(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Largest minus smallest absolute error, unit of the signal (GapONet, eq. 14)."""
    return spread(np.abs(residual(measured, simulated)))


def saturation_incidence(torque: Float[np.ndarray, "T J"], limit: Float64[np.ndarray, "J"]) -> Float64[np.ndarray, "J"]:
    """Share of samples with |torque| at or above the limit, in [0, 1] (named in GapONet, section 3.2).

    Args:
        torque: shape (T, J) [Nm or N]; samples that are not finite are left out.
        limit: positive, shape (J,), same unit; NaN for a joint without a limit, whose result is NaN.
    """
    size = np.abs(torque.astype(np.float64, copy=False))
    defined = np.isfinite(size) & np.isfinite(limit)
    return mean(np.where(defined, (size >= limit).astype(np.float64), np.nan))


def _saturation(side: str) -> Metric:
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


METRICS = (
    Metric(
        "large_gap_ratio",
        lambda s: large_gap_ratio(s.measured, s.simulated, tau=s.options.tau_rad),
        "share of samples with |e| ≥ tau, 0.5 rad if not given; joints in rad only",
        "GapONet, eq. 12",
        "large-gap ratio (share of samples)",
        unit="1",
        signals=("position",),
        bounds=SHARE,
        angles_only=True,
    ),
    Metric(
        "iqr",
        plain(gap_iqr),
        "75th minus 25th percentile of |e|",
        "GapONet, eq. 13",
        "interquartile range of the error",
    ),
    Metric("range", plain(gap_range), "max|e| - min|e|", "GapONet, eq. 14", "range of the error"),
    _saturation("measured"),
    _saturation("simulated"),
)
