"""Joints that stop following their command while their load rises: limits that were hit, contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import binary_dilation, maximum_filter1d, minimum_filter1d

from trueup.align.quality_config import QualityConfig
from trueup.align.tracks import Track, runs
from trueup.core.episode import Flag


@dataclass(frozen=True)
class _Push:
    """One stretch of time in which a standing joint is pushed."""

    start: int
    end: int
    error: float
    load: float
    unanswered: float
    at_end_of_travel: bool


def blocked_flags(track: Track, config: QualityConfig) -> list[Flag]:
    """Find where a joint stands still although its command is far away, under a load far above its usual one.

    Stiction, gravity sag and lag do not look like this: with stiction the error stays below the breakaway error that
    the joint also shows elsewhere, a sagging joint follows its command at a distance, a lagging one moves. At the
    end of the joint's travel it is a `limit_hit`, elsewhere `blocked` (an obstacle, a hand, the table). Needs
    neither the joint's limits nor its torque limit nor another episode.

    A joint that merely never reaches a command that does not change may be blocked, or too weak for its load: a note.
    """
    if track.command is None or track.time_s.size < 3:
        return []
    error = track.command - track.position
    still = _still(track, config)
    standing = np.abs(error[still])
    if standing.size < 3:
        return []
    least = max(config.push_rad, config.push_factor * float(np.percentile(standing, 25)))
    pushed = still & (np.abs(error) > least)
    usual = _usual_load(track, pushed, config)
    found = []
    for start, end in runs(pushed):
        if track.time_s[end - 1] - track.time_s[start] < 0.5 * config.still_s:
            continue
        push = _push(track, error, still, start, end, config)
        # Without a load signal the error alone has to say it, and elsewhere than at an end it may be the encoder.
        strong = (
            push.at_end_of_travel and push.error > 2.0 * least
            if usual is None
            else push.load > config.load_factor * usual
        )
        if strong:
            found.append(push)
    flags = []
    for at_end in (True, False):
        pushes = [push for push in found if push.at_end_of_travel == at_end]
        if pushes:
            flags.append(_flag(track, pushes, usual, config))
    return flags


def _still(track: Track, config: QualityConfig) -> Bool[np.ndarray, "T"]:
    width = 2 * track.samples(0.5 * config.still_s, least=2) + 1
    span = maximum_filter1d(track.position, width) - minimum_filter1d(track.position, width)
    return np.asarray(span <= max(config.still_rad, 2.5 * track.step))


def _usual_load(track: Track, pushed: Bool[np.ndarray, "T"], config: QualityConfig) -> float | None:
    if track.load is None or np.ptp(track.load) == 0.0:
        return None
    # The load rises before the joint counts as standing and falls after.
    elsewhere = ~binary_dilation(pushed, iterations=track.samples(config.response_s))
    if np.sum(elsewhere) < 10:
        return None
    return float(np.percentile(track.load[elsewhere], 95))


def _push(
    track: Track,
    error: Float64[np.ndarray, "T"],
    still: Bool[np.ndarray, "T"],
    start: int,
    end: int,
    config: QualityConfig,
) -> _Push:
    assert track.command is not None
    position = track.position
    here = float(np.median(position[start:end]))
    outward = float(np.sign(error[start]))
    extreme = position.max() if outward > 0.0 else position.min()
    # The joint may have stood there before the command went on: those rows tell how far it went unanswered.
    place = still & (np.abs(position - here) <= max(config.still_rad, 2.5 * track.step))
    first, last = start, end
    while first > 0 and place[first - 1]:
        first -= 1
    while last < place.size and place[last]:
        last += 1
    return _Push(
        start=start,
        end=end,
        error=float(np.abs(error[start:end]).max()),
        load=0.0 if track.load is None else float(np.percentile(track.load[start:end], 75)),
        unanswered=float(np.ptp(track.command[first:last])),
        at_end_of_travel=abs(here - float(extreme)) <= config.end_of_travel_rad,
    )


def _flag(track: Track, pushes: list[_Push], usual: float | None, config: QualityConfig) -> Flag:
    worst = max(pushes, key=lambda push: push.error)
    sure = any(push.unanswered >= config.unanswered_rad or push.error >= config.astray_rad for push in pushes)
    seconds = sum(float(track.time_s[push.end - 1] - track.time_s[push.start]) for push in pushes)
    limit = worst.at_end_of_travel
    place = ", the end of its travel," if limit else ""
    load = "" if usual is None else f"; load {worst.load:.3g} {track.load_unit}, elsewhere below {usual:.3g}"
    times = "once" if len(pushes) == 1 else f"{len(pushes)} times"
    doubt = "" if sure else "; its command did not change meanwhile, so it may also be too weak for its load"
    return Flag(
        kind="limit_hit" if limit else "blocked",
        signal="position",
        joint=track.joint,
        detail=(
            f"stood still at {track.say(float(track.position[worst.start]))}{place} with its command up to "
            f"{track.say(worst.error)} away ({times}, {seconds:.2g} s in all){load}{doubt}"
        ),
        severity="warning" if sure else "note",
        start_s=float(track.time_s[min(push.start for push in pushes)]),
        end_s=float(track.time_s[max(push.end for push in pushes) - 1]),
    )
