"""One log, prepared for simulation: where it starts, what it commands in each step, where its stamps lie."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float64, Int
from scipy.interpolate import make_interp_spline

from trueup.core.episode import Episode
from trueup.core.hold import SAME_INSTANT_S, held_rows
from trueup.core.protocols import RolloutRequest, RolloutResult, Simulator
from trueup.core.timeseries import TimeSeries
from trueup.core.units import SI_UNIT, joint_unit
from trueup.core.windows import window_starts
from trueup.errors import DataError
from trueup.sim.moving_base import gravity_at
from trueup.sim.replay_settings import ReplaySettings

_MOST_STEPS = 50_000_000  # half a day at 1 ms; beyond that the unit of the stamps is wrong
_FEWEST_ROWS = 3


class ReplayPlan:
    """What does not depend on the model or the delay: made once per log, used for every candidate of a fit.

    The simulation starts in the measured pose at the first measured stamp that has a command, runs on its own grid,
    and is read at the measured stamps by linear interpolation (torque: the one acting at the stamp). With `settle_s`
    it starts that much earlier, and holds the first command until then.

    Args:
        episode: in the joint names and units of the robot (see `align.JointMap`).
        simulator: with the robot in it; its joints, time step and command signals count.
        settings: windows and initial velocity.

    Attributes:
        measured: the measurement from the first command on.
        starts: rows at which a window begins, (W,).

    Raises:
        DataError: the clocks do not overlap, or the starting state or the command is not finite.
        MissingSignal: the command lacks what the controller follows, or the log does not say how its base moved.
    """

    def __init__(self, episode: Episode, simulator: Simulator, settings: ReplaySettings) -> None:
        self.episode_id = episode.id
        self._command = episode.commanded().select(simulator.joints)
        measured = episode.measured.select(simulator.joints)
        rows = np.flatnonzero(measured.time_s >= self._command.time_s[0] - SAME_INSTANT_S)
        if rows.size == 0:
            raise DataError(
                f"episode {episode.id!r}: the measurement ends before the first command",
                got=f"{measured.time_s[-1]:.3f} s",
                expected=f"at least {self._command.time_s[0]:.3f} s",
            )
        used = measured.rows(slice(int(rows[0]), None))
        # LeRobot and others keep single precision.
        double = {name: np.asarray(values, np.float64) for name, values in used.signals.items()}
        self.measured = replace(used, signals=double)
        self.starts = window_starts(self.measured.time_s, settings.window_s)
        self._step_s = simulator.timestep_s
        settle_s = 0.0 if settings.window_s else settings.settle_s
        self._settling = int(np.ceil(settle_s / self._step_s - 1e-6))
        self._steps = self._settling + self._count_steps(settings.window_s)
        self._timing = settings.command
        self._signals = [name for name in simulator.command_signals if name in self._command]
        self._position = self.measured["position"][self.starts].astype(np.float64)
        self._velocity = np.zeros_like(self._position)
        if settings.starts_moving:
            self._velocity = _velocity(self.measured)[self.starts].astype(np.float64)
        commands = {name: self._command[name] for name in self._signals}
        for name, values in {
            "starting position": self._position,
            "starting velocity": self._velocity,
            **commands,
        }.items():
            if not np.all(np.isfinite(values)):
                raise DataError(f"episode {episode.id!r}: the {name} has values that are not finite")
        self._gravity = None
        if settings.base_sensor:
            # In the middle of each step; while a motion settles, its base waits.
            ticks = np.maximum(self._ticks(), 0) + 0.5
            middle = self.measured.time_s[self.starts][:, None] + ticks * self._step_s
            self._gravity = gravity_at(episode, settings.base_sensor, middle)
        self._held: dict[tuple[str, int], tuple[float, np.ndarray]] = {}
        self._window, self._row, self._share = self._stamps()

    @property
    def steps(self) -> int:
        """Simulation steps of the longest window."""
        return self._steps

    @property
    def holds(self) -> bool:
        """Whether each command is held until the next stamp."""
        return self._timing == "held"

    @property
    def grid_s(self) -> Float64[np.ndarray, "W N"]:
        """When each simulation step of each window begins, on the measured clock [s]."""
        return np.asarray(self.measured.time_s[self.starts][:, None] + self._ticks() * self._step_s)

    def request(self, delay_s: float | tuple[float, ...] | Float64[np.ndarray, "J"] = 0.0) -> RolloutRequest:
        """One row per window; commands act `delay_s` [s] later than their stamps, one number or one per joint."""
        delays = np.broadcast_to(np.asarray(delay_s, dtype=np.float64), (len(self.measured.joints),))
        command = {
            name: np.stack([self._column(name, joint, float(delay)) for joint, delay in enumerate(delays)], axis=-1)
            for name in self._signals
        }
        return RolloutRequest(self._position, self._velocity, command, self._gravity)

    @property
    def command_period_s(self) -> float:
        """Usual time between two commands [s]; 0 of a single one."""
        steps = np.diff(self._command.time_s)
        return float(np.median(steps)) if steps.size else 0.0

    def at_stamps(self, grid: Float[np.ndarray, "*C W N1 J"]) -> Float[np.ndarray, "*C T J"]:
        """Read simulated values on the grids of the W windows at the measured stamps, by linear interpolation."""
        share = self._share[:, None]
        before, after = grid[..., self._window, self._row, :], grid[..., self._window, self._row + 1, :]
        return np.asarray((1.0 - share) * before + share * after)

    def told(self, signal: str, delay_s: Float64[np.ndarray, "J"] | None = None) -> Float64[np.ndarray, "T J"]:
        """The command in force at the measured stamps; with delays, so much later, moving on between its stamps."""
        if delay_s is not None:
            stamps, values = self._command.time_s, self._command[signal].astype(np.float64)
            return np.stack(
                [
                    np.interp(self.measured.time_s - late, stamps, values[:, joint])
                    for joint, late in enumerate(delay_s)
                ],
                axis=1,
            )
        rows = np.maximum(held_rows(self._command.time_s, self.measured.time_s), 0)
        return np.asarray(self._command[signal][rows], np.float64)

    def series(self, result: RolloutResult) -> TimeSeries:
        """The simulated `position`, `velocity`, `torque` and further signals at the measured stamps.

        Signals of bodies are those of the physics step in which a stamp lies.
        """
        lengths = self.measured.units["position"]
        signals = {
            "position": self.at_stamps(result.position),
            "velocity": self.at_stamps(result.velocity),
            "torque": result.torque[self._window, self._row],
            **{name: values[self._window, self._row] for name, values in result.further.items()},
        }
        units = {
            "position": lengths,
            "velocity": tuple(f"{unit}/s" for unit in lengths),
            "torque": tuple("N" if unit == "m" else "Nm" for unit in lengths),
            **{name: tuple(joint_unit(SI_UNIT[name], unit) for unit in lengths) for name in result.further},
        }
        for name, values in result.bodies.items():
            signals[name] = values[self._window, self._row]
            units[name] = (SI_UNIT[name],) * len(result.body_names)
        return TimeSeries(self.measured.time_s, self.measured.joints, signals, units, result.body_names)

    def _count_steps(self, window_s: float | None) -> int:
        clock, starts = self.measured.time_s, self.starts
        last = np.append(starts[1:], clock.size) - 1
        longest_s = float(np.max(clock[last] - clock[starts]))
        if longest_s / self._step_s > _MOST_STEPS:
            raise DataError(
                f"episode {self.episode_id!r} lasts too long for a time step of {self._step_s:g} s",
                got=f"{longest_s:.3g} s",
                hint="Are its stamps really in seconds?",
            )
        if starts.size > 1 and np.median(np.diff(starts)) < _FEWEST_ROWS:
            raise DataError(
                f"episode {self.episode_id!r}: a window of {window_s:g} s holds too few samples",
                got=f"samples every {np.median(np.diff(clock)):.3g} s",
                expected=f"windows of at least {_FEWEST_ROWS} samples",
            )
        return steps_of(longest_s, self._step_s)

    def _column(self, signal: str, joint: int, delay_s: float) -> Float64[np.ndarray, "W N"]:
        """One joint's command per step; the last delay's is kept, since most candidates of a fit share it."""
        known = self._held.get((signal, joint))
        if known is None or known[0] != delay_s:
            grid = self.grid_s
            column = self._command[signal][:, joint].astype(np.float64)
            if self._timing == "linear":
                values = np.interp(grid - delay_s, self._command.time_s, column)
            elif self._timing == "smooth":
                values = smooth_commands(self._command.time_s, column, grid - delay_s)
            else:
                values = held_commands(self._command.time_s, column, grid, step_s=self._step_s, delay_s=delay_s)
            known = self._held[signal, joint] = (delay_s, values)
        return known[1]

    def _ticks(self) -> Int[np.ndarray, "N"]:
        """Simulation steps, counted from the start of a window; what comes before 0 is for settling."""
        return np.arange(self._steps) - self._settling

    def _stamps(self) -> tuple[Int[np.ndarray, "T"], Int[np.ndarray, "T"], Float64[np.ndarray, "T"]]:
        """For each stamp its window, the grid point before it, and how far it is to the next."""
        clock = self.measured.time_s
        window = np.searchsorted(self.starts, np.arange(clock.size), side="right") - 1
        steps = self._settling + (clock - clock[self.starts][window]) / self._step_s
        row = np.floor(steps + 1e-6).astype(np.int64)
        return window, row, steps - row


def held_commands(
    stamps_s: Float64[np.ndarray, "N"],
    values: Float64[np.ndarray, "N"],
    grid_s: Float64[np.ndarray, "W K"],
    *,
    step_s: float,
    delay_s: float,
) -> Float64[np.ndarray, "W K"]:
    """The command that acts in each simulation step: the latest with a stamp at or before the step, `delay_s` earlier.

    What is left of the delay after whole steps is interpolated between the two steps, so that what is simulated
    changes smoothly with the delay. Before the first stamp the first command acts, after the last one the last.

    Args:
        stamps_s: of the command, increasing, (N,) [s].
        values: of one joint, (N,).
        grid_s: where steps begin, (W, K) [s].
        step_s: length of a step [s].
        delay_s: how much later than their stamps commands act [s]; negative where the stamps are late.
    """
    whole = np.floor(delay_s / step_s + 1e-9)
    rest = max(0.0, delay_s / step_s - whole)  # of a step, for a negative delay, too
    sooner: Float64[np.ndarray, "W K"] = values[np.maximum(held_rows(stamps_s, grid_s - whole * step_s), 0)]
    if rest < 1e-9:
        return sooner
    later = values[np.maximum(held_rows(stamps_s, grid_s - (whole + 1) * step_s), 0)]
    return np.asarray((1.0 - rest) * sooner + rest * later)


def smooth_commands(
    stamps_s: Float64[np.ndarray, "N"], values: Float64[np.ndarray, "N"], times_s: Float64[np.ndarray, "W K"]
) -> Float64[np.ndarray, "W K"]:
    """A command that moves smoothly from stamp to stamp: the natural cubic spline through it, held before and after.

    Args:
        stamps_s: of the command, increasing, (N,) [s].
        values: of one joint, (N,).
        times_s: when it is asked for, (W, K) [s].
    """
    inside = np.clip(times_s, stamps_s[0], stamps_s[-1])
    return np.asarray(make_interp_spline(stamps_s, values, k=3, bc_type="natural")(inside))


def _velocity(measured: TimeSeries) -> Float[np.ndarray, "T J"]:
    if "velocity" in measured:
        return measured["velocity"]
    if len(measured) < 2:
        return np.zeros_like(measured["position"])
    slope: Float[np.ndarray, "T J"] = np.gradient(measured["position"], measured.time_s, axis=0)
    return slope


def steps_of(duration_s: float, step_s: float) -> int:
    """Simulation steps of a motion: one more than up to its last stamp, since that tells what acts there.

    Args:
        duration_s: from the first stamp to the last [s].
        step_s: of the simulation [s].
    """
    return int(np.ceil(duration_s / step_s - 1e-6)) + 1
