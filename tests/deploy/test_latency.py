import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trueup.deploy import Latency

DURATIONS = st.lists(st.integers(0, 2**39), min_size=1, max_size=200)


def recorded(durations):
    latency = Latency()
    for duration in durations:
        latency.record(duration)
    return latency


@given(DURATIONS, st.sampled_from([1.0, 50.0, 99.0, 99.9, 100.0]))
def test_percentiles_are_those_of_the_samples_to_three_percent(durations, percent):
    found = recorded(durations).percentile_us(percent) * 1e3
    exact = float(np.percentile(durations, percent, method="inverted_cdf"))
    assert exact <= found * (1 + 1e-12)
    assert found <= max(exact * (1 + 1 / 32) + 1, exact + 1)


@given(DURATIONS)
def test_the_bins_hold_every_duration_once(durations):
    latency = recorded(durations)
    shown = latency.to_json()
    assert json.loads(json.dumps(shown)) == shown
    assert shown["count"] == len(latency) == len(durations) == sum(count for *_, count in shown["bins"])
    assert shown["max_us"] == max(durations) * 1e-3
    for low, high, count in shown["bins"]:
        inside = sum(round(low * 1e3) <= duration < round(high * 1e3) for duration in durations)
        assert inside == count


def test_a_histogram_by_hand():
    latency = recorded([15_000] * 98 + [40_000, 5_000_000])
    assert 15.0 <= latency.percentile_us(50.0) <= 15.5
    assert 40.0 <= latency.percentile_us(99.0) <= 41.3
    assert latency.percentile_us(99.9) == latency.max_us == 5000.0


def test_empty_cleared_and_endless():
    latency = Latency()
    assert (len(latency), latency.max_us, latency.percentile_us(99.0)) == (0, 0.0, 0.0)
    latency.record(2**60)
    assert len(latency) == 1
    assert latency.percentile_us(50.0) <= latency.max_us == 2**60 * 1e-3
    latency.clear()
    assert latency.to_json() == Latency().to_json()


def test_histograms_add_up():
    both, one, other = Latency(), Latency(), Latency()
    for number, part in ((900, one), (1_000_000, other), (5, other)):
        part.record(number)
        both.record(number)
    one.add(other)
    assert one.to_json() == both.to_json()
