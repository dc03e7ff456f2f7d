"""Which samples of a curve to draw."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from trueup.errors import ConfigError


def decimation_rows(values: Float[np.ndarray, "C T"], max_points: int) -> Int[np.ndarray, "K"]:
    """Which rows of C curves on one clock to draw, so that every bucket keeps the extremes of every curve.

    The rows are cut into buckets of equal length; of each bucket the rows of the smallest and the largest value
    of each curve stay, and one row with a NaN of each curve that has one, so that a gap stays visible as a gap.
    Room that is left is filled evenly.

    Args:
        values: the curves, (C, T); NaN is a missing sample.
        max_points: upper limit of K.

    Returns:
        Increasing row numbers, K <= max_points, with the first and the last row; all T rows if T <= max_points.

    Raises:
        ConfigError: `max_points` does not even leave room for one bucket.
    """
    curves, total = values.shape
    if total <= max_points:
        return np.arange(total)
    missing = np.isnan(values)
    per_bucket = 2 * curves + int(missing.any(axis=1).sum())
    buckets = (max_points - 2) // per_bucket
    if buckets < 1:
        raise ConfigError("max_points is too small", got=max_points, expected=f"at least {per_bucket + 2}")
    rows = _bucket_rows(values, missing, buckets)
    # Extremes of different curves often share a row; what room that leaves goes to evenly spaced rows.
    spare = np.linspace(0, total - 1, max_points - rows.size).round().astype(np.int64)
    return np.union1d(rows, spare)


def _bucket_rows(
    values: Float[np.ndarray, "C T"], missing: Bool[np.ndarray, "C T"], buckets: int
) -> Int[np.ndarray, "K"]:
    """The ends, and of each bucket the row of each curve's extremes and of a NaN."""
    curves, total = values.shape
    width = -(-total // buckets)
    buckets = -(-total // width)
    padded = np.full((curves, buckets * width), np.nan, dtype=values.dtype)
    padded[:, :total] = values
    cut = padded.reshape(curves, buckets, width)
    absent = np.isnan(cut)
    starts = np.arange(buckets) * width
    kept = np.zeros(total, dtype=bool)
    kept[[0, total - 1]] = True
    kept[starts + np.where(absent, np.inf, cut).argmin(axis=2)] = True
    kept[starts + np.where(absent, -np.inf, cut).argmax(axis=2)] = True
    if missing.any():
        padded_holes = np.zeros((curves, buckets * width), dtype=bool)
        padded_holes[:, :total] = missing
        holes = padded_holes.reshape(curves, buckets, width)
        kept[(starts + holes.argmax(axis=2))[holes.any(axis=2)]] = True
    return np.flatnonzero(kept)
