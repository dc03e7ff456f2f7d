"""Signals of a robot on one clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.errors import DataError, MissingSignal, NameMismatch

BODY_PREFIX = "body."


@dataclass(frozen=True, eq=False)
class TimeSeries:
    """Named signals on one strictly increasing clock.

    Joint signals (`position`, `velocity`, `acceleration`, `torque`, `current`, `voltage`, `temperature`) have
    shape (T, J), one column per entry of `joints`. Body signals start with `body.`: `body.position` is
    (T, B, 3) [m], `body.rotation` (T, B, 3, 3), one slot per entry of `bodies`. Values may be NaN (a missing
    sample: the quality checks flag it); the clock may not.

    Attributes:
        time_s: clock, shape (T,) [s], finite, strictly increasing, T >= 1.
        joints: names of the J columns, in order, unique.
        signals: signal name -> array, float32 or float64.
        units: signal name -> one unit per joint (or per body); a gripper in `m` or `1` sits beside arms in `rad`.
        bodies: names of the B bodies.

    Raises:
        DataError: the clock is empty, not finite or not strictly increasing; a signal has the wrong shape.
        NameMismatch: a joint name occurs twice; the units do not cover the signals.
    """

    time_s: Float64[np.ndarray, "T"]
    joints: tuple[str, ...]
    signals: Mapping[str, Float[np.ndarray, "..."]]  # shapes are checked below, with a message for users
    units: Mapping[str, tuple[str, ...]]
    bodies: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        """Refuse what is not a time series."""
        clock = self.time_s
        if clock.ndim != 1 or clock.size == 0:
            raise DataError("the clock is empty or not one-dimensional", got=f"shape {clock.shape}")
        if not np.all(np.isfinite(clock)):
            raise DataError("the clock has values that are not finite", got=f"row {int(np.argmin(np.isfinite(clock)))}")
        steps = np.diff(clock)
        if steps.size and not np.all(steps > 0):
            row = int(np.argmax(steps <= 0))
            raise DataError(
                "the clock is not strictly increasing",
                got=f"{clock[row + 1]:.9g} s after {clock[row]:.9g} s (row {row + 1})",
            )
        if len(set(self.joints)) != len(self.joints):
            raise NameMismatch("a joint name occurs twice", left=self.joints, right=sorted(set(self.joints)))
        if set(self.units) != set(self.signals):
            raise NameMismatch(
                "units do not cover the signals",
                left=sorted(self.units),
                right=sorted(self.signals),
                left_name="units for",
                right_name="signals",
            )
        for name, values in self.signals.items():
            width = self.bodies if name.startswith(BODY_PREFIX) else self.joints
            if values.shape[:2] != (clock.size, len(width)) or (values.ndim != 2) != name.startswith(BODY_PREFIX):
                raise DataError(
                    f"signal {name!r} has the wrong shape",
                    got=values.shape,
                    expected=f"{clock.size} rows and {len(width)} columns",
                )
            if len(self.units[name]) != len(width):
                raise DataError(f"signal {name!r} needs one unit per column", got=self.units[name], expected=width)

    def __len__(self) -> int:
        """The number of samples T."""
        return int(self.time_s.size)

    def __getitem__(self, signal: str) -> Float[np.ndarray, "T ..."]:
        """The values of one signal.

        Raises:
            MissingSignal: there is no such signal.
        """
        try:
            return self.signals[signal]
        except KeyError:
            raise MissingSignal(f"there is no signal {signal!r}", available=self.signals) from None

    def __contains__(self, signal: object) -> bool:
        """Whether the signal is there."""
        return signal in self.signals

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def rate_hz(self) -> float:
        """One over the median step [Hz]; 0 for a single sample."""
        return float(1.0 / np.median(np.diff(self.time_s))) if len(self) > 1 else 0.0

    def rows(self, index: slice | Int[np.ndarray, "K"]) -> TimeSeries:
        """The samples at `index` (a slice or increasing row numbers), with the clock kept as it is."""
        return replace(
            self,
            time_s=self.time_s[index],
            signals={name: values[index] for name, values in self.signals.items()},
        )

    def select(self, joints: Sequence[str]) -> TimeSeries:
        """The same series with these joints, in this order.

        Raises:
            NameMismatch: a joint is not there; both lists are printed.
        """
        columns = _columns(joints, self.joints, "joints")
        body = {name: values for name, values in self.signals.items() if name.startswith(BODY_PREFIX)}
        joint = {name: values[:, columns] for name, values in self.signals.items() if name not in body}
        units = {
            name: unit if name in body else tuple(unit[column] for column in columns)
            for name, unit in self.units.items()
        }
        return replace(self, joints=tuple(joints), signals={**joint, **body}, units=units)

    def select_bodies(self, bodies: Sequence[str]) -> TimeSeries:
        """The same series with these bodies, in this order.

        Raises:
            NameMismatch: a body is not there; both lists are printed.
        """
        columns = _columns(bodies, self.bodies, "bodies")
        own = [name for name in self.signals if name.startswith(BODY_PREFIX)]
        signals = {name: self.signals[name][:, columns] for name in own}
        units = {name: tuple(self.units[name][column] for column in columns) for name in own}
        return replace(self, bodies=tuple(bodies), signals={**self.signals, **signals}, units={**self.units, **units})


def _columns(asked: Sequence[str], known: Sequence[str], what: str) -> list[int]:
    """Where the names that are asked for stand among those of a series."""
    missing = [name for name in asked if name not in known]
    if missing:
        raise NameMismatch(
            f"{what} {missing} are not in the series",
            left=asked,
            right=known,
            left_name="asked for",
            right_name="series has",
        )
    return [known.index(name) for name in asked]


def same_units(signals: Mapping[str, str], joints: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Units for a series in which all joints share one unit per signal: {"position": "rad"} -> (J,) tuples."""
    return {signal: (unit,) * len(joints) for signal, unit in signals.items()}
