"""Each step of a close alone gives the same: by the commands that docs/close.md names, with the default kind of budget."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from safetensors.numpy import load_file

import trueup.augment.config
from trueup.augment import preset
from trueup.cli.main import main
from trueup.core.close_result import CloseResult
from trueup.core.fit_result import FitResult
from trueup.core.results import GapResult, Ladder
from trueup.identify import IdentifyConfig
from trueup.stages import FITTED, demo_dataset

ASKED = {"fit": {"delay_s": "all", "kp": "all"}, "schema": "trueup.identify/1"}
METHODS = ("moving-average", "realeasy-rt")


def small(method):
    """A network that learns for two epochs."""
    found = preset(method)
    if method == "realeasy-rt":
        found = replace(found, epochs=2, network=replace(found.network, hidden=(4, 3)))
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A close within ten minutes, of which it needs one; beside a copy of its data."""
    folder = tmp_path_factory.mktemp("alone")
    shutil.copytree(demo_dataset(folder / "data"), folder / "copy")
    (folder / "asked.yaml").write_text(yaml.safe_dump(ASKED))
    assert close(folder, "--method", METHODS[0], "--budget", "10m") == 0
    shutil.copy(folder / "out" / "close.json", folder / "first.json")
    return folder


@pytest.fixture(scope="module")
def learned(folder):
    """The same, and a network that learns, without a limit."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trueup.augment.config, "preset", small)
        given = [word for method in METHODS for word in ("--method", method)]
        assert close(folder, *given, "--budget", "none", "--resume") == 0
    return folder


def close(folder, *given, out="out"):
    said = ("--robot", "demo_arm", "--config", folder / "asked.yaml", "--jobs", "2", "--out", folder / out)
    return run("close", folder / "data", *said, *given)


def run(*words):
    with pytest.raises(SystemExit) as left:
        main([str(word) for word in words])
    return left.value.code


def out_of(folder, name):
    return json.loads((folder / name).read_text())


@pytest.mark.long
def test_all_steps_are_done_on_less_motion_than_was_asked_for(folder):
    first = CloseResult.load(folder / "first.json")
    assert {step.status for step in first.steps} == {"done"}
    assert first.budget_s == 600.0
    config = IdentifyConfig.load(folder / "out" / "identify.yaml")
    assert replace(config, data=IdentifyConfig().data) == IdentifyConfig.load(folder / "asked.yaml")
    assert not (folder / "out" / "explain.yaml").exists(), "the numbers of the fit are explained"


@pytest.mark.slow
def test_explain_alone(folder):
    assert close(folder, "--until", "explain", out="short") == 0
    config = folder / "short" / "explain.yaml"
    asked = IdentifyConfig.load(folder / "asked.yaml")
    assert replace(IdentifyConfig.load(config), data=IdentifyConfig().data) == asked
    options = ("--explain", "--config", config, "--robot", "demo_arm", "--jobs", "2")
    assert run("gap", folder / "data", "--runs", "mujoco/stock", *options, "--out", folder / "why") == 0
    alone, within, fitted = (out_of(folder / name, "explain.json") for name in ("why", "short", "out"))
    for tree in (alone, within):
        del tree["provenance"]
    assert alone == within
    # A rough search of its own comes to about the same shares as the fit.
    for cause, share in fitted["shares_total"].items():
        assert within["shares_total"][cause] == pytest.approx(share, abs=0.05)
    gap, whole = (GapResult.load(folder / name / "gap.json").to_json() for name in ("why", "out"))
    assert gap["runs"]["mujoco/stock"] == whole["runs"]["mujoco/stock"]


@pytest.mark.slow
def test_identify_alone(folder):
    """On a copy of the data, which has no runs."""
    options = ("--config", folder / "out" / "identify.yaml", "--robot", "demo_arm", "--jobs", "2")
    assert run("identify", folder / "copy", *options, "--out", folder / "fit") == 0
    alone, within = (FitResult.load(folder / name / "fit.json") for name in ("fit", "out"))
    assert alone.parameters == within.parameters
    assert (alone.status, alone.statements) == (within.status, within.statements)
    gap, whole = (GapResult.load(folder / name / "gap.json").to_json() for name in ("fit", "out"))
    assert gap["runs"] == {label: whole["runs"][label] for label in gap["runs"]}
    assert set(gap["runs"]) == {"command", "mujoco/stock", FITTED}
    ladder, rungs = (
        {rung.name: rung.splits for rung in Ladder.load(folder / name / "ladder.json").rungs} for name in ("fit", "out")
    )
    assert ladder == {name: rungs[name] for name in ("command", "stock", "fitted")}


@pytest.mark.long
def test_a_network_alone(folder):
    assert_alone_as_within(folder, METHODS[0])


@pytest.mark.slow
def test_another_method_adds_a_network_which_alone_is_the_same(learned):
    folder = learned
    result = CloseResult.load(folder / "out" / "close.json")
    assert {step.name: step.status for step in result.steps} == {
        "replay": "kept",
        "gap": "done",
        "explain": "kept",
        "identify": "kept",
        "augment": "done",
    }
    names = [rung.name for rung in Ladder.load(folder / "out" / "ladder.json").rungs]
    assert names == ["command", "stock", "moving-average", "fitted", *(f"fitted+{method}" for method in METHODS)]
    assert_alone_as_within(folder, METHODS[1])


def assert_alone_as_within(folder, method):
    config = folder / f"{method}.yaml"
    config.write_text(yaml.safe_dump(small(method).to_json()))
    options = ("--run", FITTED, "--robot", "demo_arm", "--config", config, "--name", method, "--jobs", "2")
    assert run("augment", "train", folder / "data", *options, "--out", folder / method) == 0
    within = folder / "out" / CloseResult.load(folder / "out" / "close.json").networks[f"{FITTED}+{method}"]
    alone, other = (load_file(path / "weights.safetensors") for path in (folder / method, within))
    assert alone.keys() == other.keys()
    for name, weights in alone.items():
        np.testing.assert_array_equal(weights, other[name])


@pytest.mark.long
def test_what_explain_fits_is_not_taken_without_it(folder, capsys):
    assert run("gap", folder / "data", "--config", folder / "asked.yaml") == 2
    assert "--explain" in capsys.readouterr().err
