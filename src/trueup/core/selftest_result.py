"""What a self-test found: which numbers of drawn robots a fit recovers from given motions: `selftest.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned

SELFTEST_NAME = "selftest.json"
SELFTEST_SCHEMA = "trueup.selftest/1"

# From good to bad.
SelftestVerdict = Literal["recovered", "open", "missed"]
SELFTEST_VERDICTS: tuple[SelftestVerdict, ...] = ("recovered", "open", "missed")


@dataclass(frozen=True)
class DrawnNumber:
    """One number of a drawn robot, and what a fit has made of it.

    Attributes:
        name: `QUANTITY[TARGET]`.
        unit: of all numbers here.
        truth: what was drawn.
        nominal: what the model says; None if it has no such number, or joints that share it differ.
        value: what was fitted, or kept; None where the fit has left the number out.
        interval: 95 % interval of the fit; likewise.
        verdict: `recovered` (the fit says that it is determined, or has an effective value, and the interval holds the
            truth), `missed` (it is said to be determined, and the interval does not), or `open` (the motions determine
            it weakly or not at all, or an effective value is not the true one).
        sentence: what the fit says of it.
        excite: which motion shows it; `{target}` stands for the joint or body.
        off: distance of the fitted value from the truth, in half widths of the interval, on the scale of the fit; None
            where nothing was fitted.
    """

    name: str
    unit: str
    truth: float
    nominal: float | None
    value: float | None
    interval: tuple[float, float] | None
    verdict: SelftestVerdict
    sentence: str
    excite: str
    off: float | None = None


@dataclass(frozen=True)
class DrawnRobot:
    """One drawn robot.

    Attributes:
        seed: of the draw.
        draws: how many were drawn; those before the last could not be simulated.
        numbers: its parameters.
        status: of the fit.
        model: which model the fit has chosen; `base` if no richer one.
        seconds: what simulation and fit took [s].
        cut: whether the time has ended or left out a search.
    """

    seed: int
    draws: int
    numbers: tuple[DrawnNumber, ...]
    status: str
    model: str
    seconds: float
    cut: bool = False

    def of(self, verdict: SelftestVerdict) -> tuple[DrawnNumber, ...]:
        """The numbers of one verdict."""
        return tuple(item for item in self.numbers if item.verdict == verdict)


@dataclass(frozen=True)
class SelftestResult:
    """The content of selftest.json.

    Attributes:
        truths: the drawn robots, by seed.
        motions: number of motions that were fitted; of val, on which models are chosen, are more.
        motion_s: how much motion the fit has simulated [s].
        noise: joint -> standard deviation of its encoder [rad or m].
        notes: what was left out or cut, and what must be known besides.
        provenance: versions, git hash, seed, configuration.
    """

    truths: tuple[DrawnRobot, ...]
    motions: int
    motion_s: float
    noise: Mapping[str, float]
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def missed(self) -> int:
        """How many numbers were missed, over all truths."""
        return sum(len(truth.of("missed")) for truth in self.truths)

    def save(self, path: Path) -> None:
        """Write selftest.json atomically."""
        write_json(path, {"schema": SELFTEST_SCHEMA, **asdict(self)})

    @staticmethod
    def load(path: Path) -> SelftestResult:
        """Read selftest.json.

        Raises:
            FormatError: something else, or another version.
            DataError: broken.
        """
        return build_versioned(SelftestResult, read_json(path), str(path), schema=SELFTEST_SCHEMA, what="self-test")
