"""A close that goes on, or begins anew, from one that was interrupted: never with results of another."""

import shutil
from dataclasses import replace

import pytest

from stages.closes import OTHER, QUICK, ROBOT, files_in, quick
from trueup.cli.close import exit_code
from trueup.core.close_result import STEPS
from trueup.dataset import Dataset, DatasetWriter
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import DataError, OutputExists, TrueupError
from trueup.identify.config import DataChoice, SolverChoice
from trueup.report.sections.steps import time_words
from trueup.robots.spec import PayloadSpec
from trueup.stages import Watch, demo, export_dataset
from trueup.stages.close_asked import asked_of_data, refuse_other
from trueup.stages.identifying import explain_inputs

# Of an earlier close, what must not pass for that of another.
OLD = ("fit.json", "identify.yaml", "explain.json")


class Killed(BaseException):
    """What no handler of errors sees, as a signal."""


def killed_in(step):
    def on_step(name):
        if name == step:
            raise Killed

    return Watch(on_step=on_step)


@pytest.fixture
def both(closed, tmp_path):
    """Data and results, to be changed."""
    shutil.copytree(closed.dataset.path.parent, tmp_path / "all")
    return tmp_path / "all" / "data", tmp_path / "all" / "out"


@pytest.fixture
def of_logs(recorded, closed, tmp_path):
    """Logs, and a folder with a close of them that has a fit."""
    export_dataset(recorded, tmp_path / "logs")
    options = {"options": ImportOptions(mapping=tmp_path / "logs" / "mapping.yaml"), "until": "gap"}
    quick(tmp_path / "logs", tmp_path / "out", **options)
    for name in OLD:
        shutil.copy(closed.dataset.path.parent / "out" / name, tmp_path / "out")
    return tmp_path / "logs", tmp_path / "out", options


def names_in(folder):
    return {path.name for path in folder.iterdir()}


# --- beginning anew


@pytest.mark.long
@pytest.mark.parametrize("step", ["import", "replay"])
def test_interrupted_before_there_are_new_results_the_old_ones_do_not_pass_for_them(of_logs, step):
    logs, out, options = of_logs
    before = {name: (out / name).read_bytes() for name in (*OLD, "gap.json", "close.json")}
    with pytest.raises(Killed):
        quick(logs, out, config=OTHER, overwrite=True, watch=killed_in(step), **options)
    assert {name: (out / name).read_bytes() for name in before} == before
    with pytest.raises(OutputExists, match="another configuration"):
        quick(logs, out, resume=True, **options)
    done = quick(logs, out, config=OTHER, resume=True, **options)
    assert not {*OLD, ".trueup-replacing.json"} & names_in(out)
    assert {item.name: item.status for item in done.result.steps} == {
        "import": "done" if step == "import" else "kept",
        "replay": "done",
        "gap": "done",
    }
    again = quick(logs, out, config=OTHER, resume=True, **options)
    assert [item.status for item in again.result.steps] == ["kept", "kept", "done"]


@pytest.mark.long
def test_more_time_is_for_a_new_fit_though_the_call_was_interrupted(both):
    data, out = both
    with pytest.raises(Killed):
        quick(data, out, budget_s=3600.0, overwrite=True, watch=killed_in("replay"))
    assert (out / "fit.json").is_file()
    quick(data, out, budget_s=3600.0, until="gap", resume=True)
    assert not {*OLD, "networks"} & names_in(out)


@pytest.mark.long
@pytest.mark.parametrize("what", ["logs of nothing", "no replay"])
def test_a_call_that_fails_before_it_has_made_anything_costs_no_results(both, monkeypatch, what):
    data, out = both
    source = data
    if what == "logs of nothing":
        source = data.parent / "logs"
        source.mkdir()
    else:

        def none(*_, **__):
            raise DataError("no episode could be replayed")

        monkeypatch.setattr("trueup.stages.close_steps.replay_unless_same", none)
    before = files_in(data.parent)
    with pytest.raises(TrueupError):
        quick(source, out, config=OTHER, overwrite=True)
    assert files_in(data.parent) == before
    monkeypatch.undo()
    again = quick(data, out, resume=True)
    assert {step.status for step in again.result.steps if step.name != "gap"} == {"kept"}


@pytest.mark.long
def test_an_import_that_begins_anew_ends_what_was_made_of_the_old_one(of_logs):
    logs, out, options = of_logs
    quick(logs, out, config=OTHER, overwrite=True, **{**options, "until": "import"})
    assert not {*OLD, "gap.json", "ladder.json", ".trueup-replacing.json"} & names_in(out)


@pytest.mark.long
def test_a_demo_that_was_interrupted_while_it_recorded_does_not_show_the_old_fit(closed, tmp_path):
    out = tmp_path / "out"
    demo(out, robot="demo_arm", until="gap")
    for name in OLD:
        shutil.copy(closed.dataset.path.parent / "out" / name, out)

    def killed(items, what, count):
        raise Killed

    with pytest.raises(Killed):
        demo(out, robot="demo_arm", until="gap", overwrite=True, track=killed)
    assert (out / "fit.json").is_file()
    demo(out, robot="demo_arm", until="gap", resume=True)
    assert not {*OLD, ".trueup-replacing.json"} & names_in(out)


