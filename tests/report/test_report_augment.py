"""The section of learned corrections: words, tables and figures say what augment.json says."""

import math
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from augment.evaluation_cases import card_of
from report.packed import read_json
from report.run_folders import World, simulate
from trueup.augment.evaluation import Candidate, EvaluationBuilder
from trueup.core.attention import AttentionProfile
from trueup.core.augment_result import ALL_JOINTS, ANY_CONDITION, AugmentResult, Cut, ModelPair, Pooled, Reliability
from trueup.core.close_result import CloseResult
from trueup.core.episode import EpisodeMeta
from trueup.core.results import Estimate, MetricResult
from trueup.core.step_times import StepTimes
from trueup.core.traces import TraceSet
from trueup.errors import ConfigError, DataError, FormatError
from trueup.measure import Comparison
from trueup.report import build_report
from trueup.report.augment_figures import (
    attention_figure,
    factor_figure,
    latency_figure,
    motion_figure,
    reliability_figure,
)
from trueup.report.augment_words import against, factor_interval, lead, off_sentences, sentences
from trueup.report.folder import RunFolder
from trueup.report.palette import run_styles
from trueup.report.sections.attention import attention_sentences
from trueup.report.sections.augmentation import augmentation_section, shown_traces, told_signal, typical_motion

FAR = {"far": 0.02, "far_correction": (0.0, 0.05), "far_probability": (0.0, 1.0)}
CONDITIONS = ["multi-joint", "multi-joint", "cartesian"]


def evaluation(world):
    """The second run of a world taken for a correction of the first."""
    says = {("position", joint): {**FAR, "interval": (0.05, 0.1)} for joint in world.joints}
    says["torque", world.joints[0]] = {"gate": 0.0, "reason": "no better on val"}
    card = card_of("good-net", joints=world.joints, outputs=says)
    builder = EvaluationBuilder(world.runs[0], [Candidate(world.runs[1], card)], scored_joints=world.scored)
    for number, (name, (measured, _, simulated)) in enumerate(world.series.items()):
        meta = EpisodeMeta(name, condition=CONDITIONS[number % 3], split="test")
        builder.add(Comparison(meta, measured, simulated))
    return builder.result(split="test", draws=300, notes=["mind <this>"])


@pytest.fixture(scope="module")
def world():
    return simulate(World())


@pytest.fixture(scope="module")
def result(world):
    return evaluation(world)


@pytest.fixture(scope="module")
def folder(run_folder, result, tmp_path_factory):
    path = shutil.copytree(run_folder, tmp_path_factory.mktemp("augmented") / "run")
    result.save(path / "augment.json")
    return path


@pytest.fixture(scope="module")
def run(folder):
    return RunFolder.load(folder)


def chooser_data(page, name):
    """The data of one chooser as the page's script reads them."""
    found = re.search(rf'id="{name}">.*?class="chooser-data">(.*?)</script>', page, re.S)
    return read_json(found.group(1))


def test_the_page_has_the_section_only_with_its_file(folder, run_folder):
    page = build_report(folder)
    assert '<section id="augmentation"' in page
    assert "mind &lt;this&gt;" in page
    assert "good-net leaves torque of shoulder_pan as simulated: no better on val." in page
    assert build_report(folder) == page
    assert '<section id="augmentation"' not in build_report(run_folder)


def test_after_a_close_the_signal_comes_first_that_its_rungs_are_chosen_by(run, result):
    assert told_signal(run, result) == "torque"
    closed = replace(run, close=CloseResult((), "augment"))
    assert told_signal(closed, result) == "position"
    context = augmentation_section(closed).context
    assert "position error" in context["lead"] or "position goes" in context["lead"]
    assert context["cuts"].default[1] == "position"


