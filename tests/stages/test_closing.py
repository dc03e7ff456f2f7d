"""All rungs of a close: the same results as step by step, within a time, and nothing lost when something fails."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from stages.closes import METHODS, OTHER, QUICK, ROBOT, files_in, quick
from trueup.cli.close import exit_code, lacking
from trueup.cli.main import main
from trueup.core.atomic import as_read_back
from trueup.core.close_result import STEPS, CloseResult, Step
from trueup.core.results import GapResult, Ladder
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset, DatasetWriter
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import (
    ConfigError,
    DataError,
    FormatError,
    MissingDependency,
    NameMismatch,
    OutputExists,
    how_to_install,
)
from trueup.identify import IdentifyConfig
from trueup.report import build_report
from trueup.report.sections.steps import alone_words, steps_alert, time_words
from trueup.robots import load_robot
from trueup.stages import (
    FITTED,
    STOCK,
    Watch,
    close,
    close_networks,
    close_steps,
    export_dataset,
    import_logs,
)
from trueup.stages.close_budget import Budget, fitted_motion


def steps_of(out):
    return {step.name: step for step in CloseResult.load(out / "close.json").steps}


def test_the_rungs_stand_in_order_and_the_best_on_val_is_chosen(closed):
    assert [rung.name for rung in closed.ladder.rungs] == [
        *("command", "stock", "moving-average", "fitted", "fitted+moving-average")
    ]
    errors = {rung.name: rung.splits["val"]["position"]["rmse"].total.value for rung in closed.ladder.rungs}
    assert [rung.name for rung in closed.ladder.rungs if rung.chosen] == [min(errors, key=errors.get)]
    assert errors["fitted"] < 0.5 * errors["stock"]
    # What a rung took holds what those below it took.
    seconds = {rung.name: rung.seconds for rung in closed.ladder.rungs}
    assert seconds["moving-average"] > seconds["stock"]
    assert seconds["fitted+moving-average"] > seconds["fitted"] > 0


@pytest.mark.long
def test_everything_lies_in_one_folder_and_in_one_report(closed):
    out = closed.dataset.path.parent / "out"
    steps = steps_of(out)
    assert tuple(steps) == STEPS[1:]  # nothing was imported
    assert {step.status for step in steps.values()} == {"done"}
    gap = GapResult.load(out / "gap.json")
    assert set(gap.runs) == {"command", STOCK, FITTED, f"{STOCK}+moving-average", f"{FITTED}+moving-average"}
    # What a network adds to what it corrects is compared in pairs, too.
    assert (f"{FITTED}+moving-average", FITTED) in {(pair.run, pair.baseline) for pair in gap.paired}
    page = build_report(out)
    for anchor in ("verdict", "ladder", "augmentation", "attribution", "parameters", "open", "usage", "steps"):
        assert f'<section id="{anchor}"' in page
    kept = Ladder.load(out / "ladder.json")
    assert [(rung.name, rung.chosen) for rung in kept.rungs] == [(r.name, r.chosen) for r in closed.ladder.rungs]


@pytest.mark.long
def test_a_second_call_keeps_what_is_there(closed, tmp_path):
    out = shutil.copytree(closed.dataset.path.parent, tmp_path / "copy") / "out"
    before = {name: (out / name).read_bytes() for name in ("fit.json", "explain.json")}
    with pytest.raises(OutputExists, match="not empty"):
        quick(out.parent / "data", out)
    # First to an earlier step: what is there of later ones stays, in the report as in the files.
    less = quick(out.parent / "data", out, until="gap", resume=True)
    assert [rung.name for rung in less.ladder.rungs] == ["command", "stock"]
    assert steps_of(out) == {step.name: step for step in less.result.steps}
    assert tuple(steps_of(out)) == STEPS[1:]
    assert [rung.name for rung in Ladder.load(out / "ladder.json").rungs] == [r.name for r in closed.ladder.rungs]
    assert (out / "augment.json").is_file()
    assert CloseResult.load(out / "close.json").networks == closed.result.networks
    fitted = quick(out.parent / "data", out, until="identify", resume=True)
    assert [rung.name for rung in fitted.ladder.rungs] == ["command", "stock", "fitted"]
    assert set(GapResult.load(out / "gap.json").runs) == set(closed.measurement.gap.runs)
    assert '<section id="augmentation"' in build_report(out)
    # And without time: nothing that is there is left out.
    again = quick(out.parent / "data", out, resume=True, budget_s=0.001)
    assert {step.status for step in again.result.steps if step.name not in ("gap",)} == {"kept"}
    assert {name: (out / name).read_bytes() for name in before} == before
    assert [rung.name for rung in again.ladder.rungs] == [rung.name for rung in closed.ladder.rungs]
    for rung, other in zip(again.ladder.rungs, closed.ladder.rungs, strict=True):
        assert rung.splits == other.splits
    # What they took when they were made.
    assert again.result.step("identify").seconds == closed.result.step("identify").seconds


@pytest.mark.long
@pytest.mark.parametrize(
    ("until", "last", "rungs"),
    [
        ("replay", "replay", 0),
        ("gap", "gap", 2),
        ("check", "check", 2),
        pytest.param("explain", "explain", 2, marks=pytest.mark.slow),
        ("identify", "identify", 3),
    ],
)
def test_it_ends_where_it_was_asked_to_end(data, tmp_path, until, last, rungs):
    done = quick(data, tmp_path / "out", until=until)
    assert done.result.steps[-1].name == last
    assert len(done.ladder.rungs) == rungs
    assert (tmp_path / "out" / "fit.json").is_file() == (until == "identify")
    assert (tmp_path / "out" / "gap.json").is_file() == (until != "replay")
    assert not (tmp_path / "out" / "networks").exists()
    # And goes on from there.
    if until == "explain":
        whole = quick(data, tmp_path / "out", resume=True)
        # By the numbers of the fit now, and not by those of a search of its own.
        assert [step.status for step in whole.result.steps] == ["kept", "done", "kept", "done", "done", "done"]


@pytest.mark.long
def test_logs_are_imported_first(recorded, tmp_path):
    export_dataset(recorded, tmp_path / "logs")
    mapping = ImportOptions(mapping=tmp_path / "logs" / "mapping.yaml")
    logs, out, seen = tmp_path / "logs", tmp_path / "out", []
    first = quick(logs, out, until="import", options=mapping, watch=Watch(on_step=seen.append))
    assert seen == ["import"]
    assert (first.replayed, first.measurement, first.ladder.rungs) == (None, None, ())
    assert [step.name for step in first.result.steps] == ["import"]
    assert not first.dataset.runs
    done = quick(logs, out, until="gap", options=mapping, watch=Watch(on_step=seen.append), resume=True)
    assert seen == ["import", "import", "replay", "gap"]
    assert done.imported is not None
    step = done.result.step("import")
    assert (step.what, step.status, step.seconds) == ("12 motions", "kept", first.result.steps[0].seconds)
    assert done.dataset.path == tmp_path / "out" / "dataset"
    # Another robot is refused before a motion is read.
    with pytest.raises(OutputExists, match="another robot"):
        close(logs, replace(ROBOT, name="other"), out, options=mapping, until="gap", resume=True, config=QUICK)
    assert len(seen) == 4


def test_what_is_lacking_decides_about_the_exit_code(closed):
    assert lacking(closed) == []
    steps = tuple(replace(step, status="failed") for step in closed.result.steps if step.name == "explain")
    failed = replace(closed.result, steps=steps)
    assert lacking(replace(closed, result=failed)) == ["explain failed"]
    # A step of an earlier call, that this one did not have to do.
    assert lacking(replace(closed, result=replace(failed, until="gap"))) == []
    bad = replace(closed.identified, fit=replace(closed.identified.fit, status="not-converged"))
    assert lacking(replace(closed, identified=bad)) == ["the fit is of no use (not-converged)"]
    # What the time has ended is what there was time for; what is no better is of no use however long it took.
    for status, lacks in (("not-converged", []), ("no-better", ["the fit is of no use (no-better)"])):
        fit = replace(closed.identified.fit, status=status, solver={**closed.identified.fit.solver, "stop": "time"})
        assert lacking(replace(closed, identified=replace(closed.identified, fit=fit))) == lacks
    # Neither is a search that ended for another reason, while only others had no time, nor one whose starts disagree.
    for solver in (
        {"stop": "iterations", "short_of_time": ["friction"]},
        {"stop": "time", "agreement": "local-minima"},
    ):
        fit = replace(closed.identified.fit, status="not-converged", solver={**closed.identified.fit.solver, **solver})
        assert lacking(replace(closed, identified=replace(closed.identified, fit=fit)))
    only_loud = replace(closed.identified, fit=replace(closed.identified.fit, status="not-identifiable"))
    assert lacking(replace(closed, identified=only_loud)) == []


@pytest.mark.long
def test_a_step_that_fails_is_said_and_the_others_go_on(data, tmp_path, capsys):
    """Nothing to fit, nothing to train on: all motions are for test."""
    given = Dataset(data)
    with DatasetWriter.create(tmp_path / "test-only", given.info) as writer:
        for episode in given:
            writer.append(replace(episode, meta=replace(episode.meta, split="test")))
    done = quick(tmp_path / "test-only", tmp_path / "out")
    steps = {step.name: step for step in done.result.steps}
    assert [steps[name].status for name in ("explain", "identify", "augment")] == ["failed"] * 3
    assert "no train split to fit" in steps["identify"].what
    assert [rung.name for rung in done.ladder.rungs] == ["command", "stock"]
    assert [step.name for step in done.result.failed] == ["explain", "identify", "augment"]
    page = build_report(tmp_path / "out")
    assert "no train split to fit" in page
    assert "did not go to the end: explain, identify and augment failed" in page
    # And the command says so by its exit code.
    config = tmp_path / "quick.yaml"
    config.write_text(yaml.safe_dump(as_read_back(QUICK.to_json())))
    given = ("--config", config, "--method", METHODS[0], "--budget", "none", "--resume")
    with pytest.raises(SystemExit) as left:
        main(["close", *map(str, (tmp_path / "test-only", "--robot", "demo_arm", "--out", tmp_path / "out", *given))])
    assert left.value.code == 3
    assert "error: explain failed; identify failed; augment failed" in capsys.readouterr().err


@pytest.mark.slow
def test_without_torch_the_networks_are_left_out_and_said_how_to_get(data, tmp_path, monkeypatch):
    def missing(*_, **__):
        raise MissingDependency("training needs torch", hint=how_to_install("learn"))

    monkeypatch.setattr(close_networks, "augment", missing)
    done = quick(data, tmp_path / "out")
    last = done.result.steps[-1]
    assert (last.name, last.status) == ("augment", "left out")
    assert "'.[learn]'" in last.what
    assert [rung.name for rung in done.ladder.rungs] == ["command", "stock", "fitted"]


@pytest.mark.slow
def test_a_method_that_fails_does_not_hide_the_others(data, tmp_path, monkeypatch):
    real = close_networks.augment

    def sometimes(datasets, out, **options):
        if out.name == "realeasy-rt":
            raise DataError("the motions are too short")
        return real(datasets, out, **options)

    monkeypatch.setattr(close_networks, "augment", sometimes)
    done = quick(data, tmp_path / "out", methods=("realeasy-rt", "moving-average"))
    last = done.result.steps[-1]
    assert last.status == "done"
    assert "fitted+realeasy-rt failed: the motions are too short" in last.what
    assert [rung.name for rung in done.ladder.rungs][-1] == "fitted+moving-average"


@pytest.mark.long
@pytest.mark.parametrize("budget_s", [None, 60.0])
@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"config": OTHER}, "another configuration"),
        ({"seed": 1}, "another seed.*got seed 1.*expected seed 0"),
        ({"drop_flagged": True}, "another choice of motions"),
        ({"robot": replace(ROBOT, name="other")}, "another robot"),
    ],
)
def test_what_was_asked_otherwise_is_refused_and_nothing_is_replaced(closed, tmp_path, changed, said, budget_s):
    shutil.copytree(closed.dataset.path.parent, tmp_path / "all")
    data, out = tmp_path / "all" / "data", tmp_path / "all" / "out"
    before = {path: path.read_bytes() for path in (tmp_path / "all").rglob("*") if path.is_file()}
    asked = {"robot": ROBOT, "config": QUICK, "methods": METHODS, "budget_s": budget_s, **changed}
    with pytest.raises(OutputExists, match=said) as error:
        close(data, out=out, resume=True, **asked)
    assert "--overwrite" in error.value.hint
    assert {path: path.read_bytes() for path in (tmp_path / "all").rglob("*") if path.is_file()} == before


@pytest.mark.long
def test_before_there_is_a_fit_another_question_is_refused_too(data, tmp_path):
    out = tmp_path / "out"
    quick(data, out, until="gap", budget_s=900.0)
    with pytest.raises(OutputExists, match="another configuration"):
        quick(data, out, config=None, until="gap", budget_s=900.0, resume=True)
    given = Dataset(data)
    with DatasetWriter.create(tmp_path / "fewer", given.info) as writer:
        for name in given.ids[:-1]:
            writer.append(given.episode(name))
    with pytest.raises(OutputExists, match="another data or splits"):
        quick(tmp_path / "fewer", out, until="gap", resume=True)


@pytest.mark.slow
def test_beginning_anew_leaves_nothing_of_another_configuration(closed, tmp_path):
    data = shutil.copytree(closed.dataset.path, tmp_path / "data")
    out = shutil.copytree(closed.dataset.path.parent / "out", tmp_path / "out")
    (out / "checkpoints").mkdir()
    first = quick(data, out, config=OTHER, until="gap", overwrite=True)
    assert {step.name: step.status for step in first.result.steps} == {"replay": "done", "gap": "done"}
    gone = {"fit.json", "check.json", "identify.yaml", "explain.yaml", "networks", "checkpoints"}
    assert not gone & {path.name for path in out.iterdir()}
    done = quick(data, out, config=OTHER, resume=True)  # the old networks are not in its way
    assert {step.name: step.status for step in done.result.steps} == {
        "replay": "kept",
        "gap": "done",
        **dict.fromkeys(("check", "explain", "identify", "augment"), "done"),
    }
    assert IdentifyConfig.load(out / "identify.yaml") == OTHER


@pytest.mark.long
def test_other_splits_are_refused_before_any_is_given(data, tmp_path):
    logs, out = tmp_path / "logs", tmp_path / "out"
    export_dataset(data, logs)
    shares = {"train": 0.6, "val": 0.2, "test": 0.2}
    close(logs, ROBOT, out, until="import", splits=shares)
    before, given = files_in(out), dict(Dataset(out / "dataset").splits)
    own = tmp_path / "split.json"
    own.write_text(json.dumps({"train": list(given)}))
    for other in ({"train": 0.4, "val": 0.3, "test": 0.3}, own, None):
        with pytest.raises(OutputExists, match=r"another splits \(--splits\)"):
            close(logs, ROBOT, out, until="import", splits=other, resume=True)
        assert files_in(out) == before
    assert close(logs, ROBOT, out, until="import", splits=shares, resume=True).imported.kept == len(given)


def test_splits_that_cannot_be_read_leave_nothing_behind(data, tmp_path):
    logs = tmp_path / "logs"
    export_dataset(data, logs)
    own = tmp_path / "split.json"
    for content in ("", '{"training": []}'):
        own.write_text(content)
        with pytest.raises((DataError, FormatError)):
            close(logs, ROBOT, tmp_path / "out", until="import", splits=own)
        with pytest.raises((DataError, FormatError)):
            import_logs(logs, tmp_path / "imported", splits=own)
        assert not (tmp_path / "out").exists()
        assert not (tmp_path / "imported").exists()


@pytest.mark.parametrize(("motions", "counts"), [(5, (0, 0, 0)), (6, (4, 1, 1)), (7, (5, 1, 1))])
def test_logs_that_do_not_say_what_to_hold_out(data, tmp_path, motions, counts):
    (tmp_path / "logs").mkdir()
    episodes = list(Dataset(data))
    for number in range(motions):
        episode = episodes[number % len(episodes)]
        arrays = {f"measured.{name}": values for name, values in episode.measured.signals.items()}
        arrays |= {f"command.{name}": values for name, values in episode.command.signals.items()}
        stamps = {"measured.time_s": episode.measured.time_s, "command.time_s": episode.command.time_s}
        joints = np.array(episode.measured.joints)
        np.savez(tmp_path / "logs" / f"m{number}.npz", joints=joints, robot=np.array("demo_arm"), **stamps, **arrays)
    closed = close(tmp_path / "logs", ROBOT, tmp_path / "out", until="import")
    splits = list(closed.dataset.splits.values())
    assert tuple(splits.count(split) for split in ("train", "val", "test")) == counts
    assert any("no splits given" in note for note in closed.imported.notes) == (motions >= 6)
    import_logs(tmp_path / "logs", tmp_path / "imported")  # an import alone draws nothing
    assert not {*Dataset(tmp_path / "imported").splits.values()} - {""}


@pytest.mark.long
def test_a_dataset_is_split_anew_when_it_is_asked_for(data, tmp_path):
    shutil.copytree(data, tmp_path / "other")
    quick(tmp_path / "other", tmp_path / "out", splits={"train": 0.5, "test": 0.5}, until="gap")
    assert set(Dataset(tmp_path / "other").splits.values()) == {"train", "test"}
    assert {*Dataset(data).splits.values()} != {"train", "test"}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"format": "sage"}, "is a dataset, so import options do not apply"),
        ({"options": ImportOptions(measured_topic="/x")}, "is a dataset, so import options do not apply"),
        ({"overwrite": True, "resume": True}, "--overwrite begins anew and --resume goes on"),
    ],
)
def test_options_that_would_count_for_nothing_are_refused(data, tmp_path, given, said):
    with pytest.raises(ConfigError, match=said):
        quick(data, tmp_path / "out", **given)
    assert not (tmp_path / "out").exists()


def test_logs_of_another_robot_are_refused_before_all_of_them_are_read(data, tmp_path):
    export_dataset(data, tmp_path / "logs")
    with pytest.raises(NameMismatch, match=r"no joint of the log is one of the robot's.*shoulder.*Rotation") as error:
        close(tmp_path / "logs", load_robot("so101"), tmp_path / "out", until="import")
    assert "Is --robot the robot of these logs?" in error.value.hint
    assert not (tmp_path / "out").exists()


def test_a_run_of_another_robot_is_replaced_and_that_is_said(data, tmp_path):
    assert "in place of" not in quick(data, tmp_path / "one", until="replay").result.step("replay").what
    assert "in place of" not in quick(data, tmp_path / "two", until="replay").result.step("replay").what
    other = close(data, replace(ROBOT, name="other"), tmp_path / "three", until="replay")
    assert "in place of the run mujoco/stock of another robot" in other.result.step("replay").what


@pytest.mark.parametrize("wrong", [{"budget_s": 0.0}, {"budget_s": -3.0}, {"methods": ("magic",)}, {"until": "import"}])
def test_what_makes_no_sense_is_refused_before_anything_is_written(data, tmp_path, wrong):
    with pytest.raises(ConfigError):
        quick(data, tmp_path / "out", **wrong)
    assert not (tmp_path / "out").exists()


# --- time ---


def test_a_step_has_its_part_of_what_is_left(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    budget = Budget(100.0, STEPS)
    now[0] += 20.0  # import, replay and gap took long
    assert budget.of("identify").left_s == pytest.approx(80.0 * 0.55)
    now[0] += 50.0  # and the fit longer than it was given
    assert budget.of("augment").left_s == pytest.approx(30.0 * 0.35 / 0.45)
    now[0] += 10.0
    assert budget.of("explain").left_s == pytest.approx(20.0 * 0.05 / 0.1)
    assert Budget(None, STEPS).of("explain") is None
    # Who asks for less gives the rest more.
    assert Budget(100.0, STEPS[:6]).of("identify").left_s == pytest.approx(100.0 * 0.55 / 0.65)
    assert Budget(100.0, STEPS[:5]).of("explain").left_s == pytest.approx(100.0 * 0.05 / 0.1)


@given(
    budget_s=st.floats(20.0, 1000.0),
    replay_s=st.floats(0.1, 100.0),
    measure_s=st.floats(0.1, 50.0),
    until=st.sampled_from(["explain", "identify", "augment"]),
)
def test_a_budget_holds_whatever_cannot_be_cut(budget_s, replay_s, measure_s, until):
    """Steps that use their time to the end, and then do what cannot be cut; the first have theirs before `explain`."""
    now = [0.0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "monotonic", lambda: now[0])
        asked = STEPS[: STEPS.index(until) + 1]
        budget = Budget(budget_s, asked)
        now[0] += replay_s + measure_s
        budget.took(replay_s=replay_s, measure_s=measure_s)
        for step in (name for name in ("identify", "augment", "explain") if name in asked):
            limit = budget.of(step)
            if limit.left_s < 2.0:
                continue  # it is left out
            now[0] = limit.ends_at
            if step == "identify":
                now[0] += 1.5 * replay_s + 1.5 * measure_s
            if step == "augment":
                now[0] += 4.0 * measure_s
    assert now[0] <= max(1.15 * budget_s, replay_s + measure_s) + 1e-6


def test_what_was_asked_for_is_not_left_out_so_as_to_end_early(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    for replay_s, part_s in ((10.0, 25.0 * 0.55 / 0.65), (19.0, 6.0), (20.0, 6.0), (30.0, 0.0)):
        now[0] = 0.0
        budget = Budget(60.0, STEPS[:6])
        budget.took(replay_s=replay_s, measure_s=4.0)
        now[0] += replay_s + 4.0
        assert budget.of("identify").left_s == pytest.approx(part_s, abs=1e-6), replay_s
        assert budget.of("explain").left_s <= max(0.0, 60.0 - now[0])


def test_a_time_limit_counts_down_and_stays_at_zero(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    limit = TimeLimit.after(10.0)
    assert (limit.left_s, limit.spent, limit.over) == (10.0, 0.0, False)
    now[0] = 4.0
    assert (limit.left_s, limit.spent) == pytest.approx((6.0, 0.4))
    assert limit.share(0.5).left_s == pytest.approx(3.0)
    assert limit.until(0.7).left_s == pytest.approx(3.0)
    assert limit.sooner(2.0).left_s == pytest.approx(4.0)
    assert limit.sooner(20.0).over
    now[0] = 11.0
    assert (limit.left_s, limit.spent, limit.over) == (0.0, 1.0, True)
    assert TimeLimit.after(0.0).over


def test_with_little_time_less_motion_is_fitted(recorded):
    data, config = Dataset(recorded), IdentifyConfig()
    moved_s = sum(data.index.column("duration_s").to_pylist())

    def motion_s(seconds, replay_s):
        limit = None if seconds is None else TimeLimit.after(seconds)
        return fitted_motion(config, ROBOT, data, replay_s, limit).data.budget_s

    assert motion_s(None, 1.0) == config.data.budget_s
    assert motion_s(1e5, 1.0) == config.data.budget_s
    assert motion_s(1.0, 1.0) == 20.0
    # 20 derivatives of 21 parameters, in 600 s, of a simulator that takes 1 s for all motions.
    assert motion_s(600.0, 1.0) == pytest.approx(600.0 / (20 * 21) * moved_s, abs=5.0)


@pytest.mark.long
def test_with_no_time_it_ends_all_the_same(data, tmp_path):
    done = quick(data, tmp_path / "out", config=None, methods=("realeasy-rt",), budget_s=0.001)
    assert [step.status for step in done.result.steps] == ["done", "done", "done", "left out", "left out", "left out"]
    assert [rung.name for rung in done.ladder.rungs] == ["command", "stock"]
    assert "no time was left" in build_report(tmp_path / "out")
    assert lacking(done) == [f"no time was left for {step}" for step in ("identify", "augment")]
    assert exit_code(done) == 3
    asked = quick(data, tmp_path / "asked", config=None, budget_s=0.001, until="explain")
    assert lacking(asked) == ["no time was left for explain"]
    # What was not asked for is not missed.
    fewer = quick(data, tmp_path / "fewer", config=None, budget_s=0.001, until="gap")
    assert lacking(fewer) == []


@pytest.mark.slow
def test_what_was_asked_for_comes_before_its_explanation(data, tmp_path, monkeypatch):
    begun = []
    watch = Watch(on_step=begun.append)
    done = quick(data, tmp_path / "out", until="identify", watch=watch)
    assert begun == ["replay", "gap", "check", "identify", "explain"]
    assert [step.name for step in done.result.steps] == ["replay", "gap", "check", "explain", "identify"]
    assert [step.status for step in done.result.steps] == ["done"] * 5
    # Without time for the fit there is none to explain, however much is left.
    left = {"identify": 0.0, "explain": 1000.0}
    monkeypatch.setattr(Budget, "of", lambda _, step: TimeLimit.after(left[step]))
    none = quick(data, tmp_path / "none", until="identify", budget_s=1000.0)
    assert [(step.name, step.status) for step in none.result.steps[2:]] == [
        ("check", "done"),
        ("explain", "left out"),
        ("identify", "left out"),
    ]


@pytest.mark.long
def test_an_explanation_for_which_the_time_did_not_suffice_is_left_out(data, tmp_path, monkeypatch):
    monkeypatch.setattr(Budget, "of", lambda *_: TimeLimit.after(1000.0))
    monkeypatch.setattr(close_steps, "explain", without_time(close_steps.explain))
    done = quick(data, tmp_path / "out", until="explain", budget_s=1000.0)
    assert done.result.step("explain").status == "left out"
    assert done.attribution is None
    assert not (tmp_path / "out" / "explain.json").exists()
    assert exit_code(done) == 3


def without_time(explain):
    def explained(*args, limit, **options):
        return explain(*args, limit=TimeLimit.after(0.0), **options)

    return explained


@pytest.mark.slow
def test_with_little_time_it_ends_with_what_it_has(data, tmp_path, monkeypatch):
    # What is explained needs no search, but how long its simulations take depends on what else the machine does.
    monkeypatch.setattr(Budget, "of", lambda _, step: TimeLimit.after(1000.0 if step == "explain" else 2.5))
    done = quick(data, tmp_path / "out", config=None, methods=("realeasy-rt",), budget_s=100.0)
    *first, last = [step.status for step in done.result.steps]
    assert first == ["done", "done", "done", "done", "cut short"]  # a fit that was cut short is explained all the same
    assert last in ("cut short", "done")  # so small a network may have learned all that it can by then
    assert any("no time was left to try richer models" in note for note in done.notes)
    assert done.identified.fit.status == "not-converged"
    assert (tmp_path / "out" / "identify.yaml").is_file()  # what was fitted in that time
    assert [rung.name for rung in done.ladder.rungs] == ["command", "stock", "fitted", "fitted+realeasy-rt"]
    said = build_report(tmp_path / "out").partition("cut short by the time limit")[0][-50:]
    assert "identify" in said
    assert "explain" not in said
    # The same again, with whatever time, keeps what is there, and it stays what it is.
    again = quick(data, tmp_path / "out", config=None, methods=("realeasy-rt",), budget_s=500.0, resume=True)
    assert [step.status for step in again.result.steps] == [
        "kept",
        "done",
        "kept",
        "kept",
        *first[4:],
        "kept" if last == "done" else last,
    ]
    assert again.result.step("explain").seconds == done.result.step("explain").seconds


# --- close.json ---


def test_the_report_says_how_long_all_of_it_took_and_what_did_not_go_to_the_end():
    done = CloseResult((Step("gap", "done", 20.0, ""), Step("explain", "done", 30.0, "")), "explain", 90.0)
    assert time_words(done) == "50\N{NO-BREAK SPACE}s in all, of 90\N{NO-BREAK SPACE}s that were given"
    assert steps_alert(done) == ""
    assert alone_words(done) == "The command of a step that is done gives the same alone."
    measured = replace(done, measuring_s=10.0)
    assert measured.seconds == 60.0
    assert "60\N{NO-BREAK SPACE}s in all, the last measurement included, of 90" in time_words(measured)
    # The time is that of one call, the steps are those of several.
    again = replace(measured, steps=tuple(step.of_earlier_call for step in measured.steps))
    assert [step.status for step in again.steps] == ["kept", "kept"]
    assert time_words(again).endswith("included, in several calls")
    bad = replace(done, steps=(*done.steps, Step("identify", "cut short", 9.0, ""), Step("augment", "failed", 1.0, "")))
    assert steps_alert(bad) == (
        "2\N{NO-BREAK SPACE}steps of this result did not go to the end: "
        "augment failed; identify cut short by the time limit."
    )
    assert "had less time" in alone_words(bad)
    learned = replace(done, networks={f"{STOCK}+moving-average": "a", f"{STOCK}+realeasy": "b"})
    assert "under a budget" in alone_words(learned)
    assert bad.steps[2].of_earlier_call == bad.steps[2]


def test_close_json_is_read_back_and_refuses_what_it_is_not(closed, tmp_path):
    file = closed.dataset.path.parent / "out" / "close.json"
    read = CloseResult.load(file)
    assert [step.name for step in read.steps] == [step.name for step in closed.result.steps]
    assert read.networks == closed.result.networks
    read.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == file.read_bytes()
    tree = json.loads(file.read_text())
    for change, error in (({"schema": "trueup.close/2"}, FormatError), ({"until": "tomorrow"}, DataError)):
        (tmp_path / "close.json").write_text(json.dumps({**tree, **change}))
        with pytest.raises(error):
            CloseResult.load(tmp_path / "close.json")


@pytest.mark.slow
@pytest.mark.parametrize("after", ["replay", "explain", "identify", "augment"])
def test_killed_in_any_step_it_goes_on(recorded, closed, tmp_path, after):
    """`kill -9` when a step has begun; the same call again gives what an uninterrupted one gives."""
    data = shutil.copytree(recorded, tmp_path / "data")
    script = (
        "import os, signal\n"
        "from pathlib import Path\n"
        "from tests_of_closing import METHODS, QUICK, ROBOT\n"
        "from trueup.stages import Watch, close\n"
        "def watch(name):\n"
        f"    if name == {after!r}: os.fork() or (__import__('time').sleep(0.6), os.kill(os.getppid(), signal.SIGKILL))\n"
        f"close(Path({str(data)!r}), ROBOT, Path({str(tmp_path / 'out')!r}), config=QUICK, methods=METHODS, jobs=2,\n"
        "      resume=True, watch=Watch(on_step=watch))\n"
    )
    shutil.copy(__file__, tmp_path / "tests_of_closing.py")
    folders = [str(tmp_path), str(Path(__file__).parent.parent), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, folders))}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode in (-signal.SIGKILL, 0), done.stderr
    again = quick(data, tmp_path / "out", resume=True)
    for rung, other in zip(again.ladder.rungs, closed.ladder.rungs, strict=True):
        assert rung.name == other.name
        for split in ("train", "val", "test"):
            value, expected = (item.splits[split]["position"]["rmse"].total.value for item in (rung, other))
            assert value == pytest.approx(expected, rel=1e-9)
    assert np.isfinite(again.result.step("identify").seconds)
