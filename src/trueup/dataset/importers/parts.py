"""Parts of a robot that were logged with clocks of their own, e.g. two arms, brought onto one clock."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.interpolation import columns_at
from trueup.core.timeseries import TimeSeries
from trueup.errors import DataError, NameMismatch


def on_one_clock(parts: Sequence[TimeSeries]) -> TimeSeries:
    """All joints of the parts on the clock of the first part.

    The first part keeps its samples; the others are interpolated linearly at its stamps. Stamps of the first
    part that lie before the start or after the end of another part are left out: nothing is extrapolated. A
    signal that a part does not have is NaN for its joints.

    Args:
        parts: series with different joints and one unit of time and origin.

    Raises:
        NameMismatch: a joint is in two parts.
        DataError: at no stamp of the first part all others have data.
    """
    first, *others = parts
    if not others:
        return first
    for number, part in enumerate(others, start=1):
        before = [name for other in parts[:number] for name in other.joints]
        if set(before) & set(part.joints):
            raise NameMismatch("parts of a robot share joints", left=before, right=part.joints, right_name="and")
    start = max(float(part.time_s[0]) for part in parts)
    end = min(float(part.time_s[-1]) for part in parts)
    rows = np.flatnonzero((first.time_s >= start) & (first.time_s <= end))
    if rows.size == 0:
        ranges = "; ".join(f"{part.joints[0]}…: {part.time_s[0]:.6g} to {part.time_s[-1]:.6g} s" for part in parts)
        raise DataError("the clocks of the robot's parts do not overlap", got=ranges)
    time_s = first.time_s[rows]
    kept = first.rows(rows)
    signals = {}
    names = list(dict.fromkeys(name for part in parts for name in part.signals))
    for name in names:
        columns = [kept[name] if name in kept else np.full((rows.size, len(kept.joints)), np.nan)]
        columns += [_at(part, name, time_s) for part in others]
        signals[name] = np.concatenate(columns, axis=1)
    return TimeSeries(
        time_s=time_s,
        joints=tuple(joint for part in parts for joint in part.joints),
        signals=signals,
        units={name: tuple(unit for part in parts for unit in _units(part, name, parts)) for name in names},
    )


def _at(part: TimeSeries, signal: str, time_s: Float64[np.ndarray, "K"]) -> Float[np.ndarray, "K J"]:
    if signal not in part:
        return np.full((time_s.size, len(part.joints)), np.nan)
    return columns_at(time_s, part.time_s, part[signal])


def _units(part: TimeSeries, signal: str, parts: Sequence[TimeSeries]) -> tuple[str, ...]:
    if signal in part:
        return part.units[signal]
    unit = next(other.units[signal][0] for other in parts if signal in other)
    return (unit,) * len(part.joints)