def test_tables_hold_the_numbers_of_the_file(folder, result):
    data = chooser_data(build_report(folder), "cuts-chooser")
    assert [menu["name"] for menu in data["menus"]] == ["Motions", "Signal", "Error"]
    assert data["default"] == ["multi-joint", "torque", "mse"]
    table = data["variants"]["cartesian"]["position"]["rmse"]["tables"]["cuts"]
    assert table["columns"] == ["Joint", "simulation", "good-net"]
    assert [row["head"] for row in table["rows"]] == ["shoulder_pan", "elbow_flex", "gripper", "all joints"]
    cut = result.models[0].cuts["cartesian"]["position"]["elbow_flex"]
    (simulation, corrected) = table["rows"][1]["cells"]
    assert float(simulation["text"]) == pytest.approx(
        result.simulated["cartesian"]["position"]["elbow_flex"].rmse.value, rel=5e-3
    )
    assert float(corrected["text"]) == pytest.approx(cut.rmse.value, rel=5e-3)
    assert corrected["note"] == factor_interval(cut.factor)
    off = data["variants"]["cartesian"]["torque"]["mse"]["tables"]["cuts"]["rows"][0]["cells"][1]
    assert (off["note"], off["tone"]) == ("switched off", "undecided")


def test_words_follow_the_verdict(result):
    model = result.models[0]

    def with_cut(**changes):
        cuts = {name: {s: dict(j) for s, j in signals.items()} for name, signals in model.cuts.items()}
        for name in cuts:
            cuts[name]["torque"][ALL_JOINTS] = replace(cuts[name]["torque"][ALL_JOINTS], **changes)
        return replace(model, cuts=cuts)

    assert "cuts the torque error of mujoco/stock from" in lead(result, with_cut(verdict="better"))
    assert "good-net does not help" in lead(result, with_cut(verdict="worse"))
    assert "not decided" in lead(result, with_cut(verdict="undecided"))
    factor = Estimate(20.0, "1", 10.0, 40.0)
    lines = sentences(result, with_cut(verdict="better", factor=factor))
    assert lines[0].startswith("Multi-joint motions (6): torque MSE 20.0 times smaller (10.0 to 40.0), from ")
    assert sentences(result, with_cut(verdict="undecided", factor=factor))[0].endswith("; undecided.")


def test_harm_is_named_joint_by_joint(result):
    model = result.models[0]
    quiet = {
        name: {
            signal: {joint: replace(cut, verdict="better") for joint, cut in cuts.items()}
            for signal, cuts in signals.items()
        }
        for name, signals in model.cuts.items()
    }
    assert sentences(result, replace(model, cuts=quiet))[-1].startswith("It makes no signal of any joint worse")
    bad = replace(quiet["cartesian"]["position"]["gripper"], verdict="worse")
    quiet["cartesian"]["position"]["gripper"] = bad
    expected = "It makes worse for sure: position of gripper (cartesian)."
    assert sentences(result, replace(model, cuts=quiet))[-1] == expected


def test_networks_against_each_other_read_both_ways(result):
    pair = ModelPair("b", "a", ANY_CONDITION, "torque", Estimate(4.0, "1", 2.0, 8.0), "better")
    both = replace(result, pairs=(pair,))
    assert against(both, "b", "a", ANY_CONDITION, "torque") == (pair.factor, "better")
    factor, verdict = against(both, "a", "b", ANY_CONDITION, "torque")
    assert (factor.value, factor.low, factor.high, verdict) == (0.25, 0.125, 0.5, "worse")
    assert against(both, "a", "c", ANY_CONDITION, "torque") == (None, "")
    rival = replace(result.models[0], name="a")
    named = replace(both, models=(replace(rival, name="b"), rival))
    assert "Against a, the next best: 4.00 times smaller (2.00 to 8.00)." in sentences(named, named.models[0])


