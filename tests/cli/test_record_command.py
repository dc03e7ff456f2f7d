"""`trueup record`: what it prints and leaves behind, and that bad input is one or two lines and no file."""

import json

import numpy as np
import pytest

from trueup.cli.main import main
from trueup.dataset import Dataset
from trueup.lab import LabSpec, Truth, draw_truth
from trueup.record import PlanSet

PLANS = """
name: four
seed: 3
motion: {clock: {rate_hz: 200.0, rest_s: 0.1}}
groups:
  - {name: single, kind: joint, count: 3, moving: single, velocity_share: [0.8, 1.0]}
  - {name: line, kind: cartesian, count: 1, split: test}
"""
RATES = ("--control-hz", "200", "--record-hz", "50", "--jobs", "1")


@pytest.fixture
def run(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in ("record", *arguments)])
        printed = capsys.readouterr()
        return left.value.code, printed.out, printed.err

    return call


@pytest.fixture
def plans(tmp_path):
    path = tmp_path / "four.yaml"
    path.write_text(PLANS)
    return path


def test_the_command_of_the_readme_records_a_hundredth_of_the_papers_set(run, tmp_path):
    options = ("--robot", "panda", "--hardware", "lab", "--unit", 1, "--plan", "paper", "--jobs", 1)
    code, out, err = run(*options, "--scale", "0.001", "--out", tmp_path / "D")
    assert (code, err) == (0, "")
    assert out.startswith("3 motions recorded in ")
    dataset = Dataset(tmp_path / "D")
    assert dataset.ids == ("multi-joint/00000", "single-joint/00000", "cartesian/00000")
    assert dataset.splits["cartesian/00000"] == "test"
    # Control at 1 kHz, record at 100 Hz, rest before and after.
    for plan, episode in zip(PlanSet(tmp_path / "D" / "plans"), dataset, strict=True):
        assert plan.rate_hz == pytest.approx(1000.0)
        assert min(plan.start_s, plan.duration_s - plan.end_s) >= 0.5 - 1e-9
        assert episode.measured.rate_hz == pytest.approx(100.0)


@pytest.mark.long
def test_seeds_of_descriptions_truths_and_stored_plans(run, plans, tmp_path):
    assert run("--plan", plans, *RATES, "--out", tmp_path / "D", "--truth", tmp_path / "truth.json")[0] == 0
    own = Dataset(tmp_path / "D").info.provenance
    assert own["seed"] == own["config"]["rig"]["seed"] == 3
    assert Truth.load(tmp_path / "truth.json") == draw_truth(LabSpec(), unit=1)
    assert "truth" not in {file.stem for file in (tmp_path / "D").rglob("*")}
    code, out, _ = run("--plan", tmp_path / "D" / "plans", *RATES, "--seed", 3, "--out", tmp_path / "again")
    assert (code, out.startswith("4 motions recorded")) == (0, True)
    assert Dataset(tmp_path / "again").hash == Dataset(tmp_path / "D").hash
    assert run("--plan", plans, *RATES, "--seed", 4, "--out", tmp_path / "other", "--scale", "0.1")[0] == 0
    other = Dataset(tmp_path / "other")
    assert len(other) == 2
    assert other.info.provenance["seed"] == 4
    # A second call is refused, --resume finds nothing to do.
    code, _, err = run("--plan", plans, *RATES, "--out", tmp_path / "D")
    assert (code, "--resume" in err) == (2, True)
    code, out, _ = run("--plan", plans, *RATES, "--out", tmp_path / "D", "--resume")
    assert (code, "0 motions recorded, 4 were there" in out) == (0, True)
    code, _, err = run("--plan", plans, *RATES, "--out", tmp_path / "D", "--resume", "--unit", "2")
    assert (code, "other settings (rig)" in err) == (2, True)


def test_units_and_bases_take_turns(run, plans, tmp_path):
    turns = ("--unit", 1, "--unit", 3, "--base", "stance", "--base", "gait")
    code, out, _ = run("--plan", plans, "--control-hz", 50, "--record-hz", 100, "--out", tmp_path / "D", *turns)
    assert (code, out.startswith("4 motions recorded")) == (0, True)
    metas = Dataset(tmp_path / "D").metas
    assert [(meta.unit, meta.condition.split()[1]) for meta in metas] == [
        *(("lab-1", "stance"), ("lab-1", "gait"), ("lab-3", "stance"), ("lab-3", "gait"))
    ]
    episode = Dataset(tmp_path / "D")[0]
    assert np.diff(episode.commanded().time_s).max() == pytest.approx(0.02)
    assert np.diff(episode.measured.time_s).max() == pytest.approx(0.01)


