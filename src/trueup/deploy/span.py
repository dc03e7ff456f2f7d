"""Where inputs may be: what training covered, and a margin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int

from trueup.core.model_card import Input, counterparts

# A channel that never moved in training may still carry the rounding of another simulator, in any SI unit.
_ROUNDING = 1e-6
# Beyond this, float32 knows only infinity.
_LARGEST = float(np.finfo(np.float32).max)


class Span:
    """The range of each input channel, widened by a margin; and whether a sample is inside, cheaply.

    Args:
        inputs: I channels with what training covered.
        margin: share of its range by which a channel may leave it.

    Attributes:
        low: smallest values, (I,); of channels that are relative, of how far they are from their counterparts.
        high: largest values, (I,).
    """

    def __init__(self, inputs: Sequence[Input], margin: float) -> None:
        ranges = np.array([(channel.low, channel.high) for channel in inputs])
        ends = np.clip(ranges, -_LARGEST, _LARGEST)
        width = np.where(np.isfinite(ranges).all(axis=1), np.ptp(ends, axis=1), 0.0)  # no share of an endless range
        slack = margin * width[:, None] + _ROUNDING * np.maximum(1.0, np.abs(ends))
        self.low: Float64[np.ndarray, "I"] = np.maximum(ends[:, 0] - slack[:, 0], -_LARGEST)
        self.high: Float64[np.ndarray, "I"] = np.minimum(ends[:, 1] + slack[:, 1], _LARGEST)
        self._inside = np.ones((2, len(inputs)), bool)
        self._above, self._below = self._inside
        self._all = self._inside.tobytes()
        relative = np.array([row for row, channel in enumerate(inputs) if channel.relative], int)
        self._any_relative = bool(relative.size)
        self._relative = index_of(relative) if relative.size else relative
        self._other = index_of(counterparts(inputs)[relative]) if relative.size else relative
        # What is relative may be anywhere itself, as long as it is a number.
        self._least, self._most = self.low.copy(), self.high.copy()
        self._least[relative], self._most[relative] = -_LARGEST, _LARGEST
        self._nearest, self._farthest = self.low[relative], self.high[relative]
        self._distance = np.zeros(relative.size)
        self._close = np.ones((2, relative.size), bool)
        self._not_under, self._not_over = self._close
        self._all_close = self._close.tobytes()

    def covers(self, x: Float64[np.ndarray, "I"]) -> bool:
        """Whether all channels are finite and inside; few comparisons and no array made.

        Comparing bytes takes a fifth of the time of `all()`; and a NaN is neither above nor below anything.
        """
        np.greater_equal(x, self._least, self._above)
        np.less_equal(x, self._most, self._below)
        if self._inside.tobytes() != self._all:
            return False
        if not self._any_relative:
            return True
        np.subtract(x[self._relative], x[self._other], self._distance)
        np.greater_equal(self._distance, self._nearest, self._not_under)
        np.less_equal(self._distance, self._farthest, self._not_over)
        return self._close.tobytes() == self._all_close

    def outside(self, x: Float64[np.ndarray, "I"]) -> Int[np.ndarray, "N"]:
        """Numbers of the channels that are not finite, or out of range."""
        x = self._as_read(x)
        return np.flatnonzero(~((x >= self.low) & (x <= self.high)))

    def clipped(self, x: Float64[np.ndarray, "I"]) -> Float64[np.ndarray, "I"]:
        """The nearest sample inside."""
        nearest: Float64[np.ndarray, "I"] = np.clip(self._as_read(x), self.low, self.high)
        nearest[self._relative] += nearest[self._other]
        return nearest

    def _as_read(self, x: Float64[np.ndarray, "I"]) -> Float64[np.ndarray, "I"]:
        """With distances in place of channels that are relative."""
        read = np.array(x)
        with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is not inside
            read[self._relative] -= read[self._other]
        return read


def index_of(rows: Int[np.ndarray, "N"]) -> slice | Int[np.ndarray, "N"]:
    """Row numbers as a slice, which makes no copy, if they can be one."""
    steps = {int(step) for step in np.diff(rows)} or {1}
    if len(steps) == 1 and min(steps) > 0:
        return slice(int(rows[0]), int(rows[-1]) + 1, steps.pop())
    return rows
