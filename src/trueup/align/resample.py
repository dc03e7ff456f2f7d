"""Series on other clocks: interpolation, holding, common grids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.core.hold import SAME_INSTANT_S, held_rows
from trueup.core.timeseries import TimeSeries
from trueup.errors import DataError


def resample(
    series: TimeSeries, time_s: Float64[np.ndarray, "N"], *, hold: bool = False, clip: bool = False
) -> TimeSeries:
    """The series at other times; identity at its own stamps.

    Measured signals are interpolated linearly, rotations along the shortest arc (slerp), so that they stay
    rotations. With `hold` every value, rotations included, stays until the next stamp, as a command does. A NaN
    reaches only the times between its two neighbors.

    There is no low-pass before a coarser grid: comparing two series asks that both are treated alike, and both are
    resampled here; what lies above half the new rate (torque noise) folds into the result.

    Args:
        series: signals on their own clock, T samples.
        time_s: new clock, shape (N,) [s], strictly increasing.
        hold: zero-order hold instead of interpolation, for commands.
        clip: leave out times outside the series instead of raising; never extrapolates. A held series lasts beyond
            its last stamp, so only times before its first are outside.

    Raises:
        DataError: a time is outside the series (with `clip`: all of them are).
    """
    clock = series.time_s
    inside = (time_s >= clock[0] - SAME_INSTANT_S * hold) & ((time_s <= clock[-1]) | hold)
    if clip:
        time_s = time_s[inside]
    outside = time_s.size == 0 if clip else not np.all(inside)
    if outside:
        raise DataError(
            "times outside the series",
            got="no common time" if clip else f"{np.sum(~inside)} of {inside.size} times",
            expected=f"{clock[0]:.9g} to {clock[-1]:.9g} s",
            hint="There is no extrapolation: take a grid from common_grid, or pass clip=True.",
        )
    before, weight = _brackets(clock, time_s)
    if hold:
        before = np.maximum(held_rows(clock, time_s), 0)
        signals = {name: values[before] for name, values in series.signals.items()}
    else:
        signals = {
            name: _slerp(values, before, weight) if name == "body.rotation" else _linear(values, before, weight)
            for name, values in series.signals.items()
        }
    return replace(series, time_s=time_s, signals=signals)


def common_grid(*series: TimeSeries, rate_hz: float) -> Float64[np.ndarray, "N"]:
    """A uniform clock [s] over the time that all series cover.

    Raises:
        DataError: the series have no time in common, or the rate is not above 0.
    """
    if not (rate_hz > 0.0 and np.isfinite(rate_hz)):
        raise DataError("the rate of the grid [Hz]", got=rate_hz, expected="above 0")
    start = max(one.time_s[0] for one in series)
    end = min(one.time_s[-1] for one in series)
    if end < start:
        raise DataError(
            "the series have no time in common",
            got=f"the latest starts at {start:.9g} s, the first to end ends at {end:.9g} s",
        )
    grid = start + np.arange(int((end - start) * rate_hz + 1e-6) + 1) / rate_hz
    return np.asarray(np.minimum(grid, end), dtype=np.float64)


def _brackets(
    clock: Float64[np.ndarray, "T"], time_s: Float64[np.ndarray, "N"]
) -> tuple[Int[np.ndarray, "N"], Float64[np.ndarray, "N"]]:
    if clock.size == 1:
        return np.zeros(time_s.size, dtype=np.intp), np.zeros(time_s.size)
    before = np.clip(np.searchsorted(clock, time_s, side="right") - 1, 0, clock.size - 2)
    return before, (time_s - clock[before]) / (clock[before + 1] - clock[before])


def _linear(
    values: Float[np.ndarray, "T ..."], before: Int[np.ndarray, "N"], weight: Float64[np.ndarray, "N"]
) -> Float[np.ndarray, "N ..."]:
    low, high = values[before], values[np.minimum(before + 1, len(values) - 1)]
    share = weight.reshape(-1, *(1,) * (values.ndim - 1))
    mixed = low + share * (high - low)
    # 0 * NaN is NaN: a stamp that is hit exactly must not feel its neighbor.
    return np.asarray(np.where(share == 0.0, low, np.where(share == 1.0, high, mixed)), dtype=values.dtype)


def _slerp(
    values: Float[np.ndarray, "T B 3 3"], before: Int[np.ndarray, "N"], weight: Float64[np.ndarray, "N"]
) -> Float[np.ndarray, "N B 3 3"]:
    from scipy.spatial.transform import Rotation  # takes 0.1 s that most series do not need

    low, high = values[before], values[np.minimum(before + 1, len(values) - 1)]
    result = np.where((weight == 1.0)[:, None, None, None], high, low)
    between = (weight > 0.0) & (weight < 1.0)
    known = between[:, None] & np.isfinite(low).all(axis=(2, 3)) & np.isfinite(high).all(axis=(2, 3))
    result[between[:, None] & ~known] = np.nan
    if known.any():
        start = Rotation.from_matrix(low[known])
        step = (start.inv() * Rotation.from_matrix(high[known])).as_rotvec()
        share = np.broadcast_to(weight[:, None], known.shape)[known]
        result[known] = (start * Rotation.from_rotvec(step * share[:, None])).as_matrix()
    return np.asarray(result)
