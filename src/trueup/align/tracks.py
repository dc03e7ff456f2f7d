"""One joint of an episode as the quality checks see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64

from trueup.align.quality_config import per_radian
from trueup.align.start import quantum
from trueup.core.episode import Episode
from trueup.core.hold import held_rows
from trueup.core.timeseries import TimeSeries


@dataclass(frozen=True, eq=False)
class Track:
    """Position, command and load of one joint on the measured clock, NaN bridged.

    Positions are in radians, those of other joints in what stands for one in the thresholds (see `QualityConfig`).

    Attributes:
        joint: its name.
        time_s: clock, (T,) [s].
        position: measured position.
        command: commanded position, held between its stamps; None if no path was commanded.
        velocity: measured velocity per second, or None.
        load: absolute measured torque, or current if there is no torque; None without both.
        load_unit: its unit.
        unit: unit of the positions in the log.
        radian: how much of that unit one radian is.
        step: resolution of the encoder; next to nothing for continuous values.
        period_s: median step of the clock [s].
    """

    joint: str
    time_s: Float64[np.ndarray, "T"]
    position: Float64[np.ndarray, "T"]
    command: Float64[np.ndarray, "T"] | None
    velocity: Float64[np.ndarray, "T"] | None
    load: Float64[np.ndarray, "T"] | None
    load_unit: str
    unit: str
    radian: float
    step: float
    period_s: float

    def samples(self, duration_s: float, *, least: int = 1) -> int:
        """How many samples a duration takes."""
        return max(least, round(duration_s / self.period_s)) if self.period_s > 0.0 else least

    def say(self, value: float) -> str:
        """A position or distance in the log's unit, for messages."""
        unit = "of the range" if self.unit == "1" else self.unit
        return f"{value * self.radian:.3g} {unit}"


def tracks(episode: Episode) -> tuple[Track, ...]:
    """The joints of an episode that have a measured position.

    A commanded position counts as a path to follow unless torques are commanded beside it and it never changes:
    then it is a goal (swing-up by energy shaping), from which the robot is far by design.
    """
    measured = episode.measured
    if "position" not in measured:
        return ()
    effort = next((name for name in ("torque", "current") if name in measured), "")
    found = []
    for column, joint in enumerate(measured.joints):
        unit = measured.units["position"][column]
        position = _column(measured, "position", column)
        if position is None:
            continue
        load = _column(measured, effort, column)
        found.append(
            Track(
                joint=joint,
                time_s=measured.time_s,
                position=position / per_radian(unit),
                command=_path(episode.command, joint, measured.time_s),
                velocity=_speed(measured, column),
                load=None if load is None else np.abs(load),
                load_unit=measured.units[effort][column] if load is not None else "",
                unit=unit,
                radian=per_radian(unit),
                step=quantum(position) / per_radian(unit),
                period_s=float(np.median(np.diff(measured.time_s))) if len(measured) > 1 else 0.0,
            )
        )
    return tuple(found)


def runs(mask: Bool[np.ndarray, "T"]) -> list[tuple[int, int]]:
    """First row and row after the last of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(start), int(end)) for start, end in edges.reshape(-1, 2)]


def _column(series: TimeSeries, signal: str, column: int) -> Float64[np.ndarray, "T"] | None:
    """One column with what is not finite bridged linearly; None without the signal or any finite value."""
    if signal not in series:
        return None
    values: Float[np.ndarray, "T"] = series[signal][:, column].astype(np.float64)
    finite = np.isfinite(values)
    if not finite.any():
        return None
    return values if finite.all() else np.interp(series.time_s, series.time_s[finite], values[finite])


def _speed(measured: TimeSeries, column: int) -> Float64[np.ndarray, "T"] | None:
    values = _column(measured, "velocity", column)
    return None if values is None else values / per_radian(measured.units["velocity"][column])


def _path(command: TimeSeries | None, joint: str, time_s: Float64[np.ndarray, "T"]) -> Float64[np.ndarray, "T"] | None:
    if command is None or joint not in command.joints:
        return None
    column = command.joints.index(joint)
    values = _column(command, "position", column)
    if values is None or ("torque" in command and np.ptp(values) == 0.0):
        return None
    rows = np.maximum(held_rows(command.time_s, time_s), 0)
    return np.asarray(values[rows] / per_radian(command.units["position"][column]))
