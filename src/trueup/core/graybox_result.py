"""What a gray-box regression found: coefficients with intervals, and what each block of terms is worth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned
from trueup.core.results import Estimate
from trueup.errors import MissingSignal

GRAYBOX_SCHEMA = "trueup.graybox/1"

Status = Literal["ok", "weak", "not identifiable"]
IntervalMethod = Literal["cluster", "hac", "none"]

# In place of a split: every motion, predicted by coefficients that were fitted to others.
HELD_OUT = "held out"


@dataclass(frozen=True)
class Coefficient:
    """One coefficient of eq. 1 for one joint.

    Attributes:
        unit: e.g. `Nm/rad`.
        value: the estimate; None when it is not identifiable.
        low: lower end of the 95 % interval.
        high: upper end.
        standard_error: robust standard error.
        status: `weak` means that the number depends on something that the data hardly show; the note says what.
        note: one sentence for people; empty when there is nothing to say.
    """

    unit: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    standard_error: float | None = None
    status: Status = "ok"
    note: str = ""


@dataclass(frozen=True)
class Score:
    """How well a model predicts the torque of some motions.

    Attributes:
        rmse: over all samples of these motions [Nm or N], with the interval over motions.
        reduction: by how much the RMSE is lower than without the block; negative where it made things worse.
        motions: number of motions.
        samples: number of samples.
    """

    rmse: Estimate
    reduction: Estimate
    motions: int
    samples: int


@dataclass(frozen=True)
class BlockFit:
    """The model that has all blocks up to this one.

    Attributes:
        block: the block that was added last.
        left_out: why the block was not fitted; empty if it was.
        coefficients: name -> coefficient, of this block and of all before it, refitted together.
        splits: split -> score on its motions; the reduction of `pd` is against a constant torque. `held out` is all
            motions, each predicted by coefficients that were fitted without it and its repetitions.
        payloads: split -> payload in kg, as text -> score on the motions that carry it.
    """

    block: str
    left_out: str
    coefficients: Mapping[str, Coefficient]
    splits: Mapping[str, Score]
    payloads: Mapping[str, Mapping[str, Score]]


@dataclass(frozen=True)
class JointFit:
    """The growing blocks of one joint.

    Attributes:
        blocks: in the order in which they were added.
        interval_method: `cluster` (motions left out in turn), `hac` (autocorrelation within motions), or `none`.
        motions: number of motions that were fitted.
        samples: number of samples that were fitted.
        notes: what is wrong with this joint's data, for people.
    """

    blocks: tuple[BlockFit, ...]
    interval_method: IntervalMethod
    motions: int
    samples: int
    notes: tuple[str, ...] = ()

    @property
    def final(self) -> BlockFit | None:
        """The richest model that could be fitted; None if there is none."""
        fitted = [block for block in self.blocks if not block.left_out]
        return fitted[-1] if fitted else None

    def block(self, name: str) -> BlockFit:
        """The model up to one block.

        Raises:
            MissingSignal: there is no such block.
        """
        for item in self.blocks:
            if item.block == name:
                return item
        raise MissingSignal(f"there is no block {name!r}", available=[item.block for item in self.blocks])


@dataclass(frozen=True)
class GrayboxResult:
    """A gray-box regression of all joints.

    Attributes:
        joints: joint -> fits.
        settings: what was asked for: delay_s, epsilon, filter and sources.
        notes: what had to be assumed about the episodes.
        provenance: versions, git hash, data hash.
        total: mean over the joints that could be fitted, block by block, without coefficients; empty if their torques
            have different units.
    """

    joints: Mapping[str, JointFit]
    settings: Mapping[str, Any]
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    total: tuple[BlockFit, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """A JSON object with schema `trueup.graybox/1`."""
        return {"schema": GRAYBOX_SCHEMA, **asdict(self)}

    @staticmethod
    def from_json(data: Any, where: str = "graybox.json") -> GrayboxResult:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: another kind of file or version.
            DataError: a gray-box result, but broken.
        """
        return build_versioned(GrayboxResult, data, where, schema=GRAYBOX_SCHEMA, what="gray-box regression")

    def save(self, path: Path) -> None:
        """Write the JSON object atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> GrayboxResult:
        """Read what `save` wrote."""
        return GrayboxResult.from_json(read_json(path), str(path))
