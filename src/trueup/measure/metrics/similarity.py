"""How alike two series are: Pearson, cosine, Lin's concordance, R2; all are 1 for equal series that move.

Every function takes measured and simulated, both (T, J), and returns (J,). Samples that are not finite in
either series are left out of both. What is not defined, as a correlation with a constant, is NaN.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64

from trueup.measure.columns import mean, mean_product, paired, ratio
from trueup.measure.metrics.base import CORRELATION, Metric, plain

_ROUNDING = 64.0 * float(np.finfo(np.float64).eps)


class _Moments(NamedTuple):
    mean_measured: Float64[np.ndarray, "J"]
    mean_simulated: Float64[np.ndarray, "J"]
    variance_measured: Float64[np.ndarray, "J"]
    variance_simulated: Float64[np.ndarray, "J"]
    covariance: Float64[np.ndarray, "J"]


def pearson(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Pearson's correlation, in [-1, 1]; NaN when either series is constant."""
    moments = _moments(measured, simulated)
    # Root by root: the product of two small variances may underflow.
    scale = np.sqrt(moments.variance_measured) * np.sqrt(moments.variance_simulated)
    return np.asarray(np.clip(ratio(moments.covariance, scale), -1.0, 1.0))


def cosine(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Cosine similarity, in [-1, 1]; NaN when either series is zero throughout."""
    first, second = paired(measured, simulated)
    scale = np.sqrt(mean_product(first, first)) * np.sqrt(mean_product(second, second))
    return np.asarray(np.clip(ratio(mean_product(first, second), scale), -1.0, 1.0))


def ccc(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Lin's concordance correlation coefficient, in [-1, 1], with moments over T (not T - 1).

    `2 cov / (var_measured + var_simulated + (mean_measured - mean_simulated)^2)`: Pearson's correlation, lowered
    by offset and scale. NaN when both series are the same constant. Source: Lin 1989, Biometrics 45, 255-268.
    """
    moments = _moments(measured, simulated)
    shift = moments.mean_measured - moments.mean_simulated
    scale = moments.variance_measured + moments.variance_simulated + shift**2
    return np.asarray(np.clip(ratio(2.0 * moments.covariance, scale), -1.0, 1.0))


def r2(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Coefficient of determination, at most 1: one minus MSE over the variance of measured.

    Below zero, the simulation says less than the mean of the measurement. NaN when measured is constant.
    """
    first, second = paired(measured, simulated)
    return 1.0 - ratio(mean((first - second) ** 2), _variance(first - mean(first), mean(first)))


def _moments(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> _Moments:
    first, second = paired(measured, simulated)
    mean_first, mean_second = mean(first), mean(second)
    off_first, off_second = first - mean_first, second - mean_second
    return _Moments(
        mean_first,
        mean_second,
        _variance(off_first, mean_first),
        _variance(off_second, mean_second),
        mean_product(off_first, off_second),
    )


def _variance(deviation: Float64[np.ndarray, "T J"], center: Float64[np.ndarray, "J"]) -> Float64[np.ndarray, "J"]:
    """Mean of squares, zero where it is no more than the rounding of the mean: the variance of a constant."""
    variance = mean_product(deviation, deviation)
    return np.where(variance <= (_ROUNDING * center) ** 2, 0.0, variance)


METRICS = (
    Metric(
        "pearson",
        plain(pearson),
        "cov(m, s) / (σ_m σ_s)",
        title="correlation (Pearson)",
        unit="1",
        lower_is_better=False,
        bounds=CORRELATION,
        needs_motion=True,
    ),
    Metric(
        "cosine",
        plain(cosine),
        "Σ m s / √(Σ m² Σ s²)",
        title="cosine similarity",
        unit="1",
        lower_is_better=False,
        bounds=CORRELATION,
    ),
    Metric(
        "ccc",
        plain(ccc),
        "2 cov(m, s) / (σ_m² + σ_s² + (mean m - mean s)²)",
        "Lin 1989, Biometrics 45, 255-268",
        "concordance correlation (CCC)",
        unit="1",
        lower_is_better=False,
        bounds=CORRELATION,
        needs_motion=True,
    ),
    Metric(
        "r2",
        plain(r2),
        "1 - mean(e²) / σ_m²",
        title="R² (coefficient of determination)",
        unit="1",
        lower_is_better=False,
        bounds=(-math.inf, 1.0),
        needs_motion=True,
    ),
)
