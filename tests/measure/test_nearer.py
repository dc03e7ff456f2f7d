"""Which engine is nearer, where it is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueup.core.results import Estimate, GapResult, MetricResult
from trueup.measure.nearer import engine_pairs, nearer_of
from trueup.measure.uncertainty import bootstrap_interval

LOADS = (0.0, 1.0, 2.0)


def result_of(values):
    """Run -> episode -> position RMSE of the one joint."""
    metric = {"position": {"rmse": MetricResult(Estimate(1.0, "rad"), {"a": Estimate(1.0, "rad")}, 1)}}
    return GapResult(
        runs={label: {"all": metric} for label in values},
        joints=("a",),
        scored_joints=("a",),
        episodes={
            label: {name: {"position": {"rmse": {"a": value}}} for name, value in own.items()}
            for label, own in values.items()
        },
    )


def world(rng, advantage, motions=10):
    """DART is nearer by `advantage` for each payload; how hard a motion is for both differs far more."""
    hard = rng.uniform(0.1, 2.0, motions)
    names = {f"m{k}/{load:g}kg": (k, load) for k in range(motions) for load in LOADS}
    mujoco = {name: hard[k] + 0.001 * rng.normal() for name, (k, _) in names.items()}
    dart = {name: mujoco[name] - advantage[LOADS.index(load)] for name, (_, load) in names.items()}
    noisy = {name: value + 0.002 * rng.normal() for name, value in dart.items()}
    loads = {name: load for name, (_, load) in names.items()}
    executed = {name: f"m{k}" for name, (k, _) in names.items()}
    return result_of({"mujoco/stock": mujoco, "dart/stock": noisy, "command": mujoco}), loads, executed


def test_the_nearer_engine_is_found_payload_by_payload():
    gap, loads, executed = world(np.random.default_rng(4), (0.02, 0.0, -0.02))
    found = nearer_of(gap, loads, motions=executed)
    assert list(found) == ["", "0", "1", "2"]
    verdicts = {payload: items[0].verdict for payload, items in found.items()}
    assert verdicts == {"": "undecided", "0": "better", "1": "undecided", "2": "worse"}
    first = found["0"][0]
    assert (first.run, first.baseline) == ("dart/stock", "mujoco/stock")
    assert first.difference.low < -0.02 < first.difference.high


def test_repetitions_count_as_one_motion():
    gap, loads, executed = world(np.random.default_rng(1), (0.02, 0.02, 0.02))
    values = gap.episodes
    by_motion = [
        np.mean(
            [
                values["dart/stock"][name]["position"]["rmse"]["a"]
                - values["mujoco/stock"][name]["position"]["rmse"]["a"]
                for name in loads
                if executed[name] == motion
            ]
        )
        for motion in sorted(set(executed.values()))
    ]
    found = nearer_of(gap, loads, motions=executed)[""][0].difference
    low, high = bootstrap_interval(np.array(by_motion)[:, None])
    assert found.value == pytest.approx(np.mean(by_motion))
    assert (found.low, found.high) == pytest.approx((low[0], high[0]))


@settings(max_examples=20)
@given(st.floats(-0.5, 0.5))
def test_swapping_the_engines_swaps_the_verdict(advantage):
    gap, loads, executed = world(np.random.default_rng(2), (advantage,) * 3)
    episodes = gap.episodes
    other = result_of(
        {
            label: {name: episodes[source][name]["position"]["rmse"]["a"] for name in loads}
            for label, source in (("mujoco/stock", "dart/stock"), ("dart/stock", "mujoco/stock"))
        }
    )
    there, back = (nearer_of(item, loads, motions=executed)[""][0] for item in (gap, other))
    assert there.difference.value == pytest.approx(-back.difference.value)
    assert {"better": "worse", "worse": "better", "undecided": "undecided"}[there.verdict] == back.verdict


def test_runs_of_the_same_name_are_compared_and_one_engine_with_nobody():
    labels = ["dart/stock", "mujoco/stock", "mujoco/fitted"]
    assert engine_pairs(labels) == [("dart/stock", "mujoco/stock")]
    assert engine_pairs(["dart/rough", "mujoco/fitted"]) == [("dart/rough", "mujoco/fitted")]
    assert engine_pairs(["mujoco/stock", "mujoco/fitted"]) == []
    gap, loads, executed = world(np.random.default_rng(3), (0.0, 0.0, 0.0))
    alone = result_of({"mujoco/stock": dict.fromkeys(loads, 1.0)})
    assert nearer_of(alone, loads, motions=executed) == {}
    assert list(nearer_of(gap, dict.fromkeys(loads), motions=executed)) == [""]
