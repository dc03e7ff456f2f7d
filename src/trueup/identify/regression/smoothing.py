"""Low-passed signals and their derivatives, for regressions that need accelerations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64, Int
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from trueup.errors import ConfigError

_ORDER = 2  # of the Butterworth filter; it runs forth and back, which doubles it
_GAP_STEPS = 5.0  # a step of more than this many median steps ends a stretch
_FEWEST = 12  # samples of a stretch that can be differentiated twice
_UNUSUAL = 6.0  # times the median, which is four standard deviations of normal noise
_MOST_OF_RATE = 0.4  # above this share of the rate a low-pass does nothing that can be relied on


class Smoothed(NamedTuple):
    """A signal behind a zero-phase low-pass, (T, J) each.

    Attributes:
        value: the low-passed signal; NaN where it has no stretch of samples around it.
        first: its first time derivative; NaN also within half a period of the cutoff from the ends of a stretch,
            where the filter has no data on one side.
        second: its second time derivative; NaN likewise.
    """

    value: Float64[np.ndarray, "T J"]
    first: Float64[np.ndarray, "T J"]
    second: Float64[np.ndarray, "T J"]


def smooth(values: Float[np.ndarray, "T J"], time_s: Float64[np.ndarray, "T"], *, cutoff_hz: float) -> Smoothed:
    """Low-pass (Butterworth, forth and back) and differentiate (quintic spline).

    The filter needs even steps, so each stretch is brought onto an even grid of its median step by a cubic spline
    and back; missing samples and gaps of the clock end a stretch, so that nothing is interpolated across them.

    Args:
        values: shape (T, J); NaN is a missing sample.
        time_s: clock [s], may jitter.
        cutoff_hz: half-power frequency [Hz]; lower takes more noise out of the acceleration, and below about five
            times the fastest motion it takes the motion as well. At or above 0.4 of the rate nothing is filtered.

    Raises:
        ConfigError: the cutoff is not above 0.
    """
    if not 0.0 < cutoff_hz < np.inf:
        raise ConfigError("the cutoff of the low-pass [Hz]", got=cutoff_hz, expected="above 0")
    result = np.full((3, *values.shape), np.nan)
    finite = np.isfinite(values)
    whole = finite.all(axis=0)
    columns = [np.flatnonzero(whole), *(np.array([column]) for column in np.flatnonzero(~whole))]
    for group in columns:
        if group.size:
            _smooth_group(values, time_s, finite[:, group[0]], group, cutoff_hz, result)
    return Smoothed(*result)


def without_noise(
    raw: Float64[np.ndarray, "T J"], low_passed: Float64[np.ndarray, "T J"]
) -> Float64[np.ndarray, "T J"]:
    """The low-passed signal where the filter took noise away, the raw one where it took motion away.

    A servo's step response is faster than the low-pass; there the two differ by more than the usual noise. Where
    there is no low-passed value, the result is NaN.
    """
    taken = np.abs(raw - low_passed)
    known = np.isfinite(taken)
    usual = np.array(
        [np.median(column[here]) if here.any() else 0.0 for column, here in zip(taken.T, known.T, strict=True)]
    )
    return np.where(taken > _UNUSUAL * usual, raw, low_passed)


def _smooth_group(
    values: Float[np.ndarray, "T J"],
    time_s: Float64[np.ndarray, "T"],
    present: np.ndarray,
    columns: Int[np.ndarray, "K"],
    cutoff_hz: float,
    result: Float64[np.ndarray, "3 T J"],
) -> None:
    for rows in _stretches(time_s, present):
        clock = time_s[rows]
        part = _smooth_stretch(values[np.ix_(rows, columns)].astype(np.float64), clock, cutoff_hz)
        edge = 0.5 / cutoff_hz
        inner = (clock >= clock[0] + edge) & (clock <= clock[-1] - edge)
        part[1:, ~inner] = np.nan
        result[np.ix_(np.arange(3), rows, columns)] = part


def _stretches(time_s: Float64[np.ndarray, "T"], present: np.ndarray) -> list[Int[np.ndarray, "N"]]:
    rows = np.flatnonzero(present)
    if rows.size < _FEWEST:
        return []
    steps = np.diff(time_s[rows])
    cuts = np.flatnonzero((np.diff(rows) > 1) | (steps > _GAP_STEPS * np.median(steps))) + 1
    return [part for part in np.split(rows, cuts) if part.size >= _FEWEST]


def _smooth_stretch(
    values: Float64[np.ndarray, "N K"], clock: Float64[np.ndarray, "N"], cutoff_hz: float
) -> Float64[np.ndarray, "3 N K"]:
    step = float(np.median(np.diff(clock)))
    count = max(round((clock[-1] - clock[0]) / step) + 1, _FEWEST)
    grid = np.linspace(clock[0], clock[-1], count)
    even = count == clock.size and np.abs(grid - clock).max() < 1e-3 * step
    signal = values if even else make_interp_spline(clock, values, k=3)(grid)
    rate = (count - 1) / (grid[-1] - grid[0])
    if cutoff_hz < _MOST_OF_RATE * rate:
        sections = butter(_ORDER, cutoff_hz, fs=rate, output="sos")
        signal = sosfiltfilt(sections, signal, axis=0, padlen=min(count - 1, round(2.0 * rate / cutoff_hz)))
    spline = make_interp_spline(grid, signal, k=5)
    return np.stack([spline(clock), spline.derivative(1)(clock), spline.derivative(2)(clock)])
