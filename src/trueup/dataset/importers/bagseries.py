"""Messages of a topic turned into one series: which clock, which rows, which columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64

from trueup.core.episode import Flag
from trueup.core.timeseries import TimeSeries, same_units
from trueup.core.units import SI_UNIT
from trueup.dataset.importers.clock import seconds, usable_clock
from trueup.dataset.importers.parts import on_one_clock
from trueup.dataset.importers.samples import NS_PER_S, Samples

# Header and log clocks further apart than any transport delay: one of them is simulated time or not synchronized.
_APART_NS = NS_PER_S // 2
# Stamps that jump back further than messages overtake each other: the clock was set.
_RESET_NS = NS_PER_S

Clocks = list[list[Int64[np.ndarray, "_"]]]


def choose_clocks(groups: Sequence[Sequence[Samples]]) -> tuple[Clocks, Flag]:
    """One clock for all series: header stamps where they can be used, else the time of recording.

    Args:
        groups: the samples of the measured topic and of the command's, if there is one.

    Returns:
        For each series, the stamps of each of its groups [ns]; and a flag that says which clock they are.
    """
    log = [[group.log_ns for group in series] for series in groups]
    stamps = [[group.stamp_ns for group in series] for series in groups]
    stamped = [all(bool(np.all(clock)) for clock in series) for series in stamps]
    if not stamped[0]:
        return log, _clock_flag("header stamps are not set: times are those of the recorder", "note")
    usable = [series for series, has in zip(stamps, stamped, strict=True) if has]
    back = min((int(np.diff(clock).min()) for series in usable for clock in series if clock.size > 1), default=0)
    if back < -_RESET_NS:
        return log, _clock_flag(f"header stamps jump back by {-back / 1e9:.3g} s: times are those of the recorder")
    late = [
        float(np.median(np.concatenate(log_ns) - np.concatenate(stamp))) if has else 0.0
        for log_ns, stamp, has in zip(log, stamps, stamped, strict=True)
    ]
    apart = max(late) - min(late)
    if apart > _APART_NS:
        detail = f"the clocks of command and measured are {apart / 1e9:.3g} s apart: times are those of the recorder"
        return log, _clock_flag(detail)
    if not all(stamped):
        return [stamps[0], log[1]], _clock_flag("measured: header stamps; command: times of the recorder", "note")
    return stamps, _clock_flag("times are header stamps", "note")


def _clock_flag(detail: str, severity: str = "warning") -> Flag:
    return Flag(kind="clock", detail=detail, severity=severity)


def measured_series(
    groups: Sequence[Samples], clocks: Sequence[Int64[np.ndarray, "_"]], origin: int, source: str
) -> tuple[TimeSeries, tuple[Flag, ...]]:
    """The samples of a topic on one clock, columns by name.

    Messages that share joints are rows of one table, with NaN where a message lacks a joint. Sets of joints that
    never share a message come from different publishers: they are interpolated onto the clock of the largest.

    Raises:
        DataError: publishers of different joints were never active at the same time.
    """
    parts: list[TimeSeries] = []
    flags: tuple[Flag, ...] = ()
    for members in _components(groups):
        part, new = _table([groups[k] for k in members], [clocks[k] for k in members], origin, source, "measured")
        parts.append(part)
        flags += new
    parts.sort(key=lambda part: (-len(part.joints), -len(part)))
    series = on_one_clock(parts)
    if len(parts) > 1:
        others = "; ".join(", ".join(part.joints) for part in parts[1:])
        cut = len(parts[0]) - len(series)
        detail = f"published apart from {', '.join(parts[0].joints)} and interpolated onto its clock: {others}"
        detail += f"; {cut} of {len(parts[0])} samples have no counterpart and were left out" if cut else ""
        severity = "warning" if cut > len(parts[0]) // 10 else "note"
        flags += (Flag(kind="merged_clocks", detail=detail, severity=severity),)
    return series, flags


def command_series(
    groups: Sequence[Samples], clocks: Sequence[Int64[np.ndarray, "_"]], origin: int, source: str
) -> tuple[TimeSeries, tuple[Flag, ...]]:
    """The commands of a topic on one clock, columns by name.

    A command holds until the next one, so a joint that a message leaves out keeps its last value; it is NaN
    before its first.
    """
    return _table(groups, clocks, origin, source, "command")


def _components(groups: Sequence[Samples]) -> list[list[int]]:
    """Numbers of the groups that belong together because they share joints, directly or through others."""
    components: list[tuple[set[str], list[int]]] = []
    for number, group in enumerate(groups):
        joints, members = set(group.joints), [number]
        apart = []
        for other in components:
            if joints & other[0]:
                joints |= other[0]
                members += other[1]
            else:
                apart.append(other)
        components = [*apart, (joints, members)]
    return [sorted(members) for _, members in components]


def _table(
    groups: Sequence[Samples], clocks: Sequence[Int64[np.ndarray, "_"]], origin: int, source: str, series: str
) -> tuple[TimeSeries, tuple[Flag, ...]]:
    """Rows in the order of time; groups are merged by joint name, and at equal stamps into one row."""
    joints = tuple(dict.fromkeys(name for group in groups for name in group.joints))
    names = tuple(dict.fromkeys(signal for group in groups for signal in group.signals))
    if len(groups) == 1:
        order = np.argsort(clocks[0], kind="stable")
        ticks = clocks[0][order]
        rows, flags = usable_clock(seconds(ticks, origin=origin, per_second=NS_PER_S), source=source, series=series)
        ticks = ticks[rows]
        signals = {name: groups[0].signals[name][order[rows]] for name in names}
    else:
        ticks, flags = np.unique(np.concatenate(clocks)), ()
        signals = {name: _merged(groups, clocks, ticks, joints, name, hold=series == "command") for name in names}
    overtaken = sum(int(np.count_nonzero(np.diff(clock) < 0)) for clock in clocks)
    if overtaken:
        detail = f"{overtaken} messages of {source} were recorded out of order; they are sorted by their stamps"
        flags += (Flag(kind="unordered_stamps", series=series, detail=detail, severity="note"),)
    return (
        TimeSeries(
            time_s=seconds(ticks, origin=origin, per_second=NS_PER_S),
            joints=joints,
            signals=signals,
            units=same_units({name: SI_UNIT[name] for name in names}, joints),
        ),
        flags,
    )


def _merged(
    groups: Sequence[Samples],
    clocks: Sequence[Int64[np.ndarray, "_"]],
    ticks: Int64[np.ndarray, "T"],
    joints: Sequence[str],
    signal: str,
    *,
    hold: bool,
) -> Float64[np.ndarray, "T J"]:
    values = np.full((ticks.size, len(joints)), np.nan)
    written = np.zeros(values.shape, dtype=bool)
    for group, clock in zip(groups, clocks, strict=True):
        if signal in group.signals:
            # Backwards, so that of several samples with one stamp the first stays, as everywhere else.
            columns = np.array([joints.index(name) for name in group.joints])
            cells = np.ix_(np.searchsorted(ticks, clock[::-1]), columns)
            values[cells] = group.signals[signal][::-1]
            written[cells] = True
    if hold:
        last = np.maximum.accumulate(np.where(written, np.arange(ticks.size)[:, np.newaxis], 0), axis=0)
        values = np.take_along_axis(values, last, axis=0)
    return values
