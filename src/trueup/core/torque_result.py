"""How well the torques of a robot are explained on motions that were not fitted: `torque.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned
from trueup.core.graybox_result import Score

TORQUE_NAME = "torque.json"
TORQUE_SCHEMA = "trueup.torque/1"

TorqueMethod = Literal["graybox", "dynamics"]
TorqueSource = Literal["torque", "current", "command"]
HeldOut = Literal["test", "val", "folds"]
TORQUE_METHODS: tuple[TorqueMethod, ...] = ("graybox", "dynamics")
# What needs no method: name -> what it is for people.
RIVALS: Mapping[str, str] = {
    "model": "the model as it is",
    "simple": "least squares on velocity, its sign and a constant",
    "mean": "the mean torque",
}


@dataclass(frozen=True)
class JointTorque:
    """One joint on held-out motions.

    Attributes:
        unit: of its torque: `Nm` or `N`; `A` for a current whose factor nobody has given.
        rms: root mean square of the torque.
        errors: method or rival -> RMSE of the torque it predicts, and by how much less that is than the best rival's.
        factor: torque per current [Nm/A or N/A]; None where torques were measured, or nothing tells it.
        factor_from: `robot`, or `model`: fitted, so that the links weigh what the model says. As wrong as its masses.
        factor_interval: 95 % interval of a fitted factor.
    """

    unit: str
    rms: float
    errors: Mapping[str, Score]
    factor: float | None = None
    factor_from: Literal["", "robot", "model"] = ""
    factor_interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class TorqueResult:
    """The content of torque.json.

    Attributes:
        source: what stands for the torque: `torque` or `current` (measured), or the commanded torque, `command`.
        follows: what the drives are told.
        held_out: `test` or `val`, predicted by what was fitted to train; `folds`: each motion and its repetitions,
            predicted by what was fitted to others.
        methods: those that could be fitted.
        rival: the best of the simple ones on the held-out motions.
        joints: joint -> errors.
        total: method or rival -> mean over joints of its RMSE as a share of the torque's RMS [1].
        motions: number of held-out motions.
        left_out: joint, method or rival -> why it is not there.
        notes: what was assumed.
        provenance: versions, git hash, seed, data hash.
    """

    source: TorqueSource
    follows: Literal["position", "velocity", "torque"]
    held_out: HeldOut
    methods: tuple[TorqueMethod, ...]
    rival: str
    joints: Mapping[str, JointTorque]
    total: Mapping[str, Score]
    motions: int
    left_out: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def better(self, method: str) -> bool | None:
        """Whether a method is nearer than the best rival; None where these motions cannot tell."""
        less = self.total[method].reduction
        low, high = (less.value, less.value) if less.low is None or less.high is None else (less.low, less.high)
        return True if low > 0.0 else False if high < 0.0 else None

    @property
    def any_nearer(self) -> bool:
        """Whether one of the methods has a smaller error than the best rival, be it by chance."""
        return any(self.total[method].reduction.value > 0.0 for method in self.methods)

    def save(self, path: Path) -> None:
        """Write torque.json atomically."""
        write_json(path, {"schema": TORQUE_SCHEMA, **asdict(self)})

    @staticmethod
    def load(path: Path) -> TorqueResult:
        """Read torque.json.

        Raises:
            FormatError: something else, or another version.
            DataError: broken.
        """
        return build_versioned(
            TorqueResult, read_json(path), str(path), schema=TORQUE_SCHEMA, what="held-out torque errors"
        )
