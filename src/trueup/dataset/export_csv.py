"""Episodes as CSV files, with the mapping by which trueup reads them back."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import yaml
from jaxtyping import Float

from trueup.core.atomic import appearing, is_inside, replacing, write_json, write_text
from trueup.core.episode import Episode
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.errors import DataError, NameMismatch, OutputExists

_META = ("robot", "unit", "payload_kg", "kp_setting", "condition")


def export_csv(episodes: Iterable[Episode], folder: Path) -> int:
    """Write one CSV file per series and episode, `mapping.yaml`, `episodes.csv` and `split.json`.

    Files are called `ID/measured.csv`, `ID/command.csv`, `ID/simulated/LABEL.csv`; columns `time_s` and
    `SIGNAL.JOINT`, e.g. `position.elbow`. Numbers have the digits that give the same float64 back, so that
    importing the folder again gives the same samples, clocks, units and metadata; flags are not written.

    Args:
        episodes: read one at a time.
        folder: created if it does not exist; must be empty, so that no old episode is taken for one of these.

    Returns:
        The number of episodes.

    Raises:
        OutputExists: the folder holds files.
        NameMismatch: episodes do not agree on joints, bodies or units, which one mapping cannot say.
        DataError: there is no episode; an id leads out of the folder; a joint's name cannot be a column; the disk is
            full or not writable.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputExists(f"{folder} is not an empty folder", hint="Give another folder.")
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(("id", *_META))
    splits: dict[str, list[str]] = {}
    layout: dict[str, dict[str, Any]] = {}
    count = 0
    with appearing(folder) as whole:
        for episode in episodes:
            for label, series in _all_series(episode):
                _extend(layout.setdefault(label, {"episodes": 0, "signals": {}}), label, series)
                path = whole / episode.id / f"{label}.csv"
                if not is_inside(whole, path):
                    raise DataError("an episode would be written outside the folder", got=repr(episode.id))
                _write(path, series)
            about = (getattr(episode.meta, key) for key in _META)
            writer.writerow((episode.id, *("" if own is None else own for own in about)))
            if episode.meta.split:
                splits.setdefault(episode.meta.split, []).append(episode.id)
            count += 1
        if not count:
            raise DataError(f"there is no episode to export to {folder}")
        write_text(whole / "episodes.csv", table.getvalue())
        if splits:
            write_json(whole / "split.json", splits)
        write_text(whole / "mapping.yaml", yaml.safe_dump(_mapping(layout, count), sort_keys=False, allow_unicode=True))
    return count


def _all_series(episode: Episode) -> Iterator[tuple[str, TimeSeries]]:
    yield "measured", episode.measured
    if episode.command is not None:
        yield "command", episode.command
    for label, series in episode.simulated.items():
        yield f"simulated/{label}", series


def _extend(known: dict[str, Any], label: str, series: TimeSeries) -> None:
    """Add the signals of one episode's series to what the mapping says of this series."""
    known["episodes"] += 1
    _agree(known, "joints", series.joints, label)
    if series.bodies:
        _agree(known, "bodies", series.bodies, label)
    for signal, values in series.signals.items():
        entry = known["signals"].setdefault(signal, {"episodes": 0, "dtype": str(values.dtype)})
        entry["episodes"] += 1
        if entry["dtype"] != str(values.dtype):
            entry["dtype"] = "float64"
        _agree(entry, "unit", series.units[signal], f"{label}, {signal}")


def _agree(known: dict[str, Any], key: str, value: tuple[str, ...], where: str) -> None:
    if known.setdefault(key, value) != value:
        raise NameMismatch(
            f"{where}: episodes do not agree on {key}",
            left=value,
            right=known[key],
            left_name="one has",
            right_name="those before",
            hint="Export the episodes that agree into a folder of their own.",
        )


def _write(path: Path, series: TimeSeries) -> None:
    columns: dict[str, Float[np.ndarray, "T"]] = {"time_s": series.time_s}
    for signal, values in series.signals.items():
        flat = values.reshape(len(series), -1).astype(np.float64)
        columns |= dict(zip(_columns(series, signal, values.shape), flat.T, strict=True))
    unfit = [name for name in columns if name != name.strip() or not name.isprintable()]
    if unfit:
        raise DataError("these names cannot be columns of a CSV file", got=unfit, expected="no blanks at the ends")
    table = pa.table({name: pa.array(column, from_pandas=False) for name, column in columns.items()})
    with replacing(path) as temporary, temporary.open("wb") as file:
        pyarrow.csv.write_csv(table, file)


def _columns(series: TimeSeries, signal: str, shape: tuple[int, ...]) -> list[str]:
    if not signal.startswith(BODY_PREFIX):
        return [f"{signal}.{joint}" for joint in series.joints]
    components = range(int(np.prod(shape[2:])))
    return [f"{signal}.{body}.{component}" for body in series.bodies for component in components]


def _mapping(layout: Mapping[str, Mapping[str, Any]], count: int) -> dict[str, Any]:
    """The mapping that describes what was written."""
    joints = layout["measured"]["joints"]
    bodies: dict[str, Any] = {}
    series: dict[str, Any] = {}
    for label, known in layout.items():
        bodies_here = known.get("bodies", ())
        if bodies_here:
            _agree(bodies, "bodies", bodies_here, label)
        signals = {
            signal: {
                "columns": f"{signal}.{{body}}.{{k}}" if signal.startswith(BODY_PREFIX) else f"{signal}.{{joint}}",
                "unit": list(entry["unit"]),
                "optional": entry["episodes"] < known["episodes"],
                "dtype": entry["dtype"],
            }
            for signal, entry in known["signals"].items()
        }
        series[label] = {
            "file": f"{{id}}/{label}.csv",
            "optional": known["episodes"] < count,
            "time": {"column": "time_s", "unit": "s"},
            "joints": list(known["joints"]),
            "signals": signals,
        }
    mapping = {
        "joints": list(joints),
        "episodes": r"(?P<id>.+)/measured\.csv",
        "id": "{id}",
        "metadata": "episodes.csv",
        "keep_origin": True,
        "series": series,
    }
    return {**mapping, **{key: list(value) for key, value in bodies.items()}}
