"""Replay logged commands in a simulator and read the answer at the robot's own stamps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from threading import local
from typing import Literal

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.core.episode import Episode
from trueup.core.hold import SAME_INSTANT_S, held_rows
from trueup.core.protocols import RolloutRequest, RolloutResult, Simulator
from trueup.core.timeseries import TimeSeries
from trueup.core.windows import window_starts
from trueup.errors import ConfigError, DataError, TrueupError
from trueup.robots import RobotSpec

_MOST_STEPS = 50_000_000  # half a day at 1 ms; beyond that the unit of the stamps is wrong
_FEWEST_ROWS = 3


@dataclass(frozen=True)
class ReplaySettings:
    """How a log is replayed.

    Attributes:
        window_s: restart from the measured state this often [s]; None replays whole motions.
        initial_velocity: `zero`, or the `measured` one (its derivative of position where there is no channel);
            None takes the measured one at the start of windows and zero at that of a whole motion.
        delay_s: the command acts this much later [s], >= 0.
    """

    window_s: float | None = None
    initial_velocity: Literal["zero", "measured"] | None = None
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what cannot be replayed."""
        if self.window_s is not None and not 0 < self.window_s < np.inf:
            raise ConfigError("window_s must be positive", got=self.window_s)
        if not 0 <= self.delay_s < np.inf:
            raise ConfigError("delay_s must be >= 0", got=self.delay_s)

    @property
    def starts_moving(self) -> bool:
        """Whether a simulation starts with the measured velocity."""
        return self.initial_velocity == "measured" or (self.initial_velocity is None and self.window_s is not None)

    @staticmethod
    def of(robot: RobotSpec) -> ReplaySettings:
        """What the robot description asks for."""
        return ReplaySettings(robot.replay.window_s, robot.replay.initial_velocity, robot.controller.delay_s)


def hold(
    command: TimeSeries, signal: str, time_s: Float64[np.ndarray, "*shape"], *, delay_s: float = 0.0
) -> Float[np.ndarray, "*shape J"]:
    """The command that acts at `time_s`: the latest with a stamp at or before `time_s - delay_s`.

    Before the first stamp the first command acts.
    """
    held: Float[np.ndarray, "*shape J"] = command[signal][np.maximum(held_rows(command.time_s, time_s - delay_s), 0)]
    return held


def replay_episode(episode: Episode, simulator: Simulator, settings: ReplaySettings) -> TimeSeries:
    """What the simulator makes of an episode's command.

    The simulation starts in the measured pose at the first measured stamp that has a command, runs on its own
    grid, and is read at the measured stamps by linear interpolation (torque: the one acting at the stamp).

    Args:
        episode: in the joint names and units of the robot (see `align.JointMap`).
        simulator: with the robot in it.
        settings: windows, initial velocity and delay.

    Returns:
        `position`, `velocity` and `torque`, (T, J), on the measured clock from the first command on.

    Raises:
        DataError: the clocks do not overlap, the starting state or the command is not finite, or the simulation
            diverged.
        MissingSignal: the command lacks what the controller follows.
    """
    command = episode.commanded().select(simulator.joints)
    measured = episode.measured.select(simulator.joints)
    rows = np.flatnonzero(measured.time_s >= command.time_s[0] - SAME_INSTANT_S)
    if rows.size == 0:
        raise DataError(
            f"episode {episode.id!r}: the measurement ends before the first command",
            got=f"{measured.time_s[-1]:.3f} s",
            expected=f"at least {command.time_s[0]:.3f} s",
        )
    measured = measured.rows(slice(int(rows[0]), None))
    clock = measured.time_s
    starts = window_starts(clock, settings.window_s)
    request = _request(episode.id, measured, command, starts, simulator, settings)
    result = simulator.rollout(request)
    signals = _at_stamps(result, clock, starts, simulator.timestep_s)
    lengths = measured.units["position"]
    units = {
        "position": lengths,
        "velocity": tuple(f"{unit}/s" for unit in lengths),
        "torque": tuple("N" if unit == "m" else "Nm" for unit in lengths),
    }
    return TimeSeries(clock, measured.joints, signals, units)


