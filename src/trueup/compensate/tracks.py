"""Motions at the rate of control: where the robot was when each command was given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from trueup.core.episode import Episode
from trueup.core.hold import SAME_INSTANT_S
from trueup.core.interpolation import columns_at
from trueup.errors import DataError, MissingSignal
from trueup.sim.moving_base import gravity_at

_RATE_TOLERANCE = 0.02
_FEWEST = 16


@dataclass(frozen=True, eq=False)
class Track:
    """One motion.

    Attributes:
        id: of the episode.
        payload_kg: what the robot carries.
        state: measured positions, then velocities, when each command was given, (T, 2J) [rad or m, and per second].
        command: commanded positions or torques, (T, J).
        time_s: of each row, (T,).
        gravity: what pulls on the robot from each command to the next, in the axes of its base, (T, 3) [m/s2]; None for
            a base at rest.
    """

    id: str
    payload_kg: float
    state: Float32[np.ndarray, "T S"]
    command: Float32[np.ndarray, "T J"]
    time_s: Float64[np.ndarray, "T"]
    gravity: Float32[np.ndarray, "T 3"] | None = None

    def pieces(self, rows: int) -> list[Track]:
        """The same in pieces of so many control steps, each to where the next begins; the last is what is left."""
        return [
            Track(
                self.id,
                self.payload_kg,
                self.state[first : first + rows + 1],
                self.command[first : first + rows + 1],
                self.time_s[first : first + rows + 1],
                None if self.gravity is None else self.gravity[first : first + rows + 1],
            )
            for first in range(0, len(self) - 1, rows)
        ]

    def __len__(self) -> int:
        """The number of commands."""
        return len(self.command)


def track_of(
    episode: Episode, joints: Sequence[str], control_s: float, *, signal: str = "position", base_sensor: str = ""
) -> Track:
    """A motion at the rate of control.

    Args:
        episode: in the robot's joint names.
        joints: J joints.
        control_s: control step [s].
        signal: of the commands, `position` or `torque`.
        base_sensor: the body that the robot stands on, if a sensor says how it moved.

    Raises:
        MissingSignal: no such commands, no measured positions, or nothing of the base's sensor.
        DataError: another control rate, values that are not finite, or hardly a command.
    """
    command = episode.commanded().select(joints)
    measured = episode.measured.select(joints)
    for series, what, name in ((command, "command", signal), (measured, "measured", "position")):
        if name not in series:
            raise MissingSignal(
                f"episode {episode.id!r} has no {what} {name}, so that nothing says what its commands lack",
                available=list(series.signals),
            )
    gap_s = 1.0 / command.rate_hz if len(command) > 1 else np.inf
    if abs(gap_s / control_s - 1) > _RATE_TOLERANCE:
        raise DataError(
            f"episode {episode.id!r}: its commands come at another rate",
            got=f"{command.rate_hz:.4g} Hz",
            expected=f"{1 / control_s:.4g} Hz",
            hint="Train for this rate: --control-hz.",
        )
    inside = (command.time_s >= measured.time_s[0] - SAME_INSTANT_S) & (
        command.time_s <= measured.time_s[-1] + SAME_INSTANT_S
    )
    time_s = command.time_s[inside]
    if time_s.size < _FEWEST:
        raise DataError(f"episode {episode.id!r} has hardly a command", got=time_s.size, expected=f"at least {_FEWEST}")
    position = measured["position"].astype(np.float64)
    if "velocity" in measured:
        velocity = measured["velocity"].astype(np.float64)
    else:
        velocity = np.gradient(position, measured.time_s, axis=0)
    state = np.concatenate([columns_at(time_s, measured.time_s, signal) for signal in (position, velocity)], axis=1)
    wanted = command[signal][inside]
    for values, what in ((state, "state"), (wanted, "command")):
        if not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0, 0])
            raise DataError(f"episode {episode.id!r}: the {what} is not finite", got=f"{time_s[row]:.3f} s")
    return Track(
        episode.id,
        float(episode.meta.payload_kg or 0.0),
        state.astype(np.float32),
        wanted.astype(np.float32),
        np.asarray(time_s, np.float64),
        gravity_at(episode, base_sensor, time_s + 0.5 * control_s).astype(np.float32) if base_sensor else None,
    )
