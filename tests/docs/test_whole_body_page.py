"""The part of docs/whole-body.md that a result makes says what the result says."""

import json
import math
import re
from pathlib import Path

import pytest
from benchmarks.pages import whole_body
from benchmarks.whole_body_motions import MOTIONS, SECONDS, targets_of

from trueup.robots import load_robot
from trueup.whole_body import UNITS

RESULT = Path(__file__).parent.parent.parent / "benchmarks" / "results" / "whole_body.json"


@pytest.fixture
def result():
    return json.loads(RESULT.read_text())


def test_every_row_of_every_table_has_as_many_cells_as_its_head(result):
    tables = re.findall(r"(?:^\|.*\n?)+", whole_body.part(result), re.M)
    assert len(tables) == 3
    for table in tables:
        head, rule, *rows = table.splitlines()
        assert set(rule) <= set("|-: ")
        assert rows
        assert {row.count("|") for row in rows} == {head.count("|")}, table


def test_every_way_has_every_figure_at_every_payload(result):
    assert list(result["payloads"]) == ["0", "1", "2", "3"]
    for ways in result["payloads"].values():
        assert set(ways) == set(result["references"])
        for own in ways.values():
            assert set(own["figures"]) == set(UNITS)
            assert 0 <= own["falls"] <= len(result["motions"]) * len(result["bodies"])


def test_a_verdict_is_what_its_interval_says(result):
    found = [own["differences"] for ways in result["payloads"].values() for own in ways.values()]
    for item in (item for own in found for item in own.values()):
        low, high = item["difference"]["low"], item["difference"]["high"]
        assert item["verdict"] == ("better" if high < 0 else "worse" if low > 0 else "undecided")


def test_means_lie_in_their_intervals_and_differ_by_the_differences(result):
    for ways in result["payloads"].values():
        for name, own in ways.items():
            for metric, figure in own["figures"].items():
                assert figure["low"] <= figure["value"] <= figure["high"]
                if own["differences"] and not own["falls"]:
                    plain = ways[f"plain PD, {result['references'][name]}"]
                    apart = figure["value"] - plain["figures"][metric]["value"]
                    size = max(abs(figure["value"]), abs(plain["figures"][metric]["value"]))
                    assert (
                        math.isclose(
                            own["differences"][metric]["difference"]["value"], apart, abs_tol=1e-4 * size + 1e-12
                        )
                        or plain["falls"]
                    )


@pytest.mark.parametrize("name", MOTIONS)
def test_motions_lead_from_near_home_to_home_within_the_limits(name):
    targets, joints = targets_of(name), load_robot("upper_body").joints
    assert len(targets) == round(SECONDS / 0.02)
    home = [0, 0.15, 0, -0.6, 0, 0, -0.15, 0, -0.6, 0]
    assert targets[0] == pytest.approx(home, abs=0.1)  # smoothing has it on its way
    assert targets[-1] == pytest.approx(home, abs=1e-9)
    for column, joint in zip(targets.T, joints, strict=True):
        low, high = joint.position_limits
        assert low <= column.min() <= column.max() <= high
        assert abs(column[1:] - column[:-1]).max() / 0.02 < 5.0
