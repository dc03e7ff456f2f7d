"""Where the gap comes from: `explain.json`, the share of every cause."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trueup.core.atomic import read_json, write_json
from trueup.core.config import read_versioned
from trueup.core.results import Estimate
from trueup.errors import DataError

EXPLAIN_SCHEMA = "trueup.explain/1"
# What no cause took away.
UNEXPLAINED = "unexplained"
# A step that makes the error a thousand times as large has a share of -1e6; what is beyond this cannot be drawn.
_LARGEST_SHARE = 1e30
# How the statement begins that names the searches that a time limit ended.
SHORT_OF_TIME = "the time limit ended the search for"


@dataclass(frozen=True)
class AttributionStep:
    """One of the nested fits: all causes before it, and one more.

    Attributes:
        cause: what was added: delay, gains, friction, gravity, inertia; empty for the nominal model.
        label: the same for people, e.g. `gravity or payload`.
        quantities: what this step fits on top of those before it.
        parameters: how many numbers are fitted in this step, those of the causes before it included.
        errors: joint -> root mean square error after this step, over all samples of the split.
        total: mean over motions of the mean over scored joints, with interval, as everywhere.
        seconds: how long the fit took [s].
    """

    cause: str
    label: str
    quantities: tuple[str, ...]
    parameters: int
    errors: Mapping[str, float]
    total: Estimate
    seconds: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """JSON object."""
        return {
            "cause": self.cause,
            "label": self.label,
            "quantities": list(self.quantities),
            "parameters": self.parameters,
            "errors": {joint: _null(value) for joint, value in self.errors.items()},
            "total": self.total.to_json(),
            "seconds": round(self.seconds, 3),
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> AttributionStep:
        """Read back what `to_json` wrote."""
        return AttributionStep(
            cause=data["cause"],
            label=data["label"],
            quantities=tuple(data["quantities"]),
            parameters=data["parameters"],
            errors={joint: _number(value) for joint, value in data["errors"].items()},
            total=Estimate.from_json(data["total"]),
            seconds=data["seconds"],
        )


@dataclass(frozen=True)
class Attribution:
    """The content of explain.json.

    Attributes:
        split: the motions on which the steps were scored; they were fitted to others.
        unit: of all errors.
        steps: from the nominal model (cause empty) to the fit of everything.
        shares: joint -> cause -> share of the joint's nominal mean square error that this cause took away, negative
            where it made things worse; `unexplained` is the rest, so that the shares of a joint add up to 1.
        shares_total: the same over all joints together.
        statements: what a reader must know, most important first.
        provenance: versions, git hash, seed, data hash, configuration.

    Raises:
        DataError: no steps, a first step with a cause, steps that are not about the same joints, or a share that no
            error can have.
    """

    split: str
    unit: str
    steps: tuple[AttributionStep, ...]
    shares: Mapping[str, Mapping[str, float]]
    shares_total: Mapping[str, float]
    statements: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse steps of which no share could be taken."""
        if not self.steps:
            raise DataError("an attribution needs the nominal model as its first step", got="no steps")
        if self.steps[0].cause or not all(step.cause for step in self.steps[1:]):
            raise DataError(
                "the first step of an attribution is the nominal model, the others have a cause",
                got=[step.cause for step in self.steps],
            )
        if len({step.cause for step in self.steps}) < len(self.steps):
            raise DataError("a cause occurs twice in an attribution", got=[step.cause for step in self.steps])
        if any(set(step.errors) != set(self.steps[0].errors) for step in self.steps):
            raise DataError(
                "the steps of an attribution are not about the same joints",
                got=[sorted(step.errors) for step in self.steps],
            )
        for row in (self.shares_total, *self.shares.values()):
            beyond = [share for share in row.values() if abs(share) > _LARGEST_SHARE]
            if beyond:
                raise DataError("a share of an attribution", got=beyond[0], expected=f"at most {_LARGEST_SHARE:g}")

    @staticmethod
    def of(
        split: str,
        unit: str,
        steps: Sequence[AttributionStep],
        *,
        statements: Sequence[str] = (),
        provenance: Mapping[str, Any] | None = None,
    ) -> Attribution:
        """An attribution with its shares taken from the errors of the steps.

        Raises:
            DataError: as the class.
        """
        joints = steps[0].errors if steps else {}
        return Attribution(
            split=split,
            unit=unit,
            steps=tuple(steps),
            shares={joint: shares_of(steps, [joint]) for joint in joints},
            shares_total=shares_of(steps, list(joints)),
            statements=tuple(statements),
            provenance=dict(provenance or {}),
        )

    @property
    def causes(self) -> tuple[str, ...]:
        """The causes in the order in which they were added."""
        return tuple(step.cause for step in self.steps[1:])

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
            "steps": [step.to_json() for step in self.steps],
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
            steps=tuple(AttributionStep.from_json(item) for item in data["steps"]),
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


def shares_of(steps: Sequence[AttributionStep], joints: Sequence[str]) -> dict[str, float]:
    """Cause -> share of the nominal mean square error of these joints that it took away; the rest is `unexplained`.

    All shares are NaN where there was no error to begin with, or one is not known.
    """
    squares = [sum(step.errors[joint] ** 2 for joint in joints) for step in steps]
    defined = bool(squares) and all(math.isfinite(value) for value in squares) and squares[0] > 0.0
    shares = {
        step.cause: (before - after) / squares[0] if defined else math.nan
        for step, before, after in zip(steps[1:], squares, squares[1:], strict=False)
    }
    return {**shares, UNEXPLAINED: squares[-1] / squares[0] if defined else math.nan}


def _number(value: Any) -> Any:
    return math.nan if value is None else value


def _numbers(row: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _number(value) for key, value in row.items()}


def _null(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _nulled(row: Mapping[str, float]) -> dict[str, float | None]:
    return {key: _null(value) for key, value in row.items()}
