"""The clock of the wall, for experiments on a real robot."""

from __future__ import annotations

import time


class WallClock:
    """Real time since it was made; it never goes back, whatever happens to the date of the computer."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def now_s(self) -> float:
        """Seconds since the clock was made."""
        return time.monotonic() - self._start

    def wait_until_s(self, time_s: float) -> None:
        """Sleep until `time_s`; return at once if it has passed."""
        left = time_s - self.now_s()
        if left > 0:
            time.sleep(left)
