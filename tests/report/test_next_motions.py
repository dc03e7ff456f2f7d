"""Motions to record next: lines that suit the fit, and what designed motions promise."""

import math
import shutil

import numpy as np
import pytest

from report.run_folders import World, add_identification, fit_parameters, make_fit, make_run
from trueup.core.design_result import DesignResult, Foreseen
from trueup.core.timeseries import TimeSeries, same_units
from trueup.core.traces import TraceSet
from trueup.report import build_report
from trueup.report.folder import RunFolder
from trueup.report.next_motions import (
    count_for,
    design_recipe,
    deviation_words,
    limit_options,
    promise_table,
    promised,
    unsure_parameters,
    usual_speed,
)

JOINTS = World().joints


@pytest.fixture(scope="module")
def small_folder(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("small") / "run", World(samples=200))


@pytest.fixture
def copied(small_folder, tmp_path):
    return shutil.copytree(small_folder, tmp_path / "run")


def options_of(lines):
    words = lines.split("trueup record")[0].replace("\\\n", " ").split()
    return dict(zip(words[2::2], words[3::2], strict=True))


def test_one_motion_for_each_kind_of_cause_and_one_more(copied):
    fit = make_fit(JOINTS, "not-identifiable")
    unsure = unsure_parameters(fit)
    assert {item.cause for item in unsure} == {"friction", "inertia"}
    assert [item.identified for item in unsure] == sorted((item.identified for item in unsure), key="no weakly".find)
    assert count_for(unsure) == 3
    run = RunFolder.load(add_identification(copied, fit, JOINTS))
    recipe = design_recipe(run, fit)
    given = options_of(recipe.lines)
    assert (given["--robot"], given["--fit"], given["--count"], given["--out"]) == (
        *("path/to/robot.yaml", "fit.json", "3", "plans"),
    )
    assert "friction and inertia" in recipe.text
    assert "put those of your robot" in recipe.text
    assert recipe.lines in build_report(copied).replace("&#34;", '"')


def test_nothing_is_proposed_where_all_is_known(copied):
    fit = make_fit(JOINTS, "ok")
    run = RunFolder.load(add_identification(copied, fit, JOINTS))
    assert design_recipe(run, fit) is None


def test_the_lines_take_what_the_fit_was_given(copied):
    """Whatever the robot is called, and whatever was fitted."""
    fit = make_fit(JOINTS, "not-identifiable")
    add_identification(copied, fit, JOINTS)
    for name in ("robot.stock.yaml", "fit.config.yaml"):
        (copied / name).write_text("")
    lines = design_recipe(RunFolder.load(copied), fit).lines
    assert lines.count("--robot robot.stock.yaml") == 3
    assert "trueup identify recorded --robot robot.stock.yaml --config fit.config.yaml --out identified" in lines


def test_limits_of_the_model_are_left_to_it(copied):
    fit = make_fit(JOINTS, "not-identifiable")
    add_identification(copied, fit, JOINTS)
    model = '<mujoco><custom><numeric name="velocity_limit" data="1 2 3"/></custom></mujoco>'
    (copied / "model.fitted.xml").write_text(model)
    run = RunFolder.load(copied)
    assert run.stated_limits == ("velocity",)
    given = options_of(design_recipe(run, fit).lines)
    assert "--velocity-limit" not in given
    assert "--acceleration-limit" in given


def test_the_speed_is_that_of_the_motions():
    """Two joints that turn with sines of known speed, and one that never moved."""
    time_s = np.arange(4001) * 0.005
    speeds = (2.0, 0.5)
    columns = [speed / (2 * math.pi) * np.sin(2 * math.pi * time_s) for speed in speeds]
    joints = ("a", "b", "still")
    position = np.stack([*columns, np.zeros_like(time_s)], axis=1)
    series = TimeSeries(time_s, joints, {"position": position}, same_units({"position": "rad"}, joints))
    traces = TraceSet(max_points=4001)
    traces.add("sines", "train", series, series, {})
    assert usual_speed(traces, joints) == pytest.approx(np.mean(speeds), rel=0.02)
    assert usual_speed(traces, ("still",)) is None
    assert usual_speed(None, joints) is None
    # The acceleration of a sine of 1 Hz that is as fast.
    assert limit_options(2.0) == " \\\n  --velocity-limit 2 --acceleration-limit 13"
    assert limit_options(2.0, stated=("velocity", "acceleration")) == ""
    assert limit_options(None) == ""


def design_of(fit, **changes):
    rows = [
        Foreseen(item.name, changes.get(item.name, item.value), item.unit, item.transform, 0.4, 0.1, None)
        for item in fit.free
    ]
    return DesignResult(tuple(rows), {"seed": 0})


def test_what_designed_motions_promise_stands_beside_what_is_known(copied):
    fit = make_fit(JOINTS, "not-identifiable")
    add_identification(copied, fit, JOINTS)
    (copied / "plans").mkdir()
    design_of(fit).save(copied / "plans" / "design.json")
    run = RunFolder.load(copied)
    design = promised(run)
    assert design == design_of(fit)
    row = promise_table(design).rows[[item.name for item in design.parameters].index("kp[elbow_flex]")]
    assert [cell.text.replace("\N{NO-BREAK SPACE}", " ") for cell in row.cells] == ["40 %", "–", "10 %"]
    assert row.cells[2].extra.startswith("−75")
    recipe = design_recipe(run, fit)
    assert recipe.lines.startswith("trueup record")  # they are designed
    page = build_report(copied)
    assert "Predicted standard deviations" in page
    # Of another fit they say nothing.
    design_of(fit, **{"kp[elbow_flex]": 1.0}).save(copied / "plans" / "design.json")
    assert promised(RunFolder.load(copied)) is None
    assert "Predicted standard deviations" not in build_report(copied)


@pytest.mark.parametrize(
    ("transform", "std", "words"),
    [
        ("log", 0.072, "7.2 %"),
        ("log", 1.0, "factor 2.7"),
        ("linear", 0.0034, "0.0034 Nm"),
        ("log", 90.0, "factor 4.9e8"),
    ],
)
def test_deviations_in_words(transform, std, words):
    item = Foreseen("x", 1.0, "Nm", transform, std, std, None)
    assert deviation_words(item, std).replace("\N{NO-BREAK SPACE}", " ") == words


def test_a_fit_of_many_unsure_numbers_names_the_worst(copied):
    fit = make_fit(JOINTS, "not-identifiable", fit_parameters(JOINTS, "not-identifiable"))
    run = RunFolder.load(add_identification(copied, fit, JOINTS))
    assert f"most of all {unsure_parameters(fit)[0].name}" in design_recipe(run, fit).text
