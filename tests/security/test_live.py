"""A bridge that is left alone: whatever the clock does it says numbers, and it takes no more memory than at first."""

import gc
import re
from pathlib import Path

import numpy as np
import pytest
from benchmarks.networks import inputs_of, outputs_of, real_time

from deploy.compensation_cases import compensation
from ros2.ros2_cases import JOINTS, state
from trueup.deploy import Compensator, Limits, Stream
from trueup.ros2 import Augmented, Compensated

RATE_HZ = 100.0
LIMITS = Limits((-3.0, -3.0), (3.0, 3.0))
# A number that is kept of each message takes 24 bytes and its place in a list 8.
MESSAGES, MOST_BYTES = 200_000, 2_000_000


def augmented(folder):
    channels = {"inputs": inputs_of(JOINTS), "outputs": outputs_of(JOINTS)}
    real_time(folder, hidden=(8, 5), rate_hz=RATE_HZ, joints=JOINTS, **channels)
    return Augmented(Stream.load(folder, rate_hz=RATE_HZ, joints=JOINTS))


def compensated(folder):
    compensation(folder, JOINTS, rate_hz=RATE_HZ)
    return Compensated(Compensator.load(folder, joints=JOINTS, limits=LIMITS, payload_kg=1.0))


def asked(bridge, message):
    """What is said to a message; a compensation hears where the robot is first."""
    if isinstance(bridge, Compensated):
        bridge.states.hear(message)
    return bridge.to(message)


def jumped(message, jump_s):
    message.header.stamp = type(message.header.stamp).of_ns(message.header.stamp.ns + round(jump_s * 1e9))
    return message


@pytest.mark.parametrize("make", [augmented, compensated])
@pytest.mark.parametrize("jump_s", [-3600.0, -0.5, -0.02, 0.05, 0.5, 3600.0, "still"])
def test_whatever_the_clock_does_there_is_an_answer_of_numbers(make, jump_s, tmp_path):
    bridge = make(tmp_path)
    said = [asked(bridge, state(number / RATE_HZ)) for number in range(60)]
    before = bridge.counts["ok"]
    assert before > 20
    for number in range(60):
        message = state(0.6 + number / RATE_HZ)
        stands = -number / RATE_HZ if number < 30 else 0.0  # and goes on after a while
        message = jumped(message, stands if jump_s == "still" else jump_s)
        answer = asked(bridge, message)
        assert np.isfinite(answer.position).all()
        assert np.abs(answer.position).max() <= 3.0
        assert answer.header.stamp.ns == message.header.stamp.ns
        said.append(answer)
    assert bridge.counts["ok"] - before >= 20, bridge.counts  # the network is heard again after a while
    assert bridge.counts.total() == 120


def rss_bytes():
    gc.collect()
    return 1024 * int(re.search(r"VmRSS:\s+(\d+) kB", Path("/proc/self/status").read_text())[1])


@pytest.mark.slow
@pytest.mark.parametrize("make", [augmented, compensated])
def test_a_long_run_takes_no_more_memory_than_a_short_one(make, tmp_path):
    """Half an hour of this rate; an hour at 1 kHz through DDS is `python -m benchmarks ros2_hour`."""
    bridge = make(tmp_path)
    messages = [state(number / RATE_HZ) for number in range(500)]
    for number in range(MESSAGES):
        message = messages[number % len(messages)]
        message.header.stamp = type(message.header.stamp).of_ns(1_000_000_000 + round(number * 1e9 / RATE_HZ))
        asked(bridge, message)
        if number == MESSAGES // 10:
            before = rss_bytes()
    assert rss_bytes() - before < MOST_BYTES
    assert bridge.counts["ok"] > 0.9 * MESSAGES
