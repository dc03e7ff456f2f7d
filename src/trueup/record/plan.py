"""A planned motion, ready to be executed on a robot or in an engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64

from trueup.core.timeseries import TimeSeries
from trueup.core.units import SI_UNIT, joint_unit
from trueup.errors import DataError, NameMismatch

SIGNALS = ("position", "velocity", "acceleration")


@dataclass(frozen=True, eq=False)
class Plan:
    """Positions, velocities and accelerations of all joints over time, at rest before and after the motion.

    Attributes:
        id: unique in its set; letters, digits, `_ . - /`.
        kind: how it was made: `joint`, `cartesian`, `b-spline`, `chirp`, `multisine`, `random-field`, `chebyshev`,
            `excitation`.
        joints: names of the J columns, the robot's joints in order.
        moving: the joints that move; the others stay where they are.
        time_s: even clock from 0, (T,) [s].
        position: (T, J) [rad or m].
        velocity: (T, J), derivative of the positions.
        acceleration: (T, J), derivative of the velocities.
        start_s: when the motion begins [s]; until then the robot rests.
        end_s: when it has ended [s].
        condition: free word for the base condition of the episode, e.g. `single-joint`.
        split: `train`, `val`, `test`, or empty.
        seed: of the set that it belongs to.
        index: its place in the group of its set; with the seed, all that it was drawn from.
        details: what was drawn: velocity share, plane and length of a line, degree of a spline, amplitudes.
        length_units: `rad` or `m` for each joint, (J,); all `rad` if empty.

    Raises:
        DataError: shapes that do not fit, numbers that are not finite, an uneven clock, or no rest at the ends.
        NameMismatch: a moving joint that is not among the joints.
    """

    id: str
    kind: str
    joints: tuple[str, ...]
    moving: tuple[str, ...]
    time_s: Float64[np.ndarray, "T"]
    position: Float64[np.ndarray, "T J"]
    velocity: Float64[np.ndarray, "T J"]
    acceleration: Float64[np.ndarray, "T J"]
    start_s: float
    end_s: float
    condition: str = ""
    split: str = ""
    seed: int | None = None
    index: int | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    length_units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what cannot be executed."""
        strangers = [name for name in self.moving if name not in self.joints]
        if strangers:
            raise NameMismatch(f"plan {self.id!r} moves {strangers}", left=self.moving, right=self.joints)
        shape = (self.time_s.size, len(self.joints))
        for name in SIGNALS:
            values = getattr(self, name)
            if values.shape != shape:
                raise DataError(f"{name} of plan {self.id!r} has the wrong shape", got=values.shape, expected=shape)
            if not np.isfinite(values).all():
                raise DataError(f"{name} of plan {self.id!r} has numbers that are not finite")
        if self.time_s.size < 2 or not 0 <= self.start_s <= self.end_s <= self.time_s[-1] + 1e-9:
            raise DataError(f"plan {self.id!r} has no duration", got=(self.start_s, self.end_s))
        even = np.arange(self.time_s.size) * self.timestep_s
        if self.time_s[0] != 0 or np.abs(self.time_s - even).max() > 1e-9 * max(1.0, self.time_s[-1]):
            raise DataError(f"the clock of plan {self.id!r} is not even or does not begin at 0")

    @property
    def timestep_s(self) -> float:
        """Step of the clock [s]."""
        return float(self.time_s[-1] / (self.time_s.size - 1))

    @property
    def rate_hz(self) -> float:
        """Samples per second [Hz]."""
        return 1.0 / self.timestep_s

    @property
    def duration_s(self) -> float:
        """Duration, rest included [s]."""
        return float(self.time_s[-1])

    @property
    def start(self) -> Float64[np.ndarray, "J"]:
        """The pose that the robot must be in before, (J,)."""
        first: Float64[np.ndarray, "J"] = self.position[0]
        return first

    @property
    def goal(self) -> Float64[np.ndarray, "J"]:
        """The pose that it is in afterwards, (J,)."""
        last: Float64[np.ndarray, "J"] = self.position[-1]
        return last

    def to_series(self) -> TimeSeries:
        """The plan as the command series of an episode: position, velocity, acceleration."""
        lengths = self.length_units or ("rad",) * len(self.joints)
        signals = {name: getattr(self, name) for name in SIGNALS}
        units = {name: tuple(joint_unit(SI_UNIT[name], length) for length in lengths) for name in SIGNALS}
        return TimeSeries(self.time_s, self.joints, signals, units)

    def to_row(self) -> dict[str, Any]:
        """Everything apart from the samples, JSON types only."""
        return {
            "id": self.id,
            "kind": self.kind,
            "moving": list(self.moving),
            "samples": int(self.time_s.size),
            "start_s": self.start_s,
            "end_s": self.end_s,
            "condition": self.condition,
            "split": self.split,
            "seed": self.seed,
            "index": self.index,
            "details": dict(self.details),
        }

    @staticmethod
    def from_row(row: Mapping[str, Any], series: TimeSeries) -> Plan:
        """What `to_row` and `to_series` took apart.

        Raises:
            DataError: the two do not fit.
        """
        try:
            return Plan(
                id=row["id"],
                kind=row["kind"],
                joints=series.joints,
                moving=tuple(row["moving"]),
                time_s=series.time_s,
                position=series["position"],
                velocity=series["velocity"],
                acceleration=series["acceleration"],
                start_s=row["start_s"],
                end_s=row["end_s"],
                condition=row["condition"],
                split=row["split"],
                seed=row["seed"],
                index=row["index"],
                details=row["details"],
                length_units=series.units["position"],
            )
        except (KeyError, TypeError) as error:
            raise DataError("a plan is damaged or of another version", got=repr(error)) from error
