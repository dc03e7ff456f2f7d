"""Where a motion starts: mean-shift detection, and cross-correlation as the alternative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from trueup.core.timeseries import TimeSeries
from trueup.errors import DataError, NotIdentifiable

# Of the largest travel of a joint: what moves less does not start. A simulation without noise never rests exactly.
_SLIGHTEST = 2e-5
# Shortest rest before a motion, and length of the window [s], at least 10 samples each: those of the thesis at 100 Hz.
_REST_S = 0.1
# Standard deviations. The thesis's 1.6 is left by chance once in ten samples; where the sample before the start does,
# the start is dated too early.
_FACTOR = 4.0


@dataclass(frozen=True)
class StartDetection:
    """Where a series starts to change.

    Attributes:
        row: first row of the window in which every sample has left its past; None if there is none.
        mean: mean of all samples before that row (of the whole series if none was found).
        deviation: their standard deviation.
    """

    row: int | None
    mean: float
    deviation: float

    @property
    def found(self) -> bool:
        """Whether there is a start."""
        return self.row is not None


def detect_start(
    values: Float[np.ndarray, "T"], *, initial: int = 10, window: int = 10, factor: float = 1.6, resolution: float = 0.0
) -> StartDetection:
    """First window of which every sample lies outside mean +- factor * deviation of everything before it.

    LSTM thesis, Algorithm 2; the defaults are its values at 100 Hz. One pass of cumulative sums gives all means and
    deviations, `window` passes the comparison: O(window * T) without a Python loop over samples.

    Where the past is constant (deviation 0, e.g. a resting encoder) any strict change counts; `resolution` asks for
    more than that.

    Args:
        values: one indicator, finite, e.g. a joint's position.
        initial: shortest past, in samples; fewer make the deviation unreliable.
        window: samples in a row that must have left; fewer react to outliers, more miss short motions.
        factor: standard deviations; lower reacts to noise, higher finds slow starts late.
        resolution: a sample has left only if it is also farther than this from the mean, e.g. one encoder step.

    Raises:
        DataError: a value is not finite, or a length is below 1 (`initial` below 2).
    """
    if initial < 2 or window < 1:
        raise DataError("start detection", got=f"initial={initial}, window={window}", expected="at least 2 and 1")
    if not np.all(np.isfinite(values)):
        raise DataError("start detection needs finite values", got=f"row {int(np.argmin(np.isfinite(values)))}")
    # Sums of squares cancel badly far from zero; relative to the first value a resting series is exactly 0.
    shifted = values.astype(np.float64) - (float(values[0]) if values.size else 0.0)
    count = np.arange(1, shifted.size + 1)
    mean = np.cumsum(shifted) / count
    deviation = np.sqrt(np.maximum(np.cumsum(shifted**2) / count - mean**2, 0.0))
    pasts = shifted.size - window - initial + 1
    row = None
    if pasts > 0:
        past = slice(initial - 1, initial - 1 + pasts)
        center, bound = mean[past], factor * deviation[past]
        nearest = np.full(pasts, np.inf)
        for ahead in range(window):
            np.minimum(nearest, np.abs(shifted[initial + ahead : initial + ahead + pasts] - center), out=nearest)
        left = (nearest >= bound) & (nearest > resolution)
        row = initial + int(np.argmax(left)) if left.any() else None
    last = (row or shifted.size) - 1
    if last < 0:
        return StartDetection(None, float("nan"), float("nan"))
    return StartDetection(row, float(mean[last] + values[0]), float(deviation[last]))


def detect_motion_start(series: TimeSeries) -> StartDetection:
    """Row at which a robot leaves its rest: that of the joint which leaves it first.

    The thesis averages the positions over the joints, in which joints that move against each other cancel. Rows with
    NaN count as the last value before them. A sample counts as moved only beyond one and a half encoder steps, so that
    a reading that flickers between two steps is a rest, and beyond 0.002 % of the largest travel.

    Args:
        series: with positions, (T, J).

    Raises:
        MissingSignal: there are no positions.
        DataError: they start with NaN.
    """
    columns = held_over_nan(series["position"].astype(np.float64))
    samples = max(10, round(_REST_S * series.rate_hz))
    slightest = _SLIGHTEST * float(np.ptp(columns, axis=0).max())
    found = [
        detect_start(
            column, initial=samples, window=samples, factor=_FACTOR, resolution=max(1.5 * quantum(column), slightest)
        )
        for column in columns.T
    ]
    return min(found, key=lambda start: len(series) if start.row is None else start.row)


def align_starts(measured: TimeSeries, simulated: TimeSeries) -> float:
    """How much later the measured motion starts than the simulated one [s]; subtract it from the measured clock.

    Raises:
        NotIdentifiable: one of the two never leaves its rest, or does not start with one.
    """
    starts = {}
    for name, series in (("measured", measured), ("simulated", simulated)):
        start = detect_motion_start(series)
        if start.row is None:
            hint = "Without a rest before the motion use shift_by_cross_correlation or estimate_delay."
            raise NotIdentifiable(f"the {name} series has no start of motion", hint=hint)
        starts[name] = float(series.time_s[start.row])
    return starts["measured"] - starts["simulated"]


def shift_by_cross_correlation(a: Float[np.ndarray, "T"], b: Float[np.ndarray, "T"], *, max_shift: int) -> int:
    """Samples by which `a` comes later than `b`: the s that maximizes Pearson's correlation of a[i] and b[i - s].

    Better than a start where there is none (periodic motions) or noise hides it; worse where the two differ in shape,
    since a slower rise counts as a later one.

    Args:
        a: one signal on a uniform clock.
        b: the other, on the same clock.
        max_shift: search limit on both sides, in samples; at least half of the samples must stay in common.

    Raises:
        DataError: `max_shift` leaves too few samples.
        NotIdentifiable: one of the two is constant.
    """
    count = a.size
    if not 0 <= max_shift <= count // 2:
        raise DataError("max_shift [samples]", got=max_shift, expected=f"0 to {count // 2}")
    first, second = a.astype(np.float64) - a.mean(), b.astype(np.float64) - b.mean()
    if not (np.ptp(a) > 0.0 and np.ptp(b) > 0.0):
        raise NotIdentifiable("a constant signal has no shift")
    shifts = np.arange(-max_shift, max_shift + 1)
    from scipy.signal import correlate  # takes 0.3 s to load, which most commands do not need

    products = correlate(first, second, mode="full", method="fft")[shifts + count - 1]
    late, early = np.maximum(shifts, 0), np.maximum(-shifts, 0)
    common = count - np.abs(shifts)
    sum_a, energy_a = _over(first, late, count - early), _over(first**2, late, count - early)
    sum_b, energy_b = _over(second, early, count - late), _over(second**2, early, count - late)
    spread_a, spread_b = energy_a - sum_a**2 / common, energy_b - sum_b**2 / common
    # What is left of a signal that rests at its end can be next to nothing and would be divided by.
    enough = (spread_a > 1e-3 * np.sum(first**2)) & (spread_b > 1e-3 * np.sum(second**2))
    norm = np.sqrt(np.where(enough, spread_a * spread_b, 1.0))
    score = np.where(enough, (products - sum_a * sum_b / common) / norm, -np.inf)
    return int(shifts[np.argmax(score)])


def _over(
    values: Float[np.ndarray, "T"], start: Int[np.ndarray, "K"], end: Int[np.ndarray, "K"]
) -> Float[np.ndarray, "K"]:
    """Sums of values[start:end]."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[end] - total[start])


def quantum(values: Float[np.ndarray, "T"]) -> float:
    """Smallest step between neighbors: an encoder's resolution, next to nothing for continuous values, 0 for none."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > 1e-9 * max(float(np.max(np.abs(values), initial=0.0)), 1e-12)]
    return float(steps.min()) if steps.size else 0.0


def held_over_nan(values: Float[np.ndarray, "T J"]) -> Float[np.ndarray, "T J"]:
    """The values with each one that is not finite replaced by the last finite one before it.

    Raises:
        DataError: a column starts with one.
    """
    finite = np.isfinite(values)
    if finite.all():
        return values
    if not finite[0].all():
        raise DataError("a signal starts without a finite value", got=f"columns {np.flatnonzero(~finite[0]).tolist()}")
    rows = np.maximum.accumulate(np.where(finite, np.arange(len(values))[:, None], 0), axis=0)
    return np.asarray(np.take_along_axis(values, rows, axis=0))
