"""What a sweep of trainings found: `sweep.json`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, without_nan, write_json
from trueup.core.config import build_versioned

SWEEP_NAME = "sweep.json"
SWEEP_SCHEMA = "trueup.sweep/1"

# Looked for in this order where nobody says by which signal networks are compared; simulators have torques worst.
_PREFERRED = ("torque", "position", "velocity", "current", "voltage", "body.position", "body.rotation")


@dataclass(frozen=True)
class SweepError:
    """An error on val, the root of the mean square over samples and joints (components, of bodies).

    Attributes:
        corrected: of the run after correction.
        simulated: of the run as it was simulated.
        unit: of both; `1` where the joints of the signal have several units, and both are shares of each joint's
            simulated error.
    """

    corrected: float
    simulated: float
    unit: str


@dataclass(frozen=True)
class SweepTraining:
    """One training.

    Attributes:
        candidate: name of what is trained: a method, or a file of a configuration.
        method: of the network.
        seed: of all its draws.
        folder: of its model, relative to that of sweep.json.
        state: `complete`, `failed`, or `open` as long as it has not ended.
        reason: why it failed.
        seconds: that it took [s], those before an interruption included.
        epochs: that it took; 0 of what needs none.
        val: signal -> error of the model that was kept.
    """

    candidate: str
    method: str
    seed: int
    folder: str
    state: Literal["complete", "failed", "open"] = "open"
    reason: str = ""
    seconds: float = 0.0
    epochs: int = 0
    val: Mapping[str, SweepError] = field(default_factory=dict)


@dataclass(frozen=True)
class SweepRow:
    """One candidate over its seeds, by the error of the signal that is compared.

    Attributes:
        candidate: its name.
        method: of its networks.
        complete: trainings that are.
        failed: trainings that have failed.
        mean: of the corrected error over complete trainings.
        low: the smallest one.
        high: the largest one.
        simulated: error before correction.
        unit: of all four.
        seconds: mean time of a training [s].
        best: folder of the training with the smallest error.
    """

    candidate: str
    method: str
    complete: int
    failed: int
    mean: float
    low: float
    high: float
    simulated: float
    unit: str
    seconds: float
    best: str


@dataclass(frozen=True)
class SweepResult:
    """The content of sweep.json.

    Attributes:
        trainings: all of them, in the order in which they were asked for.
        signal: by which candidates are compared; empty as long as no training is complete.
        ranking: candidates, the best one first: those of which no training failed, by the mean over seeds.
        chosen: folder of the best training of the best candidate; empty as long as there is none.
        split: of all errors.
        asked: hash of what all trainings share: data, run, robot.
        provenance: versions, git hash, seed, data hash, configuration of every candidate.
    """

    trainings: tuple[SweepTraining, ...]
    signal: str = ""
    ranking: tuple[SweepRow, ...] = ()
    chosen: str = ""
    split: str = "val"
    asked: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write sweep.json, whole or not at all."""
        write_json(path, without_nan({"schema": SWEEP_SCHEMA, **asdict(self)}))

    @staticmethod
    def load(path: Path) -> SweepResult:
        """Read it back.

        Raises:
            DataError: it is not there, or no JSON.
            FormatError: it is none of this version.
        """
        return build_versioned(SweepResult, read_json(path), str(path), schema=SWEEP_SCHEMA, what="result of a sweep")


def signal_of(trainings: tuple[SweepTraining, ...], wanted: str | None = None) -> str:
    """The signal by which complete trainings are compared: the one that is wanted, or one that all of them correct.

    Returns:
        Its name; empty where there is none.
    """
    complete = [training for training in trainings if training.state == "complete"]
    common = [name for name in _PREFERRED if complete and all(name in training.val for training in complete)]
    if wanted is not None:
        return wanted if wanted in common else ""
    return common[0] if common else ""


def ranked(trainings: tuple[SweepTraining, ...], signal: str) -> tuple[SweepRow, ...]:
    """Candidates by their error on val, smaller ones first; those of which a training failed behind all others.

    Candidates without a complete training are left out.
    """
    by_candidate: dict[str, list[SweepTraining]] = {}
    for training in trainings:
        by_candidate.setdefault(training.candidate, []).append(training)
    rows = [_row(own, signal) for own in by_candidate.values() if any(signal in item.val for item in own)]
    return tuple(sorted(rows, key=lambda row: (row.failed > 0, row.mean)))


def _row(trainings: list[SweepTraining], signal: str) -> SweepRow:
    complete = [item for item in trainings if signal in item.val]
    errors = [item.val[signal].corrected for item in complete]
    best = complete[errors.index(min(errors))]
    return SweepRow(
        candidate=best.candidate,
        method=best.method,
        complete=len(complete),
        failed=sum(item.state == "failed" for item in trainings),
        mean=math.fsum(errors) / len(errors),
        low=min(errors),
        high=max(errors),
        simulated=best.val[signal].simulated,
        unit=best.val[signal].unit,
        seconds=math.fsum(item.seconds for item in complete) / len(complete),
        best=best.folder,
    )