@pytest.mark.slow
@pytest.mark.parametrize("step", STEPS[1:])
def test_interrupted_in_any_step_after_overwrite_it_ends_as_an_uninterrupted_one(closed, tmp_path, step):
    whole, part = (shutil.copytree(closed.dataset.path.parent, tmp_path / name) for name in ("whole", "part"))
    asked = {"config": replace(QUICK, solver=SolverChoice(max_iterations=2))}
    expected = quick(whole / "data", whole / "out", overwrite=True, **asked)
    with pytest.raises(Killed):
        quick(part / "data", part / "out", overwrite=True, watch=killed_in(step), **asked)
    found = quick(part / "data", part / "out", resume=True, **asked)
    assert found.identified.fit.values == expected.identified.fit.values
    assert found.identified.fit.values != closed.identified.fit.values
    for rung, other in zip(found.ladder.rungs, expected.ladder.rungs, strict=True):
        assert (rung.name, rung.splits, rung.chosen) == (other.name, other.splits, other.chosen)
    names = [{path.relative_to(base) for path in files_in(base / "out")} for base in (whole, part)]
    assert names[0] == names[1]


# --- going on


@pytest.mark.long
def test_logs_with_more_motions_are_refused_before_any_is_added(recorded, tmp_path):
    logs, out = tmp_path / "logs", tmp_path / "out"
    export_dataset(recorded, logs)
    later = max(path.parent for path in logs.rglob("measured.csv"))
    later.rename(tmp_path / later.name)
    options = {"options": ImportOptions(mapping=logs / "mapping.yaml")}
    quick(logs, out, until="import", **options)
    (tmp_path / later.name).rename(later)
    quick(logs, out, until="gap", resume=True, **options)  # nothing was made of fewer yet
    assert len(Dataset(out / "dataset")) == 12
    another = shutil.copytree(later, later.with_name("another"))
    before = files_in(out)
    with pytest.raises(OutputExists, match=r"holds motions that .*dataset has not.*another"):
        quick(logs, out, until="gap", resume=True, **options)
    assert files_in(out) == before
    shutil.rmtree(another)
    assert quick(logs, out, until="gap", resume=True, **options).result.step("replay").status == "kept"


@pytest.mark.slow
def test_a_look_at_the_gap_keeps_the_windows_of_a_fit_and_what_was_measured_in_them(data, tmp_path):
    out, config = tmp_path / "out", replace(QUICK, data=DataChoice(window_s=1.0, burn_in_s=0.0, budget_s=12.0))
    quick(data, out, config=config, until="identify")
    before = {name: (out / name).read_bytes() for name in ("gap.json", "ladder.json")}
    less = quick(data, out, config=config, until="gap", resume=True)
    assert less.result.step("replay").status == "kept"
    assert {name: (out / name).read_bytes() for name in before} == before


def test_other_payloads_are_other_motions_for_a_robot_that_carries_them(data):
    carrying, given = replace(ROBOT, payload=PayloadSpec(("hand",))), Dataset(data)
    with DatasetWriter.create(data.parent / "heavier", given.info) as writer:
        for episode in given:
            load = episode.meta.payload_kg
            writer.append(replace(episode, meta=replace(episode.meta, payload_kg=load and load + 0.1)))
    heavier = Dataset(data.parent / "heavier")
    assert heavier.hash == given.hash

    def said(robot):
        options = {"model": None, "config": None, "seed": 0}
        return [(asked_of_data(own, robot, None), explain_inputs(own, robot, **options)) for own in (given, heavier)]

    assert len({text for _, text in said(ROBOT)}) == 1
    assert len({text for _, text in said(carrying)}) == 2
    refuse_other(data, *(asked for asked, _ in said(ROBOT)))
    with pytest.raises(OutputExists, match="another payload of motions"):
        refuse_other(data, *(asked for asked, _ in said(carrying)))


def test_the_run_that_a_dataset_came_with_is_not_one_of_an_earlier_close(data, tmp_path):
    assert quick(data, tmp_path / "one", until="replay").result.step("replay").status == "done"
    first = quick(data, tmp_path / "two", until="replay").result
    (step,) = first.steps
    assert (step.status, step.what) == ("done", "12 motions simulated with the original model, as the dataset has them")
    assert "several calls" not in time_words(first)
    assert first.provenance["data_hash"] == Dataset(data).hash
    assert quick(data, tmp_path / "two", until="replay", resume=True).result.step("replay").status == "kept"


@pytest.mark.long
def test_a_motion_that_the_identified_model_cannot_replay_is_exit_code_2(closed):
    assert exit_code(closed) == 0
    stock, fitted = closed.identified.replayed
    lost = replace(fitted, failed={"m1": DataError("the simulation diverged")})
    bad = replace(closed, identified=replace(closed.identified, replayed=(stock, lost)))
    assert (exit_code(bad), exit_code(bad, skip_bad=True)) == (2, 0)
