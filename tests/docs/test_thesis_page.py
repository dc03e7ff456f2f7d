"""docs/thesis.md is what the script makes of the result file, and the result file keeps the bar."""

import importlib.util
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
spec = importlib.util.spec_from_file_location("thesis_page", ROOT / "scripts" / "thesis_page.py")
thesis_page = importlib.util.module_from_spec(spec)
spec.loader.exec_module(thesis_page)
RESULT = json.loads(thesis_page.RESULT.read_text())


def test_the_page_is_made_from_the_result():
    assert thesis_page.PAGE.read_text() == thesis_page.page(RESULT)


def test_the_stored_result_keeps_the_bar_of_the_default_solver():
    assert len(RESULT["robots"]) == 3
    for robot in RESULT["robots"]:
        joints = robot["searches"]["auto"]["joints"]
        assert list(joints) == [f"joint{number}" for number in range(1, 8)]
        for own in joints.values():
            assert own["cut_percent"] == pytest.approx(100 * (1 - own["final_rad"] / own["initial_rad"]))
            assert own["cut_percent"] >= 98.0
            assert own["held_out_cut_percent"] >= 98.0


def test_a_missed_bar_would_be_said():
    worse = json.loads(json.dumps(RESULT))
    worse["robots"][1]["searches"]["auto"]["joints"]["joint4"]["cut_percent"] = 97.123
    assert "is missed: the worst is 97.12 %" in thesis_page.page(worse)
    assert "is met" in thesis_page.page(RESULT)


def test_three_solvers_and_the_thesis_stand_in_one_table():
    rows = thesis_page.solver_table(RESULT["robots"][0]["searches"]).splitlines()
    for solver in ("`auto`", "`evolution`", "`cma-es`", "the thesis"):
        assert any(row.startswith(f"| {solver}") for row in rows)
    # ES thesis, Table 3.6: 188.8488 to 3.0121 on joint 1, 288.9131 to 54.1302 on joint 7.
    assert rows[-1].split(" | ")[1:8] == ["98.4", "94.6", "96.7", "97.2", "95.8", "90.0", "81.3"]
