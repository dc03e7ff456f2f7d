"""Cutting the rest before and after a motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from trueup.align.start import held_over_nan
from trueup.core.episode import Episode
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.errors import DataError

# Fewer samples are commands sent now and then: all motion and no noise.
_LEAST = 20
# A joint this far from its first pose has left it [rad, m or share of the range].
_TOLERANCE = 0.005


def moving_span(series: TimeSeries) -> tuple[float, float] | None:
    """First and last time at which the series is away from its first and from its last pose [s]; None if never.

    A joint is away when its position differs by more than 0.005 (rad, m or share of the range) or eight
    standard deviations of its noise, whatever is more. Unlike the mean-shift test this never takes a part of a motion
    without rests for a rest. Without positions every signal is looked at, with 2 % of its span as the tolerance.
    """
    if "position" in series:
        values = _filled(series["position"])
        limit = np.maximum(_TOLERANCE, 8.0 * _noise(values))
    else:
        joint = [_filled(values) for name, values in series.signals.items() if not name.startswith(BODY_PREFIX)]
        values = np.concatenate(joint, axis=1) if joint else np.zeros((len(series), 1))
        limit = np.maximum(0.02 * np.ptp(values, axis=0), 8.0 * _noise(values))
    ends = 10 if len(values) >= _LEAST else 1
    after_first = _any_away(values, np.median(values[:ends], axis=0), limit)
    before_last = _any_away(values, np.median(values[-ends:], axis=0), limit)
    if not (after_first.any() or before_last.any()):
        return None
    # A series that starts and ends in different poses is away from one of them in every row.
    first = int(np.argmax(after_first)) if after_first.any() else len(series) - 1
    last = len(series) - 1 - int(np.argmax(before_last[::-1])) if before_last.any() else 0
    return float(series.time_s[first]), float(series.time_s[last])


def cut_rest(episode: Episode, *, margin_s: float = 0.5) -> Episode:
    """The episode without the rest at its two ends, cut at the same times in all of its series.

    It starts `margin_s` before the command or the measurement first moves and ends as long after both have come to
    rest. The command in force at the cut is kept, with its stamp. An episode in which nothing moves is returned
    as it is: a robot that holds a pose is data, too.

    Args:
        episode: command, measured and simulated series are all cut; simulated ones have no say in where.
        margin_s: rest to keep on either side [s].

    Raises:
        DataError: the margin is negative.
    """
    if margin_s < 0.0:
        raise DataError("margin_s", got=margin_s, expected="0 or more")
    deciding = [one for one in (episode.measured, episode.command) if one is not None]
    spans = [span for one in deciding if (span := moving_span(one)) is not None]
    if not spans:
        return episode
    start = min(first for first, _ in spans) - margin_s
    end = max(last for _, last in spans) + margin_s
    command = episode.command
    return replace(
        episode,
        measured=_between(episode.measured, start, end, held=False),
        command=None if command is None else _between(command, start, end, held=True),
        simulated={label: _between(run, start, end, held=False) for label, run in episode.simulated.items()},
    )


def _between(series: TimeSeries, start_s: float, end_s: float, *, held: bool) -> TimeSeries:
    first = int(np.searchsorted(series.time_s, start_s, side="right" if held else "left"))
    first = max(first - 1, 0) if held else first
    last = int(np.searchsorted(series.time_s, end_s, side="right"))
    if last <= first:
        raise DataError(
            "a series has no samples in the motion",
            got=f"{series.time_s[0]:.9g} to {series.time_s[-1]:.9g} s",
            expected=f"{start_s:.9g} to {end_s:.9g} s",
        )
    return series.rows(slice(first, last))


def _any_away(
    values: Float[np.ndarray, "T J"], pose: Float[np.ndarray, "J"], limit: Float[np.ndarray, "J"]
) -> Bool[np.ndarray, "T"]:
    return np.asarray(np.any(np.abs(values - pose) > limit, axis=1))


def _noise(values: Float[np.ndarray, "T J"]) -> Float[np.ndarray, "J"]:
    """Standard deviation of the noise: the lesser of two guesses, either of which motion can only raise.

    Second differences see a smooth motion as rest; the ten samples at either end see the rests.
    """
    if len(values) < _LEAST:
        return np.zeros(values.shape[1])
    bends = np.median(np.abs(np.diff(values, n=2, axis=0)), axis=0) / (0.6745 * np.sqrt(6.0))
    return np.asarray(np.minimum(bends, np.maximum(values[:10].std(axis=0), values[-10:].std(axis=0))))


def _filled(values: Float[np.ndarray, "T J"]) -> Float[np.ndarray, "T J"]:
    known = values.astype(np.float64)
    # A column that starts with NaN starts with its first value; one without any value never moves.
    first = np.array([column[np.isfinite(column)][:1].sum() for column in known.T])
    known[0] = np.where(np.isfinite(known[0]), known[0], first)
    return held_over_nan(known)
