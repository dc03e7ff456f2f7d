"""What a `close` did, step by step: `close.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned

CLOSE_NAME = "close.json"
CLOSE_SCHEMA = "trueup.close/1"

# In the order in which they are done.
StepName = Literal["import", "replay", "gap", "explain", "identify", "augment"]
STEPS: tuple[StepName, ...] = ("import", "replay", "gap", "explain", "identify", "augment")


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes:
        name: which.
        status: `done`; `kept` from an earlier call; `cut short` by the time limit; `left out` for want of time or of
            something that is not installed; `failed`, without what depends on it.
        seconds: wall-clock time [s].
        what: what came of it, or why not, in a sentence without a full stop.
        inputs: hash of what decides about it; empty where its own files say so.
    """

    name: StepName
    status: Literal["done", "kept", "cut short", "left out", "failed"]
    seconds: float
    what: str
    inputs: str = ""


@dataclass(frozen=True)
class CloseResult:
    """The content of close.json.

    Attributes:
        steps: in order, as far as the call went.
        until: the last one that was asked for.
        budget_s: time that all were to take together [s]; None without a limit.
        networks: label of a corrected run -> folder of its network, relative to that of close.json.
        provenance: versions, git hash, seed, hash of the data.
    """

    steps: tuple[Step, ...]
    until: StepName
    budget_s: float | None = None
    networks: Mapping[str, str] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def step(self, name: StepName) -> Step | None:
        """The step of this name, if the call came to it."""
        return next((step for step in self.steps if step.name == name), None)

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
