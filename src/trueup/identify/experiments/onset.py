"""When a joint begins to move: robust to noise, quantization and creep, and corrected for the time it takes to see.

Motion is a *window speed* (the difference of positions, or the mean of velocities, over a short window) that stays
above a threshold for a few samples. The threshold is at least the speed below which a joint counts as standing
(ES thesis 3.1.2: 0.03 rad/s), and more where the noise of the rest before, or the step of the encoder, asks for it.

By the time this is seen the joint has been moving for a while. Under a ramp, right after breaking away at `t0`,

    q(t) = q0 + c t + a (t - t0)^2 + b (t - t0)^3,    a, b >= 0,

where `a` comes from the drop from static to kinetic friction, `b` from the ramp itself, and `c` is creep before.
`onset_time` fits that to the samples up to the detection and returns `t0`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

STILL_SPEED = 0.03  # rad/s or m/s
PERSISTENCE = 3  # samples; a single outlier of the position lifts one window speed only
_WINDOW_S = 0.02
_LEAST_WINDOW = 5  # samples
_SIGMAS = 6.0
_STEPS = 1.5  # of the encoder: one step back and forth is no motion
_STOOD = 0.05  # share of the speed at detection
_CANDIDATES = 24
_LONGEST_FIT = 600  # samples

Samples = Float64[np.ndarray, "T"]


@dataclass(frozen=True)
class Stillness:
    """What standing still looks like for one joint.

    Attributes:
        channel: `position` or `velocity`: the one that tells motion from rest at the lower speed.
        threshold: window speed above which it moves [rad/s or m/s].
        rows: samples per window.
        window_s: duration of a window [s].
        moving: whether the joint moved during the rest already.
    """

    channel: str
    threshold: float
    rows: int
    window_s: float
    moving: bool

    @staticmethod
    def of_rest(time_s: Samples, position: Samples | None, velocity: Samples | None, still_speed: float) -> Stillness:
        """Learn it from a rest of at least `least_rest` samples.

        The joint moves during the rest when it drifts at a third of `still_speed` (a velocity sensor alone, which may
        be biased: at `still_speed`) by more than noise and encoder explain.
        """
        step_s = float(np.median(np.diff(time_s)))
        rows = _rows(step_s)
        thresholds, moving = {}, None
        for channel, values in (("position", position), ("velocity", velocity)):
            if values is None:
                continue
            speed = window_speed(time_s, values, rows, is_position=channel == "position")[rows:]
            noise = float(np.std(_detrended(speed)))
            thresholds[channel] = max(still_speed, _SIGMAS * noise)
            if moving is None:  # a biased velocity does not count where there is a position
                moving = _drifts(time_s, values, still_speed, is_position=channel == "position")
        channel = min(thresholds, key=lambda name: thresholds[name])
        return Stillness(channel, thresholds[channel], rows, rows * step_s, bool(moving))

    def level(self, step: float) -> float:
        """The threshold for an encoder of this step, which a rest without a change does not show."""
        return max(self.threshold, _STEPS * step / self.window_s) if self.channel == "position" else self.threshold

    def moves(self, time_s: Samples, values: Samples) -> Bool[np.ndarray, "T"]:
        """Where the joint moves, in samples of the watched channel: above the threshold, and for a while."""
        is_position = self.channel == "position"
        speed = window_speed(time_s, values, self.rows, is_position=is_position)
        above = np.abs(speed) > self.level(encoder_step(values) if is_position else 0.0)
        moving: Bool[np.ndarray, "T"] = above.copy()
        for back in range(1, PERSISTENCE):
            moving[back:] &= above[:-back]
            moving[:back] = False
        return moving


def least_rest(time_s: Samples) -> int:
    """Samples that a rest needs so that its noise can be told."""
    return 4 * _rows(float(np.median(np.diff(time_s))))


def window_speed(time_s: Samples, values: Samples, rows: int, *, is_position: bool) -> Samples:
    """Mean speed over the last `rows` samples, (T,); 0 for the first ones, which have no full window."""
    speed = np.zeros(time_s.size)
    if time_s.size <= rows:
        return speed
    if is_position:
        speed[rows:] = (values[rows:] - values[:-rows]) / (time_s[rows:] - time_s[:-rows])
    else:
        total = np.concatenate([[0.0], np.cumsum(values)])
        speed[rows:] = (total[rows + 1 :] - total[1:-rows]) / rows
    return speed


def encoder_step(position: Samples) -> float:
    """Smallest change from one sample to the next; 0 if nothing changes."""
    steps = np.abs(np.diff(position))
    steps = steps[steps > 0]
    return float(steps.min()) if steps.size else 0.0


def onset_time(time_s: Samples, values: Samples, begin: int, seen: int, *, is_position: bool) -> float:
    """When the motion began that was seen at row `seen`, with the law at the top of this module [s].

    Args:
        time_s: stamps.
        values: position or velocity, signed so that the motion is positive.
        begin: first row of the ramp.
        seen: row at which the window speed passed its threshold.
        is_position: which of the two `values` is.
    """
    first = _fit_start(time_s, values, begin, seen, is_position=is_position)
    thin = max(1, (seen + 1 - first) // _LONGEST_FIT)
    clock, data = time_s[first : seen + 1 : thin], values[first : seen + 1 : thin]
    low, high = float(clock[0]), float(clock[-1])
    best = low
    for _ in range(2):
        candidates = np.linspace(low, high, _CANDIDATES)
        costs = [_onset_cost(clock, data, start, is_position=is_position) for start in candidates]
        best = float(candidates[int(np.argmin(costs))])
        width = (high - low) / (_CANDIDATES - 1)
        low, high = max(best - width, float(clock[0])), min(best + width, float(clock[-1]))
    return best


def _rows(step_s: float) -> int:
    return max(_LEAST_WINDOW, round(_WINDOW_S / step_s))


def _detrended(values: Samples) -> Samples:
    grid = np.linspace(-1.0, 1.0, values.size)
    return np.asarray(values - np.polynomial.Polynomial.fit(grid, values, 1)(grid))


def _drifts(time_s: Samples, values: Samples, still_speed: float, *, is_position: bool) -> bool:
    if not is_position:
        error = float(np.std(values)) / np.sqrt(values.size)
        return bool(abs(values.mean()) > max(still_speed, _SIGMAS * error))
    half = values.size // 2
    span = float(time_s[half:].mean() - time_s[:half].mean())
    drift = abs(float(values[half:].mean() - values[:half].mean())) / span
    error = 2.0 * float(np.std(_detrended(values))) / np.sqrt(values.size) / span
    return bool(drift > max(still_speed / 3.0, _SIGMAS * error, _STEPS * encoder_step(values) / span))


def _fit_start(time_s: Samples, values: Samples, begin: int, seen: int, *, is_position: bool) -> int:
    """First row of the onset fit: far enough back that the joint still stood in the first half of the rows."""
    rows = _rows(float(np.median(np.diff(time_s))))
    fast = float(window_speed(time_s, values, rows, is_position=is_position)[seen])
    length = 4 * rows
    while seen - length > begin:
        first, half = seen - length, seen - length // 2
        edge = max(length // 8, 1)
        if is_position:
            before, after = slice(first, first + edge), slice(half - edge, half)
            early = (values[after].mean() - values[before].mean()) / (time_s[after].mean() - time_s[before].mean())
        else:
            early = values[first:half].mean()
        if early < _STOOD * fast:
            return first
        length = length * 3 // 2
    return begin


def _onset_cost(clock: Samples, data: Samples, start: float, *, is_position: bool) -> float:
    """Sum of squares that the best onset at `start` leaves."""
    since = np.maximum(clock - start, 0.0)
    scale = max(float(clock[-1]) - start, 1e-9)
    since = since / scale
    center = (clock - clock[0]) / max(float(clock[-1] - clock[0]), 1e-9)
    rest = np.stack([np.ones_like(clock), center], axis=1) if is_position else np.ones((clock.size, 1))
    powers = (2, 3) if is_position else (1, 2)
    growth = np.stack([since**power for power in powers], axis=1)
    best = np.inf
    # Both coefficients are positive, or one of them is zero.
    for columns in ((0, 1), (0,), (1,), ()):
        design = np.concatenate([rest, growth[:, list(columns)]], axis=1)
        solution = np.linalg.lstsq(design, data, rcond=None)[0]
        if np.all(solution[rest.shape[1] :] >= 0.0):
            best = min(best, float(np.sum((data - design @ solution) ** 2)))
            if columns == (0, 1):
                break
    return best
