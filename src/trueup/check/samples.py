"""Motions as a check looks at them: even grids, low-passed alike, so that what is linear stays so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.signal import butter, sosfiltfilt

from trueup.core.episode import Episode
from trueup.core.hold import held_rows
from trueup.robots import Setup

# Of each motion at most this much is looked at [s of a clock that is right, else samples].
_LONGEST_S, _MOST_SAMPLES = 60.0, 12_000
_HIGHEST_HZ, _CUTOFF_HZ, _CUTOFF_SHARE = 200.0, 10.0, 0.12
_FEWEST = 40
_LARGEST = 1e9


@dataclass(frozen=True, eq=False)
class Motion:
    """One motion on an even grid; values are means over its cells behind a zero-phase low-pass.

    Attributes:
        id: of the episode.
        setup: how the robot is in it.
        time_s: grid, (N,) [s].
        position: measured, (N, J).
        velocity: its first derivative.
        acceleration: its second derivative.
        command: command signal -> commanded values, held between their stamps, (N, J).
        measured_velocity: as the log has it, (N, J); None without.
        torque: measured torque, (N, J); None without.
        known: whether a command was there and the filter had data on both sides, (N,).
        edge_s: how far the filter reaches [s].
        whole: whether all positions are whole numbers, as counts are, (J,).
    """

    id: str
    setup: Setup
    time_s: Float64[np.ndarray, "N"]
    position: Float64[np.ndarray, "N J"]
    velocity: Float64[np.ndarray, "N J"]
    acceleration: Float64[np.ndarray, "N J"]
    command: dict[str, Float64[np.ndarray, "N J"]]
    measured_velocity: Float64[np.ndarray, "N J"] | None
    torque: Float64[np.ndarray, "N J"] | None
    known: np.ndarray
    edge_s: float
    whole: np.ndarray

    @property
    def step_s(self) -> float:
        """Of the grid [s]."""
        return float(self.time_s[1] - self.time_s[0])

    def commanded(self, signal: str, lag_s: float) -> Float64[np.ndarray, "N J"]:
        """The command of `lag_s` earlier."""
        values = self.command[signal]
        if lag_s == 0.0:
            return values
        columns = [np.interp(self.time_s - lag_s, self.time_s, column) for column in values.T]
        return np.stack(columns, axis=1)

    def usable(self, lag_s: float) -> np.ndarray:
        """Rows of which measurement and command are known, (N,)."""
        shifted = np.interp(self.time_s - lag_s, self.time_s, self.known.astype(float), left=0.0, right=0.0)
        return np.asarray(self.known & (shifted > 0.999))


def motion_of(
    episode: Episode, joints: Sequence[str], setup: Setup, delay_s: Sequence[float] | None = None
) -> Motion | None:
    """The motion; None where too little is there to look at.

    Args:
        episode: in the robot's names and units.
        joints: of the robot, in order.
        setup: how the robot is in it.
        delay_s: how much later the commands of each joint act already, as robot.yaml has it [s]; not at all if None.
    """
    measured = episode.measured.select(joints)
    if "position" not in measured or len(measured) < _FEWEST:
        return None
    clock = measured.time_s[:_MOST_SAMPLES]
    clock = clock[clock <= clock[0] + max(_LONGEST_S, _FEWEST * float(np.median(np.diff(clock))))]
    if clock.size < _FEWEST:
        return None
    rate_hz = min(1.0 / float(np.median(np.diff(clock))), _HIGHEST_HZ)
    step_s = 1.0 / rate_hz
    edges = np.arange(clock[0], clock[-1], step_s)
    if edges.size < _FEWEST:
        return None
    grid = edges[:-1] + 0.5 * step_s
    cutoff_hz = min(_CUTOFF_HZ, _CUTOFF_SHARE * rate_hz)
    sections = butter(2, cutoff_hz, fs=rate_hz, output="sos")

    def smooth(values: np.ndarray) -> Float64[np.ndarray, "N J"]:
        pad = min(values.shape[0] - 1, round(2.0 * rate_hz / cutoff_hz))
        return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=pad))

    # Differences in place of means: a velocity of the cells whose mean is the position.
    raw = _filled(measured["position"][: clock.size])
    position = smooth(_means(measured.time_s[: clock.size], raw, edges, held=False))
    velocity = np.gradient(position, step_s, axis=0)
    acceleration = np.gradient(velocity, step_s, axis=0)
    commands = {}
    known = np.ones(grid.size, bool)
    if episode.command is not None:
        command = episode.command.select(joints)
        known &= (grid >= command.time_s[0]) & (grid <= command.time_s[-1] + 0.5)
        for name in ("position", "velocity", "torque"):
            if name in command:
                own = _filled(command[name])
                late = np.zeros(len(joints)) if delay_s is None else np.asarray(delay_s)
                columns = [
                    _means(command.time_s, own[:, [joint]], edges - late[joint], held=True)
                    for joint in range(late.size)
                ]
                commands[name] = smooth(np.concatenate(columns, axis=1))
    further: dict[str, Float64[np.ndarray, "N J"] | None] = {"velocity": None, "torque": None}
    for name in further:
        if name in measured and np.isfinite(measured[name]).any():
            values = _filled(measured[name][: clock.size])
            further[name] = smooth(_means(measured.time_s[: clock.size], values, edges, held=False))
    reach_s = 0.5 / cutoff_hz
    known &= (grid >= grid[0] + reach_s) & (grid <= grid[-1] - reach_s)
    return Motion(
        id=episode.id,
        setup=setup,
        time_s=grid,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        command=commands,
        measured_velocity=further["velocity"],
        torque=further["torque"],
        known=known,
        edge_s=reach_s,
        whole=np.all(np.abs(raw - np.round(raw)) < 1e-6 * np.maximum(np.abs(raw), 1.0), axis=0),
    )


def _filled(values: np.ndarray) -> Float64[np.ndarray, "T J"]:
    """Missing samples bridged; a column without any value is zero."""
    known = np.clip(values.astype(np.float64), -_LARGEST, _LARGEST)
    rows = np.arange(len(known))
    for column in known.T:
        finite = np.isfinite(column)
        if not finite.all():
            column[:] = np.interp(rows, rows[finite], column[finite]) if finite.any() else 0.0
    return known


def _means(
    time_s: Float64[np.ndarray, "T"], values: Float64[np.ndarray, "T J"], edges: Float64[np.ndarray, "M"], *, held: bool
) -> Float64[np.ndarray, "N J"]:
    """Means over the cells between the edges, of values that are held, or straight between their stamps."""
    if held:
        rows = np.maximum(held_rows(time_s, edges), 0)
        whole = np.concatenate(
            [np.zeros((1, values.shape[1])), np.cumsum(values[:-1] * np.diff(time_s)[:, None], axis=0)]
        )
        sums = whole[rows] + values[rows] * (edges - time_s[rows])[:, None]
    else:
        steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time_s)[:, None]
        whole = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(steps, axis=0)])
        rows = np.clip(held_rows(time_s, edges), 0, time_s.size - 2)
        apart = (edges - time_s[rows])[:, None]
        slope = (values[rows + 1] - values[rows]) / np.diff(time_s)[rows][:, None]
        sums = whole[rows] + values[rows] * apart + 0.5 * slope * apart**2
    return np.asarray(np.diff(sums, axis=0) / np.diff(edges)[:, None])
