"""Checks of clocks and of the rate at which samples really arrive."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from trueup.align.quality_config import QualityConfig
from trueup.align.start import quantum
from trueup.core.episode import Episode, Flag
from trueup.core.timeseries import TimeSeries


def clock_flags(series: TimeSeries, config: QualityConfig, *, name: str = "measured") -> list[Flag]:
    """`gap` and `jittering_stamps` of one series."""
    steps = np.diff(series.time_s)
    if steps.size < 2:
        return []
    median = float(np.median(steps))
    gap = steps > config.gap_steps * median
    flags = []
    if gap.any():
        rows = np.flatnonzero(gap)
        longest, lost = float(steps.max()), float(np.sum(steps[gap] - median))
        share = lost / series.duration_s
        bad = longest >= config.gap_warning_s or share >= config.gap_warning_share
        flags.append(
            Flag(
                kind="gap",
                series=name,
                detail=(
                    f"{rows.size} gaps, the longest {1e3 * longest:.3g} ms at a step of {1e3 * median:.3g} ms; "
                    f"{100 * share:.2g} % of the time is missing"
                ),
                severity="warning" if bad else "note",
                start_s=float(series.time_s[rows[0]]),
                end_s=float(series.time_s[rows[-1] + 1]),
            )
        )
    jitter = ~gap & (np.abs(steps - median) > config.jitter_share * median)
    if jitter.any():
        rows = np.flatnonzero(jitter)
        flags.append(
            Flag(
                kind="jittering_stamps",
                series=name,
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
