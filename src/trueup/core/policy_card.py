"""What a policy says of itself: `policy.json`, beside `policy.onnx`.

`policy.onnx` takes what is seen, (N, 3J + 3) float32 as `deploy.looking` makes it, and gives torques (N, J) float32
[Nm] within the largest ones. What is seen has in it where the end of the arm is; the card has the kinematics for that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from trueup.core.atomic import file_hash, read_json, write_json
from trueup.core.card import sealed, unsealed, verified, what_is
from trueup.core.config import build
from trueup.errors import ConfigError, DataError

POLICY_SCHEMA = "trueup.policy/1"
POLICY_CARD = "policy.json"
POLICY_GRAPH = "policy.onnx"
# What a training that begins with the policy needs besides, and a robot does not.
POLICY_LEARNER = "learner.safetensors"


@dataclass(frozen=True)
class Kinematics:
    """From the base of an arm to its end: K joints, and what is fixed between them.

    Attributes:
        columns: which joint moves part k, (K,).
        axes: its axis, (K, 3).
        hinges: whether it turns, or slides, (K,).
        turns: rotations that are fixed before each part and after the last one, by rows, (K + 1, 9).
        shifts: likewise [m], (K + 1, 3).

    Raises:
        ConfigError: numbers that make no chain.
    """

    columns: tuple[int, ...]
    axes: tuple[tuple[float, ...], ...]
    hinges: tuple[bool, ...]
    turns: tuple[tuple[float, ...], ...]
    shifts: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        """Refuse what is no chain."""
        count = len(self.columns)
        sizes = (len(self.axes), len(self.hinges), len(self.turns) - 1, len(self.shifts) - 1)
        rows = [*((row, 3) for row in (*self.axes, *self.shifts)), *((row, 9) for row in self.turns)]
        whole = all(len(row) == width and all(map(math.isfinite, row)) for row, width in rows)
        if not count or sizes != (count,) * 4 or not whole or min(self.columns) < 0:
            raise ConfigError("kinematics of a policy", got=f"{count} parts, {sizes}", expected="a chain")


@dataclass(frozen=True)
class PolicyCard:
    """The content of policy.json.

    Attributes:
        name: of the policy.
        robot: name of the kind of robot.
        joints: names of its J joints, in order.
        rate_hz: control steps per second that it was trained at.
        torque_nm: largest torque of each joint besides what carries the weight, (J,) [Nm].
        kinematics: of the arm.
        site: of the model, what reaches the goal.
        files: name -> SHA-256 of the files beside the card.
        description: for people.
        provenance: versions, seed, configuration, and what the training did.

    Raises:
        ConfigError: numbers that make no policy.
    """

    name: str
    robot: str
    joints: tuple[str, ...]
    rate_hz: float
    torque_nm: tuple[float, ...]
    kinematics: Kinematics
    site: str = ""
    files: Mapping[str, str] = field(default_factory=dict)
    description: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a card that describes no policy."""
        positive = (self.rate_hz, *self.torque_nm)
        if not all(0 < value < math.inf for value in positive) or len(self.torque_nm) != len(self.joints):
            raise ConfigError(
                f"policy {self.name!r}: rate_hz and torque_nm",
                got=positive,
                expected=f"a rate and {len(self.joints)} torques, all positive",
            )
        if max(self.kinematics.columns) >= len(self.joints):
            raise ConfigError(f"policy {self.name!r}: its kinematics are of other joints", got=self.joints)

    def save(self, folder: Path) -> PolicyCard:
        """Write policy.json, last of all files: with the hash of the graph; returns the card as written."""
        files = {POLICY_GRAPH: file_hash(folder / POLICY_GRAPH)}
        write_json(folder / POLICY_CARD, sealed(POLICY_SCHEMA, asdict(replace(self, files=files))))
        return PolicyCard.load(folder)

    @staticmethod
    def load(folder: Path) -> PolicyCard:
        """Read policy.json; the graph is not looked at.

        Raises:
            DataError: missing, truncated or changed.
            FormatError: of another version.
        """
        where = folder / POLICY_CARD
        if not where.exists():
            raise DataError(
                f"{folder} holds no policy",
                got=what_is(folder),
                expected=POLICY_CARD,
                hint="Give a folder that `trueup policy train` has written, or zoo:panda-reach.",
            )
        content = unsealed(read_json(where), str(where), schema=POLICY_SCHEMA, what="policy")
        try:
            return build(PolicyCard, content, str(where))
        except ConfigError as error:
            raise DataError(f"{where} is broken", got=error.summary) from error

    def graph(self, folder: Path) -> bytes:
        """The bytes of policy.onnx, after a look at their hash.

        Raises:
            DataError: it is missing, truncated or changed.
        """
        return verified(folder, POLICY_GRAPH, self.files, POLICY_CARD)
