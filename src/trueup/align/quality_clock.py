"""Checks of clocks and of the rate at which samples really arrive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.align.quality_config import QualityConfig
from trueup.align.start import quantum
from trueup.align.tracks import Track
from trueup.core.episode import Episode, Flag
from trueup.core.timeseries import TimeSeries

# Samples that may come together; a gap of which nobody knows what moved in it [s]; and no time at all [s].
_BURST = 10
_BLIND_S = 0.1
_LEAST_S = 1e-9


def clock_flags(series: TimeSeries, seen: Sequence[Track], config: QualityConfig) -> list[Flag]:
    """`gap` and `jittering_stamps` of one series.

    Simulations are read at the log's own stamps, so that uneven ones do no harm. A gap does if a joint moved in it in a
    way that its ends do not tell: then it is a warning.

    Args:
        series: measured.
        seen: its joints.
        config: thresholds.
    """
    steps = np.diff(series.time_s)
    if steps.size < 2:
        return []
    period = _period(series.time_s)
    gap = (steps > config.gap_steps * period) & (steps > period + config.jitter_s)
    flags = []
    if gap.any():
        rows = np.flatnonzero(gap)
        longest, lost = float(steps.max()), float(np.sum(steps[gap] - period))
        share = lost / series.duration_s
        unseen, what = _unseen(series, seen, rows, config)
        flags.append(
            Flag(
                kind="gap",
                detail=(
                    f"{rows.size} gaps, the longest {1e3 * longest:.3g} ms at a step of {1e3 * period:.3g} ms; "
                    f"{100 * share:.2g} % of the time is missing{what}"
                ),
                severity="warning" if unseen else "note",
                start_s=float(series.time_s[rows[0]]),
                end_s=float(series.time_s[rows[-1] + 1]),
            )
        )
    median = float(np.median(steps))
    jitter = ~gap & (np.abs(steps - median) > config.jitter_share * median)
    if jitter.any():
        rows = np.flatnonzero(jitter)
        flags.append(
            Flag(
                kind="jittering_stamps",
                detail=(
                    f"{rows.size} of {steps.size} steps are off the median of {1e3 * median:.3g} ms by more than "
                    f"{100 * config.jitter_share:.0f} %, from {1e3 * steps[~gap].min():.3g} to "
                    f"{1e3 * steps[~gap].max():.3g} ms: use the stamps, not a fixed step"
                ),
                severity="note",
                start_s=float(series.time_s[rows[0]]),
                end_s=float(series.time_s[rows[-1] + 1]),
            )
        )
    return flags


def _period(time_s: Float64[np.ndarray, "T"]) -> float:
    """Time from sample to sample [s]; of samples that come in bursts, that of many.

    The median step of a clock whose samples come in bursts is the time within a burst.
    """
    steps = np.diff(time_s)
    median = float(np.median(steps))
    if steps.size < 4 * _BURST:
        return median
    return max(median, float(np.median((time_s[_BURST:] - time_s[:-_BURST]) / _BURST)))


def _unseen(
    series: TimeSeries, seen: Sequence[Track], rows: Int[np.ndarray, "G"], config: QualityConfig
) -> tuple[bool, str]:
    """Whether a joint may have moved in a gap in a way that nobody saw, and the worst case in words.

    The slope over the gap is compared with those over as long a time before and after it. With a constant
    acceleration `a`, a gap of length `L` leaves up to `a L^2 / 8` between the path and the straight line, and the
    slopes differ by `a L`: a quarter of `L` times their difference is twice that.

    Args:
        series: measured.
        seen: its joints; without positions nobody knows what moved, and a gap of 0.1 s is taken for a bad one.
        rows: after which there is a gap.
        config: thresholds.
    """
    stamps = series.time_s
    starts, ends = stamps[rows], stamps[rows + 1]
    length = ends - starts
    earlier, later = np.maximum(starts - length, stamps[0]), np.minimum(ends + length, stamps[-1])
    if not seen:
        return bool(length.max() >= _BLIND_S), ""
    worst, words = 0.0, ""
    for track in seen:
        least = min(config.gap_rad, max(config.gap_share * float(np.ptp(track.position)), config.gap_least_rad))
        at = [np.interp(times, stamps, track.position) for times in (earlier, starts, ends, later)]
        over = (at[2] - at[1]) / length
        before = np.where(starts > earlier, over - (at[1] - at[0]) / np.maximum(starts - earlier, _LEAST_S), 0.0)
        after = np.where(later > ends, over - (at[3] - at[2]) / np.maximum(later - ends, _LEAST_S), 0.0)
        moved = 0.25 * length * np.maximum(np.abs(before), np.abs(after))
        number = int(np.argmax(moved))
        if moved[number] > worst * least:
            worst = float(moved[number]) / least
            words = f"; {track.joint} can have moved by {track.say(float(moved[number]))} unseen"
    return worst >= 1.0, words if worst >= 1.0 else ""


def clock_mismatch_flags(episode: Episode, config: QualityConfig) -> list[Flag]:
    """`clock_mismatch`: as many commands as measurements, but another duration, so one clock is not what it says."""
    measured, command = episode.measured, episode.command
    if command is None or len(command) != len(measured) or len(measured) < 10:
        return []
    ratio = command.duration_s / measured.duration_s
    if abs(ratio - 1.0) <= config.clock_share:
        return []
    detail = (
        f"{len(measured)} commands take {command.duration_s:.4g} s and as many measurements "
        f"{measured.duration_s:.4g} s: one of the two clocks is nominal, not measured"
    )
    return [Flag(kind="clock_mismatch", series="command", detail=detail, severity="warning")]


def repeated_sample_flags(series: TimeSeries, config: QualityConfig) -> list[Flag]:
    """`repeated_samples`: rows that only repeat the one before, since the source is slower than the topic.

    ES thesis, 2.4.3: a 1 kHz topic fed at 250 Hz; derivatives of such a signal are wrong. A robot at rest repeats
    rows, too, and a slow one moves by one encoder step now and then. So only changes of two steps and more are
    looked at: a joint this fast changes again in the next sample, unless the sample is a copy.
    """
    flags = []
    for signal in ("position", "velocity", "torque", "current"):
        gaps = _gaps_in_motion(series[signal]) if signal in series else np.zeros(0)
        if gaps.size < config.repeated_changes:
            continue
        share = float(np.mean(gaps > 1))
        if share < config.repeated_share:
            continue
        rate_hz = series.rate_hz / float(np.mean(gaps[gaps <= 2 * np.median(gaps)]))
        flags.append(
            Flag(
                kind="repeated_samples",
                signal=signal,
                detail=(
                    f"stamped at {series.rate_hz:.4g} Hz but new only at about {rate_hz:.3g} Hz: "
                    f"{100 * share:.0f} % of the changes are followed by copies"
                ),
                severity="warning" if signal in ("position", "velocity") else "note",
                start_s=float(series.time_s[0]),
                end_s=float(series.time_s[-1]),
            )
        )
    return flags


def _gaps_in_motion(values: Float[np.ndarray, "T J"]) -> np.ndarray:
    """Rows from each change of at least two resolution steps in some joint to the next change of any."""
    steps = np.abs(np.diff(values.astype(np.float64), axis=0))
    resolution = np.array([quantum(column) for column in values.T.astype(np.float64)])
    changed = np.any(steps > 0.5 * resolution, axis=1)
    large = np.any((steps > 1.5 * resolution) & (resolution > 0.0), axis=1)
    rows = np.flatnonzero(changed)
    return np.diff(rows)[large[rows[:-1]]] if rows.size > 1 else np.zeros(0, dtype=np.int64)
