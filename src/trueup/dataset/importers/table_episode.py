"""One episode from tables: their columns as series, each on its own clock."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int, Shaped

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.core.units import conversion
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.clock import common_origin, seconds, usable_clock
from trueup.dataset.importers.files import episode_id, files_hash, inside
from trueup.dataset.importers.mapping import COMPONENTS, SplitRule, TableMapping
from trueup.dataset.importers.parts import on_one_clock
from trueup.dataset.importers.pattern import matches
from trueup.dataset.importers.tables import ArrayTable, Table, open_table
from trueup.dataset.importers.text_table import split_component
from trueup.dataset.importers.units import override_units
from trueup.errors import ConfigError, DataError, NameMismatch

Rows = Int[np.ndarray, "N"]


@dataclass(frozen=True)
class TableEpisode:
    """The files of one episode.

    Attributes:
        meta: what is known before they are read.
        series: series name -> path below the imported folder.
        part: number of the motion in its file, where a file has several; None for all of it.
        group: of the arrays in the file; empty for all of them.
    """

    meta: EpisodeMeta
    series: Mapping[str, str]
    part: int | None = None
    group: str = ""


def parts_of(root: Path, files: TableEpisode, mapping: TableMapping) -> list[TableEpisode]:
    """The motions in the files of an episode, which the mapping's `split` takes apart.

    Raises:
        ConfigError: the series are in files of their own.
        DataError: a file cannot be used.
    """
    if mapping.split is None and not mapping.group:
        return [files]
    names = set(files.series.values())
    if len(names) > 1:
        raise ConfigError(
            f"{mapping.name}: split and group take one file apart, in which all series are",
            got=", ".join(sorted(names)),
        )
    table = open_table(inside(root, root / names.pop()), mapping)
    if mapping.group:
        return [
            TableEpisode(replace(files.meta, id=episode_id(f"{files.meta.id}/{group}")), files.series, group=group)
            for group in _groups(table, mapping)
        ]
    labels = [name for name, _ in _split_rows(table, mapping)]
    return [
        TableEpisode(replace(files.meta, id=episode_id(f"{files.meta.id}/{label}")), files.series, part)
        for part, label in enumerate(labels)
    ]


def load_episode(root: Path, files: TableEpisode, mapping: TableMapping, options: ImportOptions) -> Episode:
    """Read the files of one episode.

    Raises:
        DataError: a file cannot be used; the message has its line.
        NameMismatch: a column is missing.
        UnitError: a unit that the user stated is unknown.
    """
    paths = {name: inside(root, root / name) for name in dict.fromkeys(files.series.values())}
    tables = {name: _table(path, mapping, files.group) for name, path in paths.items()}
    there = {series: name for series, name in files.series.items() if _load(tables[name], mapping, series)}
    part = None
    if files.part is not None:
        (table,) = tables.values()
        part = _split_rows(table, mapping)[files.part][1]
    loaded = {series: _Loaded(tables[name], mapping, series, part) for series, name in there.items()}
    for series, name in there.items():
        others = [loaded[other].filled for other, place in there.items() if other != series and place == name]
        loaded[series].leave_to(others)
    clocks = _clocks(loaded, mapping)
    done = {series: own.series(clocks[series], options) for series, own in loaded.items()}
    cut = [Flag(kind="cut_file", severity="note", detail=table.cut) for table in tables.values() if table.cut]
    meta = replace(
        files.meta,
        source_hash=files_hash(
            own
            for table in tables.values()
            for own in (table.files if isinstance(table, ArrayTable) else (table.path,))
        ),
        flags=(*(flag for _, flags in done.values() for flag in flags), *cut),
    )
    return Episode(
        meta=meta,
        measured=done["measured"][0],
        command=done["command"][0] if "command" in done else None,
        simulated={name.partition("/")[2]: done[name][0] for name in done if name.startswith("simulated/")},
    )


def _table(path: Path, mapping: TableMapping, group: str) -> Table:
    table = open_table(path, mapping)
    return table.within(group) if group and isinstance(table, ArrayTable) else table


def _groups(table: Table, mapping: TableMapping) -> list[str]:
    """Groups that the mapping's expression matches in full, in the order of numbers in their names.

    Raises:
        DataError: there is none.
    """
    prefixes = dict.fromkeys(
        name[:place]
        for name in (table.names if isinstance(table, ArrayTable) else ())
        for place, sign in enumerate(name)
        if sign in "/."
    )
    found = matches(mapping.group, list(prefixes), where=f"{mapping.name}: group")
    groups = [name for name, own in zip(prefixes, found, strict=True) if own is not None]
    if not groups:
        raise DataError(f"{table.path} has no group as {mapping.name} says", got=mapping.group, available=prefixes)
    return sorted(groups, key=lambda name: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name)])


def _load(table: Table, mapping: TableMapping, series: str) -> bool:
    """Read the columns of a series, its clock and the signals that the file has; False if it has none.

    Raises:
        DataError: it has none, and must have some.
    """
    spec = mapping.series[series]
    wanted = [*spec.time.names, *((spec.joint_column,) if spec.joint_column else ())]
    signals = _signals(table, mapping, series)
    if not signals and spec.optional:
        return False
    if not signals:
        raise DataError(f"{table.path} has no signal of the {series} series", available=table.names)
    wanted += [column for signal in signals for column in mapping.columns(series, signal)]
    table.load(list(dict.fromkeys(wanted)))
    return True


def _signals(table: Table, mapping: TableMapping, series: str) -> list[str]:
    """Those that the file has, or must have."""
    spec, known = mapping.series[series], set(table.names)
    found = []
    for signal, item in spec.signals.items():
        columns = {split_component(name, known)[0] for name in mapping.columns(series, signal)}
        if columns & known or not (item.optional or spec.optional):
            found.append(signal)
    return found


class _Loaded:
    """A series of a table that was read.

    Attributes:
        rows: of the table, that are its samples.
    """

    def __init__(self, table: Table, mapping: TableMapping, series: str, part: Rows | None) -> None:
        self.table, self._mapping, self._series = table, mapping, series
        self._spec = mapping.series[series]
        for name in (self._spec.time.column, *self._spec.time.columns):
            if name:
                table.ticks(name)  # how many there are says whether arrays have a sample in each row
        self._values = {signal: self._signal(signal) for signal in _signals(table, mapping, series)}
        lengths = {signal: len(values) for signal, values in self._values.items()}
        count = next(iter(lengths.values()))
        if len(set(lengths.values())) > 1 or not count:
            raise DataError(
                f"{table.path}: the signals of {series} are not of one length",
                got=", ".join(f"{length} rows of {signal}" for signal, length in lengths.items()),
            )
        self.rows = np.arange(count) if part is None else part
        self._count = count

    @property
    def filled(self) -> Bool[np.ndarray, "N"]:
        """Rows that have a value of the series."""
        filled = np.any(
            [np.isfinite(values.reshape(self._count, -1)).any(axis=1) for values in self._values.values()],
            axis=0,
        )
        return np.asarray(filled)

    @property
    def still(self) -> Bool[np.ndarray, "N"]:
        """Rows at which no position is another than at the row before."""
        position = self._values["position"]
        return np.concatenate([[False], ~np.any(np.diff(position, axis=0) != 0.0, axis=1)])

    def leave_to(self, others: list[Bool[np.ndarray, "_"]]) -> None:
        """Leave rows without a value to series of the same file that have one there: their rates differ."""
        if not others or any(len(other) != self._count for other in others):
            return
        theirs = np.any(others, axis=0) & ~self.filled
        self.rows = self.rows[~theirs[self.rows]]

    def ticks(self) -> tuple[Shaped[np.ndarray, "N"], int]:
        """The stamps of the rows, and how many ticks are a second."""
        time, per_second = self._spec.time, round(1 / conversion(self._spec.time.unit, "s"))
        if time.rate_hz is not None or time.period:
            step = (
                1.0 / time.rate_hz if time.rate_hz else float(self.table.numbers(time.period).ravel()[0]) / per_second
            )
            if not 0 < step < np.inf:
                raise DataError(f"{self.table.path}: the time between two samples", got=f"{step} s", expected="above 0")
            return step * np.arange(self._count)[self.rows], 1
        if time.columns:
            whole, parts = (self._stamps(name)[0] for name in time.columns)
            if whole.dtype == np.int64 and parts.dtype == np.int64:
                return (whole * 1_000_000_000 + parts)[self.rows], 1_000_000_000
            return (whole + 1e-9 * parts)[self.rows], 1
        ticks, dates = self._stamps(time.column)
        return ticks[self.rows], 1_000_000_000 if dates else per_second

    def _stamps(self, column: str) -> tuple[Shaped[np.ndarray, "N"], bool]:
        """A clock with a stamp for each row."""
        ticks, dates = self.table.ticks(column)
        if len(ticks) != self._count:
            raise DataError(
                f"{self.table.path}: {column} is no clock of the {self._series} series",
                got=f"{len(ticks)} stamps for {self._count} samples",
            )
        return ticks, dates

    def series(self, time_s: Float64[np.ndarray, "N"], options: ImportOptions) -> tuple[TimeSeries, tuple[Flag, ...]]:
        """The series on its clock, and what is suspicious about it."""
        if not self._spec.joint_column:
            return self._table_series(time_s, options)
        words = self.table.words(self._spec.joint_column)
        if len(words) != self._count:
            got = f"{len(words)} names for {self._count} samples"
            raise DataError(
                f"{self.table.path}: {self._spec.joint_column} does not name the joint of each row", got=got
            )
        names = np.array(words)[self.rows]
        parts: list[TimeSeries] = []
        flags: tuple[Flag, ...] = ()
        for joint in self._mapping.joints_of(self._series):
            own = np.flatnonzero(names == joint)
            if not own.size:
                raise NameMismatch(
                    f"{self.table.path} has no row of joint {joint!r}",
                    left=self._mapping.joints_of(self._series),
                    right=sorted(set(names.tolist())),
                    right_name="the file has",
                )
            rows, flags = usable_clock(time_s[own], source=f"{self.table.path}, {joint}", series=self._series)
            place = self.rows[own[rows]]
            values = {signal: own_values[place][:, None] for signal, own_values in self._values.items()}
            units = {
                signal: (self._mapping.units(self._series, signal)[self._mapping.joints_of(self._series).index(joint)],)
                for signal in values
            }
            parts.append(TimeSeries(time_s[own[rows]], (joint,), values, units))
        series = on_one_clock(parts)
        return replace(series, units=override_units(dict(series.units), series.joints, options.units)), flags

    def _table_series(
        self, time_s: Float64[np.ndarray, "N"], options: ImportOptions
    ) -> tuple[TimeSeries, tuple[Flag, ...]]:
        mapping, series = self._mapping, self._series
        rows, flags = usable_clock(time_s, source=str(self.table.path), series=series)
        joints = mapping.joints_of(series)
        signals = {
            signal: values[self.rows][rows].astype(mapping.series[series].signals[signal].dtype, copy=False)
            for signal, values in self._values.items()
        }
        units = {signal: mapping.units(series, signal) for signal in signals}
        joint_units = {signal: unit for signal, unit in units.items() if not signal.startswith(BODY_PREFIX)}
        units |= override_units(joint_units, joints, options.units)
        bodies = mapping.bodies if len(joint_units) < len(units) else ()
        return TimeSeries(time_s=time_s[rows], joints=joints, signals=signals, units=units, bodies=bodies), flags

    def _signal(self, signal: str) -> Float64[np.ndarray, "N *S"]:
        """Values of all rows, with factor and offset."""
        mapping, series, table = self._mapping, self._series, self.table
        item, slots = self._spec.signals[signal], mapping.slots(series, signal)
        columns = mapping.columns(series, signal)
        if self._spec.joint_column:
            values = table.numbers(columns[0])
            if values.ndim != 1:
                raise DataError(f"{table.path}: {columns[0]} holds vectors", expected="a number in each row")
            return values * _first(item.factor) + _first(item.offset)
        if mapping.is_vector(series, signal):
            values = table.numbers(columns[0])
        else:
            values = np.column_stack([_plain(table, column) for column in columns])
        wanted = (len(slots), *COMPONENTS.get(signal, ()))
        if values.ndim != 2 or values.shape[1] != int(np.prod(wanted)):
            raise DataError(
                f"{table.path}: {', '.join(columns)} has another number of values than there are joints",
                got=f"{values.shape[1] if values.ndim > 1 else 1} a row",
                expected=f"{int(np.prod(wanted))}: {', '.join(slots)}",
                hint=f"Name the components that are meant: columns: ['{columns[0]}[0]', …].",
            )
        factor, offset = (np.broadcast_to(np.asarray(own, float), (len(slots),)) for own in (item.factor, item.offset))
        values = values.reshape(len(values), *wanted)
        if np.any(factor != 1.0) or np.any(offset != 0.0):
            shape = (1, len(slots), *(1,) * len(COMPONENTS.get(signal, ())))
            values = values * factor.reshape(shape) + offset.reshape(shape)
        return values


def _first(own: float | tuple[float, ...]) -> float:
    return own if isinstance(own, int | float) else own[0]


def _plain(table: Table, column: str) -> Float64[np.ndarray, "N"]:
    values = table.numbers(column)
    if values.ndim == 2 and values.shape[1] == 1:  # of one joint
        values = values[:, 0]
    if values.ndim != 1:
        raise DataError(
            f"{table.path}: {column} holds vectors",
            got=f"{values.shape[1]} numbers in a row",
            expected="one",
            hint=f"Name the component that is meant: {column}[0], …",
        )
    return values


def _clocks(loaded: Mapping[str, _Loaded], mapping: TableMapping) -> dict[str, Float64[np.ndarray, "_"]]:
    """The clock of each series [s], counted from the episode's first stamp unless the mapping keeps the origin."""
    found = {series: own.ticks() for series, own in loaded.items()}
    rates = {per_second for _, per_second in found.values()}
    if not mapping.keep_origin and len(rates) == 1 and all(ticks.dtype == np.int64 for ticks, _ in found.values()):
        origin = int(common_origin(*(ticks for ticks, _ in found.values())))
        return {series: seconds(ticks, origin=origin, per_second=rate) for series, (ticks, rate) in found.items()}
    clocks = {series: ticks / float(per_second) for series, (ticks, per_second) in found.items()}
    first = 0.0 if mapping.keep_origin else common_origin(*clocks.values())
    return {series: clock - first for series, clock in clocks.items()}


