"""The torque ramps in a log, and at which torque each of them set the joint in motion."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float64

from trueup.identify.experiments.joint_log import JointLog
from trueup.identify.experiments.onset import Stillness, least_rest, onset_time

_QUIET = 0.02  # share of the largest torque below which there is none
_STRAIGHT = 0.98  # correlation of torque and time above which a stretch of torque is a ramp
_AFTER_S = 0.05  # a motion may be seen this long after the ramp was ended because of it


@dataclass(frozen=True)
class Attempt:
    """One ramp of one joint; torques are signed like the ramp and NaN where they are not defined."""

    episode: str
    joint: str
    sign: int
    outcome: Literal["moved", "no_motion", "moves_without_torque"]
    threshold: float = math.nan
    seen_after_s: float = math.nan
    correction: float = math.nan
    tick: float = math.nan
    largest: float = math.nan

    def to_json(self, effort: str) -> dict[str, Any]:
        """One row of the table of runs, torques with their signs."""
        return {
            "episode": self.episode,
            "joint": self.joint,
            "direction": self.sign,
            "outcome": self.outcome,
            "threshold": self.sign * self.threshold,
            "largest_torque": self.sign * self.largest,
            "seen_after_s": self.seen_after_s,
            "correction": self.correction,
            "unit": effort,
        }


def read_attempts(log: JointLog, still_speed: float) -> tuple[list[Attempt], list[str]]:
    """The ramps of one joint in a log, and why others are none."""
    torque = np.abs(log.torque)
    peak = float(torque.max())
    active = torque > _QUIET * peak
    pieces = _pieces(active, np.sign(log.torque))
    found, reasons = [], []
    if not pieces:
        still = _stillness(log, slice(0, len(torque)), still_speed)
        if still is not None and still.moving:
            found = [Attempt(log.episode, log.joint, sign, "moves_without_torque") for sign in (1, -1)]
        else:
            reasons = ["the commanded torque is zero throughout"]
    previous = 0
    for begin, end in pieces:
        rest = slice(previous + (begin - previous) // 2 if previous else 0, begin)
        previous = end
        still = _stillness(log, rest, still_speed)
        top = begin + int(np.argmax(torque[begin:end]))
        if not _is_ramp(log.time_s[begin : top + 1], torque[begin : top + 1]):
            reasons.append("the commanded torque is no ramp")
        elif still is None:
            reasons.append("there is no rest without torque before the ramp")
        elif still.moving:
            found.append(Attempt(log.episode, log.joint, int(np.sign(log.torque[begin])), "moves_without_torque"))
        else:
            attempt = _attempt(log, still, rest.start, begin, end)
            if attempt is None:
                reasons.append("the joint moved against the ramp: is the sign of the torque the robot's?")
            else:
                found.append(attempt)
    return found, reasons


def _attempt(log: JointLog, still: Stillness, first: int, begin: int, end: int) -> Attempt | None:
    """One ramp, in rows `begin` to before `end` after a rest from `first` on; None if it moved the wrong way."""
    sign = int(np.sign(log.torque[begin]))
    torque, clock = np.abs(log.torque), log.time_s
    is_position = still.channel == "position"
    values = log.position if is_position else log.velocity
    assert values is not None
    last = max(int(np.searchsorted(clock, clock[end - 1] + _AFTER_S, side="right")), end + 1)
    moving = np.flatnonzero(still.moves(clock[first:last], values[first:last])) + first
    moving = moving[moving >= begin]
    ramp = torque[begin:end]
    tick = float(np.median(np.diff(np.unique(ramp)))) if np.unique(ramp).size > 1 else 0.0
    largest = float(ramp.max())
    if moving.size == 0:
        return Attempt(log.episode, log.joint, sign, "no_motion", tick=tick, largest=largest)
    seen = int(moving[0])
    forward = sign * values
    moved = forward[seen] - forward[seen - still.rows] if is_position else forward[seen - still.rows : seen].sum()
    if moved < 0.0:
        return None
    start_s = onset_time(clock, forward, begin, seen, is_position=is_position)
    # A held command breaks the joint away at a tick; the threshold lies between this torque and the one before.
    threshold = max(float(np.interp(start_s, clock[first:end], torque[first:end])) - 0.5 * tick, 0.0)
    return Attempt(
        log.episode,
        log.joint,
        sign,
        "moved",
        threshold=threshold,
        seen_after_s=float(clock[seen] - start_s),
        correction=float(torque[min(seen, end - 1)]) - threshold,
        tick=tick,
        largest=largest,
    )


def _pieces(active: Bool[np.ndarray, "T"], sign: Float64[np.ndarray, "T"]) -> list[tuple[int, int]]:
    """Stretches of torque of one sign, as (first row, row after the last)."""
    label = np.where(active, sign, 0.0)
    edges = np.flatnonzero(np.diff(label, prepend=0.0, append=0.0))
    return [(int(a), int(b)) for a, b in itertools.pairwise(edges) if label[a] != 0.0]


def _is_ramp(time_s: Float64[np.ndarray, "N"], torque: Float64[np.ndarray, "N"]) -> bool:
    if time_s.size < 10 or torque[0] > 0.3 * torque.max() or np.ptp(torque) == 0.0:
        return False
    return bool(np.corrcoef(time_s, torque)[0, 1] > _STRAIGHT)


def _stillness(log: JointLog, rest: slice, still_speed: float) -> Stillness | None:
    """What standing still looks like in these rows; None if they are too few."""
    clock = log.time_s[rest]
    if clock.size < 10 or clock.size < least_rest(clock):
        return None
    position, velocity = (None if values is None else values[rest] for values in (log.position, log.velocity))
    return Stillness.of_rest(clock, position, velocity, still_speed)
