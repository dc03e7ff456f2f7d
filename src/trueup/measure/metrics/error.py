"""Sizes of the residual: MSE, RMSE, NRMSE, MAE, maximum, MAPE.

Every function takes measured and simulated, both (T, J), and returns (J,). Samples that are not finite in
either series are left out of both; a joint without samples gives NaN.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from trueup.measure.columns import largest, mean, mean_product, paired, ratio, residual, spread
from trueup.measure.metrics.base import Metric, plain


def mse(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Mean squared error, unit of the signal squared (LSTM thesis, eq. 18)."""
    difference = residual(measured, simulated)
    return mean_product(difference, difference)


def rmse(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Root of the mean squared error, unit of the signal (LSTM thesis, section 2.9)."""
    return np.asarray(np.sqrt(mse(measured, simulated)))


def nrmse(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """RMSE over the range (maximum minus minimum) of the measured joint in the same samples, a pure number.

    GapONet (section 3.2) reports a normalized RMSE without saying by what; the range is the common choice that
    does not depend on where zero lies. NaN for a joint that did not move.
    """
    first, _ = paired(measured, simulated)
    return ratio(rmse(measured, simulated), spread(first))


def mae(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Mean absolute error, unit of the signal."""
    return mean(np.abs(residual(measured, simulated)))


def max_error(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Largest absolute error, unit of the signal."""
    return largest(np.abs(residual(measured, simulated)))


def mape(
    measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"], *, floor: float = 0.05
) -> Float64[np.ndarray, "J"]:
    """Mean absolute percentage error [%] over the samples in which the measured value is not near zero.

    Args:
        measured: shape (T, J).
        simulated: shape (T, J).
        floor: samples with |measured| below this share of the joint's largest |measured| are left out; lower
            values keep more samples and let those near zero dominate the mean.
    """
    first, second = paired(measured, simulated)
    size = np.abs(first)
    kept = (size >= floor * largest(size)) & (size > 0.0)
    error = np.abs(first - second) / np.where(kept, size, 1.0)
    return 100.0 * mean(np.where(kept, error, np.nan))


METRICS = (
    Metric("rmse", plain(rmse), "√mean(e²)", "LSTM thesis, eq. 18", "RMSE (root mean square error)"),
    Metric("mse", plain(mse), "mean(e²)", "LSTM thesis, eq. 18", "MSE (mean square error)", unit="signal^2"),
    Metric(
        "nrmse",
        plain(nrmse),
        "rmse / (max m - min m)",
        "GapONet, section 3.2; the range is our choice, the paper names none",
        "NRMSE (RMSE over the measured range)",
        unit="1",
        needs_motion=True,
    ),
    Metric("mae", plain(mae), "mean|e|", title="MAE (mean absolute error)"),
    Metric("max", plain(max_error), "max|e|", title="largest error"),
    Metric(
        "mape",
        plain(mape),
        "100 · mean(|e| / |m|) over samples with |m| ≥ 5 % of max|m|",
        title="MAPE (mean absolute percentage error)",
        unit="%",
    ),
)
