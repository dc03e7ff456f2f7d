"""What a check of the set-up found: `check.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned

CHECK_NAME = "check.json"
CHECK_SCHEMA = "trueup.check/1"

CheckSeverity = Literal["certain", "likely", "note"]
SEVERITIES: tuple[CheckSeverity, ...] = ("certain", "likely", "note")
MendPlace = Literal["robot.yaml", "mapping", "model", "recording"]


@dataclass(frozen=True)
class Mend:
    """What mends a finding.

    Attributes:
        where: which file is changed; `recording` if the log cannot be mended and has to be made again.
        lines: what stands there afterwards, YAML or MJCF, line breaks included. Of robot.yaml only the joints and keys
            that change: `check.mended` merges them. Empty where there is nothing to copy.
        words: what to do, in a sentence without a full stop.
    """

    where: MendPlace
    lines: str = ""
    words: str = ""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with the set-up, or may be.

    Attributes:
        kind: short stable word, e.g. `sign`, `swap`, `unit`, `gravity`.
        severity: `certain` stops a close; `likely` deserves a look; `note` is worth knowing.
        evidence: what speaks for it, with numbers, in sentences.
        joints: those that it is about, in the robot's names; empty for all of them.
        mends: what mends it, the likeliest first; the others where the log cannot tell which.
        numbers: the same numbers for programs; shares are from 0 to 1.
        motions: those that it is about; empty for all.
    """

    kind: str
    severity: CheckSeverity
    evidence: str
    joints: tuple[str, ...] = ()
    mends: tuple[Mend, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    motions: tuple[str, ...] = ()


@dataclass(frozen=True)
class CheckResult:
    """The content of check.json.

    Attributes:
        findings: the gravest first.
        motions: number of motions that were looked at.
        unseen: questions that these motions cannot answer, one sentence each.
        seconds: what the check took [s].
        provenance: versions, git hash, hash of the data.
    """

    findings: tuple[Finding, ...]
    motions: int
    unseen: tuple[str, ...] = ()
    seconds: float = 0.0
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def certain(self) -> tuple[Finding, ...]:
        """The findings with which no fit should begin."""
        return tuple(finding for finding in self.findings if finding.severity == "certain")

    def to_json(self) -> dict[str, Any]:
        """The content of check.json."""
        return {"schema": CHECK_SCHEMA, **asdict(self)}

    def save(self, path: Path) -> None:
        """Write check.json atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> CheckResult:
        """Read check.json.

        Raises:
            FormatError: something else, or another version.
            DataError: broken.
        """
        return build_versioned(CheckResult, read_json(path), str(path), schema=CHECK_SCHEMA, what="check of a set-up")
