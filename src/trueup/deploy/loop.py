"""A loop at a fixed rate that knows why it was late."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any

from trueup.core.protocols import Clock
from trueup.deploy.clock import RealTimeClock
from trueup.deploy.latency import Latency
from trueup.errors import ConfigError

_NS = 1e9


@dataclass(eq=False)
class LoopReport:
    """How punctual a loop was. A cycle overran if it was not done when the next was due.

    Attributes:
        rate_hz: cycles per second that were asked for.
        cycles: how many there were.
        skipped: cycles that were left out because the loop was behind by more than a period.
        overran_by_step: overruns whose step itself computed for longer than a period.
        overran_by_waiting: overruns whose step took longer than a period but computed for less: the operating system
            interrupted it, or it waited for something.
        overran_by_wakeup: overruns whose step took less than a period, but began late.
        step: how long steps took.
        wakeup: how much too late they began.
    """

    rate_hz: float
    cycles: int = 0
    skipped: int = 0
    overran_by_step: int = 0
    overran_by_waiting: int = 0
    overran_by_wakeup: int = 0
    step: Latency = field(default_factory=Latency)
    wakeup: Latency = field(default_factory=Latency)

    @property
    def overruns(self) -> int:
        """All cycles that were not done in time."""
        return self.overran_by_step + self.overran_by_waiting + self.overran_by_wakeup

    def to_json(self) -> dict[str, Any]:
        """Everything, JSON types."""
        counts = ("rate_hz", "cycles", "skipped", "overran_by_step", "overran_by_waiting", "overran_by_wakeup")
        return {
            **{name: getattr(self, name) for name in counts},
            "step": self.step.to_json(),
            "wakeup": self.wakeup.to_json(),
        }


def run_loop(
    step: Callable[[float], object],
    *,
    rate_hz: float,
    duration_s: float,
    clock: Clock | None = None,
    computed_s: Callable[[], float] = time.thread_time,
    pause_gc: bool = True,
) -> LoopReport:
    """Call a function at a fixed rate.

    Cycles are scheduled from the start, so that lateness does not add up to a drift. A loop that is behind by whole
    periods leaves these out instead of running them in a burst.

    Args:
        step: is given the time at which it is called [s]; if it returns False itself, the loop ends.
        rate_hz: cycles per second.
        duration_s: how long [s]; infinity for until `step` returns False.
        clock: None for a new `RealTimeClock`.
        computed_s: time that this thread has computed [s], to tell a slow step from one that was interrupted.
        pause_gc: keep Python's garbage collector from running meanwhile; its pauses are the longest delays of a step.
            Objects in reference cycles then stay in memory until the end.

    Raises:
        ConfigError: rate or duration is not positive.
    """
    if not (0 < rate_hz < float("inf") and duration_s > 0):
        raise ConfigError("a loop needs a positive rate and duration", got=f"{rate_hz:g} Hz, {duration_s:g} s")
    clock = clock or RealTimeClock()
    report = LoopReport(rate_hz)
    period_s = 1 / rate_hz
    # Half a period of tolerance: 0.3 s at 10 Hz are three cycles, whatever 0.3 * 10 is.
    end = duration_s * rate_hz - 0.5
    cycle = 0
    with _without_gc() if pause_gc else nullcontext():
        start_s = clock.now_s()
        while cycle < end:
            due_s = start_s + cycle * period_s
            clock.wait_until_s(due_s)
            computed = computed_s()
            began_s = clock.now_s()
            go_on = step(began_s)
            done_s = clock.now_s()
            computed = computed_s() - computed
            report.cycles += 1
            report.step.record(max(0, int((done_s - began_s) * _NS)))
            report.wakeup.record(max(0, int((began_s - due_s) * _NS)))
            cycle += 1
            behind_s = done_s - (start_s + cycle * period_s)
            if behind_s > 0:
                if computed > period_s:
                    report.overran_by_step += 1
                elif done_s - began_s > period_s:
                    report.overran_by_waiting += 1
                else:
                    report.overran_by_wakeup += 1
                while cycle < end and start_s + (cycle + 1) * period_s <= done_s:
                    report.skipped += 1
                    cycle += 1
            if go_on is False:
                break
    return report


@contextmanager
def _without_gc() -> Iterator[None]:
    """Collect once, then not at all until the end."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