def replay(
    episodes: Iterable[Episode],
    make_simulator: Callable[[], Simulator],
    settings: ReplaySettings,
    *,
    jobs: int = 1,
) -> Iterator[tuple[str, TimeSeries | TrueupError]]:
    """Replay many episodes over threads, in order.

    Args:
        episodes: read one by one, so that memory does not grow with their number.
        make_simulator: called once per thread.
        settings: windows, initial velocity and delay.
        jobs: threads; MuJoCo releases Python's lock while it steps.

    Yields:
        (episode id, simulated series); the error in place of the series if that episode cannot be replayed, so
        that one bad log does not stop the others.
    """
    own = local()

    def work(episode: Episode) -> TimeSeries | TrueupError:
        if not hasattr(own, "simulator"):
            own.simulator = make_simulator()
        try:
            return replay_episode(episode, own.simulator, settings)
        except TrueupError as error:
            return error

    waiting: list[tuple[str, Future[TimeSeries | TrueupError]]] = []
    with ThreadPoolExecutor(max_workers=jobs) as pool:
        for episode in episodes:
            waiting.append((episode.id, pool.submit(work, episode)))
            if len(waiting) > 2 * jobs:
                episode_id, future = waiting.pop(0)
                yield episode_id, future.result()
        for episode_id, future in waiting:
            yield episode_id, future.result()


def _request(
    episode_id: str,
    measured: TimeSeries,
    command: TimeSeries,
    starts: Int[np.ndarray, "W"],
    simulator: Simulator,
    settings: ReplaySettings,
) -> RolloutRequest:
    clock, timestep = measured.time_s, simulator.timestep_s
    last = np.append(starts[1:], clock.size) - 1
    longest_s = float(np.max(clock[last] - clock[starts]))
    if longest_s / timestep > _MOST_STEPS:
        raise DataError(
            f"episode {episode_id!r} lasts too long for a time step of {timestep:g} s",
            got=f"{longest_s:.3g} s",
            hint="Are its stamps really in seconds?",
        )
    if starts.size > 1 and np.median(np.diff(starts)) < _FEWEST_ROWS:
        raise DataError(
            f"episode {episode_id!r}: a window of {settings.window_s:g} s holds hardly a sample",
            got=f"samples every {np.median(np.diff(clock)):.3g} s",
            expected=f"windows of at least {_FEWEST_ROWS} samples",
        )
    steps = max(1, int(np.ceil(longest_s / timestep - 1e-6)))
    grid = clock[starts][:, None] + np.arange(steps) * timestep
    position = measured["position"][starts].astype(np.float64)
    velocity = np.zeros_like(position)
    if settings.starts_moving:
        velocity = _velocity(measured)[starts].astype(np.float64)
    needed = [signal for signal in simulator.command_signals if signal in command]
    held = {signal: hold(command, signal, grid, delay_s=settings.delay_s) for signal in needed}
    for name, values in {"starting position": position, "starting velocity": velocity, **held}.items():
        if not np.all(np.isfinite(values)):
            raise DataError(f"episode {episode_id!r}: the {name} has values that are not finite")
    return RolloutRequest(position=position, velocity=velocity, command=held)


def _velocity(measured: TimeSeries) -> Float[np.ndarray, "T J"]:
    if "velocity" in measured:
        return measured["velocity"]
    if len(measured) < 2:
        return np.zeros_like(measured["position"])
    slope: Float[np.ndarray, "T J"] = np.gradient(measured["position"], measured.time_s, axis=0)
    return slope


def _at_stamps(
    result: RolloutResult, clock: Float64[np.ndarray, "T"], starts: Int[np.ndarray, "W"], timestep_s: float
) -> dict[str, Float[np.ndarray, "T J"]]:
    """Read the windows' grids at the stamps."""
    window = np.searchsorted(starts, np.arange(clock.size), side="right") - 1
    steps = (clock - clock[starts][window]) / timestep_s
    # The last stamp of a motion sits on the last grid point, up to rounding.
    row = np.minimum(np.floor(steps + 1e-6).astype(np.int64), result.position.shape[1] - 2)
    share = (steps - row)[:, None]
    blend = {
        name: (1.0 - share) * values[window, row] + share * values[window, row + 1]
        for name, values in (("position", result.position), ("velocity", result.velocity))
    }
    return {**blend, "torque": result.torque[window, row]}