def closed_with_two(run, result, *, split="test"):
    """Two networks: `first` is better on the motions that are shown, `second` was on val."""
    model = result.models[0]
    cuts = {name: dict(signals) for name, signals in model.cuts.items()}
    total = cuts[ANY_CONDITION]["position"][ALL_JOINTS]
    better = replace(total, mse=replace(total.mse, value=0.5 * total.mse.value))
    cuts[ANY_CONDITION]["position"] = {**cuts[ANY_CONDITION]["position"], ALL_JOINTS: better}
    labels = {"first": "mujoco/stock+first", "second": "mujoco/stock+second"}
    both = (
        replace(model, name="first", run=labels["first"], cuts=cuts),
        replace(model, name="second", run=labels["second"]),
    )
    card = card_of("net", joints=result.joints)
    runs = {
        labels[name]: {"val": {"position": {"rmse": MetricResult(Estimate(error, "rad"), {}, 4)}}}
        for name, error in (("first", 0.2), ("second", 0.1))
    }
    pair = ModelPair("second", "first", ANY_CONDITION, "position", Estimate(0.5, "1", 0.4, 0.6), "worse")
    return replace(
        run,
        close=CloseResult((), "augment", networks={label: f"networks/{name}" for name, label in labels.items()}),
        networks=dict.fromkeys(labels.values(), card),
        gap=replace(run.gap, runs={**run.gap.runs, **runs}),
        augment=replace(result, models=both, pairs=(pair,), split=split),
    )


def test_after_a_close_the_page_speaks_of_the_network_that_val_chose(run, result):
    """The judged motions decide nothing, not even which network the page begins with."""
    closed = closed_with_two(run, result)
    assert closed.augment.best("position").name == "first"
    context = augmentation_section(closed).context
    assert context["lead"].startswith(("second ", "It is not decided whether second "))
    assert context["sentences"][0] == "Of 2 networks it is the best on validation motions."
    assert any(line.startswith("Against first, the next best: ") for line in context["sentences"])


@pytest.mark.parametrize("closed", [False, True])
def test_a_network_that_is_the_best_on_the_shown_motions_owns_up_to_it(run, result, closed):
    """Those of `augment eval` alone, and the val motions of a close without test motions."""
    shown = closed_with_two(run, result, split="val" if closed else "test")
    shown = shown if closed else replace(shown, close=None, networks={})
    signal = told_signal(shown, shown.augment)
    context = augmentation_section(shown).context
    assert shown.augment.best(signal).name in context["lead"]
    assert "too kind" in context["sentences"][0]
    alone = replace(shown, augment=replace(shown.augment, models=shown.augment.models[:1]))
    assert "too kind" not in augmentation_section(alone).context["sentences"][0]


def test_all_joints_that_are_off_are_named_together(result):
    model = result.models[0]
    gated = tuple(replace(model.gated[0], joint=joint) for joint in result.joints)
    (line,) = off_sentences(replace(result, models=(replace(model, gated=gated),)))
    assert line == "good-net leaves torque of all joints as simulated: no better on val."


