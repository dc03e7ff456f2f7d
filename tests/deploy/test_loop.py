import gc
import time

import pytest

from trueup.core.protocols import Clock
from trueup.deploy import RealTimeClock, run_loop
from trueup.errors import ConfigError


class Simulated:
    """A clock that only goes on when somebody waits or computes, and that can wake up late."""

    def __init__(self):
        self.now, self.computed, self.late = 5.0, 0.0, {}
        self.waits = 0

    def now_s(self):
        return self.now

    def wait_until_s(self, time_s):
        self.now = max(self.now, time_s) + self.late.get(self.waits, 0.0)
        self.waits += 1

    def busy(self, seconds, *, computing=True):
        self.now += seconds
        self.computed += seconds if computing else 0.0


def looped(clock, step, **options):
    return run_loop(step, rate_hz=100.0, clock=clock, computed_s=lambda: clock.computed, **options)


def test_an_undisturbed_loop_is_on_time():
    clock, times = Simulated(), []
    report = looped(clock, lambda time_s: (times.append(time_s), clock.busy(0.004)), duration_s=0.3)
    assert times == pytest.approx([5.0 + 0.01 * cycle for cycle in range(30)])
    assert (report.cycles, report.overruns, report.skipped) == (30, 0, 0)
    assert report.step.max_us == pytest.approx(4000, rel=1e-3)
    assert report.wakeup.max_us < 1


def test_who_is_to_blame_for_an_overrun():
    """Cycle 3: woken 8 ms late, 4 ms of work. Cycle 6: computes for 12 ms. Cycle 10: waits for 12 ms."""
    clock, cycle = Simulated(), iter(range(100))
    clock.late = {3: 0.008}

    def step(time_s):
        number = next(cycle)
        if number == 10:
            clock.busy(0.012, computing=False)
        else:
            clock.busy({6: 0.012}.get(number, 0.004))

    report = looped(clock, step, duration_s=0.2)
    assert (report.overran_by_wakeup, report.overran_by_step, report.overran_by_waiting) == (1, 1, 1)
    assert report.overruns == 3
    assert (report.cycles, report.skipped) == (20, 0)
    shown = report.to_json()
    assert (shown["cycles"], shown["overran_by_step"], shown["step"]["count"]) == (20, 1, 20)


def test_whole_periods_that_were_lost_are_left_out_and_the_schedule_stays():
    clock, times, cycle = Simulated(), [], iter(range(100))

    def step(time_s):
        times.append(round(time_s - 5.0, 6))
        clock.busy(0.035 if next(cycle) == 1 else 0.001)

    report = looped(clock, step, duration_s=0.1)
    assert times == [0.0, 0.01, 0.045, 0.05, 0.06, 0.07, 0.08, 0.09]
    assert (report.cycles, report.skipped) == (8, 2)


def test_false_ends_a_loop_and_nothing_else_does():
    clock, answers = Simulated(), iter([None, 0, True, False, None])
    report = looped(clock, lambda _: next(answers), duration_s=float("inf"))
    assert report.cycles == 4


@pytest.mark.long
@pytest.mark.parametrize("pause", [True, False])
def test_the_garbage_collector_rests_in_the_loop_and_runs_after_it(pause):
    seen = []
    looped(Simulated(), lambda _: seen.append(gc.isenabled()), duration_s=0.02, pause_gc=pause)
    assert seen == [not pause] * 2
    assert gc.isenabled()

    def broken(time_s):
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        looped(Simulated(), broken, duration_s=0.02, pause_gc=pause)
    assert gc.isenabled()


@pytest.mark.parametrize(("rate_hz", "duration_s"), [(0.0, 1.0), (float("nan"), 1.0), (100.0, 0.0)])
def test_senseless_loops_are_refused(rate_hz, duration_s):
    with pytest.raises(ConfigError):
        run_loop(print, rate_hz=rate_hz, duration_s=duration_s)


def test_the_real_clock_never_returns_early():
    clock = RealTimeClock(spin_s=1e-3)
    assert isinstance(clock, Clock)
    for _ in range(20):
        target = clock.now_s() + 0.002
        clock.wait_until_s(target)
        assert clock.now_s() >= target
    before = time.perf_counter()
    clock.wait_until_s(0.0)
    assert time.perf_counter() - before < 0.5
    with pytest.raises(ConfigError):
        RealTimeClock(spin_s=-1.0)


def test_a_real_loop():
    report = run_loop(lambda _: None, rate_hz=200.0, duration_s=0.1)
    assert report.cycles + report.skipped == 20
    assert report.overran_by_step == 0
