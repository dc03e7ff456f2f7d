"""Derivatives over a clock that jitters, never across the start of a segment."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int


def gradient(
    values: Float64[np.ndarray, "T J"], time_s: Float64[np.ndarray, "T"], starts: Int[np.ndarray, "S"]
) -> Float64[np.ndarray, "T J"]:
    """First derivative: central differences of second order with the actual stamps, one-sided at segment ends.

    Within a segment this is `numpy.gradient(values, time_s, axis=0)`. A row that is alone in its segment is NaN.
    A NaN sample makes the derivative NaN there and at its neighbors.

    Args:
        values: shape (T, J).
        time_s: clock, strictly increasing [s].
        starts: first row of each segment, increasing, the first is 0.
    """
    rows = len(values)
    result = np.full(values.shape, np.nan)
    if rows < 2:
        return result
    step = np.diff(time_s)[:, None]
    slope = np.diff(values, axis=0) / step
    result[1:-1] = (step[1:] * slope[:-1] + step[:-1] * slope[1:]) / (step[1:] + step[:-1])
    ends = np.append(starts[1:], rows) - 1
    longer = starts < ends
    result[starts[longer]] = slope[starts[longer]]
    result[ends[longer]] = slope[ends[longer] - 1]
    result[starts[~longer]] = np.nan
    return result


def second_difference(
    values: Float64[np.ndarray, "T J"], time_s: Float64[np.ndarray, "T"], starts: Int[np.ndarray, "S"]
) -> Float64[np.ndarray, "T J"]:
    """Second derivative from three neighboring samples with the actual stamps; NaN at both ends of a segment.

    For a uniform step h this is `(q[t+1] - 2 q[t] + q[t-1]) / h^2`.

    Args:
        values: shape (T, J).
        time_s: clock, strictly increasing [s].
        starts: first row of each segment, increasing, the first is 0.
    """
    rows = len(values)
    result = np.full(values.shape, np.nan)
    if rows < 3:
        return result
    step = np.diff(time_s)[:, None]
    slope = np.diff(values, axis=0) / step
    result[1:-1] = 2.0 * np.diff(slope, axis=0) / (step[1:] + step[:-1])
    result[starts] = np.nan
    result[np.append(starts[1:], rows) - 1] = np.nan
    return result
