"""The part of graybox.json that a report shows: how far each block of terms lowers the error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueup.core.atomic import read_json
from trueup.core.results import Estimate
from trueup.errors import DataError, FormatError

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
        data = read_json(path)
        if not isinstance(data, Mapping) or data.get("schema") != GRAYBOX_SCHEMA:
            raise FormatError("this file holds no gray-box regression, or another version", expected=GRAYBOX_SCHEMA)
        try:
            joints = {str(name): tuple(_block(item) for item in fit["blocks"]) for name, fit in data["joints"].items()}
            notes = tuple(str(note) for note in data.get("notes", ()))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise DataError("a gray-box regression is broken", got=f"{type(error).__name__}: {error}") from error
        return Graybox(joints, notes)


def _block(data: Mapping[str, Any]) -> Block:
    scores = {str(split): {ALL_MOTIONS: _score(item)} for split, item in data["splits"].items()}
    for split, payloads in data["payloads"].items():
        scores.setdefault(str(split), {}).update({str(load): _score(item) for load, item in payloads.items()})
    return Block(str(data["block"]), str(data["left_out"]), scores)


def _score(data: Mapping[str, Any]) -> BlockScore:
    return BlockScore(_estimate(data["rmse"]), _estimate(data["reduction"]), int(data["motions"]))


def _estimate(data: Mapping[str, Any]) -> Estimate:
    estimate = Estimate.from_json(data)
    for end in (estimate.low, estimate.high):
        if not isinstance(end, int | float | None):
            raise TypeError(f"{end!r} is no number")
    if not isinstance(estimate.unit, str):
        raise TypeError(f"{estimate.unit!r} is no unit")
    return estimate
