"""Seconds, processor seconds, and joules by a stated factor."""

import time

from trueup.core.effort import WATTS_PER_CORE, Effort, Meter


def test_waiting_takes_seconds_and_work_takes_the_processor():
    meter = Meter()
    time.sleep(0.05)
    waited = meter.read()
    began = time.process_time()
    while time.process_time() - began < 0.05:
        pass
    worked = meter.read()
    assert waited.seconds >= 0.05
    assert waited.cpu_seconds < 0.05
    assert worked.cpu_seconds >= waited.cpu_seconds + 0.05
    assert worked.joules == worked.cpu_seconds * WATTS_PER_CORE


def test_one_after_the_other():
    assert Effort(1.0, 2.0) + Effort(0.5, 0.25) == Effort(1.5, 2.25)
