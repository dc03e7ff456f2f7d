"""All rungs of a close: the same results as step by step, within a time, and nothing lost when something fails."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from trueup.augment import preset
from trueup.core.attribution import Attribution
from trueup.core.close_result import STEPS, CloseResult
from trueup.core.fit_result import FitResult
from trueup.core.results import GapResult, Ladder
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset, DatasetWriter
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import ConfigError, DataError, FormatError, MissingDependency, OutputExists
from trueup.identify import IdentifyConfig
from trueup.identify.config import DataChoice, SolverChoice
from trueup.report import build_report
from trueup.robots import load_robot
from trueup.stages import (
    FITTED,
    STOCK,
    Watch,
    augment,
    close,
    close_networks,
    demo_dataset,
    explain,
    export_dataset,
    fit,
)
from trueup.stages.close_budget import Budget, fitted_motion

ROBOT = load_robot("demo_arm")
# Two quantities, little motion: a fit of seconds.
QUICK = IdentifyConfig(
    fit={"delay_s": "all", "kp": "all"},
    data=DataChoice(budget_s=12.0),
    solver=SolverChoice(max_iterations=4),
)
METHODS = ("moving-average",)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return demo_dataset(tmp_path_factory.mktemp("recorded") / "data")


@pytest.fixture(scope="module")
def closed(recorded, tmp_path_factory):
    data = shutil.copytree(recorded, tmp_path_factory.mktemp("closed") / "data")
    return close(data, ROBOT, data.parent / "out", config=QUICK, methods=METHODS, jobs=2)


@pytest.fixture
def data(recorded, tmp_path):
    return shutil.copytree(recorded, tmp_path / "data")


def quick(data, out, **options):
    return close(data, ROBOT, out, **{"config": QUICK, "methods": METHODS, "jobs": 2, **options})


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


def test_each_step_alone_gives_the_same(closed, recorded, tmp_path):
    """`trueup gap --explain`, `identify` and `augment train`, on a copy of the data."""
    data = Dataset(shutil.copytree(recorded, tmp_path / "data"))
    out = closed.dataset.path.parent / "out"
    alone = fit(data, ROBOT, tmp_path / "fit", config=QUICK, jobs=2)
    kept = FitResult.load(out / "fit.json")
    assert alone.fit.parameters == kept.parameters
    assert alone.fit.status == kept.status
    causes = explain(data, ROBOT, config=QUICK, jobs=2)
    assert causes.shares_total == pytest.approx(Attribution.load(out / "explain.json").shares_total)
    made = augment([data], tmp_path / "network", run=FITTED, config=preset("moving-average"), robot=ROBOT)
    folder = out / closed.result.networks[f"{FITTED}+moving-average"]
    assert (made.folder / "weights.safetensors").read_bytes() == (folder / "weights.safetensors").read_bytes()


def test_a_second_call_keeps_what_is_there(closed, tmp_path):
    out = shutil.copytree(closed.dataset.path.parent, tmp_path / "copy") / "out"
    before = {name: (out / name).read_bytes() for name in ("fit.json", "explain.json")}
    with pytest.raises(OutputExists, match="not empty"):
        quick(out.parent / "data", out)
    again = quick(out.parent / "data", out, resume=True)
    assert {step.status for step in again.result.steps if step.name not in ("gap",)} == {"kept"}
    assert {name: (out / name).read_bytes() for name in before} == before
    assert [rung.name for rung in again.ladder.rungs] == [rung.name for rung in closed.ladder.rungs]
    for rung, other in zip(again.ladder.rungs, closed.ladder.rungs, strict=True):
        assert rung.splits == other.splits
    # What they took when they were made.
    assert again.result.step("identify").seconds == closed.result.step("identify").seconds


@pytest.mark.parametrize(
    ("until", "last", "rungs"),
    [("replay", "gap", 2), ("gap", "gap", 2), ("explain", "explain", 2), ("identify", "identify", 3)],
)
def test_it_ends_where_it_was_asked_to_end(data, tmp_path, until, last, rungs):
    done = quick(data, tmp_path / "out", until=until)
    assert done.result.steps[-1].name == last
    assert len(done.ladder.rungs) == rungs
    assert (tmp_path / "out" / "fit.json").is_file() == (until == "identify")
    assert not (tmp_path / "out" / "networks").exists()
    # And goes on from there.
    if until == "explain":
        whole = quick(data, tmp_path / "out", resume=True)
        assert [step.status for step in whole.result.steps] == ["kept", "done", "kept", "done", "done"]


def test_logs_are_imported_first(closed, tmp_path):
    export_dataset(closed.dataset.path, tmp_path / "logs")
    mapping = ImportOptions(mapping=tmp_path / "logs" / "mapping.yaml")
    seen = []
    done = quick(tmp_path / "logs", tmp_path / "out", until="gap", options=mapping, watch=Watch(on_step=seen.append))
    assert seen == ["import", "replay", "gap"]
    assert done.imported is not None
    assert done.result.step("import").what == "12 motions"
    assert done.dataset.path == tmp_path / "out" / "dataset"


def test_a_step_that_fails_is_said_and_the_others_go_on(data, tmp_path):
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
    assert "no train split to fit" in build_report(tmp_path / "out")


def test_without_torch_the_networks_are_left_out_and_said_how_to_get(data, tmp_path, monkeypatch):
    def missing(*_, **__):
        raise MissingDependency("training needs torch", hint="pip install 'trueup[learn]'")

    monkeypatch.setattr(close_networks, "augment", missing)
    done = quick(data, tmp_path / "out")
    last = done.result.steps[-1]
    assert (last.name, last.status) == ("augment", "left out")
    assert "trueup[learn]" in last.what
    assert [rung.name for rung in done.ladder.rungs] == ["command", "stock", "fitted"]


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


def test_results_of_other_inputs_are_not_replaced_unasked(closed, tmp_path):
    data = shutil.copytree(closed.dataset.path, tmp_path / "data")
    out = shutil.copytree(closed.dataset.path.parent / "out", tmp_path / "out")
    other = replace(QUICK, data=DataChoice(budget_s=13.0))
    with pytest.raises(OutputExists, match="fitted to other data"):
        quick(data, out, config=other, resume=True)
    assert FitResult.load(out / "fit.json") == FitResult.load(closed.dataset.path.parent / "out" / "fit.json")
    done = quick(data, out, config=other, overwrite=True)
    assert {step.status for step in done.result.steps} == {"done", "kept"}  # the replay is the same
    assert done.result.step("identify").status == "done"


@pytest.mark.parametrize("wrong", [{"budget_s": 0.0}, {"budget_s": -3.0}, {"methods": ("magic",)}])
def test_what_makes_no_sense_is_refused_before_anything_is_written(data, tmp_path, wrong):
    with pytest.raises(ConfigError):
        quick(data, tmp_path / "out", **wrong)
    assert not (tmp_path / "out").exists()


# --- time ---


def test_a_step_has_its_part_of_what_is_left(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    budget = Budget(100.0, STEPS)
    assert budget.of("explain").left_s == pytest.approx(15.0)
    now[0] += 60.0  # replays took long, and the explanation longer than it was given
    assert budget.of("identify").left_s == pytest.approx(40.0 * 0.5 / 0.85)
    now[0] += 10.0
    assert budget.of("augment").left_s == pytest.approx(30.0 * 0.3 / 0.35)
    assert Budget(None, STEPS).of("explain") is None
    # Who asks for less gives the rest more.
    assert Budget(100.0, STEPS[:5]).of("explain").left_s == pytest.approx(100.0 * 0.15 / 0.7)


def test_a_time_limit_counts_down_and_stays_at_zero(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    limit = TimeLimit.after(10.0)
    assert (limit.left_s, limit.spent, limit.over) == (10.0, 0.0, False)
    now[0] = 4.0
    assert (limit.left_s, limit.spent) == pytest.approx((6.0, 0.4))
    assert limit.share(0.5).left_s == pytest.approx(3.0)
    assert limit.until(0.7).left_s == pytest.approx(3.0)
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


def test_with_no_time_it_ends_all_the_same(data, tmp_path):
    done = quick(data, tmp_path / "out", config=None, methods=("realeasy-rt",), budget_s=0.001)
    assert [step.status for step in done.result.steps] == ["done", "done", "left out", "left out", "left out"]
    assert [rung.name for rung in done.ladder.rungs] == ["command", "stock"]
    assert "no time was left" in build_report(tmp_path / "out")


def test_with_little_time_it_ends_with_what_it_has(data, tmp_path, monkeypatch):
    monkeypatch.setattr(Budget, "of", lambda *_: TimeLimit.after(2.5))
    done = quick(data, tmp_path / "out", config=None, methods=("realeasy-rt",), budget_s=100.0)
    *first, last = [step.status for step in done.result.steps]
    assert first == ["done", "done", "cut short", "cut short"]
    assert last in ("cut short", "done")  # so small a network may have learned all that it can by then
    assert any("time limit" in note for note in done.notes)
    assert any("no time was left to try richer models" in note for note in done.notes)
    assert done.identified.fit.status == "not-converged"
    assert (tmp_path / "out" / "identify.yaml").is_file()  # what was fitted in that time
    assert [rung.name for rung in done.ladder.rungs] == ["command", "stock", "fitted", "fitted+realeasy-rt"]
    # The same again, with whatever time, keeps what is there.
    again = quick(data, tmp_path / "out", config=None, methods=("realeasy-rt",), budget_s=500.0, resume=True)
    assert {step.status for step in again.result.steps if step.name != "gap"} == {"kept"}


# --- close.json ---


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
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode in (-signal.SIGKILL, 0), done.stderr
    again = quick(data, tmp_path / "out", resume=True)
    for rung, other in zip(again.ladder.rungs, closed.ladder.rungs, strict=True):
        assert rung.name == other.name
        for split in ("train", "val", "test"):
            value, expected = (item.splits[split]["position"]["rmse"].total.value for item in (rung, other))
            assert value == pytest.approx(expected, rel=1e-9)
    assert np.isfinite(again.result.step("identify").seconds)
