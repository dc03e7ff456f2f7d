"""Clocks as logs have them: ticks since 1970, repeated stamps, stamps that run backwards.

An episode's series share one origin, the first stamp of the command or of the measurement, whichever comes
first: a log stamped in seconds since 1970 is stored as seconds since its own start, and the offset between its
series stays what it was.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int

from trueup.core.episode import Flag
from trueup.core.timeseries import TimeSeries
from trueup.errors import DataError

_SHORTEST_S = 1e-9
# A log that repeats more of its stamps has lost its clock.
_LEAST_KEPT = 0.2
_LATEST_S = 1e11  # 3,000 years; milliseconds since 1970 read as seconds are beyond it


def usable_clock(
    time_s: Float64[np.ndarray, "N"], *, source: str, series: str = "measured"
) -> tuple[Int[np.ndarray, "K"], tuple[Flag, ...]]:
    """Rows that form a strictly increasing clock: the first sample of every stamp.

    Args:
        time_s: raw stamps, (N,) [s].
        source: file (and topic) for the error message; rows are counted from 1.
        series: series that the flag is about, `measured` or `command`.

    Returns:
        Numbers of the rows to keep, (K,), K <= N, and a flag `repeated_stamps` if K < N.

    Raises:
        DataError: there is no stamp, one is not finite or beyond 1e11 s, nearly all repeat the one before, or the clock
            runs backwards.
    """
    if time_s.size == 0:
        raise DataError(f"{source} has no samples", expected="at least one row")
    finite = np.isfinite(time_s)
    if not finite.all():
        row = int(np.argmin(finite))
        raise DataError(f"{source} has a stamp that is not finite", got=f"{time_s[row]} in row {row + 1}")
    if np.abs(time_s).max() > _LATEST_S:
        raise DataError(
            f"{source} has stamps that no clock shows",
            got=f"{time_s[np.argmax(np.abs(time_s))]:.6g} s",
            expected=f"at most {_LATEST_S:.0g} s",
            hint="Is the unit of the time column right? Nanoseconds since 1970 read as seconds look like this.",
        )
    backwards = time_s[1:] < time_s[:-1]
    if backwards.any():
        row = int(np.argmax(backwards)) + 1
        raise DataError(
            f"the clock of {source} runs backwards",
            got=f"{time_s[row]:.9f} s after {time_s[row - 1]:.9f} s in row {row + 1}",
            hint="If another motion begins there, `split: {back: true}` in a mapping takes the file apart; else sort "
            "the log by time.",
        )
    rows = np.concatenate(([0], np.flatnonzero(time_s[1:] > time_s[:-1]) + 1))
    if rows.size > 1 and (step := float(np.median(np.diff(time_s[rows])))) < _SHORTEST_S:
        raise DataError(
            f"{source} has stamps that no clock shows",
            got=f"steps of {step:.3g} s",
            expected=f"at least {_SHORTEST_S:g} s",
            hint="Is the unit of the time column right?",
        )
    repeated = time_s.size - rows.size
    if not repeated:
        return rows, ()
    if rows.size < _LEAST_KEPT * time_s.size:
        raise DataError(
            f"{source}: nearly all samples have the stamp of the one before",
            got=f"{rows.size} stamps in {time_s.size} rows",
            hint="Is a part of the stamp missing? A mapping reads seconds and nanoseconds as `time: {columns: [sec, "
            "nanosec]}`, and a log without a clock by `time: {rate_hz: …}`. Stamps since 1970 need 64 bits.",
        )
    again = time_s[1:][time_s[1:] == time_s[:-1]]
    flag = Flag(
        kind="repeated_stamps",
        series=series,
        detail=f"{repeated} of {time_s.size} samples repeat the stamp before them; the first of each was kept",
        start_s=float(again[0]),
        end_s=float(again[-1]),
    )
    return rows, (flag,)


def seconds(ticks: Int[np.ndarray, "N"], *, origin: int, per_second: int) -> Float64[np.ndarray, "N"]:
    """Integer stamps as seconds since an origin, subtracted as integers so that nanoseconds survive.

    Args:
        ticks: stamps, (N,) [1 / per_second s], e.g. nanoseconds since 1970.
        origin: tick that becomes 0 s.
        per_second: ticks in a second, e.g. 1_000_000_000.
    """
    return np.asarray((ticks - np.asarray(origin, dtype=ticks.dtype)) / float(per_second), dtype=np.float64)


def common_origin(*clocks: Float64[np.ndarray, "_"] | Int[np.ndarray, "_"] | None) -> float | int:
    """The earliest first stamp of an episode's clocks; None and empty ones do not count.

    Raises:
        DataError: there is no stamp at all.
    """
    first: list[float | int] = [clock[0].item() for clock in clocks if clock is not None and clock.size]
    if not first:
        raise DataError("no series of the episode has a stamp")
    return min(first)


def shifted(series: TimeSeries, flags: tuple[Flag, ...], *, origin: float) -> tuple[TimeSeries, tuple[Flag, ...]]:
    """A series and its flags with the clock counted from `origin` [s]."""
    moved = tuple(
        replace(
            flag,
            start_s=None if flag.start_s is None else flag.start_s - origin,
            end_s=None if flag.end_s is None else flag.end_s - origin,
        )
        for flag in flags
    )
    return replace(series, time_s=series.time_s - origin), moved
