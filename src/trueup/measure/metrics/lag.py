"""Phase lag between two motions, joint by joint."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.measure.columns import paired
from trueup.measure.correlation import cross_correlation, find_peak
from trueup.measure.metrics.base import MAX_LAG_S, Metric

MIN_CORRELATION = 0.5


def phase_lag(
    measured: Float[np.ndarray, "T J"],
    source: Float[np.ndarray, "T J"],
    time_s: Float64[np.ndarray, "T"],
    *,
    starts: Int[np.ndarray, "S"] | None = None,
    max_lag_s: float = MAX_LAG_S,
    min_correlation: float = MIN_CORRELATION,
) -> Float64[np.ndarray, "J"]:
    """The lag [s] with `measured(t) = source(t - lag)`, shape (J,): positive when the measured motion comes later.

    With the simulated motion as source it is the lag of the robot behind the simulation (negative: the simulation
    is slower); with the command as source it is the lag from command to motion. The largest normalized
    cross-correlation of the two velocities, refined by a parabola. Lags beyond half of a segment cannot be seen.

    NaN where there is no such lag: a joint that rests, a peak below `min_correlation`, or no peak within
    `max_lag_s`. Samples that are not finite in either series are bridged by straight lines in both.

    Args:
        measured: positions, shape (T, J).
        source: positions on the same clock, shape (T, J).
        time_s: common clock [s].
        starts: first row of each segment; None for one segment.
        max_lag_s: search limit in both directions [s]; must exceed the true lag.
        min_correlation: lower values report a lag also for motions that hardly resemble each other.
    """
    begin = np.zeros(1, dtype=np.int64) if starts is None else starts
    if len(time_s) < 3:
        return np.full(measured.shape[1], np.nan)
    step = float(np.median(np.diff(time_s)))
    both = _bridged(np.concatenate(paired(measured, source), axis=1), time_s)
    velocity, begin = _velocity(both, time_s, begin, step)
    longest = int(np.diff(np.append(begin, len(velocity))).max())
    max_lag = max(min(int(np.ceil(max_lag_s / step)) + 1, longest - 1), 1)
    joints = measured.shape[1]
    peak = find_peak(cross_correlation(velocity[:, joints:], velocity[:, :joints], begin, max_lag=max_lag))
    lag = peak.lag * step
    trusted = (peak.height >= min_correlation) & (np.abs(lag) <= max_lag_s)
    return np.where(trusted, lag, np.nan)


def _bridged(values: Float64[np.ndarray, "T K"], time_s: Float64[np.ndarray, "T"]) -> Float64[np.ndarray, "T K"]:
    """Missing samples interpolated, a column without any sample zero: left out, they would favor a lag of 0."""
    missing = np.isnan(values)
    if not missing.any():
        return values
    result = np.where(missing.all(axis=0), 0.0, values)
    for column in np.flatnonzero(missing.any(axis=0) & ~missing.all(axis=0)):
        known = ~missing[:, column]
        result[:, column] = np.interp(time_s, time_s[known], values[known, column])
    return result


def _velocity(
    values: Float64[np.ndarray, "T K"], time_s: Float64[np.ndarray, "T"], starts: Int[np.ndarray, "S"], step: float
) -> tuple[Float64[np.ndarray, "N K"], Int[np.ndarray, "S2"]]:
    """Differences on a uniform grid inside each segment, and the rows at which the segments start now."""
    ends = np.append(starts[1:], len(time_s))
    counts = np.floor((time_s[ends - 1] - time_s[starts]) / step + 1e-6).astype(np.int64)
    long_enough = counts > 0
    starts, ends, counts = starts[long_enough], ends[long_enough], counts[long_enough]
    segment = np.repeat(np.arange(len(starts)), counts + 1)
    first_row = np.concatenate([[0], np.cumsum(counts + 1)[:-1]])
    tick = np.arange(len(segment)) - first_row[segment]
    grid = np.minimum(time_s[starts][segment] + tick * step, time_s[ends - 1][segment])
    right = np.clip(np.searchsorted(time_s, grid, side="left"), starts[segment] + 1, ends[segment] - 1)
    weight = (grid - time_s[right - 1]) / (time_s[right] - time_s[right - 1])
    series = np.ascontiguousarray(values.T)
    left = series[:, right - 1]
    velocity = (np.diff(left + weight * (series[:, right] - left), axis=-1) / step).T
    return velocity[segment[1:] == segment[:-1]], first_row - np.arange(len(starts))


METRICS = (
    Metric(
        "phase_lag",
        lambda s: phase_lag(s.measured, s.simulated, s.time_s, starts=s.starts, max_lag_s=s.options.max_lag_s),
        "the lag with m(t) = s(t - lag): largest correlation of the two velocities, up to 0.5 s",
        "named in GapONet, section 3.2",
        unit="s",
        lower_is_better=None,
        signals=("position",),
        bounds=(-math.inf, math.inf),
        needs_motion=True,
    ),
)
