"""What the page on the verdict's worth says of made-up cells: complete or not, kept or missed."""

import re
from xml.etree import ElementTree as ET

import pytest
from benchmarks import foreign_verdicts as verdicts
from benchmarks.foreign import BY_NAME, ORACLE_SEED, SEEDS
from benchmarks.pages import foreign as page
from benchmarks.pages import foreign_figure

from foreign_cells import cell, number


def result(*cells, oracles=()):
    return {"cells": {f"{own['case']}/{own['seed']}": own for own in cells}, "oracles": dict(oracles)}


def whole(*, named=True, wrong=False):
    cells = [
        cell(
            case.group,
            case=name,
            seed=seed,
            cause={"kind": case.cause, "joints": ["a"]} if case.cause else {},
            findings=[{"kind": case.cause, "severity": "certain", "joints": ["a"], "evidence": f"{case.cause} of a"}]
            if case.cause and named
            else [],
            numbers=[number("kp[a]", (45, 50, 55), 60 if wrong else 51)],
        )
        for name, case in BY_NAME.items()
        for seed in SEEDS
    ]
    narrow = cell(numbers=[number("kp[a]", (48, 50, 52), 51)])
    oracles = {f"{name}/{ORACLE_SEED}": narrow for name in BY_NAME}
    return result(*cells, oracles=oracles)


def flat(text):
    return " ".join(text.split())


@pytest.mark.parametrize(
    "own",
    [result(), result(cell()), result(cell("B", cause={"kind": "backlash", "joints": ["a"]})), whole()],
    ids=["empty", "one of A", "one of B", "whole"],
)
def test_a_page_is_made_of_what_there_is(own):
    made = page.page(own)
    assert not re.search(r"\{[a-z_]+\}|\bnan\b|\bNone\b", made)
    for table in re.findall(r"(?:^\|.*\n)+", made, re.M):
        head, rule, *rows = table.splitlines()
        assert set(rule) <= set("|-: ")
        assert {row.replace("\\|", "").count("|") for row in rows} == {head.count("|")}, table
    for figure in page.figures(own).values():
        ET.fromstring(figure.replace("&#160;", " "))


def test_missing_cells_are_named():
    own = whole()
    assert "Incomplete" not in page.page(own)
    del own["cells"]["ur5e/1"], own["cells"]["ur5e/2"], own["oracles"][f"panda/{ORACLE_SEED}"]
    said = flat(page.page(own))
    assert f"**Incomplete.** 2 of {len(SEEDS) * len(BY_NAME)} fits are missing: `ur5e` with seed 1 and 2." in said
    assert "The narrowest intervals are missing of `panda`." in said
    for name in BY_NAME:
        for seed in (1, 2):
            own["cells"].pop(f"{name}/{seed}", None)
    said = flat(page.page(own))
    assert f"{2 * len(BY_NAME)} of {len(SEEDS) * len(BY_NAME)} fits are missing: every robot with seed 1 and 2." in said
    empty = page.page(result())
    assert "fits are missing: every robot with any seed." in flat(empty)
    assert empty.count("| not measured |") == 8


def test_a_missed_bar_is_shown_as_missed():
    kept, missed = page.page(whole()), page.page(whole(named=False, wrong=True))
    assert "**missed**" not in kept
    rows = dict(re.findall(r"^\| ([AB]: .*?) \| .* \| (\S+) \|$", missed, re.M))
    assert len(rows) == len(verdicts.NAMES)
    assert [name for name, verdict in rows.items() if verdict == "kept"] == [
        "A: widths over the narrowest that there can be, ur5e",
        "A: fits that leave at most 1.3 times the noise",
        "A: fits with the status ok",
    ]
    assert set(rows.values()) == {"kept", "**missed**"}


def test_the_tables_say_what_the_cells_say():
    rows = [number("kp[a]", (45, 50, 55), 51), number("kp[b]", (45, 50, 55), 60), number("kv[a]", (1, 2, 3), None)]
    one = cell(numbers=rows, left={"a": {"rms": 6e-4, "noise": 3e-4}})
    two = cell(seed=1, status="at-bound", numbers=rows[:1], fit={"short_of_time": True}, seconds=300.0)
    made = page.page(result(one, two))
    assert "| `demo_arm` | position, held, dart | `ok`, `at-bound` (short of time) | 4/4 | 2/3 | 2.0 % |" in made
    assert "A command took 200 s (median), 300 s at most." in made


def test_what_was_said_in_place_of_a_cause_stands_beside_it():
    cause = {"kind": "sign", "joints": ["a"]}
    certain = [{"kind": "sign", "severity": "certain", "joints": ["a"], "evidence": "a counts | other <way>"}]
    stopped = cell("B", cause=cause, status="stopped", code=3, numbers=[], left={}, findings=certain)
    silent = cell("B", cause=cause, seed=1, statements=["the search ended"])
    broken = cell("B", cause=cause, seed=2, status="failed", numbers=[], left={}, said="a\nerror: no room")
    made = page.page(result(stopped, silent, broken))
    assert "/0` | sign | `stopped` | yes |  |" in made
    assert "/1` | sign | `ok` | **no**: the search ended | 0/1 |" in made
    assert "/2` | sign | `failed` | **no**: error: no room |  |" in made
    elsewhere = [{"kind": "payload", "severity": "likely", "joints": [], "evidence": "a mass | of <iron>"}]
    made = page.page(result(cell("B", cause=cause, findings=elsewhere)))
    assert "| `ok` | **no**: payload: a mass \\| of &lt;iron> | 0/1 |" in made


def test_remarks_are_about_robots_whose_model_can_be_right():
    likely = [{"kind": "payload", "severity": "likely", "joints": [], "evidence": "a mass"}]
    assert "rightly finds nothing wrong in any of these 1 set-ups" in page.page(result(cell()))
    said = flat(page.page(result(cell(findings=likely), cell(seed=1))))
    assert (
        "In 1 of these 2 set-ups the check finds something that is or may be wrong: `demo_arm`, seed 0: payload (likely)."
        in said
    )
    assert "Over all 2 joints of such servos the sum is off by 9.1 % (median)" in said
    assert "hold the true one in 2." in said
    later = cell(seed=1, made={"machine": "a machine", "git": "aaaa", "created": "2026-11-26T10:00:00+00:00"})
    said = flat(page.page(result(cell(), later)))
    assert "2026-11-25 to 2026-11-26, commits `0123456789`, `aaaa`." in said


def test_the_figure_has_every_number_once():
    made = foreign_figure.figure("About", {"one": [0.2, -1.0, 1.5, -7.0], "two": []})
    assert made.count("<circle") == made.count("<path") == 2
    assert ">2 of 4<" in made
    assert ">0 of 0<" in made
