"""Checks of the values: missing, spiking, frozen, saturated."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool

from trueup.align.quality_config import QualityConfig
from trueup.align.tracks import Track, runs
from trueup.core.episode import Flag
from trueup.core.hold import held_rows
from trueup.core.timeseries import BODY_PREFIX, TimeSeries

# A joint that stops within one sample from this share of its usual speed has not been braked.
_STOPPED = 0.25


def nan_flags(series: TimeSeries, config: QualityConfig, *, name: str = "measured") -> list[Flag]:
    """`nan`: samples that are not finite, one flag per signal and joint."""
    flags = []
    for signal, values in series.signals.items():
        names = series.bodies if signal.startswith(BODY_PREFIX) else series.joints
        bad = ~np.isfinite(values)
        bad = bad.any(axis=tuple(range(2, bad.ndim))) if bad.ndim > 2 else bad
        for column in np.flatnonzero(bad.any(axis=0)):
            mask = bad[:, column]
            longest = max(_seconds(series, start, end) for start, end in runs(mask))
            share = float(mask.mean())
            severe = share > config.nan_warning_share or longest > config.nan_warning_s
            detail = f"{mask.sum()} of {mask.size} samples are not finite, up to {longest:.3g} s in a row"
            if mask.all() and signal != "position":
                # Many drivers have a place for what this joint has no sensor for.
                severe, detail = False, "no sample has a value: it was not measured"
            flags.append(
                Flag(
                    kind="nan",
                    series=name,
                    signal=signal,
                    joint=names[column],
                    detail=detail,
                    severity="warning" if severe else "note",
                    start_s=float(series.time_s[np.argmax(mask)]),
                    end_s=float(series.time_s[mask.size - 1 - np.argmax(mask[::-1])]),
                )
            )
    return flags


def spike_flags(track: Track, config: QualityConfig) -> list[Flag]:
    """`spike`: a position that jumps away and comes back within three samples."""
    steps = np.diff(track.position)
    if steps.size < 10:
        return []
    least = max(config.spike_rad, config.spike_factor * float(np.percentile(np.abs(steps), 99)))
    jumps = np.where(np.abs(steps) > least, np.sign(steps), 0.0)
    hit = np.zeros(track.position.size, dtype=bool)
    for width in (1, 2, 3):
        for row in np.flatnonzero((jumps[:-width] != 0.0) & (jumps[width:] == -jumps[:-width])):
            # Back means back: a step and a later step the other way leave more than a rest.
            if abs(track.position[row + width + 1] - track.position[row]) < 0.5 * abs(steps[row]):
                hit[row + 1 : row + 1 + width] = True
    if not hit.any():
        return []
    height = float(np.abs(steps[np.concatenate([hit[1:], [False]])[: steps.size] | hit[: steps.size]]).max())
    rows = np.flatnonzero(hit)
    return [
        Flag(
            kind="spike",
            signal="position",
            joint=track.joint,
            detail=f"{len(runs(hit))} spikes, up to {track.say(height)} there and back within three samples",
            severity="warning",
            start_s=float(track.time_s[rows[0]]),
            end_s=float(track.time_s[rows[-1]]),
        )
    ]


def frozen_flags(track: Track, config: QualityConfig) -> list[Flag]:
    """`frozen`: an unchanged position although the joint must have moved.

    Its own velocity says so; or its command does, and the position scatters otherwise, or is somewhere else at once
    when it changes again. Dry friction holds a joint against a command, too, but lets it go from where it was: soft
    servos and slow commands show it all the time, and nothing is wrong with their measurement.
    """
    if track.time_s.size < 3:
        return []
    found, noisy = [], _scatters(track)
    for start, end in runs(np.diff(track.position) == 0.0):
        # Rows start..end carry one value; a joint that answers late to a step is not frozen.
        inner = track.time_s[start : end + 1]
        if inner[-1] - inner[0] < config.frozen_s:
            continue
        last = start + int(np.searchsorted(inner, inner[-1] - config.response_s, side="right"))
        if last <= start:
            continue
        commanded, moved = _commanded(track, start, last), _moved(track, start, last)
        if moved >= config.frozen_travel_rad or (
            commanded >= config.frozen_travel_rad and (noisy or _elsewhere(track, start, end, config))
        ):
            found.append((start, end))
    if not found:
        return []
    seconds = sum(float(track.time_s[end] - track.time_s[start]) for start, end in found)
    travel = max(max(_commanded(track, start, end + 1), _moved(track, start, end + 1)) for start, end in found)
    return [
        Flag(
            kind="frozen",
            signal="position",
            joint=track.joint,
            detail=(
                f"position did not change by one encoder step for {seconds:.3g} s in all, in which it should have "
                f"moved by {track.say(travel)}"
            ),
            severity="warning",
            start_s=float(track.time_s[found[0][0]]),
            end_s=float(track.time_s[found[-1][1]]),
        )
    ]


def saturation_flags(
    series: TimeSeries, limits: Mapping[str, float] | None, command: TimeSeries | None, config: QualityConfig
) -> list[Flag]:
    """`saturation` of the torque: at a known limit, or on a plateau that the commanded torque exceeds.

    Args:
        series: measured.
        limits: joint -> torque limit, in the unit of the log; joints without an entry are judged by the command.
        command: its `torque`, if it has one, says whether a plateau is a limit or what was asked for.
        config: thresholds.
    """
    if "torque" not in series:
        return []
    flags = []
    for column, joint in enumerate(series.joints):
        load = np.abs(np.nan_to_num(series["torque"][:, column].astype(np.float64), posinf=0.0, neginf=0.0))
        limit = None if limits is None else limits.get(joint)
        if limit is not None:
            mask, level, what = load >= config.saturated_share * limit, limit, "its limit"
        elif command is not None and "torque" in command and joint in command.joints:
            rows = np.maximum(held_rows(command.time_s, series.time_s), 0)
            asked = np.abs(command["torque"][rows, command.joints.index(joint)].astype(np.float64))
            level, what = float(np.percentile(load, 99.9)), "a plateau below its command"
            beyond = config.saturated_share * asked > level
            mask = (load >= config.saturated_share * level) & (load <= level / config.saturated_share) & beyond
        else:
            continue
        flags += _saturation(series, joint, column, mask, level, what, config)
    return flags


def position_limit_flags(
    track: Track, limits: Mapping[str, tuple[float, float] | None], config: QualityConfig
) -> list[Flag]:
    """`position_limit`: the joint is at, or beyond, a limit that is known."""
    known = limits.get(track.joint)
    if known is None:
        return []
    low, high = (value / track.radian for value in known)
    at = (track.position <= low + config.limit_rad) | (track.position >= high - config.limit_rad)
    stretches = [(a, b) for a, b in runs(at) if track.time_s[b - 1] - track.time_s[a] >= config.saturated_s]
    if not stretches:
        return []
    asked = track.position if track.command is None else track.command
    pushed = [max(float((low - asked[a:b]).max()), float((asked[a:b] - high).max())) for a, b in stretches]
    beyond = max(low - float(track.position.min()), float(track.position.max()) - high, 0.0)
    seconds = sum(float(track.time_s[b - 1] - track.time_s[a]) for a, b in stretches)
    detail = f"at a limit ({track.say(low)} to {track.say(high)}) for {seconds:.3g} s"
    if beyond > config.limit_rad:
        detail += f" and up to {track.say(beyond)} beyond: the limit or the zero of the joint is not what was stated"
    if max(pushed) > config.push_rad:
        detail += f", with its command up to {track.say(max(pushed))} beyond"
    return [
        Flag(
            kind="position_limit",
            signal="position",
            joint=track.joint,
            detail=detail,
            severity="warning" if max(pushed) > config.push_rad else "note",
            start_s=float(track.time_s[stretches[0][0]]),
            end_s=float(track.time_s[stretches[-1][1] - 1]),
        )
    ]


def _commanded(track: Track, first: int, last: int) -> float:
    """How far the command moves."""
    return 0.0 if track.command is None else float(np.ptp(track.command[first:last]))


def _moved(track: Track, first: int, last: int) -> float:
    """How far the joint moves, by its velocity."""
    if track.velocity is None:
        return 0.0
    steps = np.diff(track.time_s[first:last])
    return float(np.ptp(np.concatenate([[0.0], np.cumsum(track.velocity[first : last - 1] * steps)])))


def _scatters(track: Track) -> bool:
    """Whether readings scatter by more than the encoder resolves, so that a joint at rest does not read the same."""
    third = np.abs(np.diff(track.position, 3))
    if not third.any():
        return False
    # Of white noise, third differences have 20 times the variance, and half of them are below 0.67 deviations.
    scatter = float(np.median(third[third > 0.0])) / (0.67 * np.sqrt(20.0))
    return bool(scatter > 2.0 * _tick(track))


def _tick(track: Track) -> float:
    """The least by which readings differ."""
    return float(np.diff(np.unique(np.round(track.position, 9))).min(initial=np.inf))


def _elsewhere(track: Track, start: int, end: int, config: QualityConfig) -> bool:
    """Whether a position that was the same in rows start..end has left a joint that moves, or comes back to one.

    It jumps by half of what the command has changed by, and by more than the joint usually moves from sample to sample;
    or it stops in motion, and the log ends before it changes again.
    """
    steps = np.abs(np.diff(track.position))
    usual = float(np.percentile(steps[steps > 0.0], 90)) if steps.any() else 0.0
    if end + 1 >= track.position.size:
        return bool(start > 0 and steps[start - 1] > max(_STOPPED * usual, 2.0 * _tick(track)))
    assert track.command is not None
    changed = abs(float(track.command[end] - track.command[start]))
    return bool(steps[end] > max(0.5 * changed, 2.0 * usual, 0.1 * config.frozen_travel_rad))


def _saturation(
    series: TimeSeries,
    joint: str,
    column: int,
    mask: Bool[np.ndarray, "T"],
    level: float,
    what: str,
    config: QualityConfig,
) -> list[Flag]:
    stretches = [(a, b) for a, b in runs(mask) if _seconds(series, a, b) >= config.saturated_s]
    if not stretches:
        return []
    share = sum(b - a for a, b in stretches) / mask.size
    return [
        Flag(
            kind="saturation",
            signal="torque",
            joint=joint,
            detail=(
                f"torque at {what} ({level:.3g} {series.units['torque'][column]}) in {100 * share:.2g} % of the "
                f"recording, {len(stretches)} times"
            ),
            severity="warning" if share > config.saturated_warning_share else "note",
            start_s=float(series.time_s[stretches[0][0]]),
            end_s=float(series.time_s[stretches[-1][1] - 1]),
        )
    ]


def _seconds(series: TimeSeries, start: int, end: int) -> float:
    """Duration of the rows from `start` to before `end`, each lasting until the next stamp [s]."""
    last = min(end, len(series) - 1)
    return float(series.time_s[last] - series.time_s[start]) if last > start else 1.0 / max(series.rate_hz, 1e-9)
