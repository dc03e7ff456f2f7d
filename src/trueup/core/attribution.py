"""Where the gap comes from: `explain.json`, the share of each cause."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trueup.core.atomic import read_json, write_json
from trueup.core.config import read_versioned
from trueup.core.results import Estimate
from trueup.errors import DataError

EXPLAIN_SCHEMA = "trueup.explain/2"
# What no cause took away.
UNEXPLAINED = "unexplained"
# A model that makes the error a thousand times as large has a share of -1e6; what is beyond this cannot be drawn.
_LARGEST_SHARE = 1e30
# How the statement begins that names the searches that a time limit ended.
SHORT_OF_TIME = "the time limit ended the search for"


@dataclass(frozen=True)
class AttributionCause:
    """One cause of the gap.

    Attributes:
        cause: delay, gains, friction, gravity, inertia.
        label: the same for people, e.g. `gravity or payload`.
        quantities: whose fitted numbers are other than those of the model as it came.
        parameters: how many numbers these are.
    """

    cause: str
    label: str
    quantities: tuple[str, ...]
    parameters: int

    def to_json(self) -> dict[str, Any]:
        """JSON object."""
        return {
            "cause": self.cause,
            "label": self.label,
            "quantities": list(self.quantities),
            "parameters": self.parameters,
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> AttributionCause:
        """Read back what `to_json` wrote."""
        return AttributionCause(data["cause"], data["label"], tuple(data["quantities"]), data["parameters"])


@dataclass(frozen=True)
class Attribution:
    """The content of explain.json.

    Attributes:
        split: the motions on which models were scored; they were fitted to others.
        unit: of all errors.
        before: error of the model as it came: mean over motions of the mean over scored joints, with interval.
        after: the same with all fitted numbers.
        causes: in the order delay, gains, friction, gravity, inertia.
        shares: joint -> cause -> share of the joint's nominal mean square error that this cause takes away, negative
            where it makes things worse; `unexplained` is the rest, so that the shares of a joint add up to 1.
        shares_total: the same over all joints together.
        statements: what a reader must know, most important first.
        provenance: versions, git hash, seed, data hash, configuration.

    Raises:
        DataError: a cause occurs twice, or a share that no error can have.
    """

    split: str
    unit: str
    before: Estimate
    after: Estimate
    causes: tuple[AttributionCause, ...]
    shares: Mapping[str, Mapping[str, float]]
    shares_total: Mapping[str, float]
    statements: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse shares that nobody could draw."""
        names = [own.cause for own in self.causes]
        if len(set(names)) < len(names) or not all(names):
            raise DataError("causes of an attribution have a name each", got=names)
        for row in (self.shares_total, *self.shares.values()):
            beyond = [share for share in row.values() if abs(share) > _LARGEST_SHARE]
            if beyond:
                raise DataError("a share of an attribution", got=beyond[0], expected=f"at most {_LARGEST_SHARE:g}")

    @property
    def labels(self) -> dict[str, str]:
        """Cause -> its name for people, the unexplained rest last."""
        return {**{own.cause: own.label or own.cause for own in self.causes}, UNEXPLAINED: UNEXPLAINED}

    @property
    def short_of_time(self) -> bool:
        """Whether a time limit ended a search: without it, the shares may be others."""
        return any(statement.startswith(SHORT_OF_TIME) for statement in self.statements)

    def to_json(self) -> dict[str, Any]:
        """The content of explain.json; a share that is not defined is null."""
        return {
            "schema": EXPLAIN_SCHEMA,
            "split": self.split,
            "unit": self.unit,
            "statements": list(self.statements),
            "before": self.before.to_json(),
            "after": self.after.to_json(),
            "causes": [own.to_json() for own in self.causes],
            "shares": {joint: _nulled(row) for joint, row in self.shares.items()},
            "shares_total": _nulled(self.shares_total),
            "provenance": dict(self.provenance),
        }

    @staticmethod
    def from_json(data: Any, where: str = "explain.json") -> Attribution:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: not an attribution, or of another version.
            DataError: an attribution, but broken.
        """
        return read_versioned(Attribution._read, data, where, schema=EXPLAIN_SCHEMA, what="attribution")

    @staticmethod
    def _read(data: Mapping[str, Any]) -> Attribution:
        return Attribution(
            split=data["split"],
            unit=data["unit"],
            before=Estimate.from_json(data["before"]),
            after=Estimate.from_json(data["after"]),
            causes=tuple(AttributionCause.from_json(item) for item in data["causes"]),
            shares={joint: _numbers(row) for joint, row in data["shares"].items()},
            shares_total=_numbers(data["shares_total"]),
            statements=tuple(data["statements"]),
            provenance=data.get("provenance", {}),
        )

    def save(self, path: Path) -> None:
        """Write explain.json atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> Attribution:
        """Read explain.json."""
        return Attribution.from_json(read_json(path), str(path))


def _number(value: Any) -> Any:
    return math.nan if value is None else value


def _numbers(row: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _number(value) for key, value in row.items()}


def _null(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _nulled(row: Mapping[str, float]) -> dict[str, float | None]:
    return {key: _null(value) for key, value in row.items()}
