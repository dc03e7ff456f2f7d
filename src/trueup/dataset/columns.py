"""A time series as flat Arrow columns, and back.

The columns are for people (`position[shoulder_pan]`, `body.position[hand].x`); their names are never parsed. What
they mean stands, in order, in a JSON layout in the schema's metadata.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pyarrow as pa

from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.errors import DataError, FormatError

LAYOUT_SCHEMA = "trueup.series/1"
LAYOUT_KEY = b"trueup"

# Little-endian on every machine, so that content hashes agree between machines.
_DTYPES = {"float32": "<f4", "float64": "<f8"}
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class SignalLayout:
    """One signal of a series.

    Attributes:
        name: e.g. `position` or `body.rotation`.
        shape: shape without the time axis: (J,), (B, 3) or (B, 3, 3).
        dtype: `float32` or `float64`.
        units: one per joint or body.
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    units: tuple[str, ...]

    @property
    def width(self) -> int:
        """The number of flat columns."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Layout:
    """Everything about a series apart from its numbers: what its flat columns mean, in order."""

    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    signals: tuple[SignalLayout, ...]

    @property
    def width(self) -> int:
        """The number of flat columns, clock included."""
        return 1 + sum(signal.width for signal in self.signals)


def layout_of(series: TimeSeries) -> Layout:
    """The layout of a series.

    Raises:
        DataError: a signal is neither float32 nor float64.
    """
    signals = []
    for name, values in series.signals.items():
        if values.dtype.name not in _DTYPES:
            raise DataError(f"signal {name!r} cannot be stored", got=values.dtype.name, expected="float32 or float64")
        signals.append(SignalLayout(name, values.shape[1:], values.dtype.name, tuple(series.units[name])))
    return Layout(tuple(series.joints), tuple(series.bodies), tuple(signals))


@lru_cache(maxsize=256)
def layout_text(layout: Layout) -> str:
    """The layout as canonical JSON."""
    return json.dumps({"schema": LAYOUT_SCHEMA, **asdict(layout)}, sort_keys=True)


def parse_layout(schema: pa.Schema) -> Layout:
    """The layout that stands in the metadata of an Arrow schema.

    Raises:
        FormatError: there is none, it is of another version, or the columns are not those that it describes.
    """
    text = (schema.metadata or {}).get(LAYOUT_KEY)
    if text is None:
        raise FormatError("the columns carry no layout", expected=f"{LAYOUT_SCHEMA} in the metadata")
    try:
        data = json.loads(text)
        if data["schema"] != LAYOUT_SCHEMA:
            raise FormatError("unknown layout of columns", got=data["schema"], expected=LAYOUT_SCHEMA)
        layout = Layout(
            _names(data["joints"]), _names(data["bodies"]), tuple(_signal(item) for item in data["signals"])
        )
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise FormatError("the layout of the columns is damaged", got=repr(error)) from error
    if layout.width != len(schema) or not schema.equals(arrow_schema(layout)):
        raise FormatError("the columns are not those of the layout", got=len(schema), expected=layout.width)
    return layout


def _signal(item: Mapping[str, Any]) -> SignalLayout:
    shape = tuple(item["shape"])
    # Numbers from a file: a huge or negative size must not reach numpy.
    if item["dtype"] not in _DTYPES or not all(isinstance(size, int) and 0 <= size < 100_000 for size in shape):
        raise ValueError(f"signal {item['name']!r} of type {item['dtype']!r} and shape {shape}")
    return SignalLayout(_names([item["name"]])[0], shape, item["dtype"], _names(item["units"]))


def _names(values: Any) -> tuple[str, ...]:
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise ValueError("expected a list of names")
    return tuple(values)


@lru_cache(maxsize=256)
def arrow_schema(layout: Layout) -> pa.Schema:
    """The Arrow schema of a layout, layout in the metadata.

    Raises:
        DataError: a name is not valid Unicode.
    """
    names = ["time_s"]
    types = [pa.float64()]
    for signal in layout.signals:
        owners = layout.bodies if signal.name.startswith(BODY_PREFIX) else layout.joints
        for owner, indices in itertools.product(owners, np.ndindex(*signal.shape[1:])):
            names.append(f"{signal.name}[{owner}]" + _suffix(indices, signal.shape[1:]))
            types.append(pa.from_numpy_dtype(signal.dtype))
    try:
        fields = [pa.field(name, kind, nullable=False) for name, kind in zip(_unique(names), types, strict=True)]
        return pa.schema(fields, metadata={LAYOUT_KEY: layout_text(layout)})
    except UnicodeEncodeError as error:
        raise DataError("a name of a joint, body or signal is not valid Unicode", got=ascii(error.object)) from error


def _suffix(indices: tuple[int, ...], shape: tuple[int, ...]) -> str:
    if not indices:
        return ""
    if all(size == len(_AXES) for size in shape):
        return "." + "".join(_AXES[index] for index in indices)
    return "." + "_".join(map(str, indices))


def _unique(names: list[str]) -> list[str]:
    """Brackets inside names can make two columns look alike, which pandas refuses; number the later ones."""
    seen: set[str] = set()
    result = []
    for name in names:
        candidate, count = name, 1
        while candidate in seen:
            count += 1
            candidate = f"{name}~{count}"
        seen.add(candidate)
        result.append(candidate)
    return result


def to_table(series: TimeSeries, layout: Layout) -> pa.Table:
    """The flat columns of a series; a copy, so that the caller may reuse its arrays.

    Raises:
        DataError: a name is not valid Unicode.
    """
    arrays = [pa.array(np.array(series.time_s, dtype="<f8"))]
    for signal in layout.signals:
        flat = series.signals[signal.name].reshape(len(series), signal.width)
        arrays.extend(map(pa.array, np.array(flat.T, dtype=_DTYPES[signal.dtype], order="C")))
    return pa.Table.from_arrays(arrays, schema=arrow_schema(layout))


def from_table(table: pa.Table, layout: Layout) -> TimeSeries:
    """The series that `to_table` took apart; one allocation per signal.

    Raises:
        DataError: the clock or a shape is not that of a series.
    """
    columns = [column.chunk(0) if column.num_chunks == 1 else column.combine_chunks() for column in table.columns]
    signals: dict[str, np.ndarray[Any, Any]] = {}
    start = 1
    for signal in layout.signals:
        values = np.empty((table.num_rows, signal.width), dtype=signal.dtype)
        for index in range(signal.width):
            values[:, index] = columns[start + index].to_numpy()
        start += signal.width
        signals[signal.name] = values.reshape(table.num_rows, *signal.shape)
    return TimeSeries(
        time_s=np.array(columns[0].to_numpy()),
        joints=layout.joints,
        signals=signals,
        units={signal.name: signal.units for signal in layout.signals},
        bodies=layout.bodies,
    )


def content_hash(series: Mapping[str, tuple[TimeSeries, Layout]]) -> str:
    """SHA-256 over clocks, values, names and units of named series; how they are stored does not enter."""
    digest = hashlib.sha256()
    for name in sorted(series):
        values, layout = series[name]
        digest.update(f"{name}\0{len(values)}\0{layout_text(layout)}\0".encode())
        digest.update(np.ascontiguousarray(values.time_s, dtype="<f8").data)
        for signal in layout.signals:
            digest.update(np.ascontiguousarray(values.signals[signal.name], dtype=_DTYPES[signal.dtype]).data)
    return digest.hexdigest()
