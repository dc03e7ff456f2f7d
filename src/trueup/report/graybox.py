"""The part of graybox.json that a report shows: how far each block of terms lowers the error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueup.core.atomic import read_json
from trueup.core.config import read_versioned
from trueup.core.results import Estimate

GRAYBOX_SCHEMA = "trueup.graybox/1"
# In place of a payload: all motions of a split together.
ALL_MOTIONS = ""


@dataclass(frozen=True)
class BlockScore:
    """How well the model up to one block predicts the torque of some motions.

    Attributes:
        rmse: root mean square error.
        reduction: by how much that is lower than without the block; negative where it is higher.
        motions: number of motions.
    """

    rmse: Estimate
    reduction: Estimate
    motions: int


@dataclass(frozen=True)
class Block:
    """One step of the growing model.

    Attributes:
        name: e.g. `friction`.
        left_out: why it was not fitted, or empty.
        scores: split -> payload in kg as text, or `ALL_MOTIONS` -> score.
    """

    name: str
    left_out: str
    scores: Mapping[str, Mapping[str, BlockScore]]


@dataclass(frozen=True)
class Graybox:
    """Blocks joint by joint.

    Attributes:
        joints: joint -> blocks in the order in which they were added.
        notes: what had to be assumed, for people.
    """

    joints: Mapping[str, tuple[Block, ...]]
    notes: tuple[str, ...] = ()

    @staticmethod
    def load(path: Path) -> Graybox:
        """Read graybox.json.

        Raises:
            FormatError: another kind of file or version.
            DataError: missing or broken.
        """
        what = "gray-box regression"
        return read_versioned(Graybox._read, read_json(path), str(path), schema=GRAYBOX_SCHEMA, what=what)

    @staticmethod
    def _read(data: Mapping[str, Any]) -> Graybox:
        joints = {name: tuple(_block(item) for item in fit["blocks"]) for name, fit in data["joints"].items()}
        return Graybox(joints, tuple(data.get("notes", ())))


def _block(data: Mapping[str, Any]) -> Block:
    scores = {split: {ALL_MOTIONS: _score(item)} for split, item in data["splits"].items()}
    for split, payloads in data["payloads"].items():
        scores.setdefault(split, {}).update({load: _score(item) for load, item in payloads.items()})
    return Block(data["block"], data["left_out"], scores)


def _score(data: Mapping[str, Any]) -> BlockScore:
    return BlockScore(Estimate.from_json(data["rmse"]), Estimate.from_json(data["reduction"]), data["motions"])
