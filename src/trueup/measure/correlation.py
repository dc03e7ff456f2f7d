"""Cross-correlation of two series on one grid over a range of lags."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

_SAME_PEAK = 1e-3  # peaks of a periodic motion that are this close in height are taken as equal


class Correlation(NamedTuple):
    """Normalized cross-correlation, one column per joint.

    Attributes:
        lags: lags in samples, shape (L,), increasing and symmetric about 0.
        values: correlation in [-1, 1], shape (L, J); NaN where the overlap is too short or has no energy.
    """

    lags: Int[np.ndarray, "L"]
    values: Float64[np.ndarray, "L J"]


class Peak(NamedTuple):
    """Where the correlation is largest.

    Attributes:
        lag: in samples with a fraction, shape (J,); NaN when there is no peak inside the range of lags.
        height: correlation at the peak, shape (J,); NaN likewise.
    """

    lag: Float64[np.ndarray, "J"]
    height: Float64[np.ndarray, "J"]


def cross_correlation(
    source: Float64[np.ndarray, "T J"],
    delayed: Float64[np.ndarray, "T J"],
    starts: Int[np.ndarray, "S"],
    *,
    max_lag: int,
    min_overlap: float = 0.5,
) -> Correlation:
    """Correlate `delayed[i + lag]` with `source[i]` on a uniform grid, never across the start of a segment.

    Means are removed, and each lag is normalized by the energy of the samples that overlap at this lag, so that
    long lags are not punished for their shorter overlap.

    Args:
        source: finite, shape (T, J), T >= 1.
        delayed: finite, shape (T, J).
        starts: first row of each segment, increasing, the first is 0.
        max_lag: largest lag in samples, at least 1; both signs are searched.
        min_overlap: lags with a smaller share of overlapping samples than this are NaN.
    """
    pair = np.array([source.T, delayed.T])  # time last: the transforms run along it
    pair -= pair.mean(axis=-1, keepdims=True)
    lags = np.arange(-max_lag, max_lag + 1)

    # Segments lie max_lag zeros apart, so that the product of the transforms never mixes two of them.
    rows = np.arange(len(source))
    rows += max_lag * (np.searchsorted(starts, rows, side="right") - 1)
    size = _fast_size(int(rows[-1]) + 1 + max_lag)
    spread = np.zeros((2, source.shape[1], size))
    if len(starts) == 1:
        spread[:, :, : len(source)] = pair
    else:
        spread[:, :, rows] = pair
    first, second = np.fft.rfft(spread, axis=-1)
    cross = np.fft.irfft(np.conj(first) * second, n=size, axis=-1)[:, lags].T

    # At lag k the source loses the last k samples of each segment and the other its first k; at -k vice versa.
    ends = np.append(starts[1:], len(source))[:, None]
    begins = starts[:, None]
    earlier = np.maximum(ends - np.abs(lags), begins)
    later = np.minimum(begins + np.abs(lags), ends)
    overlap = (earlier - begins).sum(axis=0)
    sums = np.zeros((2, source.shape[1], len(source) + 1))
    np.cumsum(pair**2, axis=-1, out=sums[:, :, 1:])
    head = (sums[:, :, earlier] - sums[:, :, begins]).sum(axis=2)
    tail = (sums[:, :, ends] - sums[:, :, later]).sum(axis=2)
    energy = np.where(lags >= 0, head[0] * tail[1], tail[0] * head[1]).T

    usable = (overlap >= max(min_overlap * len(source), 2.0))[:, None] & (energy > 1e-12 * energy[max_lag])
    values = np.full(cross.shape, np.nan)
    np.divide(cross, np.sqrt(np.where(usable, energy, 1.0)), out=values, where=usable)
    return Correlation(lags, np.clip(values, -1.0, 1.0))


def find_peak(correlation: Correlation) -> Peak:
    """The highest local maximum, refined by a parabola through its neighbors.

    Among peaks of equal height, as a periodic motion has them, the one nearest to lag 0 is taken. A maximum at
    the end of the range is no peak: the true lag may lie beyond.
    """
    values = correlation.values
    width = values.shape[1]
    if len(values) < 3:
        return Peak(np.full(width, np.nan), np.full(width, np.nan))
    before, center, after = values[:-2], values[1:-1], values[2:]
    is_peak = (center >= before) & (center > after)
    curvature = np.where(is_peak, before - 2.0 * center + after, -1.0)
    offset = np.where(is_peak, 0.5 * (before - after), 0.0) / curvature
    height = np.where(is_peak, center - 0.25 * (before - after) * offset, -np.inf)
    lag = correlation.lags[1:-1, None] + offset

    highest = height.max(axis=0)
    distance = np.where(height >= highest - _SAME_PEAK, np.abs(lag), np.inf)
    row = distance.argmin(axis=0)
    columns = np.arange(width)
    # At the ends of what could be searched the correlation may still be rising.
    edge = np.where(np.isnan(values), -np.inf, values).max(axis=0) > highest + _SAME_PEAK
    found = np.isfinite(highest) & ~edge
    return Peak(
        np.where(found, lag[row, columns], np.nan),
        np.where(found, np.minimum(height[row, columns], 1.0), np.nan),
    )


def _fast_size(least: int) -> int:
    """The smallest 2^n, 3 * 2^n or 5 * 2^n that is at least this, which transforms take quickly."""
    return min(factor << max(-(-least // factor) - 1, 0).bit_length() for factor in (1, 3, 5))