def _split_rows(table: Table, mapping: TableMapping) -> list[tuple[str, Rows]]:
    """Name and rows of each motion in a table.

    Raises:
        DataError: nothing is left.
    """
    rule = mapping.split
    assert rule is not None
    _load(table, mapping, "measured")
    measured = _Loaded(table, mapping, "measured", None)
    if rule.column:
        table.load([rule.column])
        words = np.array(table.words(rule.column))
        if words.size != measured.rows.size:
            got = f"{words.size} values for {measured.rows.size} samples"
            raise DataError(f"{table.path}: {rule.column} does not say the motion of each row", got=got)
        motions = [word for word in dict.fromkeys(words.tolist()) if word.lower() not in ("", "nan", "none")]
        return [(word, np.flatnonzero(words == word)) for word in motions]
    ticks, per_second = measured.ticks()
    time_s = (ticks - ticks[0]) / float(per_second)
    begins, kept = _begins(rule, time_s, measured)
    groups = [rows[kept[rows]] for rows in np.split(np.arange(time_s.size), begins)]
    groups = [rows for rows in groups if rows.size > 1]
    if not groups:
        raise DataError(f"{table.path}: split leaves nothing", got=f"{time_s.size} rows")
    return [(f"{number:03d}", rows) for number, rows in enumerate(groups, start=1)]


def _begins(
    rule: SplitRule, time_s: Float64[np.ndarray, "N"], measured: _Loaded
) -> tuple[Int[np.ndarray, "K"], Bool[np.ndarray, "N"]]:
    """Rows at which motions begin, but for the first, and rows that belong to one."""
    kept = np.ones(time_s.size, bool)
    step = np.diff(time_s)
    if rule.back:
        return np.flatnonzero(step < 0) + 1, kept
    if rule.gap_s is not None:
        return np.flatnonzero(step > rule.gap_s) + 1, kept
    if rule.every_s is not None:
        return np.flatnonzero(np.diff(np.floor(time_s / rule.every_s))) + 1, kept
    still = measured.still
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if time_s[min(end, time_s.size) - 1] - time_s[begin] >= (rule.rest_s or 0.0):
            kept[begin:end] = False
    return np.flatnonzero(np.diff(kept.astype(int)) == 1) + 1, kept
