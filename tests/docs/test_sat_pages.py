"""What the page of building blocks says of the stored results of servos, bodies and how far they carry."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest
from benchmarks.pages import sat, sat_bodies, sat_robustness, sat_training

RESULTS = Path(__file__).parent.parent.parent / "benchmarks" / "results"


def stored(name):
    return json.loads((RESULTS / f"{name}.json").read_text())


def test_bars_of_servos_are_held_against_the_stored_figures():
    result = stored("sat")
    for test in ("kickbot_b", "dancebot"):
        for metric, bar in (("mae", 0.5), ("max", 0.35)):
            own = [result["errors"][test][name]["position"][metric] for name in ("simulator", "sat")]
            cut = result["cuts"][test]["sat"]["position"][metric]
            assert cut["value"] == pytest.approx(1 - np.mean(own[1]) / np.mean(own[0]), abs=1e-3)
            assert cut["low"] <= cut["value"] <= cut["high"]
            worse = copy.deepcopy(result)
            worse["cuts"][test]["sat"]["position"][metric]["value"] = bar - 0.01
            assert f"missed: {metric} on {test}" in sat.part(worse)
    missed = any(
        result["cuts"][test]["sat"]["position"][metric]["value"] < bar
        for test in ("kickbot_b", "dancebot")
        for metric, bar in (("mae", 0.5), ("max", 0.35))
    )
    assert ("both are kept" in sat.part(result)) != missed


def test_attention_is_shared_out():
    for shares in stored("sat")["attention"].values():
        assert sum(shares) == pytest.approx(1.0, abs=1e-3)


def test_a_network_of_a_whole_robot_does_not_serve_another():
    result = stored("sat")
    assert "whole" not in result["errors"]["dancebot"]
    assert "has other joints" in sat.part(result)


def test_what_is_missed_when_simulators_are_off_is_named():
    result = stored("sat_robustness")
    for share, bar in (("0.5", 0.50), ("1.0", 0.25)):
        changed = copy.deepcopy(result)
        changed["bodies"]["mass"][share]["mae"]["value"] = bar - 0.01
        assert "bodies, mass at" in sat_robustness.part(changed)
    shares = [
        item["mae"]["value"] for kind in ("servos", "bodies") for own in result[kind].values() for item in own.values()
    ]
    assert ("Both are kept everywhere" in sat_robustness.part(result)) <= (min(shares) >= 0.25)


def test_bodies_say_what_val_chose():
    result = stored("sat_bodies")
    assert f"`{result['chosen_on_val']}` is the one that val chose" in sat_bodies.part(result)


def test_a_seed_that_misses_is_named():
    result = stored("sat_training")
    for test in ("kickbot_b", "dancebot"):
        for metric, words, bar in (("mae", "mean", 0.5), ("max", "largest", 0.35)):
            changed = copy.deepcopy(result)
            changed["seeds"]["2"][test][metric]["value"] = bar - 0.01
            assert f"seed 2 by the {words} error on {sat_training.SHORT[test]}" in sat_training.part(changed)
            for own in changed["seeds"].values():
                own[test][metric]["value"] = bar + 0.01
            assert f"by the {words} error on {sat_training.SHORT[test]}" not in sat_training.part(changed)


def test_what_is_left_in_long_runs_is_that_of_the_table():
    result = stored("sat_training")
    said = sat_training.part(result)
    for name, own in result["long"].items():
        assert len(own["value"]) == result["long_s"] / result["piece_s"]
        if name != "simulator":
            left = own["value"][-1] / result["long"]["simulator"]["value"][-1]
            assert f"{left:.0%}".replace("%", " %") in said