@pytest.mark.long
def test_faults_are_told(run, plans, tmp_path):
    code, out, err = run("--plan", plans, *RATES, "--out", tmp_path / "D", "--faults", "1.0", "--scale", 4)
    dataset = Dataset(tmp_path / "D")
    failed = err.count("was not recorded")
    assert len(dataset) + failed == 16
    assert code == (2 if failed else 0)
    assert f"{len(dataset)} motions recorded" in out
    assert (f", {failed} failed in " in out) == bool(failed)
    assert err.count("note: ") >= sum(meta.warned for meta in dataset.metas) > 0


def test_a_folder_of_the_name_of_a_built_in_set_is_no_plan_set(run, tmp_path, monkeypatch):
    (tmp_path / "paper").mkdir()
    (tmp_path / "paper" / "thesis.tex").write_text("years of work")
    monkeypatch.chdir(tmp_path)
    assert run("--plan", "paper", "--scale", "0.0001", "--jobs", 1, "--out", "D")[0] == 0


BAD = {
    "control rate": (("--control-hz", "-1000"), "control_hz must be positive"),
    "record rate": (("--record-hz", "-5"), "record_hz must be positive"),
    "no rate": (("--record-hz", "nan"), "record_hz"),
    "uneven rates": (("--record-hz", "70"), "multiple"),
    "control against plan": (("--control-hz", "400", "--record-hz", "40"), "multiple of control_hz"),
    "robot": (("--robot", "pandah"), "panda"),
    "other robot": (("--robot", "demo_arm"), "yaw"),
    "springs for a robot that needs none": (("--servo-hz", "3"), "follows positions by itself"),
    "springs that are none": (("--robot", "panda_torque", "--servo-hz", "0"), "frequency of a servo"),
    "hardware": (("--hardware", "franka"), "lab, mujoco, dart, ros2"),
    "plan": (("--plan", "papre"), "paper"),
    "plan file": (("--plan", "nothing.yaml"), "does not exist"),
    "scale": (("--scale", "0"), "scale must be positive"),
    "negative scale": (("--scale", "-1"), "scale must be positive"),
    "unit": (("--unit", "-1"), "unit"),
    "two robots behind ROS 2": (("--hardware", "ros2", "--unit", "1", "--unit", "2"), "one robot behind ROS 2"),
    "seed": (("--seed", "-1"), "seed"),
    "jobs": (("--jobs", "0"), "jobs"),
    "payload": (("--payload-kg", "7"), "payload"),
    "negative payload": (("--payload-kg", "-1"), "payload"),
    "one of the payloads": (("--payload-kg", "0", "--payload-kg", "7"), "payload"),
    "faults": (("--faults", "2"), "share"),
    "faults of an engine": (("--hardware", "mujoco", "--faults", "0.5"), "no faults"),
    "base": (("--base", "run"), "fixed, stance, squat, gait"),
    "base of an engine": (("--hardware", "mujoco", "--base", "gait"), "no base"),
    "no lab": (("--lab", "nothing.yaml"), "does not exist"),
    "no such lab": (("--lab", "xm540"), "xm430"),
    "model": (("--model", "nothing.xml"), "nothing.xml"),
    "truth of an engine": (("--hardware", "mujoco", "--truth", "t.json"), "truth"),
    "truth in the data": (("--truth", "D/truth.json"), "kept apart"),
    "truth behind a dot": (("--truth", "x/../D/./truth.json"), "kept apart"),
}


@pytest.mark.parametrize(("arguments", "word"), BAD.values(), ids=BAD)
def test_bad_input_is_told_in_two_lines_and_nothing_is_written(run, plans, tmp_path, monkeypatch, arguments, word):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    given = () if "--plan" in arguments else ("--plan", plans)
    code, out, err = run(*given, *RATES, "--out", "D", *arguments)
    assert (code, out) == (2, "")
    assert len(err.strip().splitlines()) <= 2
    assert err.startswith("error: ")
    assert word in err
    assert sorted(tmp_path.rglob("*")) == before


