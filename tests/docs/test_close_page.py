"""The section of docs/close.md that a benchmark makes, from a result of one's choice."""

import json
from pathlib import Path

from benchmarks import close
from benchmarks.pages.close import part
from benchmarks.pages.markdown import with_section

from trueup.core.close_result import CloseResult, Step
from trueup.core.results import Estimate, Ladder, MetricResult, Rung

PAGE = Path(__file__).parent.parent.parent / "docs" / "close.md"


def left(folder, best):
    """What a call leaves: the rungs with their errors on test [rad], one of them chosen."""
    errors = {"command": 0.05, "stock": 0.04, "fitted": 0.0101, "fitted+realeasy": 0.0112}
    rungs = []
    for number, (name, error) in enumerate(errors.items()):
        metrics = {"position": {"rmse": MetricResult(Estimate(error, "rad", 0.5 * error, 2.0 * error), {}, 6)}}
        rungs.append(Rung(name, 100.0 * number, dict.fromkeys(close.SPLITS, metrics), chosen=name == best))
    Ladder(rungs).save(folder / "ladder.json")
    steps = (Step("gap", "done", 7.0, "36 | 40"), Step("identify", "cut short", 400.0, "21 of 30"))
    CloseResult(steps, "augment", 900.0, measuring_s=12.0).save(folder / "close.json")
    return close.left_in(folder)


def result(folder, best="fitted"):
    config = {"machine": {"name": "a computer"}}
    so101 = {"seconds": 1080.0, "code": 3, **left(folder, best), "fit": "at-bound"}
    demo = {"seconds": 300.0, "code": 0, **left(folder, "command"), "fit": "not-converged"}
    return {"so101": so101, "demo": demo, "provenance": {"config": config}}


def test_the_best_on_val_is_held_against_the_bar_and_so_is_the_time(tmp_path):
    rows = {row.name: row for row in close.rows(result(tmp_path))}
    assert rows["SO-101, test: position RMSE of fitted"].ok
    assert (rows["SO-101: the whole command"].value, rows["SO-101: the whole command"].limit) == (1080.0, 1200.0)
    assert rows["demo: the whole command"].limit == 360.0
    assert rows["SO-101: identify"].value == 400.0
    missed = {row.name: row.ok for row in close.rows(result(tmp_path, best="fitted+realeasy"))}
    assert not missed["SO-101, test: position RMSE of fitted+realeasy"]


def test_the_section_shows_the_ladder_and_the_steps(tmp_path):
    made = with_section(PAGE.read_text(), part(result(tmp_path)))
    assert "| **fitted** | 10.1 [5.0, 20.2] | 10.1 [5.0, 20.2] | 10.1 [5.0, 20.2] | 200 |" in made
    assert "| identify | cut short | 21 of 30 | 400 |" in made
    assert "36 \\| 40" in made
    assert "18.0 min" in made
    assert "**fitted** is the best on val" in made
    assert "Status of the fit: `at-bound`." in made
    said = " ".join(made.split())
    assert "`trueup demo --full` took 5.0 min. Test errors: command 50.0, stock 40.0, fitted 10.1 mrad." in said
    assert "Best on val: `command`. Status of the fit: `not-converged`." in said
    assert with_section(made, part(result(tmp_path))) == made


def test_the_first_page_says_what_the_demo_ends_with():
    stored = json.loads((PAGE.parents[1] / "benchmarks" / "results" / "first_look.json").read_text())
    assert "\n".join(stored["said"]) in (PAGE.parent / "index.md").read_text()


def test_without_the_recording_there_is_nothing_to_measure(monkeypatch):
    monkeypatch.setattr(close, "recording", lambda _: None)
    assert close.run() == []
