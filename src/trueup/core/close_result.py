"""What a `close` did, step by step: `close.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned

CLOSE_NAME = "close.json"
CLOSE_SCHEMA = "trueup.close/1"

# In the order in which they are done.
StepName = Literal["import", "replay", "gap", "check", "explain", "identify", "augment"]
STEPS: tuple[StepName, ...] = ("import", "replay", "gap", "check", "explain", "identify", "augment")
# What a step says that was left out for want of time.
NO_TIME = "no time was left"
StepStatus = Literal["done", "kept", "cut short", "left out", "failed"]


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes:
        name: which.
        status: `done`; `kept` from an earlier call; `cut short` by the time limit, in this call or in the one that it
            is kept from; `left out` for want of time or of something that is not installed; `failed`, without what
            depends on it.
        seconds: wall-clock time that it took when it was done [s].
        what: what came of it, or why not, in a sentence without a full stop.
        inputs: hash of what decides about it; empty where its own files say so.
    """

    name: StepName
    status: StepStatus
    seconds: float
    what: str
    inputs: str = ""

    @property
    def finished(self) -> bool:
        """Whether it left results."""
        return self.status in ("done", "kept", "cut short")

    @property
    def of_earlier_call(self) -> Step:
        """The same, as a call says it that goes on from there."""
        return replace(self, status="kept") if self.status == "done" else self


@dataclass(frozen=True)
class CloseResult:
    """The content of close.json.

    Attributes:
        steps: in order, as far as the call went, or an earlier one that it goes on from.
        until: the last one that was asked for.
        budget_s: time that the call had for all of them [s]; None without a limit.
        networks: label of a corrected run -> folder of its network, relative to that of close.json.
        asked: what decides about the results, so that no call goes on from what was made otherwise: name -> what was
            asked for, or its hash.
        measuring_s: what it took to measure all runs when the last step was done [s].
        provenance: versions, git hash, seed, hash of the data.
    """

    steps: tuple[Step, ...]
    until: StepName
    budget_s: float | None = None
    networks: Mapping[str, str] = field(default_factory=dict)
    asked: Mapping[str, Any] = field(default_factory=dict)
    measuring_s: float = 0.0
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def step(self, name: StepName) -> Step | None:
        """The step of this name, if the call came to it."""
        return next((step for step in self.steps if step.name == name), None)

    @property
    def seconds(self) -> float:
        """What all steps and the last measurement took, in whichever call [s]."""
        return sum(step.seconds for step in self.steps) + self.measuring_s

    def is_asked(self, name: StepName) -> bool:
        """Whether the last call was to do this step."""
        return STEPS.index(name) <= STEPS.index(self.until)

    @property
    def failed(self) -> tuple[Step, ...]:
        """Steps that the last call was to do, and that failed."""
        return tuple(step for step in self.steps if step.status == "failed" and self.is_asked(step.name))

    @property
    def untimely(self) -> tuple[Step, ...]:
        """Steps that the last call was to do, and for which there was no time."""
        return tuple(
            step
            for step in self.steps
            if step.status == "left out" and step.what == NO_TIME and self.is_asked(step.name)
        )

    def save(self, path: Path) -> None:
        """Write close.json atomically."""
        write_json(path, {"schema": CLOSE_SCHEMA, **asdict(self)})

    @staticmethod
    def load(path: Path) -> CloseResult:
        """Read close.json.

        Raises:
            FormatError: something else, or another version.
            DataError: broken.
        """
        return build_versioned(CloseResult, read_json(path), str(path), schema=CLOSE_SCHEMA, what="result of a close")
