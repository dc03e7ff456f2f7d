"""Statistics of columns in which samples may be missing: never a warning, NaN where nothing is defined."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64


def paired(
    measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]
) -> tuple[Float64[np.ndarray, "T J"], Float64[np.ndarray, "T J"]]:
    """Both series as float64, NaN in both where either of them is not finite."""
    first = measured.astype(np.float64, copy=False)
    second = simulated.astype(np.float64, copy=False)
    valid = np.isfinite(first) & np.isfinite(second)
    if valid.all():
        return first, second
    return np.where(valid, first, np.nan), np.where(valid, second, np.nan)


def residual(measured: Float[np.ndarray, "T J"], simulated: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "T J"]:
    """`measured - simulated`, NaN where either of them is not finite."""
    first, second = paired(measured, simulated)
    difference: Float64[np.ndarray, "T J"] = first - second
    return difference


def mean(values: Float64[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Mean of each column over the samples that are not NaN; NaN for a column without any."""
    total: Float64[np.ndarray, "J"] = values.sum(axis=0)
    if len(values) and not np.isnan(total).any():
        return total / len(values)
    valid = ~np.isnan(values)
    return ratio(np.where(valid, values, 0.0).sum(axis=0), valid.sum(axis=0).astype(np.float64))


def mean_product(first: Float64[np.ndarray, "T J"], second: Float64[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Mean of `first * second` as in `mean`, without an array of the products."""
    total = np.vecdot(first.T, second.T)
    if len(first) and not np.isnan(total).any():
        return np.asarray(total / len(first))
    return mean(first * second)


def largest(values: Float64[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Maximum of each column; NaN for a column without samples."""
    top = values.max(axis=0, initial=-np.inf)
    if np.isnan(top).any():
        top = np.where(np.isnan(values), -np.inf, values).max(axis=0, initial=-np.inf)
    return np.where(np.isfinite(top), top, np.nan)


def spread(values: Float64[np.ndarray, "T J"]) -> Float64[np.ndarray, "J"]:
    """Maximum minus minimum of each column; NaN for a column without samples."""
    bottom = values.min(axis=0, initial=np.inf)
    if np.isnan(bottom).any():
        bottom = np.where(np.isnan(values), np.inf, values).min(axis=0, initial=np.inf)
    width: Float64[np.ndarray, "J"] = largest(values) - bottom
    return width


def quantiles(values: Float64[np.ndarray, "T J"], levels: tuple[float, ...]) -> Float64[np.ndarray, "Q J"]:
    """Quantiles of each column by linear interpolation; NaN for a column without samples."""
    if not len(values):
        return np.full((len(levels), values.shape[1]), np.nan)
    ordered = np.sort(values, axis=0)  # NaN goes last
    last = np.maximum((~np.isnan(values)).sum(axis=0) - 1, 0)
    columns = np.arange(values.shape[1])
    position = np.array(levels)[:, None] * last
    below = np.floor(position).astype(np.int64)
    above = np.minimum(below + 1, last)
    weight = position - below
    result: Float64[np.ndarray, "Q J"] = (1.0 - weight) * ordered[below, columns] + weight * ordered[above, columns]
    return result


def ratio(
    numerator: Float64[np.ndarray, "*shape"], denominator: Float64[np.ndarray, "*shape"]
) -> Float64[np.ndarray, "*shape"]:
    """The quotient where the denominator is positive, NaN elsewhere."""
    result = np.full(numerator.shape, np.nan)
    np.divide(numerator, denominator, out=result, where=denominator > 0.0)
    return result
