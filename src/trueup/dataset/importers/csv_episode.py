"""One episode from CSV files: its columns as series, each on its own clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float64

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.core.units import conversion
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.clock import common_origin, seconds, usable_clock
from trueup.dataset.importers.columns import TextTable
from trueup.dataset.importers.files import files_hash, inside, read_bytes
from trueup.dataset.importers.mapping import COMPONENTS, CsvMapping
from trueup.dataset.importers.units import override_units
from trueup.errors import DataError


@dataclass(frozen=True)
class CsvEpisode:
    """The files of one episode.

    Attributes:
        meta: what is known before they are read.
        series: series name -> path below the imported folder.
    """

    meta: EpisodeMeta
    series: Mapping[str, str]


def load_episode(root: Path, files: CsvEpisode, mapping: CsvMapping, options: ImportOptions) -> Episode:
    """Read the files of one episode.

    Raises:
        DataError: a file cannot be used; the message has its line.
        NameMismatch: a column is missing.
        UnitError: a unit that the user stated is unknown.
    """
    paths = {name: inside(root, root / name) for name in dict.fromkeys(files.series.values())}
    layout: dict[str, Any] = {"header": mapping.header, "skip_lines": mapping.skip_lines}
    tables = {
        name: TextTable(path, read_bytes(path), delimiter=mapping.delimiter, **layout) for name, path in paths.items()
    }
    texts = {series: text for series, name in files.series.items() if (text := _texts(tables[name], mapping, series))}
    clocks = _clocks({series: tables[files.series[series]] for series in texts}, texts, mapping)
    done = {
        series: _series(tables[files.series[series]], text, clocks[series], mapping, series, options)
        for series, text in texts.items()
    }
    meta = replace(
        files.meta,
        source_hash=files_hash(paths.values()),
        flags=tuple(flag for _, flags in done.values() for flag in flags),
    )
    return Episode(
        meta=meta,
        measured=done["measured"][0],
        command=done["command"][0] if "command" in done else None,
        simulated={name.partition("/")[2]: done[name][0] for name in done if name.startswith("simulated/")},
    )


def _texts(table: TextTable, mapping: CsvMapping, series: str) -> dict[str, pa.StringArray]:
    """The columns of a series as text: its clock, and the signals that the file has; empty if it has none."""
    spec = mapping.series[series]
    wanted = [spec.time.column]
    signals = 0
    for signal, item in spec.signals.items():
        columns = mapping.columns(series, signal)
        if (item.optional or spec.optional) and not set(columns) & set(table.names):
            continue
        signals += 1
        wanted += columns
    if not signals and spec.optional:
        return {}
    if not signals:
        raise DataError(f"{table.path} has no signal of the {series} series", available=table.names)
    return table.read(list(dict.fromkeys(wanted)))


def _clocks(
    tables: Mapping[str, TextTable], texts: Mapping[str, Mapping[str, pa.StringArray]], mapping: CsvMapping
) -> dict[str, Float64[np.ndarray, "_"]]:
    """The clock of each series [s], counted from the episode's first stamp unless the mapping keeps the origin."""
    specs = {series: mapping.series[series].time for series in tables}
    ticks = {
        series: table.ticks(specs[series].column, texts[series][specs[series].column])
        for series, table in tables.items()
    }
    per_second = {series: round(1 / conversion(spec.unit, "s")) for series, spec in specs.items()}
    if (
        not mapping.keep_origin
        and len(set(per_second.values())) == 1
        and all(t.dtype == np.int64 for t in ticks.values())
    ):
        origin = int(common_origin(*ticks.values()))
        return {
            series: seconds(stamps, origin=origin, per_second=per_second[series]) for series, stamps in ticks.items()
        }
    clocks = {series: stamps / float(per_second[series]) for series, stamps in ticks.items()}
    first = 0.0 if mapping.keep_origin else common_origin(*clocks.values())
    return {series: clock - first for series, clock in clocks.items()}


def _series(
    table: TextTable,
    text: Mapping[str, pa.StringArray],
    time_s: Float64[np.ndarray, "N"],
    mapping: CsvMapping,
    series: str,
    options: ImportOptions,
) -> tuple[TimeSeries, tuple[Flag, ...]]:
    """One series, and what is suspicious about its clock."""
    rows, flags = usable_clock(time_s, source=str(table.path), series=series)
    joints = mapping.joints_of(series)
    signals, units = {}, {}
    for signal, item in mapping.series[series].signals.items():
        columns = mapping.columns(series, signal)
        if columns[0] not in text:
            continue
        values = np.column_stack([table.floats(column, text[column]) for column in columns])[rows]
        shape = (len(rows), len(mapping.slots(series, signal)), *COMPONENTS.get(signal, ()))
        signals[signal] = values.reshape(shape).astype(item.dtype, copy=False)
        units[signal] = mapping.units(series, signal)
    joint_units = {signal: unit for signal, unit in units.items() if not signal.startswith(BODY_PREFIX)}
    units |= override_units(joint_units, joints, options.units)
    bodies = mapping.bodies if len(joint_units) < len(units) else ()
    return TimeSeries(time_s=time_s[rows], joints=joints, signals=signals, units=units, bodies=bodies), flags
