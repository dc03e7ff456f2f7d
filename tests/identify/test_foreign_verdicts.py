"""What a fit says is read and held against the truth as the page says: made-up cells, no fits."""

import json
import math
import sys
from concurrent.futures import Future

import numpy as np
import pytest
from benchmarks import __main__ as command
from benchmarks import foreign
from benchmarks import foreign_verdicts as verdicts
from benchmarks.foreign_cases import CASES

from foreign_cells import PAYLOAD, TRUTH, cell, fit_result, number, parameter
from trueup.core.check_result import CheckResult, Finding
from trueup.core.close_result import CloseResult, Step


def test_a_number_stands_beside_its_truth_or_beside_none():
    fit = fit_result(parameter("kp[a]", 48.0, (45.0, 51.2)), parameter("stribeck[a]", 0.1, (0.0, 0.2), frozen=True))
    gain, other = verdicts.numbers(fit, TRUTH)
    assert (gain["value"], gain["low"], gain["high"], gain["truth"], gain["nominal"]) == (48.0, 45.0, 51.2, 50.0, 60.0)
    assert other["truth"] is None
    assert other["frozen"]
    assert verdicts.truths(TRUTH)["torque_limit[b]"] == 9.0
    assert "torque_limit[a]" not in verdicts.truths(TRUTH)


def test_what_hangs_at_a_body_belongs_to_its_mass():
    found = verdicts.truths({**TRUTH, "cause": PAYLOAD})
    assert found["mass[hand]"] == pytest.approx(0.5 + 1.2)
    assert not {"com_x[hand]", "inertia_scale[hand]"} & set(found)
    assert verdicts.truths(TRUTH)["com_x[hand]"] == 0.01
    # A fit that carries it itself leaves the body as it is.
    fit = fit_result(parameter("mass[hand]", 0.5, (0.4, 0.6)), parameter("payload_mass", 1.1, (1.0, 1.3)))
    assert [row["truth"] for row in verdicts.numbers(fit, {**TRUTH, "cause": PAYLOAD})] == [0.5, 1.2]


def test_only_numbers_that_are_called_determined_and_have_a_truth_are_judged():
    rows = [
        number("kp[a]", (40, 50, 60), 55),
        number("kp[b]", (40, 50, 60), 61),
        number("kp[c]", (40, 50, 60), 61, identified="weakly"),
        number("kp[d]", (40, 50, 60), 61, frozen=True),
        number("kp[e]", (40, 50, 60), None),
    ]
    assert [row["name"] for row in verdicts.called(rows)] == ["kp[a]", "kp[b]", "kp[e]"]
    assert [row["name"] for row in verdicts.judged(rows)] == ["kp[a]", "kp[b]"]
    assert verdicts.coverage(rows) == 0.5
    assert verdicts.coverage(rows[2:]) is None


def test_the_truth_in_units_of_its_interval():
    log = number("kp[a]", (25, 50, 100), 100)
    assert verdicts.off(log) == pytest.approx(1.0)
    assert verdicts.off({**log, "truth": 12.5}) == pytest.approx(-2.0)
    linear = number("torque_offset[a]", (-1, 0, 3), 1.5, transform="linear")
    assert verdicts.off(linear) == pytest.approx(0.5)
    assert verdicts.off({**linear, "truth": 0}) == 0.0
    for truth in np.linspace(20, 120, 41):
        row = {**log, "truth": float(truth)}
        assert verdicts.holds(row) == (abs(verdicts.off(row)) <= 1 + 1e-12)
    assert verdicts.width(log) == pytest.approx(math.log(4))
    assert verdicts.width(linear) == 4.0


def test_errors_are_those_of_numbers_that_are_positive_by_nature():
    rows = [
        number("kp[a]", (40, 55, 60), 50),
        number("delay_s[a]", (0.0, 0.012, 0.02), 0.010, transform="linear"),
        number("torque_offset[a]", (-1, 0.5, 1), 0.001, transform="linear"),
    ]
    assert [verdicts.error(row) for row in rows] == [pytest.approx(0.1), pytest.approx(0.2), None]
    assert verdicts.middle_error(rows) == pytest.approx(0.15)
    assert verdicts.middle_error(rows[2:]) is None


def test_what_is_left_is_held_against_the_noise_that_was_added():
    left = {"a": {"rms": 3e-4, "noise": 1e-4}, "b": {"rms": 6e-4, "noise": 1e-4}}
    assert verdicts.left(cell(noise=3e-4, left=left)) == pytest.approx(math.sqrt(2.5))
    assert verdicts.left(cell(left={})) is None


