"""Real time for control loops: sleep most of the wait, spin through the last part."""

from __future__ import annotations

import time

from trueup.errors import ConfigError


class RealTimeClock:
    """Real time since it was made; it never goes back, whatever happens to the date of the computer.

    An operating system wakes a sleeper late, by some 50 us when idle. So the last part of a wait is spent awake.

    Args:
        spin_s: that part [s]. Longer: more punctual, and more of a core is used up.
    """

    def __init__(self, *, spin_s: float = 200e-6) -> None:
        if not 0 <= spin_s < 1:
            raise ConfigError("spin_s of a clock", got=spin_s, expected="between 0 and 1 s")
        self._spin_s = spin_s
        self._start = time.perf_counter()

    def now_s(self) -> float:
        """Seconds since the clock was made."""
        return time.perf_counter() - self._start

    def wait_until_s(self, time_s: float) -> None:
        """Return at `time_s`; at once if it has passed."""
        target = self._start + time_s
        asleep = target - time.perf_counter() - self._spin_s
        if asleep > 0:
            time.sleep(asleep)
        while time.perf_counter() < target:
            pass
