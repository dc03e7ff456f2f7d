"""What the error depends on: `analysis.json`, the numbers behind the explaining figures of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Sized
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trueup.core.atomic import read_json, write_json
from trueup.core.config import read_versioned
from trueup.errors import DataError

ANALYSIS_SCHEMA = "trueup.analysis/1"


@dataclass(frozen=True)
class BinnedCurve:
    """The distribution of the absolute residual in bins of another quantity, over all samples of all episodes.

    Attributes:
        centers: middle of each bin, increasing, in `x_unit`.
        median: median of |residual| per bin, in `y_unit`; NaN where a bin is empty.
        q25: lower quartile per bin.
        q75: upper quartile per bin.
        count: samples per bin.
        x_unit: unit of the quantity that was binned.
        y_unit: unit of the residual.
    """

    centers: tuple[float, ...]
    median: tuple[float, ...]
    q25: tuple[float, ...]
    q75: tuple[float, ...]
    count: tuple[int, ...]
    x_unit: str
    y_unit: str

    def __post_init__(self) -> None:
        """Refuse columns of unequal length."""
        _same_length("bins", self.centers, self.median, self.q25, self.q75, self.count)

    def to_json(self) -> dict[str, Any]:
        """JSON object; NaN becomes null."""
        return {
            "centers": _nulled(self.centers),
            "median": _nulled(self.median),
            "q25": _nulled(self.q25),
            "q75": _nulled(self.q75),
            "count": list(self.count),
            "x_unit": self.x_unit,
            "y_unit": self.y_unit,
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> BinnedCurve:
        """Read back what `to_json` wrote."""
        return BinnedCurve(
            centers=_numbers(data["centers"]),
            median=_numbers(data["median"]),
            q25=_numbers(data["q25"]),
            q75=_numbers(data["q75"]),
            count=tuple(data["count"]),
            x_unit=data["x_unit"],
            y_unit=data["y_unit"],
        )


@dataclass(frozen=True)
class Lag:
    """A delay with its 95 % interval: measured(t) = source(t - value_s).

    Attributes:
        value_s: the delay [s]; NaN where it could not be determined.
        low_s: lower end [s], None where there is none.
        high_s: upper end [s].
    """

    value_s: float
    low_s: float | None = None
    high_s: float | None = None

    def to_json(self) -> dict[str, Any]:
        """JSON object; NaN becomes null."""
        return {"value_s": _null(self.value_s), "low_s": _null(self.low_s), "high_s": _null(self.high_s)}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Lag:
        """Read back what `to_json` wrote."""
        return Lag(value_s=_number(data["value_s"]), low_s=data["low_s"], high_s=data["high_s"])


@dataclass(frozen=True)
class HorizonCurve:
    """How the error grows after a restart from the measured state.

    Attributes:
        time_s: time since the restart [s], increasing.
        rmse: root mean square residual at that time over all windows, in `unit`.
        unit: unit of the residual.
    """

    time_s: tuple[float, ...]
    rmse: tuple[float, ...]
    unit: str

    def __post_init__(self) -> None:
        """Refuse columns of unequal length."""
        _same_length("horizon", self.time_s, self.rmse)

    def to_json(self) -> dict[str, Any]:
        """JSON object; NaN becomes null."""
        return {"time_s": _nulled(self.time_s), "rmse": _nulled(self.rmse), "unit": self.unit}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> HorizonCurve:
        """Read back what `to_json` wrote."""
        return HorizonCurve(time_s=_numbers(data["time_s"]), rmse=_numbers(data["rmse"]), unit=data["unit"])


@dataclass(frozen=True)
class Analysis:
    """The content of analysis.json.

    Attributes:
        bins: run -> signal -> joint -> `velocity`, `position` or `load` -> curve. The run `command` takes the
            command as the motion.
        lags: source (`command` or a run) -> joint -> delay from that source to the measured motion.
        horizon: run -> signal -> joint -> curve; empty unless short windows were scored.
        provenance: versions, git hash, data hash.
    """

    bins: Mapping[str, Mapping[str, Mapping[str, Mapping[str, BinnedCurve]]]] = field(default_factory=dict)
    lags: Mapping[str, Mapping[str, Lag]] = field(default_factory=dict)
    horizon: Mapping[str, Mapping[str, Mapping[str, HorizonCurve]]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """The content of analysis.json."""
        return {
            "schema": ANALYSIS_SCHEMA,
            "bins": _tree(self.bins, BinnedCurve.to_json, 4),
            "lags": _tree(self.lags, Lag.to_json, 2),
            "horizon": _tree(self.horizon, HorizonCurve.to_json, 3),
            "provenance": dict(self.provenance),
        }

    @staticmethod
    def from_json(data: Any, where: str = "analysis.json") -> Analysis:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: not an analysis, or of another version.
            DataError: an analysis, but broken.
        """
        return read_versioned(Analysis._read, data, where, schema=ANALYSIS_SCHEMA, what="analysis of a gap")

    @staticmethod
    def _read(data: Mapping[str, Any]) -> Analysis:
        return Analysis(
            bins=_tree(data["bins"], BinnedCurve.from_json, 4),
            lags=_tree(data["lags"], Lag.from_json, 2),
            horizon=_tree(data["horizon"], HorizonCurve.from_json, 3),
            provenance=data.get("provenance", {}),
        )

    def save(self, path: Path) -> None:
        """Write analysis.json atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> Analysis:
        """Read analysis.json."""
        return Analysis.from_json(read_json(path), str(path))


def _tree(tree: Any, leaf: Any, depth: int) -> Any:
    """The same nesting of mappings with `leaf` applied at `depth`."""
    return leaf(tree) if depth == 0 else {key: _tree(value, leaf, depth - 1) for key, value in tree.items()}


def _same_length(what: str, *columns: Sized) -> None:
    lengths = [len(column) for column in columns]
    if len(set(lengths)) > 1:
        raise DataError(f"the columns of {what} have unequal lengths", got=lengths)


def _null(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _nulled(values: Sequence[float]) -> list[float | None]:
    return [_null(value) for value in values]


def _number(value: Any) -> Any:
    return math.nan if value is None else value


def _numbers(values: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(_number(value) for value in values)