def test_widths_are_compared_where_both_call_a_number_determined():
    rows = [
        number(f"kp[{joint}]", (50 / wide, 50, 50 * wide), 50) for joint, wide in (("a", 1.1), ("b", 1.2), ("c", 1.3))
    ]
    oracle = [number(f"kp[{joint}]", (50 / 1.05, 50, 50 * 1.05), 50) for joint in "abd"]
    ratio = [math.log(wide) / math.log(1.05) for wide in (1.1, 1.2)]
    assert verdicts.wider(cell(numbers=rows), cell(numbers=oracle)) == pytest.approx(sum(ratio) / 2)
    assert verdicts.wider(cell(numbers=rows), cell(numbers=[])) is None


def test_draws_say_what_a_sum_is():
    fit = fit_result(parameter("kv[a]", 1.5, (0.5, 3)), parameter("damping[a]", 0.5, (0.1, 2)))
    kv = np.random.default_rng(0).uniform(1.0, 2.0, 4000)
    (row,) = verdicts.sums(fit, {"kv[a]": kv, "damping[a]": 2.0 - kv + 0.01 * kv}, TRUTH)
    assert row["name"] == "kv+damping[a]"
    assert (row["value"], row["truth"]) == (2.0, 2.2)
    assert row["low"] == pytest.approx(2.01, abs=2e-3)
    assert not verdicts.holds(row)
    assert verdicts.sum_error([row]) == pytest.approx(0.2 / 2.2)
    assert verdicts.sums(fit, {"kv[a]": kv}, TRUTH) == []


SAID = {
    "late-feedback": "what is left of a fits feedback that is late: a feedback delay of 8 ms",
    "integral": "a stands where the model sags: its servo has an integral part",
    "backlash": "what is left of a reverses with its velocity: there is play in its gears",
    "elastic": "what is left of a swings at 9 Hz: an elastic gear",
    "payload": "a payload of 1.2 kg would explain the remaining error of a",
    "sign": "a is mirrored in the measurement",
}


@pytest.mark.parametrize("kind", SAID)
@pytest.mark.parametrize("about", SAID)
def test_a_sentence_names_its_cause_and_no_other(kind, about):
    own = cell("B", cause={"kind": kind, "joints": ["a"]}, statements=[SAID[about]])
    assert verdicts.naming(own) == ([SAID[about]] if kind == about else [])


@pytest.mark.parametrize("kind", SAID)
def test_what_every_fit_may_say_names_nothing(kind):
    usual = [
        (
            "the remaining error is 2.1 times the sensor noise (largest at a: 0.0012, noise 0.0003). The model lacks "
            "something, so fitted numbers may be off by more than their intervals; none of late feedback, "
            "an integral term, backlash, an elastic gear, friction that grows with the load or falls with time, a largest "
            "speed, a payload and a mirrored joint explains it"
        ),
        (
            "the fitted model simulates a logged signal worse than the original model: velocity of a (0.1 -> 0.2). Either its "
            "parameters are not the robot's, or the signal has another sign, scale or unit"
        ),
        (
            "2 of 24 parameters are not determined by these motions: delay_s[a], mass[hand]; their values come mostly "
            "from your model, and their intervals show how far off they may be"
        ),
        "the fit stopped before it converged (time): raise solver.max_iterations, or give it more time",
        "the command is interpolated between its stamps: this fits the logs better",
    ]
    assert verdicts.naming(cell("B", cause={"kind": kind, "joints": ["a"]}, statements=usual)) == []


def test_causes_of_the_cases_have_words_that_a_table_can_show():
    assert {case.cause for case in CASES if case.cause} == set(verdicts.ACCEPTED)
    assert not [word for _, words in verdicts.ACCEPTED.values() for word in words if "|" in word]


@pytest.mark.parametrize(
    ("kind", "severity", "joints", "named"),
    [
        ("sign", "certain", ["a"], True),
        ("sign", "likely", ["b", "a"], True),
        ("sign", "likely", [], True),
        ("sign", "note", ["a"], False),
        ("sign", "certain", ["b"], False),
        ("swap", "certain", ["a"], False),
    ],
)
def test_a_finding_names_a_cause_by_its_kind_and_joints(kind, severity, joints, named):
    finding = {"kind": kind, "severity": severity, "joints": joints, "evidence": "with this change, it is explained"}
    own = cell("B", cause={"kind": "sign", "joints": ["a"]}, findings=[finding])
    assert bool(verdicts.naming(own)) == named


def test_a_sentence_about_other_joints_names_nothing():
    cause = {"kind": "backlash", "joints": ["a"]}
    assert verdicts.naming(cell("B", cause=cause, statements=["backlash of a"]))
    assert verdicts.naming(cell("B", cause=cause, statements=["there is backlash"]))
    assert not verdicts.naming(cell("B", cause=cause, statements=["backlash of b"]))