PLANS_THAT_ARE_NONE = {
    "of one name": ("[{name: a, kind: joint, count: 1}, {name: a, kind: chirp, count: 1}]", "different names"),
    "no motion": ("[{name: a, kind: joint, count: 0}]", "needs motions: got {'a': 0}"),
    "a billion motions": ("[{name: a, kind: joint, count: 1111111111}]", "too many motions: got {'a': 1111111111}"),
    "fractions of no split": (
        "[{name: a, kind: joint, count: 1}]\nfractions: {tran: 1.0}",
        "available: train, val, test",
    ),
    "animations that are not there": (
        "[{name: a, kind: animation, count: 1, animations: [bow]}]\nanimations: {nod: {duration_s: 1, joints: {j: []}}}",
        "available: nod",
    ),
    "no animations": ("[{name: a, kind: animation, count: 1}]", "Describe them under `animations:`"),
    "keyframes out of order": (
        "[{name: a, kind: animation, count: 1}]\nanimations: {nod: {duration_s: 1, joints: {j: [[2, 0.1]]}}}",
        "increasing times between 0 and 1 s",
    ),
    "a speed of nothing": ("[{name: a, kind: joint, count: 1, speed: [0, 1]}]", "speed of group 'a' is no range"),
    "few control points": ("[{name: a, kind: b-spline, count: 1, control_points: 3}]", "more than 4 control_points"),
    "fractions of more": ("[{name: a, kind: joint, count: 1}]\nfractions: {train: 0.9, test: 0.9}", "add up to 1"),
}


@pytest.mark.parametrize(("groups", "word"), PLANS_THAT_ARE_NONE.values(), ids=PLANS_THAT_ARE_NONE)
def test_a_description_of_no_plan_set_is_told_by_what_is_wrong_with_it(run, tmp_path, groups, word):
    (tmp_path / "none.yaml").write_text(f"name: none\ngroups: {groups}\n")
    code, out, err = run("--plan", tmp_path / "none.yaml", *RATES, "--out", tmp_path / "D")
    assert (code, out) == (2, "")
    assert word in err
    assert not (tmp_path / "D").exists()


def test_a_lab_that_follows_torques_is_told_what_to_change(run, plans, tmp_path):
    (tmp_path / "lab.yaml").write_text("controller: {kind: torque}\n")
    code, _, err = run("--plan", plans, *RATES, "--out", tmp_path / "D", "--lab", tmp_path / "lab.yaml")
    assert (code, "kind: impedance" in err) == (2, True)
    assert not (tmp_path / "D").exists()


BROKEN = [
    "friction: {enabled: maybe}",
    "frictoin: {}",
    "[1, 2",
    "!!python/object:os.system {}",
    "delay: {delay_s: -1.0}",
    "",
]


@pytest.mark.parametrize("text", BROKEN)
@pytest.mark.parametrize("option", ["--lab", "--plan"])
def test_broken_yaml(run, plans, tmp_path, monkeypatch, option, text):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.yaml").write_text(text)
    code, _, err = run("--plan", plans, *RATES, "--out", "D", option, "broken.yaml")
    assert code == 2
    assert len(err.strip().splitlines()) <= 2
    assert "broken.yaml" in err or "lab" in err
    assert not (tmp_path / "D").exists()


def test_a_plan_set_that_is_damaged_or_of_another_robot(run, plans, tmp_path):
    assert run("--plan", plans, *RATES, "--out", tmp_path / "D", "--scale", 0.1)[0] == 0
    stored = tmp_path / "D" / "plans"
    code, _, err = run("--plan", stored, *RATES, "--out", tmp_path / "E", "--scale", 0.5)
    assert (code, "recorded as it is" in err) == (2, True)
    tree = json.loads((stored / "plans.json").read_text())
    tree["joints"] = ["yaw", "shoulder", "elbow"]
    (stored / "plans.json").write_text(json.dumps(tree))
    code, _, err = run("--plan", stored, *RATES, "--out", tmp_path / "E")
    assert (code, "yaw" in err, "joint7" in err) == (2, True, True)
    for text in ("", "[]", '{"schema": "trueup.plans/1"}', '{"schema": "trueup.plans/9"}'):
        (stored / "plans.json").write_text(text)
        code, _, err = run("--plan", stored, *RATES, "--out", tmp_path / "E")
        assert (code, len(err.strip().splitlines()) <= 2) == (2, True)
    assert not (tmp_path / "E").exists()
