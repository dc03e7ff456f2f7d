"""What an experiment says: numbers with unit, interval, status and a plain sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import read_versioned
from trueup.core.results import Estimate
from trueup.errors import MissingSignal

EXPERIMENT_SCHEMA = "trueup.experiment/1"

Experiment = Literal["breakaway", "constant_torque", "coast"]
Status = Literal["ok", "censored", "no_motion", "moves_without_torque", "not_identifiable", "implausible"]


@dataclass(frozen=True)
class Finding:
    """One number of one joint.

    Attributes:
        estimate: value with unit and 95 % interval; the value is NaN where the data do not determine it, and an end
            of the interval may be there all the same (a threshold above the largest torque that was tried).
        sentence: what it means, for people, with its assumptions.
        status: `ok`; `censored` (some repetitions did not reach it, so the value is biased); `no_motion` up to the
            largest torque; `moves_without_torque`; `not_identifiable`; `implausible` (a friction would be negative
            beyond doubt: something else happened in these motions, and nothing is found in them).
    """

    estimate: Estimate
    sentence: str
    status: Status = "ok"

    def to_json(self) -> dict[str, Any]:
        """JSON object; a NaN becomes null."""
        return {**self.estimate.to_json(), "status": self.status, "sentence": self.sentence}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Finding:
        """Read back what `to_json` wrote."""
        return Finding(Estimate.from_json(data), data["sentence"], data["status"])


@dataclass(frozen=True)
class Rejection:
    """An episode, or a part of it, that said nothing about a joint (any joint, if it is empty), and why."""

    episode: str
    joint: str
    reason: str


@dataclass(frozen=True)
class ExperimentResult:
    """The result of one kind of experiment on some joints.

    Attributes:
        experiment: which one.
        joints: joint -> quantity -> finding; the quantities are listed at the estimator.
        notes: joint -> what may spoil the numbers: other joints that moved, saturation, a poor fit, …
        runs: one flat JSON object per attempt or trajectory, in the order of the data.
        rejected: what could not be used.
        settings: how it was evaluated.
        provenance: versions, git hash, data hash, as the caller gives it.
    """

    experiment: Experiment
    joints: Mapping[str, Mapping[str, Finding]]
    notes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    runs: tuple[Mapping[str, Any], ...] = ()
    rejected: tuple[Rejection, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def finding(self, joint: str, quantity: str) -> Finding:
        """One finding.

        Raises:
            MissingSignal: the joint or the quantity is not in the result.
        """
        if joint not in self.joints:
            raise MissingSignal(f"no {self.experiment} result for joint {joint!r}", available=self.joints)
        if quantity not in self.joints[joint]:
            raise MissingSignal(f"no quantity {quantity!r} for joint {joint!r}", available=self.joints[joint])
        return self.joints[joint][quantity]

    @property
    def problems(self) -> tuple[str, ...]:
        """One sentence per finding that is not `ok`, note and rejection: what must not be overlooked."""
        findings = (
            f"{joint}: {item.sentence}"
            for joint, items in self.joints.items()
            for item in items.values()
            if item.status != "ok"
        )
        notes = (f"{joint}: {note}" for joint, items in self.notes.items() for note in items)
        rejected = (
            f"{item.episode}, {item.joint}: {item.reason}" if item.joint else f"{item.episode}: {item.reason}"
            for item in self.rejected
        )
        return tuple(dict.fromkeys((*findings, *notes, *rejected)))

    def to_json(self) -> dict[str, Any]:
        """JSON object of schema trueup.experiment/1."""
        return {
            "schema": EXPERIMENT_SCHEMA,
            "experiment": self.experiment,
            "joints": {
                joint: {name: finding.to_json() for name, finding in items.items()}
                for joint, items in self.joints.items()
            },
            "notes": {joint: list(notes) for joint, notes in self.notes.items()},
            "runs": [{key: _json_value(value) for key, value in run.items()} for run in self.runs],
            "rejected": [
                {"episode": item.episode, "joint": item.joint, "reason": item.reason} for item in self.rejected
            ],
            "settings": dict(self.settings),
            "provenance": dict(self.provenance),
        }

    @staticmethod
    def from_json(data: Any, where: str = "experiment.json") -> ExperimentResult:
        """Read back what `to_json` wrote; a NaN in `runs` comes back as None.

        Raises:
            FormatError: not the result of an experiment, or of another version.
            DataError: a result, but broken.
        """
        return read_versioned(ExperimentResult._read, data, where, schema=EXPERIMENT_SCHEMA, what="experiment")

    @staticmethod
    def _read(data: Mapping[str, Any]) -> ExperimentResult:
        return ExperimentResult(
            experiment=data["experiment"],
            joints={
                joint: {name: Finding.from_json(item) for name, item in items.items()}
                for joint, items in data["joints"].items()
            },
            notes={joint: tuple(notes) for joint, notes in data["notes"].items()},
            runs=tuple(data["runs"]),
            rejected=tuple(Rejection(**item) for item in data["rejected"]),
            settings=data["settings"],
            provenance=data["provenance"],
        )

    def save(self, path: Path) -> None:
        """Write it atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> ExperimentResult:
        """Read what `save` wrote."""
        return ExperimentResult.from_json(read_json(path), str(path))