def bars(cells, oracles=()):
    result = {"cells": {f"{own['case']}/{own['seed']}": own for own in cells}, "oracles": dict(oracles)}
    return {row.name: row for row in verdicts.bars(result)}


def test_the_bars_of_robots_whose_model_can_be_right():
    good = [number(f"kp[{index}]", (40, 50.5, 60), 50) for index in range(19)]
    bad = number("kp[x]", (40, 50, 60), 61)
    cells = [cell(case="one", numbers=[*good, bad]), cell(case="two", numbers=[good[0], bad], status="unexplained")]
    oracle = {**cell(), "numbers": [number("kp[0]", (45, 50, 55), 50)]}
    found = bars(cells, {"one/0": oracle})
    assert found["A: numbers called determined that hold the truth"].value == pytest.approx(100 * 20 / 22)
    assert found["A: numbers called determined that hold the truth"].ok
    worst = found["A: the same on the worst robot, two"]
    assert (worst.value, worst.ok) == (50.0, False)
    assert found["A: fits with the status ok"].value == 50.0
    assert not found["A: fits with the status ok"].ok
    assert found["A: fits that leave at most 1.3 times the noise"].value == 100.0
    assert found["A: error of numbers called determined, median"].value == pytest.approx(1.0)
    wide = found["A: widths over the narrowest that there can be, one"]
    assert wide.value == pytest.approx(math.log(60 / 40) / math.log(55 / 45))
    assert not [name for name in found if name.startswith("B")]


def test_a_fit_that_did_not_come_about_keeps_no_bar():
    found = bars([cell(status="failed", numbers=[], left={}), cell(seed=1)])
    assert found["A: fits with the status ok"].value == 50.0
    assert found["A: fits that leave at most 1.3 times the noise"].value == 50.0
    assert bars([]) == {}


def test_the_bars_of_causes_that_no_number_expresses():
    cause = {"kind": "payload", "joints": ["a"]}
    wrong = [number("kp[a]", (40, 50, 60), 61), number("kp[b]", (40, 50, 60), 61, identified="no")]
    named = cell("B", cause=cause, statements=["a payload"], status="unexplained", numbers=wrong)
    silent = cell("B", cause=cause, seed=1, numbers=wrong)
    found = bars([named, silent])
    row = found["B: numbers called determined outside their interval in fits called ok"]
    assert (row.value, row.limit, row.ok) == (1, 0, False)
    assert found["B: cause named"].value == 50.0
    assert bars([named])["B: numbers called determined outside their interval in fits called ok"].ok


def test_a_folder_of_results_is_read(tmp_path):
    fit = fit_result(parameter("kv[a]", 1.5, (1.0, 2.0)), parameter("damping[a]", 0.5, (0.1, 2), identified="no"))
    fit.save(tmp_path / "fit.json")
    np.savez(tmp_path / "fit.samples.npz", **{"kv[a]": np.full(9, 1.5), "damping[a]": np.full(9, 0.5)})
    CheckResult((Finding("payload", "likely", "a mass at the end", ("a",)),), motions=8).save(tmp_path / "check.json")
    steps = (Step("identify", "cut short", 12.34, "a fit"),)
    CloseResult(steps, "identify").save(tmp_path / "close.json")
    found = foreign.found_in(tmp_path, TRUTH, 0)
    assert (found["status"], found["code"]) == ("ok", 0)
    assert [row["name"] for row in verdicts.judged(found["numbers"])] == ["kv[a]"]
    assert found["sums"][0]["value"] == 2.0
    assert found["findings"] == [
        {"kind": "payload", "severity": "likely", "joints": ["a"], "evidence": "a mass at the end"}
    ]
    assert found["steps"] == {"identify": {"seconds": 12.3, "status": "cut short"}}
    assert found["left"] == {"a": {"rms": 3.1e-4, "noise": 3e-4}}
    assert found["fit"]["command"] == "held"
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize(("severity", "status"), [("certain", "stopped"), ("note", "failed")])
def test_a_folder_without_a_fit_says_why(tmp_path, severity, status):
    CheckResult((Finding("sign", severity, "mirrored", ("a",)),), motions=8).save(tmp_path / "check.json")
    found = foreign.found_in(tmp_path, TRUTH, 3)
    assert (found["status"], found["numbers"], found["left"]) == (status, [], {})
    assert foreign.found_in(tmp_path / "nothing", TRUTH, 1)["status"] == "failed"