def test_the_motion_that_is_shown_has_the_median_cut(run, result, world):
    model = result.models[0]
    found, factor = typical_motion(run, result, model, "multi-joint", "torque")
    factors = {}
    for number, (name, (measured, _, simulated)) in enumerate(world.series.items()):
        if CONDITIONS[number % 3] == "multi-joint":
            before, after = (((measured["torque"] - simulated[label]["torque"]) ** 2)[:, :2] for label in world.runs)
            factors[name] = before.mean(axis=0).sum() / after.mean(axis=0).sum()
    assert factor == pytest.approx(factors[found])
    assert sorted(factors.values())[len(factors) // 2] == pytest.approx(factor)
    assert typical_motion(run, result, model, "walking", "torque") is None


def test_curves_of_a_motion_are_those_that_were_kept(run, world):
    styles = run_styles(world.runs)
    motion = next(iter(run.traces.episodes.values()))
    traces = shown_traces(motion, "torque", world.runs[0])
    figure = motion_figure(traces, world.runs[0], {"good-net": world.runs[1]}, styles, shown="good-net")
    names = [curve["name"] for curve in figure["data"]]
    assert names == ["measured", "simulated", "good-net"] * len(world.joints)
    assert figure["data"][3]["y"] == pytest.approx(traces[1].curves["measured"].tolist(), rel=1e-3, abs=1e-6)
    assert all("visible" not in curve for curve in figure["data"])
    other = motion_figure(traces, world.runs[0], {"good-net": world.runs[1]}, styles, shown="another")
    assert {curve.get("visible") for curve in other["data"] if curve["name"] == "good-net"} == {"legendonly"}
    used = {curve["yaxis"] for curve in figure["data"]}
    assert used == {"y", "y2", "y3"}
    assert {"yaxis", "yaxis2", "yaxis3"} <= figure["layout"].keys()


def cut(value, low=None, high=None, verdict="better"):
    return Cut(Estimate(1.0, "(Nm)^2"), Estimate(1.0, "Nm"), Estimate(value, "1", low, high), verdict)


def test_factors_are_drawn_within_the_axis_and_what_is_no_number_is_not():
    styles = run_styles(["one", "two"])
    cuts = {
        "one": {"a": cut(10.0, 5.0, 20.0), "b": cut(2.0, 0.0, 1e6), "c": cut(math.nan)},
        "two": {"a": cut(0.5, 0.4, None), "b": cut(3.0)},
    }
    figure = factor_figure(["a", "b", "c"], cuts, styles)
    low, high = (10**end for end in figure["layout"]["xaxis"]["range"])
    first, second = figure["data"]
    assert first["x"] == [10.0, 2.0]
    assert [round(place) for place in first["y"]] == [0, 1]
    assert first["y"][0] < second["y"][0]
    assert 0 < low < 0.5
    assert 20 < high < 100
    for curve in (first, second):
        for x, up, down in zip(curve["x"], curve["error_x"]["array"], curve["error_x"]["arrayminus"], strict=True):
            assert low * 0.99 <= x - down
            assert x + up <= high * 1.01
    assert second["error_x"]["array"][1] == 0.0


def test_reliability_is_drawn_in_percent():
    curve = Reliability((0.1, 0.8), (Estimate(0.2, "1", 0.1, 0.4), Estimate(0.7, "1")), (0.9, 0.1), 0.25, 0.1, 0.5)
    figure = reliability_figure({"net": curve}, run_styles(["net"]))
    drawn = figure["data"][1]
    assert (drawn["x"], drawn["y"]) == ([10.0, 80.0], [20.0, 70.0])
    assert drawn["error_y"]["array"] == pytest.approx([20.0, 0.0])
    assert drawn["error_y"]["arrayminus"] == pytest.approx([10.0, 0.0])


def test_times_are_drawn_as_shares_of_all_steps(run, result):
    times = StepTimes(
        4, 10.0, 30.0, 30.0, 31.0, ((8.0, 12.5, 2), (12.5, 18.0, 1), (25.0, 36.0, 1)), 1000.0, 0, "a machine"
    )
    figure = latency_figure({"net": times}, run_styles(["net"]))
    assert figure["data"][0]["x"] == [10.0, 15.0, None, 30.0]
    assert figure["data"][0]["y"] == [50.0, 25.0, None, 25.0]
    assert figure["layout"]["shapes"][0]["x0"] == 1000.0
    timed = replace(run, augment=replace(result, models=(replace(result.models[0], latency=times),)))
    chooser = augmentation_section(timed).context["latency"]
    assert [cell.text for cell in chooser.shown.tables["latency"].rows[0].cells][-2:] == ["4", "0"]
    assert augmentation_section(run).context["latency"] is None


def test_too_little_coverage_is_marked(run, result):
    chooser = augmentation_section(run).context["coverage"]
    assert list(chooser.default) == ["multi-joint", "position"]
    rows = chooser.shown.tables["coverage"].rows
    share = result.models[0].coverage["multi-joint"]["position"]["gripper"].share
    cell = rows[2].cells[0]
    assert cell.text.startswith(f"{100 * share.value:.0f}" if share.value < 0.995 else "100")
    assert (cell.tone == "worse") == (share.high < 0.9)
    assert "reliability" in chooser.shown.figures


def test_a_network_with_too_few_val_motions_promises_nothing(run, result):
    heads = []
    for note in ("", "2 val motions; 9 are needed to promise 90 % coverage"):
        noted = replace(result, models=(replace(result.models[0], coverage_note=note),))
        chooser = augmentation_section(replace(run, augment=noted)).context["coverage"]
        heads.append(chooser.shown.tables["coverage"].columns[1])
    assert heads == [
        "good-net, promised 90\N{NO-BREAK SPACE}%",
        "good-net, meant to be 90\N{NO-BREAK SPACE}%, nothing promised",
    ]


def test_all_joints_are_off_where_all_scored_ones_are(run, result):
    model = result.models[0]
    gated = tuple(replace(model.gated[0], joint=joint) for joint in result.scored_joints)
    off = replace(result, models=(replace(model, gated=gated),))
    notes = []
    for shown in (result, off):
        table = augmentation_section(replace(run, augment=shown)).context["cuts"].shown.tables["cuts"]
        (row,) = [row for row in table.rows if row.head == "all joints"]
        notes.append(row.cells[-1].note)
    assert notes[0] != notes[1] == "switched off"


def test_a_file_of_another_measurement_is_refused(folder, result, tmp_path):
    path = shutil.copytree(folder, tmp_path / "run")
    replace(result, run="dart/stock").save(path / "augment.json")
    with pytest.raises(DataError, match="runs that were not measured"):
        RunFolder.load(path)
    replace(result, motions={**result.motions, "waving": 1}).save(path / "augment.json")
    with pytest.raises(DataError, match="groups of motions differ"):
        RunFolder.load(path)


def test_names_of_networks_cannot_break_the_page(folder, result, tmp_path):
    path = shutil.copytree(folder, tmp_path / "run")
    evil = "</script><img src=x>"
    model = replace(result.models[0], name=evil)
    replace(result, models=(model,)).save(path / "augment.json")
    assert evil not in build_report(path)


def test_a_section_without_curves_or_intervals_still_has_its_tables(run, result):
    bare = replace(result.models[0], coverage={}, reliability={}, gated=())
    section = augmentation_section(replace(run, traces=None, augment=replace(result, models=(bare,))))
    assert section.context["cuts"] is not None
    assert section.context["motion"] is None
    assert section.context["coverage"] is None
    assert augmentation_section(replace(run, augment=replace(result, models=()))) is None


def test_many_joints_show_the_worst_ones_in_their_order():
    joints = tuple(f"j{number}" for number in range(12))
    world = simulate(World(joints=joints, scored=joints, names=("chirp",), splits=("test",), samples=400))
    measured, command, simulated = world.series["chirp"]
    traces = TraceSet()
    traces.add("chirp", "test", measured, command, simulated)
    shown = [trace.joint for trace in shown_traces(traces.episodes["chirp"], "position", world.runs[0])]
    errors = ((measured["position"] - simulated[world.runs[0]]["position"]) ** 2).mean(axis=0)
    expected = {joints[column] for column in np.argsort(errors)[-8:]}
    assert set(shown) == expected
    assert shown == [joint for joint in joints if joint in expected]


def test_every_run_has_a_style_of_its_own():
    styles = run_styles([f"mujoco/stock+{number}" for number in range(14)])
    assert len({(item.color, item.symbol) for item in styles.values()}) == 15


def test_pooled_errors_survive_the_file(folder, result):
    again = AugmentResult.load(folder / "augment.json")
    assert again.simulated["cartesian"]["torque"]["gripper"] == result.simulated["cartesian"]["torque"]["gripper"]
    assert isinstance(again.simulated["cartesian"]["torque"]["gripper"], Pooled)


def looking(shares=(0.4, 0.1, 0.1, 0.1, 0.3), oldest=(0.3, 0.29, 0.31), **changes):
    """A profile of 4 samples at 250 Hz."""
    return AttentionProfile(
        **{
            "rate_hz": 250.0,
            "mean": shares,
            "low": tuple(0.9 * share for share in shares),
            "high": tuple(1.1 * share for share in shares),
            "motions": 5,
            "half_s": Estimate(0.004, "s", 0.003, 0.005),
            "oldest": Estimate(oldest[0], "1", *oldest[1:]),
            **changes,
        }
    )


def test_where_a_network_looks_is_shown_in_time(folder, result, tmp_path):
    path = shutil.copytree(folder, tmp_path / "run")
    with_profile = replace(result, models=(replace(result.models[0], attention=looking()),))
    with_profile.save(path / "augment.json")
    assert AugmentResult.load(path / "augment.json").models[0].attention == looking()
    page = build_report(path)
    assert "Where it looks in the past" in page
    assert "Where it looks in the past" not in build_report(folder)
    shown = chooser_data(page, "attention-chooser")["variants"]
    band, curve, alike = shown["figures"]["attention"]["data"]
    assert curve["x"] == [0.0, -4.0, -8.0, -12.0, -16.0]
    assert curve["y"] == pytest.approx([40.0, 10.0, 10.0, 10.0, 30.0])
    assert band["y"] == pytest.approx([44.0, 11.0, 11.0, 11.0, 33.0, 27.0, 9.0, 9.0, 9.0, 36.0])
    assert alike["y"] == [20.0, 20.0]
    (row,) = shown["tables"]["attention"]["rows"]
    texts = [cell["text"].replace("\N{NO-BREAK SPACE}", " ") for cell in row["cells"]]
    assert texts == ["16.0 ms", "4.00 ms", "40 %", "30 %", "5"]


def test_networks_with_other_histories_have_no_common_line():
    profiles = {"one": looking(), "two": looking((0.5, 0.0, 0.5), rate_hz=100.0)}
    figure = attention_figure(profiles, run_styles(["one", "two"]))
    assert [curve.get("name") for curve in figure["data"]] == [None, "one", None, "two"]
    assert all(value > 0 for curve in figure["data"] for value in curve["y"])  # on a log axis
    assert figure["layout"]["xaxis"]["title"]["text"] == "time before the present sample [ms]"


@pytest.mark.parametrize(
    ("oldest", "words"),
    [
        ((0.3, 0.29, 0.45), ""),
        ((0.4, 0.36, 0.45), "a longer history is worth a try"),
        ((0.4, None, None), "a longer history is worth a try"),
        ((0.02, 0.01, 0.04), "a shorter history may do"),
        ((0.04, 0.01, 0.06), ""),
    ],
)
def test_what_a_profile_says_of_the_history_holds_over_the_interval(result, oldest, words):
    models = (replace(result.models[0], attention=looking(oldest=oldest)), result.models[0])
    (line,) = attention_sentences(replace(result, models=models))
    start, _, rest = line.replace("\N{NO-BREAK SPACE}", " ").partition("oldest quarter.")
    assert start.startswith(
        "good-net sees 16.0 ms back (4 samples); half of its attention lies on the last 4.00 ms (1 sample)"
    )
    assert words in rest
    assert bool(words) == bool(rest)


def test_files_from_before_profiles_are_read_and_broken_profiles_are_not(result):
    content = result.to_json()
    del content["models"][0]["attention"]
    assert AugmentResult.from_json(content).models[0].attention is None
    for change in (
        {"mean": [0.4, 0.1]},
        {"mean": [0.4, 0.1, 0.1, 0.1, 0.1]},
        {"low": [-0.1, 0.1, 0.1, 0.1, 0.3]},
        {"mean": ["0.4", 0.1, 0.1, 0.1, 0.3]},
        {"motions": 0},
        {"rate_hz": 0.0},
        {"more": 1},
    ):
        content = replace(result, models=(replace(result.models[0], attention=looking()),)).to_json()
        content["models"][0]["attention"] |= change
        with pytest.raises((ConfigError, DataError, FormatError)):
            AugmentResult.from_json(content)
