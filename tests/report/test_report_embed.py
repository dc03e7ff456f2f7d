"""Curves in the page stay within their budget and come back from base64."""

import base64

import numpy as np

from trueup.core.traces import EpisodeTraces, Trace
from trueup.report.embed import MIN_POINTS, fit_to_budget, to_base64


def episode(name, rows, joints=6, runs=1, seed=0):
    rng = np.random.default_rng(seed)
    time_s = np.linspace(0, 30, rows, dtype=np.float32)
    labels = ["measured", "command", *(f"run{number}" for number in range(runs))]
    traces = [
        Trace(
            signal,
            f"joint{joint}",
            "rad",
            rows,
            time_s,
            {key: rng.normal(size=rows).astype(np.float32) for key in labels},
        )
        for signal in ("position", "velocity", "torque", "current")
        for joint in range(joints)
    ]
    return EpisodeTraces(name, "test", 0.0, tuple(traces))


def size(embedded):
    return sum(item.pack()[0].nbytes for item in embedded.episodes)


def test_43_motions_of_six_joints_fit_and_stay_readable():
    episodes = [episode(str(number), 1000, seed=number) for number in range(43)]
    embedded = fit_to_budget(episodes)
    assert embedded.left_out == 0
    assert embedded.thinned
    assert embedded.max_points >= 350
    assert 0.8 * 6_500_000 < size(embedded) <= 6_500_000


def test_small_runs_are_not_thinned():
    embedded = fit_to_budget([episode("one", 500)])
    assert not embedded.thinned
    assert embedded.left_out == 0


def test_too_many_motions_drop_the_last():
    episodes = [episode(str(number), 600, joints=1) for number in range(12)]
    embedded = fit_to_budget(episodes, budget_bytes=100_000)
    assert embedded.max_points == MIN_POINTS
    assert 0 < len(embedded.episodes) < 12
    assert [item.id for item in embedded.episodes] == [str(number) for number in range(len(embedded.episodes))]
    assert embedded.left_out == 12 - len(embedded.episodes)
    assert size(embedded) <= 100_000


def test_base64_is_little_endian_float32():
    values = np.array([1.5, np.nan, -2.25], np.float32)
    np.testing.assert_array_equal(np.frombuffer(base64.b64decode(to_base64(values)), "<f4"), values)