class Here:
    """A pool whose work is done when it is asked for."""

    def __init__(self, *_, **__):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def shutdown(self, **_):
        pass

    def submit(self, work):
        future = Future()
        try:
            future.set_result(work())
        except RuntimeError as error:
            future.set_exception(error)
        return future


@pytest.fixture
def measured(monkeypatch):
    """Which cells were measured; those of `panda` fail."""
    asked = []

    def closed(name, seed, *, threads, budget=""):
        assert budget == ""
        asked.append(("cells", name, seed, threads))
        if name == "panda":
            raise RuntimeError("out of range")
        return cell(case=name, seed=seed, numbers=[number("kp[a]", (45, 50, 55), 51)])

    def known(name, seed, own):
        assert own["case"] == name
        asked.append(("oracles", name, seed, 0))
        return {"numbers": own["numbers"]}

    monkeypatch.setattr(foreign, "ThreadPoolExecutor", Here)
    monkeypatch.setattr(foreign, "closed", closed)
    monkeypatch.setattr(foreign, "known", known)
    monkeypatch.setattr(foreign, "foreign_folder", lambda: foreign.RESULT.parent)
    monkeypatch.setattr(foreign.os, "cpu_count", lambda: 4)
    return asked


def test_cells_are_kept_one_by_one_and_not_measured_twice(measured, tmp_path, capsys):
    path = tmp_path / "results" / "foreign.json"
    foreign.measure(foreign.Wanted(("tidybot", "panda", "demo_arm"), (1, 0), jobs=2), path)
    assert len(measured) == 6
    assert {threads for *_, threads in measured} == {2}
    assert list(foreign.stored(path)["cells"]) == ["demo_arm/0", "demo_arm/1", "tidybot/0", "tidybot/1"]
    assert "panda/0: no cell" in capsys.readouterr().out
    made = json.loads(path.read_text())["provenance"]
    assert made["git"]
    assert made["created"]

    measured.clear()
    found = foreign.measure(foreign.Wanted(("demo_arm", "panda", "ur5e_sign"), (1,), oracle=True), path)
    assert sorted((kind, name) for kind, name, *_ in measured) == [
        *(("cells", "panda"), ("cells", "ur5e_sign"), ("oracles", "demo_arm"))
    ]
    assert {row.name: row.value for row in found}["cells"] == 5
    assert list(foreign.stored(path)["oracles"]) == ["demo_arm/1"]

    measured.clear()
    foreign.measure(foreign.Wanted(("demo_arm",), (0, 1)), path)
    assert measured == []
    foreign.measure(foreign.Wanted(("demo_arm",), (0,), again=True), path)
    assert [(kind, name, seed) for kind, name, seed, _ in measured] == [("cells", "demo_arm", 0)]


def test_robots_whose_models_are_not_here_are_left_out(measured, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(foreign, "foreign_folder", lambda: tmp_path / "nothing")
    foreign.measure(foreign.Wanted(("ur5e", "demo_arm"), (0,)), tmp_path / "foreign.json")
    assert [name for _, name, *_ in measured] == ["demo_arm"]
    assert "TRUEUP_SHARED" in capsys.readouterr().out


def test_options_of_a_benchmark_stand_behind_its_name(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(foreign, "measure", lambda wanted: asked.append(wanted) or [])
    foreign.run_with(["--cases", "ur5e,demo_arm", "--seeds", "2", "--jobs", "3", "--oracle"])
    foreign.run()
    assert asked[0] == foreign.Wanted(("ur5e", "demo_arm"), (2,), 3, oracle=True)
    assert (len(asked[1].cases), asked[1].seeds, asked[1].oracle) == (len(CASES), (0, 1, 2), False)
    for wrong, said in (
        (["--cases", "ur7"], "no case ur7"),
        (["--seeds", "a"], "seeds are"),
        (["--jobs", "0"], "jobs"),
    ):
        with pytest.raises(SystemExit):
            foreign.run_with(wrong)
        assert said in capsys.readouterr().err


def test_the_command_passes_them_on(monkeypatch, capsys):
    passed = []
    monkeypatch.setattr(command, "_run", lambda name, *own: passed.append((name, *own)) or [])
    monkeypatch.setattr(command, "keep", lambda *_: None)
    monkeypatch.setattr(sys, "argv", ["benchmarks", "foreign", "--cases", "ur5e", "--oracle"])
    command.main()
    assert passed == [("foreign", "--cases", "ur5e", "--oracle")]
    for wrong in (["replay", "--oracle"], ["--oracle"], ["foreign", "replay", "--oracle"]):
        monkeypatch.setattr(sys, "argv", ["benchmarks", *wrong])
        with pytest.raises(SystemExit):
            command.main()
        assert "unrecognized arguments: --oracle" in capsys.readouterr().err
