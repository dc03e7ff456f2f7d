"""When long work has to end."""

from __future__ import annotations

import time
from dataclasses import dataclass


class OutOfTime(Exception):
    """Work was broken off in the middle, for its time is over; what was finished before stands."""


@dataclass(frozen=True)
class TimeLimit:
    """An end that work looks at between its steps: it ends with what it has then, a step late at most.

    It is no part of what work is asked to do: an interrupted work is gone on with under another limit. Work that it has
    ended is finished, and says that it was cut short; with more time, other results may come of it.

    Attributes:
        began_at: on the clock of `time.monotonic` [s].
        ends_at: likewise.
    """

    began_at: float
    ends_at: float

    @staticmethod
    def after(seconds: float) -> TimeLimit:
        """So long from now."""
        now = time.monotonic()
        return TimeLimit(now, now + seconds)

    @property
    def left_s(self) -> float:
        """Seconds that are left; 0 afterwards."""
        return max(0.0, self.ends_at - time.monotonic())

    @property
    def spent(self) -> float:
        """Share that has passed, 0 to 1."""
        whole_s = self.ends_at - self.began_at
        return 1.0 if whole_s <= 0 else min(1.0, 1.0 - self.left_s / whole_s)

    @property
    def over(self) -> bool:
        """Whether it has passed."""
        return self.left_s <= 0

    def share(self, fraction: float) -> TimeLimit:
        """The end of so much of what is left."""
        return TimeLimit.after(fraction * self.left_s)

    def sooner(self, seconds: float) -> TimeLimit:
        """The end so much earlier, for what has to be done after it."""
        return TimeLimit(self.began_at, self.ends_at - max(0.0, seconds))

    def until(self, spent: float) -> TimeLimit:
        """The time at which this share of the whole will have passed."""
        return TimeLimit(self.began_at, self.began_at + spent * (self.ends_at - self.began_at))
