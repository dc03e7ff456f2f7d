"""Curves of episodes, thinned for drawing: `traces.npz` with its index `traces.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int

from trueup.core.atomic import file_hash, read_json, regular, replacing, write_json
from trueup.core.decimation import decimation_rows
from trueup.core.hold import held_rows
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.errors import ConfigError, DataError, FormatError, NameMismatch, UnitError

TRACES_SCHEMA = "trueup.traces/1"
DEFAULT_MAX_POINTS = 1000
MEASURED = "measured"
COMMAND = "command"
_LONGEST_HEADER = 10_000


@dataclass(frozen=True, eq=False)
class Trace:
    """The curves of one joint and signal on common rows, so that differences of them mean something.

    Attributes:
        signal: signal name.
        joint: joint name.
        unit: unit of all curves.
        samples: number of samples before thinning.
        time_s: time since the first measured sample, (K,) [s], not decreasing.
        curves: `measured`, `command` if there is one, then the run labels, each (K,); NaN where there is no value.
    """

    signal: str
    joint: str
    unit: str
    samples: int
    time_s: Float32[np.ndarray, "K"]
    curves: Mapping[str, Float32[np.ndarray, "K"]]

    @property
    def runs(self) -> tuple[str, ...]:
        """Labels of the simulated curves."""
        return tuple(label for label in self.curves if label not in (MEASURED, COMMAND))

    def thinned(self, max_points: int) -> Trace:
        """The same curves at no more than `max_points` rows.

        The rows follow the extremes of the measured curve and of the largest residual of each row; the extremes
        of every curve and of every residual over the whole motion are kept as well.

        Raises:
            ConfigError: `max_points` is too small for this number of curves.
        """
        if self.time_s.size <= max_points:
            return self
        measured = self.curves[MEASURED]
        compared = self.runs or tuple(label for label in self.curves if label != MEASURED)
        residuals = np.stack([measured - self.curves[label] for label in compared]) if compared else measured[None]
        largest = np.abs(np.nan_to_num(residuals)).argmax(axis=0)
        worst = np.take_along_axis(residuals, largest[None], axis=0)
        always = _extreme_rows(np.concatenate([np.stack(list(self.curves.values())), residuals]))
        rows = decimation_rows(np.concatenate([measured[None], worst]), max_points - always.size)
        rows = np.union1d(rows, always)
        curves = {label: values[rows] for label, values in self.curves.items()}
        return Trace(self.signal, self.joint, self.unit, self.samples, self.time_s[rows], curves)


@dataclass(frozen=True, eq=False)
class EpisodeTraces:
    """The traces of one episode.

    Attributes:
        id: the episode's id.
        split: its split, or empty.
        start_s: stamp of the first measured sample on the episode's own clock [s]; flags are stamped on that clock.
        traces: one entry per signal and joint.
    """

    id: str
    split: str
    start_s: float
    traces: tuple[Trace, ...]

    def thinned(self, max_points: int) -> EpisodeTraces:
        """Every trace at no more than `max_points` rows."""
        return EpisodeTraces(self.id, self.split, self.start_s, tuple(item.thinned(max_points) for item in self.traces))

    def pack(self) -> tuple[Float32[np.ndarray, "N"], dict[str, Any]]:
        """All curves in one flat array, and the index that says where they are.

        For each trace in order the array holds its time and then its curves.
        """
        blocks = [block for trace in self.traces for block in (trace.time_s, *trace.curves.values())]
        index = {
            "id": self.id,
            "split": self.split,
            "start_s": self.start_s,
            "traces": [
                {
                    "signal": trace.signal,
                    "joint": trace.joint,
                    "unit": trace.unit,
                    "samples": trace.samples,
                    "rows": int(trace.time_s.size),
                    "curves": list(trace.curves),
                }
                for trace in self.traces
            ],
        }
        return np.concatenate([np.empty(0, np.float32), *blocks]), index

    @staticmethod
    def unpack(flat: Float32[np.ndarray, "N"], index: Mapping[str, Any]) -> EpisodeTraces:
        """Read back what `pack` wrote.

        Raises:
            DataError: array and index do not belong together.
        """
        traces = []
        position = 0
        for item in index["traces"]:
            labels, rows = [str(label) for label in item["curves"]], int(item["rows"])
            size = (1 + len(labels)) * rows
            if rows < 1 or MEASURED not in labels or position + size > flat.size:
                raise DataError(f"the curves of episode {index['id']!r} do not agree with their index")
            block = flat[position : position + size].reshape(1 + len(labels), rows)
            if not np.all(np.isfinite(block[0])) or np.any(np.diff(block[0]) < 0):
                raise DataError(f"a clock of episode {index['id']!r} is not finite or decreases")
            curves = dict(zip(labels, block[1:], strict=True))
            trace = Trace(
                signal=str(item["signal"]),
                joint=str(item["joint"]),
                unit=str(item["unit"]),
                samples=int(item["samples"]),
                time_s=block[0],
                curves=curves,
            )
            traces.append(trace)
            position += size
        if position != flat.size:
            raise DataError(f"the curves of episode {index['id']!r} do not agree with their index")
        return EpisodeTraces(str(index["id"]), str(index["split"]), float(index["start_s"]), tuple(traces))


class TraceSet:
    """Curves of many episodes, thinned as they are added, so that the full series need not stay in memory.

    Args:
        max_points: rows per joint and signal that are kept.

    Raises:
        ConfigError: `max_points` is below 100.
    """

    def __init__(self, *, max_points: int = DEFAULT_MAX_POINTS) -> None:
        if max_points < 100:
            raise ConfigError("max_points is too small for a curve", got=max_points, expected="at least 100")
        self.max_points = max_points
        self.episodes: dict[str, EpisodeTraces] = {}
        self.provenance: Mapping[str, Any] = {}

    def add(
        self,
        episode_id: str,
        split: str,
        measured: TimeSeries,
        command: TimeSeries | None,
        simulated: Mapping[str, TimeSeries],
    ) -> None:
        """Add one episode.

        Simulated series are interpolated linearly at the measured stamps and the command is held between its
        stamps; outside their clocks both are NaN (the command stays after its last stamp). Traced are the
        measured joint signals that the command or a run has as well.

        Raises:
            DataError: the episode was added before; a run is called `measured` or `command`.
            NameMismatch: a joint is missing in the command or in a run.
            UnitError: a unit differs from the measured one.
        """
        if episode_id in self.episodes:
            raise DataError(f"episode {episode_id!r} was added twice")
        if {MEASURED, COMMAND} & set(simulated):
            raise DataError(f"a run cannot be called {MEASURED!r} or {COMMAND!r}", available=simulated)
        sources = {**({COMMAND: command} if command is not None else {}), **simulated}
        traces = []
        for signal, values in measured.signals.items():
            present = {label: series for label, series in sources.items() if signal in series}
            if signal.startswith(BODY_PREFIX) or not present:
                continue
            columns = {label: _at_stamps(label, series, signal, measured) for label, series in present.items()}
            for number, joint in enumerate(measured.joints):
                curves = {MEASURED: values[:, number], **{label: array[:, number] for label, array in columns.items()}}
                trace = Trace(
                    signal=signal,
                    joint=joint,
                    unit=measured.units[signal][number],
                    samples=len(measured),
                    time_s=(measured.time_s - measured.time_s[0]).astype(np.float32),
                    curves={label: np.asarray(curve, np.float32) for label, curve in curves.items()},
                )
                traces.append(trace.thinned(self.max_points))
        self.episodes[episode_id] = EpisodeTraces(episode_id, split, float(measured.time_s[0]), tuple(traces))

    def save(self, folder: Path) -> None:
        """Write traces.npz and traces.json, each atomically, the index last."""
        packed = [episode.pack() for episode in self.episodes.values()]
        arrays = {f"episode_{number:06d}": flat for number, (flat, _) in enumerate(packed)}
        with replacing(folder / "traces.npz") as temporary, temporary.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]  # the keys never collide with allow_pickle
        index = [{"array": name, **item} for name, (_, item) in zip(arrays, packed, strict=True)]
        write_json(
            folder / "traces.json",
            {
                "schema": TRACES_SCHEMA,
                "max_points": self.max_points,
                "curves": file_hash(folder / "traces.npz"),
                "episodes": index,
                "provenance": dict(self.provenance),
            },
        )

    @staticmethod
    def load(folder: Path) -> TraceSet:
        """Read what `save` wrote.

        Raises:
            DataError: a file is missing or broken, or the two do not belong together.
            FormatError: the index is of another kind or version.
        """
        index = read_json(folder / "traces.json")
        if not isinstance(index, Mapping) or index.get("schema") != TRACES_SCHEMA:
            raise FormatError(f"{folder / 'traces.json'} is no index of traces", expected=TRACES_SCHEMA)
        path = folder / "traces.npz"
        # Whoever is killed between the two files leaves an index of other curves.
        if index.get("curves") is not None and path.is_file() and index["curves"] != file_hash(path):
            raise DataError(f"{path} is not the file that traces.json describes", hint="Run the command again.")
        try:
            traces = TraceSet(max_points=index["max_points"])
            with regular(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
                for item in index["episodes"]:
                    episode = EpisodeTraces.unpack(_flat(archive, item), item)
                    traces.episodes[episode.id] = episode
        except FileNotFoundError:
            raise DataError(f"{path} does not exist", hint="traces.json and traces.npz belong together") from None
        except DataError:
            raise
        except Exception as error:  # headers go through zipfile, zlib, ast and tokenize, each with errors of its own
            raise DataError(f"{path} or its index is broken", got=f"{type(error).__name__}: {error}") from error
        return traces


def _flat(archive: Any, item: Mapping[str, Any]) -> Float32[np.ndarray, "N"]:
    """The array of an episode; one of another size than the index says is not unpacked, zip files may blow it up."""
    size = archive.zip.getinfo(f"{item['array']}.npy").file_size
    expected = 4 * sum((1 + len(trace["curves"])) * int(trace["rows"]) for trace in item["traces"])
    flat = archive[item["array"]] if expected <= size <= expected + _LONGEST_HEADER else None
    if flat is None or flat.dtype != np.float32 or flat.shape != (expected // 4,):
        raise DataError(f"the curves of episode {item['id']!r} do not agree with their index")
    return np.asarray(flat)


def _extreme_rows(values: Float32[np.ndarray, "C T"]) -> Int[np.ndarray, "K"]:
    """The rows of the smallest and the largest value of each curve."""
    missing = np.isnan(values)
    low = np.where(missing, np.inf, values).argmin(axis=1)
    high = np.where(missing, -np.inf, values).argmax(axis=1)
    return np.unique(np.concatenate([low, high]))


def _at_stamps(label: str, series: TimeSeries, signal: str, measured: TimeSeries) -> Float64[np.ndarray, "T J"]:
    """One signal of another series at the measured stamps, joint by joint."""
    try:
        series = series.select(measured.joints)
    except NameMismatch as error:
        raise NameMismatch(
            f"the joints of {label!r} are not those that were measured",
            left=series.joints,
            right=measured.joints,
            left_name=label,
            right_name=MEASURED,
        ) from error
    if series.units[signal] != measured.units[signal]:
        raise UnitError(
            f"{signal} of {label!r} is in other units than the measured one",
            got=series.units[signal],
            expected=measured.units[signal],
        )
    values = np.asarray(series[signal], np.float64)
    if label == COMMAND:
        return _held(series.time_s, values, measured.time_s)
    return _interpolated(series.time_s, values, measured.time_s)


def _held(
    stamps: Float64[np.ndarray, "N"], values: Float64[np.ndarray, "N J"], clock: Float64[np.ndarray, "T"]
) -> Float64[np.ndarray, "T J"]:
    rows = held_rows(stamps, clock)
    return np.where(rows[:, None] >= 0, values[np.maximum(rows, 0)], np.nan)


def _interpolated(
    stamps: Float64[np.ndarray, "N"], values: Float64[np.ndarray, "N J"], clock: Float64[np.ndarray, "T"]
) -> Float64[np.ndarray, "T J"]:
    # Half a step of slack: engines end on their own grid, a hair before the last measured stamp.
    slack = 0.5 * float(np.median(np.diff(stamps))) if stamps.size > 1 else 0.0
    inside = (clock >= stamps[0] - slack) & (clock <= stamps[-1] + slack)
    columns = [np.interp(clock, stamps, column) for column in values.T]
    return np.where(inside[:, None], np.stack(columns, axis=1), np.nan)
