"""What was read from a robot and commanded so far, and the episode that it makes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.timeseries import TimeSeries, same_units
from trueup.core.units import SI_UNIT
from trueup.errors import MissingSignal

_SPEED_ROWS = 10  # over which a robot without a velocity signal is differentiated


class Tape:
    """What was read and commanded so far."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self.joints = joints
        self.time_s: list[float] = []
        self.rows: dict[str, list[Float64[np.ndarray, "J"]]] = {}
        self.torque: list[Float64[np.ndarray, "J"]] = []
        self.late = 0

    @property
    def last_s(self) -> float | None:
        """Time of the last reading [s]."""
        return self.time_s[-1] if self.time_s else None

    def read(self, time_s: float, reading: Mapping[str, np.ndarray]) -> str:
        """Take a reading.

        Returns:
            What is wrong with it, or an empty string.

        Raises:
            MissingSignal: the first reading has no position.
        """
        if not self.rows:
            self.rows = {name: [] for name in reading if name in SI_UNIT}
            if "position" not in self.rows:
                self.rows = {}
                raise MissingSignal("the robot reports no position", available=reading)
        missing = [name for name in self.rows if name not in reading]
        if missing:
            return f"the robot stopped reporting {missing}"
        values = {name: np.array(reading[name], dtype=np.float64) for name in self.rows}
        if any(row.shape != (len(self.joints),) or not np.isfinite(row).all() for row in values.values()):
            return "the robot sent values that are not finite, or not one per joint"
        if self.time_s and time_s <= self.time_s[-1]:
            return "the clock stands still"
        self.time_s.append(time_s)
        for name, row in values.items():
            self.rows[name].append(row)
        return ""

    def velocity(self) -> Float64[np.ndarray, "J"]:
        """The measured velocity, or the slope of the last positions."""
        if "velocity" in self.rows:
            return self.rows["velocity"][-1]
        back = min(_SPEED_ROWS, len(self.time_s) - 1)
        if back == 0:
            return np.zeros(len(self.joints))
        position = self.rows["position"]
        return np.asarray((position[-1] - position[-1 - back]) / (self.time_s[-1] - self.time_s[-1 - back]))

    def repeats(self) -> bool:
        """Whether the last two readings are the same, bit for bit, in more than a position."""
        return len(self.rows) > 1 and all(
            len(rows) > 1 and np.array_equal(rows[-1], rows[-2]) for rows in self.rows.values()
        )

    def episode(self, meta: EpisodeMeta) -> Episode:
        """The samples with a command; a row of NaN if there are none."""
        count = len(self.torque)
        if count == 0:  # a series has at least one row
            nothing = np.full((1, len(self.joints)), np.nan)
            clock = np.zeros(1)
            measured = TimeSeries(
                clock, self.joints, {"position": nothing}, same_units({"position": "rad"}, self.joints)
            )
            return Episode(meta, measured, self._command(clock, np.zeros_like(nothing)))
        clock = np.array(self.time_s[:count])
        if self.late:
            detail = f"{self.late} of {count + self.late} ticks were missed: the loop is too slow for its rate"
            meta = replace(meta, flags=(*meta.flags, Flag("late_ticks", detail=detail, severity="note")))
        signals = {name: np.stack(rows[:count]) for name, rows in self.rows.items()}
        units = same_units({name: SI_UNIT[name] for name in signals}, self.joints)
        return Episode(
            meta, TimeSeries(clock, self.joints, signals, units), self._command(clock, np.stack(self.torque))
        )

    def _command(self, clock: Float64[np.ndarray, "T"], torque: Float64[np.ndarray, "T J"]) -> TimeSeries:
        return TimeSeries(clock, self.joints, {"torque": torque}, same_units({"torque": "Nm"}, self.joints))
