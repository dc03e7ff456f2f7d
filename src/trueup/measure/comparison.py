"""One episode, ready to be compared: measured, simulated and commanded motion on one clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int

from trueup.core.episode import EpisodeMeta
from trueup.core.timeseries import TimeSeries
from trueup.errors import DataError, MissingSignal, NameMismatch, UnitError

COMMAND_RUN = "command"

# A command says how to move only where it names a motion; a commanded torque is no simulation of the torque.
_COMMANDED_MOTION = ("position", "velocity")


@dataclass(frozen=True, eq=False)
class Comparison:
    """One episode with everything on the measured clock and in the robot's joint names.

    Attributes:
        meta: what is known about the episode.
        measured: the robot's signals.
        simulated: run label -> simulated signals on the same clock; a run that lacks this episode is left out.
        command: the command held on the same clock, or None; its position (and velocity) is scored as the run
            `command`, the command taken as the motion.
        starts: rows at which the simulation was restarted from the measured state, int, the first is 0.

    Raises:
        DataError: a clock differs from the measured one, or `starts` are no increasing rows that begin with 0.
        NameMismatch: joints or bodies differ, or a run is called `command`.
    """

    meta: EpisodeMeta
    measured: TimeSeries
    simulated: Mapping[str, TimeSeries] = field(default_factory=dict)
    command: TimeSeries | None = None
    starts: Int[np.ndarray, "S"] = field(default_factory=lambda: np.zeros(1, dtype=np.int64))

    def __post_init__(self) -> None:
        """Refuse what cannot be compared sample by sample."""
        if COMMAND_RUN in self.simulated:
            raise NameMismatch(
                f"the run label {COMMAND_RUN!r} is reserved for the command taken as the motion",
                left=self.simulated,
                right=["any other label"],
            )
        for label, series in self.simulated.items():
            self._check(label, series)
        if self.command is not None:
            self._check(COMMAND_RUN, self.command)
        rows = self.starts
        if not (rows.size and rows[0] == 0 and np.all(np.diff(rows) > 0) and rows[-1] < len(self.measured)):
            raise DataError(
                f"episode {self.meta.id!r}: starts must be increasing rows, the first 0",
                got=rows[:10].tolist(),
                expected=f"below {len(self.measured)}",
            )

    @property
    def labels(self) -> tuple[str, ...]:
        """The runs of this episode, `command` last and only where it says a motion of a kind that was measured."""
        motions = [name for name in _COMMANDED_MOTION if name in self.measured]
        commanded = self.command is not None and any(name in self.command for name in motions)
        return (*self.simulated, COMMAND_RUN) if commanded else tuple(self.simulated)

    def run(self, label: str) -> TimeSeries:
        """The series of one run, joints in the measured order; for `command` only what names a motion.

        Raises:
            MissingSignal: this episode has no such run.
        """
        if label not in self.labels:
            raise MissingSignal(f"episode {self.meta.id!r} has no run {label!r}", available=self.labels)
        series = self.simulated.get(label, self.command)
        assert series is not None
        return series if series.joints == self.measured.joints else series.select(self.measured.joints)

    def common_signals(self, label: str) -> tuple[str, ...]:
        """The signals that measured and this run both have, in the measured order."""
        series = self.run(label)
        names = [name for name in self.measured.signals if name in series]
        return tuple(name for name in names if label != COMMAND_RUN or name in _COMMANDED_MOTION)

    def columns(self, signal: str) -> tuple[str, ...]:
        """The joints, or for a body signal the bodies, of a measured signal."""
        return self.measured.bodies if signal.startswith("body.") else self.measured.joints

    def _check(self, label: str, series: TimeSeries) -> None:
        where = f"episode {self.meta.id!r}, {label}"
        for kind, left, right in (
            ("joints", set(series.joints), set(self.measured.joints)),
            ("bodies", series.bodies or self.measured.bodies, self.measured.bodies or series.bodies),
        ):
            if left != right:
                raise NameMismatch(
                    f"{where}: the {kind} are not those that were measured",
                    left=series.joints if kind == "joints" else series.bodies,
                    right=self.measured.joints if kind == "joints" else self.measured.bodies,
                )
        clock, expected = series.time_s, self.measured.time_s
        if clock.shape != expected.shape or not np.allclose(clock, expected, rtol=0.0, atol=1e-9):
            raise DataError(
                f"{where}: the clock is not the measured one",
                got=f"{clock.size} samples from {clock[0]:.6g} to {clock[-1]:.6g} s",
                expected=f"{expected.size} samples from {expected[0]:.6g} to {expected[-1]:.6g} s",
                hint="resample the run at the measured stamps first",
            )
        self._check_units(where, series)

    def _check_units(self, where: str, series: TimeSeries) -> None:
        for signal, units in series.units.items():
            if signal not in self.measured.units:
                continue
            names = series.bodies if signal.startswith("body.") else series.joints
            other = dict(zip(names, units, strict=True))
            own = dict(zip(self.columns(signal), self.measured.units[signal], strict=True))
            wrong = [name for name in own if own[name] != other[name]]
            if wrong:
                raise UnitError(
                    f"{where}: the unit of {signal} differs from the measured one for {', '.join(wrong)}",
                    got=", ".join(other[name] for name in wrong),
                    expected=", ".join(own[name] for name in wrong),
                )