def said(estimate: Estimate) -> str:
    """The number in words, as precise as its interval: `0.652 Nm (95 %: 0.633 to 0.671)`."""
    unit = "" if estimate.unit == "1" else f" {estimate.unit}"
    if estimate.low is None or estimate.high is None:
        return f"{estimate.value:.3g}{unit} (no interval)"
    width = estimate.high - estimate.low
    size = max(abs(estimate.low), abs(estimate.high))
    if not (math.isfinite(width) and 0.0 < width < size):
        return f"{estimate.value:.3g}{unit} (95 %: {estimate.low:.3g} to {estimate.high:.3g})"
    digits = min(2 + math.ceil(math.log10(size / width)), 9)
    numbers = (f"{value:.{digits}g}" for value in (estimate.value, estimate.low, estimate.high))
    return "{}{} (95 %: {} to {})".format(next(numbers), unit, *numbers)


def of_friction(estimate: Estimate, sentence: str) -> Finding:
    """A finding about a friction, which cannot be negative.

    Args:
        estimate: as it was fitted.
        sentence: what it means, with `{}` where the number stands.

    Returns:
        One whose value and interval end at zero; one without a value where all of the interval is negative.
    """
    low, high = estimate.low, estimate.high
    if (estimate.value < 0.0 and high is None) or (high is not None and high < 0.0):
        told = f"Not found in these motions: {sentence.format(said(estimate))} A negative friction is none."
        return Finding(Estimate(math.nan, estimate.unit), told, "implausible")
    if (low is not None and low <= 0.0) or estimate.value < 0.0:
        kept = Estimate(max(0.0, estimate.value), estimate.unit, None if low is None else max(0.0, low), high)
        return Finding(kept, f"{sentence.format(said(kept))} The data do not tell it from zero.")
    return Finding(estimate, sentence.format(said(estimate)))


def refuted(findings: Mapping[str, Finding], what: str, record: str) -> dict[str, Finding]:
    """What is left of a fit: nothing where it says something impossible, for its other numbers are of the same motions.

    Args:
        findings: of one joint.
        what: the quantity that is then said not to be found.
        record: what to record in place of these motions.

    Returns:
        The findings as they are, or a single one.
    """
    bad = next((item for item in findings.values() if item.status == "implausible"), None)
    if bad is None:
        return dict(findings)
    cause = "Something besides friction acts in them: gravity, other joints, or a torque that is not in the log."
    return {what: Finding(Estimate(math.nan, bad.estimate.unit), f"{bad.sentence} {cause} {record}", "implausible")}


def in_words(error: object) -> str:
    """An error on one line."""
    return ". ".join(line.strip() for line in str(error).splitlines())


def reasons_in_short(rejected: Sequence[Rejection]) -> str:
    """The first few different reasons."""
    reasons = dict.fromkeys(f"{item.episode}: {item.reason}" for item in rejected)
    return "; ".join(list(reasons)[:4]) or "no joint is commanded"


def _json_value(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
