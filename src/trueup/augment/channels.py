"""From an episode to the rows that a network reads: its channels, on a clock of its rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from trueup.augment.components import values_of
from trueup.core.episode import Episode
from trueup.core.hold import held_rows
from trueup.core.interpolation import columns_at
from trueup.core.model_card import Channel
from trueup.core.timeseries import TimeSeries
from trueup.deploy.agreement import RATE_TOLERANCE
from trueup.errors import DataError, MissingSignal, NameMismatch, UnitError

# A clock whose steps are this near to the network's is taken as it is: robots' clocks jitter.
_STEP_TOLERANCE = 0.2


@dataclass(frozen=True, eq=False)
class Grid:
    """The clock on which a network sees a motion.

    Attributes:
        time_s: the stamps, (N,) [s].
        own: whether they are the series' own stamps.
    """

    time_s: Float64[np.ndarray, "N"]
    own: bool

    @staticmethod
    def of(stamps_s: Float64[np.ndarray, "T"], rate_hz: float, what: str = "this motion") -> Grid:
        """The stamps themselves where they come at `rate_hz`, else an even clock from the first to the last.

        Args:
            stamps_s: of a series, (T,).
            rate_hz: of the network.
            what: whose they are, for messages.

        Raises:
            DataError: the series is shorter than two samples of that rate.
        """
        step = 1.0 / rate_hz
        steps = np.diff(stamps_s)
        at_rate = bool(steps.size) and abs(step / steps.mean() - 1) <= RATE_TOLERANCE
        if at_rate and np.all(np.abs(steps / step - 1) <= _STEP_TOLERANCE):
            return Grid(stamps_s, own=True)
        count = int(np.floor((stamps_s[-1] - stamps_s[0]) / step + 1e-6)) + 1
        if count < 2:
            raise DataError(
                f"{what} is too short for the network", got=f"{stamps_s.size} samples", expected=f"{2 * step:g} s"
            )
        return Grid(stamps_s[0] + step * np.arange(count), own=False)

    def back(
        self, values: Float32[np.ndarray, "N K"], stamps_s: Float64[np.ndarray, "T"]
    ) -> Float32[np.ndarray, "T K"]:
        """Values on this clock, linearly interpolated at the stamps."""
        return values if self.own else _linear(self.time_s, values, stamps_s)


def gather(
    episode: Episode, run: str, channels: Sequence[Channel], time_s: Float64[np.ndarray, "N"]
) -> Float32[np.ndarray, "N I"]:
    """The channels of one run of an episode at given times, in SI.

    Simulated signals are interpolated linearly, commands are held between their stamps; before its first stamp a
    command counts as its first value. Measured signals are the latest readings at the row before, as a control loop
    knows them; in the first row, the simulated ones.

    Raises:
        MissingSignal: the episode lacks the run, the command or a signal.
        NameMismatch: joints or bodies are missing; both lists are printed.
        DataError: a rotation is none.
        UnitError: a channel has another unit than the series.
    """
    columns = []
    for channel in channels:
        if channel.series == "measured":
            columns.append(_sensed(episode, run, channel, time_s))
            continue
        series = episode.run(run) if channel.series == "simulated" else episode.commanded()
        values = column(
            series, channel, f"episode {episode.id!r}, {run if channel.series == 'simulated' else 'command'}"
        )
        if time_s is series.time_s:
            columns.append(values)
        elif channel.series == "command":
            columns.append(values[np.maximum(held_rows(series.time_s, time_s), 0)])
        else:
            columns.append(_linear(series.time_s, values[:, None], time_s)[:, 0])
    return np.stack(columns, axis=1).astype(np.float32)


def _sensed(episode: Episode, run: str, channel: Channel, time_s: Float64[np.ndarray, "N"]) -> Float32[np.ndarray, "N"]:
    simulated, measured = (
        column(series, channel, f"episode {episode.id!r}, {name}")
        for series, name in ((episode.run(run), run), (episode.measured, "measured"))
    )
    start = np.interp(time_s[:1], episode.run(run).time_s, simulated)
    # Held, not interpolated: a control loop does not know the reading that comes next.
    latest = np.maximum(held_rows(episode.measured.time_s, time_s[:-1]), 0)
    return np.concatenate([start, measured[latest]]).astype(np.float32)


def column(series: TimeSeries, channel: Channel, where: str) -> Float32[np.ndarray, "T"] | Float64[np.ndarray, "T"]:
    """The values of one channel on the clock of its series.

    Raises:
        MissingSignal: there is no such signal.
        NameMismatch: there is no such joint or body.
        UnitError: the unit differs.
        DataError: a rotation is none.
    """
    quantity = channel.quantity
    if quantity not in series:
        raise MissingSignal(f"{where} has no signal {quantity!r}", available=series.signals)
    what, names = ("body", series.bodies) if channel.of_body else ("joint", series.joints)
    if channel.joint not in names:
        raise NameMismatch(
            f"{where} lacks the {what} {channel.joint!r}",
            left=names,
            right=[channel.joint],
            left_name="it has",
            right_name="the network needs",
        )
    at = names.index(channel.joint)
    unit = series.units[quantity][at]
    if unit != channel.unit:
        raise UnitError(f"{where}: {quantity} of {channel.joint!r}", got=unit, expected=channel.unit)
    values = series[quantity]
    return values_of(values, at, channel.signal, f"{where}, {channel.joint}") if channel.of_body else values[:, at]


def _linear(stamps_s: Float64[np.ndarray, "T"], values: np.ndarray, time_s: Float64[np.ndarray, "N"]) -> np.ndarray:
    """Columns at other times; constant beyond the ends."""
    return columns_at(time_s, stamps_s, values).astype(np.float32)
