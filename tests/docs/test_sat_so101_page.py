"""The part of docs/building-blocks.md about the real arm says what its result says, whatever that is."""

import copy
import json
import re
from pathlib import Path

import numpy as np
import pytest
from benchmarks.pages import sat_so101

from trueup.measure import paired_difference

RESULT = Path(__file__).parent.parent.parent / "benchmarks" / "results" / "sat_so101.json"


@pytest.fixture
def result():
    return json.loads(RESULT.read_text())


def test_every_row_of_every_table_has_as_many_cells_as_its_head(result):
    tables = re.findall(r"(?:^\|.*\n)+", sat_so101.part(result), re.M)
    assert len(tables) == 1
    for table in tables:
        head, rule, *rows = table.splitlines()
        assert set(rule) <= set("|-: ")
        assert rows
        assert {row.count("|") for row in rows} == {head.count("|")}, table


def test_the_differences_are_those_of_the_errors(result):
    for key, found in result["differences"].items():
        name, base = key.split(" - ")
        for metric, groups in found.items():
            for group, stored in groups.items():
                own, other = (np.mean(result["errors"][run][metric][group], axis=0) for run in (name, base))
                made = paired_difference(
                    own, other, run=name, baseline=base, split="test", signal="position", metric=metric, unit="rad"
                )
                assert stored["difference"]["value"] == pytest.approx(made.difference.value, abs=1e-6)
                assert stored["difference"]["high"] == pytest.approx(made.difference.high, abs=1e-6)
                low, high = stored["difference"]["low"], stored["difference"]["high"]
                assert stored["verdict"] == ("better" if high < 0 else "worse" if low > 0 else "undecided")


def test_groups_of_joints_are_their_means(result):
    for own in result["errors"].values():
        for groups in own.values():
            for group, joints in {
                "seen": result["seen"],
                "unseen": result["unseen"],
                "all": [*result["seen"], *result["unseen"]],
            }.items():
                mean = np.mean([groups[joint] for joint in joints], axis=0)
                np.testing.assert_allclose(groups[group], mean, rtol=1e-3)


def test_the_wrist_was_never_seen_and_improves_with_a_sensor(result):
    assert result["unseen"] == ["wrist_flex", "wrist_roll"]
    assert not set(result["seen"]) & set(result["unseen"])
    models = result["provenance"]["config"]["models"]
    for name in ("sat", "sat-sensed"):
        assert models[name]["data"]["joints"] == result["seen"]
        assert models[name]["data"]["modular"]
    for metric in ("mae", "rmse"):
        assert result["differences"]["sat-sensed - simulator"][metric]["unseen"]["difference"]["high"] < 0


def test_the_ladder_has_the_network_beside_realeasy(result):
    assert {"command", "fitted", "fitted+sat", "fitted+realeasy-rt", "fitted+realeasy"} <= set(result["rungs"])
    assert "`fitted+sat`" in sat_so101.part(result)


@pytest.mark.parametrize(
    ("verdict", "said"),
    [("better", "improves over the identified"), ("worse", "gets worse than"), ("undecided", "nothing is claimed")],
)
def test_only_what_is_sure_is_claimed(result, verdict, said):
    other = copy.deepcopy(result)
    other["differences"]["sat - simulator"]["mae"]["unseen"]["verdict"] = verdict
    assert f"Without a sensor, {'' if verdict == 'undecided' else 'the wrist '}{said}" in sat_so101.verdict(other)


def test_what_the_choice_found_is_said(result):
    other = copy.deepcopy(result)
    for own in other["choice"].values():
        own["verdict"] = "undecided"
    assert "do not help a joint that was left out" in sat_so101.choice_words(other)
    name = next(iter(other["choice"]))
    other["choice"][name]["verdict"] = "better"
    assert f"helps a joint that was left out: *{name}*." in sat_so101.choice_words(other)
