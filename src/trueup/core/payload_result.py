"""What a robot carries, by recordings with it and without it: `payload.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned

PAYLOAD_NAME = "payload.json"
PAYLOAD_SCHEMA = "trueup.payload/1"

# How it was weighed: by the motion (simulated), or by the measured torques (inverse dynamics).
Way = Literal["motion", "torque"]


@dataclass(frozen=True)
class Weighed:
    """Mass and center of mass of a payload, as one method finds them.

    Attributes:
        mass_kg: [kg]; not below zero.
        interval_kg: 95 % interval, not below zero [kg].
        determined: whether the interval is narrow enough: half of it is no more than half of the mass, or than a
            twentieth of the mass that moves.
        center_m: center of mass in the given frame, x, y and z [m].
        center_interval_m: its 95 % intervals [m].
        center_seen: of each axis, whether the motions determine it to 3 cm either way.
        notes: what has to be known besides, sentences without a full stop.
    """

    mass_kg: float
    interval_kg: tuple[float, float]
    determined: bool
    center_m: tuple[float, float, float]
    center_interval_m: tuple[tuple[float, float], ...]
    center_seen: tuple[bool, bool, bool]
    notes: tuple[str, ...] = ()

    @property
    def carries(self) -> bool:
        """Whether something is carried beyond doubt: the interval of its mass does not hold zero."""
        return self.interval_kg[0] > 0.0


@dataclass(frozen=True)
class HeldOut:
    """Motions with the payload that no number was fitted to.

    Attributes:
        motions: their ids.
        without: position RMSE of the model without a payload [rad or m], over scored joints and motions.
        with_it: the same with the payload.
    """

    motions: tuple[str, ...]
    without: float
    with_it: float


@dataclass(frozen=True)
class PayloadResult:
    """The content of payload.json.

    Attributes:
        determined: whether the mass is determined.
        best: the method whose numbers count: the one with the narrower interval.
        ways: method -> what it found.
        body: name of the body that carries it.
        frame: body or site in whose frame the center is given.
        held_out: errors on motions that were not fitted; None where a single one was recorded.
        doubts: what speaks against the result, sentences without a full stop; empty where nothing does.
        notes: what was left out, and how motions were read.
        motions: number of motions of each kind that were fitted, `free` and `loaded`.
        provenance: versions, git hash, seed, configuration, hash of the data.
    """

    determined: bool
    best: Way
    ways: Mapping[Way, Weighed]
    body: str
    frame: str
    held_out: HeldOut | None
    doubts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    motions: Mapping[str, int] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def weighed(self) -> Weighed:
        """What the better method found."""
        return self.ways[self.best]

    def save(self, path: Path) -> None:
        """Write payload.json atomically."""
        write_json(path, {"schema": PAYLOAD_SCHEMA, **asdict(self)})

    @staticmethod
    def load(path: Path) -> PayloadResult:
        """Read payload.json.

        Raises:
            FormatError: something else, or another version.
            DataError: broken.
        """
        return build_versioned(PayloadResult, read_json(path), str(path), schema=PAYLOAD_SCHEMA, what="payload")
