"""The verdict says what the numbers say, and no more."""

import math
from dataclasses import replace

import pytest

from trueup.core.episode import Flag
from trueup.core.quality import EpisodeQuality, Quality
from trueup.core.results import Estimate, GapResult, Ladder, MetricResult, PairedDifference, Rung
from trueup.report.sections.ladder import ladder_chooser
from trueup.report.sections.verdict import quality_sentence, tiles
from trueup.report.verdict import (
    compare,
    extreme_joints,
    find_headline,
    gap_sentence,
    joints_sentence,
    stock_label,
    turned,
)


def result(value, low=None, high=None, episodes=6, joints=(0.5, 1.5)):
    per_joint = {name: Estimate(value * share, "rad") for name, share in zip("abc", joints, strict=False)}
    return {"position": {"rmse": MetricResult(Estimate(value, "rad", low, high), per_joint, episodes)}}


def difference(run, baseline, value, low, high, relative, verdict, split="test"):
    estimate = Estimate(value, "rad", low, high)
    return PairedDifference(run, baseline, split, "position", "rmse", estimate, relative, verdict)


def gap(runs, **more):
    return GapResult(runs=runs, joints=("a", "b"), scored_joints=("a", "b"), **more)


def plain(text):
    return text.replace("\N{NO-BREAK SPACE}", " ")


SO101 = gap(
    {
        "command": {"test": result(0.0383, 0.024, 0.053), "val": result(0.0284, episodes=4)},
        "mujoco/stock": {"test": result(0.0365, 0.022, 0.051), "val": result(0.0273, episodes=4)},
    },
    paired=(difference("mujoco/stock", "command", -0.0018, -0.0071, 0.0035, -0.047, "undecided"),),
)


def test_the_sentence_of_the_stock_arm():
    headline = find_headline(SO101)
    assert plain(gap_sentence(headline, SO101)) == (
        "On 6 test motions the simulator mujoco/stock misses the measured position by 0.0365 rad (2.09°) RMSE, "
        "averaged over 2 joints (95 % interval 0.0220 to 0.0510 rad)."
    )
    comparison = compare(headline, "command", SO101)
    assert comparison.tone == "undecided"
    assert plain(comparison.sentence) == (
        "That is 4.7 % less than taking the command as the motion (0.0383 rad), but undecided: "
        "the 95 % interval of the difference, −0.00710 to +0.00350 rad, includes zero."
    )


@pytest.mark.parametrize(
    ("value", "low", "high", "relative", "verdict", "words"),
    [
        (
            -0.02,
            -0.03,
            -0.01,
            -0.52,
            "better",
            "52 % less than taking the command as the motion (0.0383 rad), clearly better",
        ),
        (
            0.02,
            0.01,
            0.03,
            0.52,
            "worse",
            "52 % more than taking the command as the motion (0.0383 rad), clearly worse",
        ),
        (0.0, -0.01, 0.01, 0.0, "undecided", "no more and no less than taking the command as the motion"),
    ],
)
def test_decided_differences_say_so(value, low, high, relative, verdict, words):
    paired = (difference("mujoco/stock", "command", value, low, high, relative, verdict),)
    comparison = compare(find_headline(SO101), "command", replace(SO101, paired=paired))
    assert words in plain(comparison.sentence)
    assert comparison.tone == verdict


def test_one_motion_has_no_interval_and_decides_nothing():
    single = gap(
        {"command": {"test": result(0.04, episodes=1)}, "x/stock": {"test": result(0.02, episodes=1)}},
        paired=(difference("x/stock", "command", -0.02, None, None, -0.5, "undecided"),),
    )
    headline = find_headline(single)
    assert plain(gap_sentence(headline, single)).startswith("On 1 test motion the simulator x/stock misses")
    assert "no interval: a single motion does not show how much motions differ" in gap_sentence(headline, single)
    sentence = compare(headline, "command", single).sentence
    assert "decides nothing" in sentence
    assert "clearly" not in sentence
    assert tiles(headline, [], None)[0].note.endswith("no interval")


def test_tiles_say_what_the_best_rung_brings_with_the_interval_that_it_rests_on():
    runs = {
        **SO101.runs,
        "mujoco/fitted": {"test": result(0.0146, 0.009, 0.021), "val": result(0.0110, episodes=4)},
    }
    paired = (
        difference("mujoco/fitted", "mujoco/stock", -0.0219, -0.0301, -0.0137, -0.6, "better"),
        difference("mujoco/fitted", "command", -0.0237, -0.05, 0.002, -0.62, "undecided"),
    )
    judged = replace(SO101, runs=runs, paired=paired)
    headline = find_headline(judged)
    shown = tiles(headline, [compare(headline, label, judged) for label in ("command", "mujoco/stock")], None)
    stock, command = shown[1:]
    assert (stock.title, plain(stock.value), stock.tone) == ("Against the model as it came", "−60 %", "better")
    assert plain(stock.note) == "▼ better · −0.0301 to −0.0137 rad"
    assert (command.title, command.tone) == ("Against the command", "undecided")
    assert plain(command.note) == "≈ undecided · −0.0500 to +0.0020 rad"
    # The model as it came is not compared with itself.
    own = find_headline(SO101)
    assert [tile.title for tile in tiles(own, [compare(own, "command", SO101)], None)][1:] == ["Against the command"]


@pytest.mark.parametrize(
    ("run", "labels", "found"),
    [
        ("dart/fitted+net", ["command", "mujoco/stock", "dart/stock"], "dart/stock"),
        ("sage/fitted", ["mujoco/stock", "dart/stock"], "mujoco/stock"),
        ("mujoco/fitted", ["command", "mujoco/stock+net"], ""),
    ],
)
def test_the_model_as_it_came_is_that_of_the_same_engine(run, labels, found):
    assert stock_label(run, labels) == found


def test_without_a_paired_comparison_nothing_is_claimed():
    comparison = compare(find_headline(SO101), "command", replace(SO101, paired=()))
    assert comparison.tone == "untested"
    assert comparison.ratio == pytest.approx(0.0365 / 0.0383 - 1)
    assert "not compared motion by motion" in comparison.sentence


def test_a_comparison_stored_the_other_way_is_turned():
    other = turned(difference("command", "mujoco/stock", 0.02, 0.01, 0.03, 1.0, "worse"))
    assert (other.run, other.baseline, other.verdict) == ("mujoco/stock", "command", "better")
    assert (other.difference.value, other.difference.low, other.difference.high) == (-0.02, -0.03, -0.01)
    # command = 2 x stock, so stock is half of the command
    assert other.relative == pytest.approx(-0.5)


def three_runs(**values):
    return gap({name: {split: result(value) for split, value in splits.items()} for name, splits in values.items()})


def test_among_runs_the_one_chosen_on_validation_is_judged():
    runs = three_runs(command={"val": 0.5, "test": 0.5}, one={"val": 0.2, "test": 0.1}, two={"val": 0.1, "test": 0.2})
    headline = find_headline(runs)
    assert headline.run == "two"
    assert headline.result.total.value == 0.2
    assert "validation motions, on which it was chosen" in headline.reason


def test_a_choice_on_the_judged_motions_is_owned_up_to():
    headline = find_headline(three_runs(one={"all": 0.2}, two={"all": 0.1}))
    assert headline.run == "two"
    assert "too kind" in headline.reason


def test_the_chosen_rung_of_the_ladder_is_judged():
    runs = three_runs(**{"mujoco/stock": {"val": 0.1, "test": 0.1}, "mujoco/fitted": {"val": 0.2, "test": 0.2}})
    ladder = Ladder([Rung("stock", 1.0, {}), Rung("fitted", 9.0, {}, chosen=True)])
    assert find_headline(runs, ladder).run == "mujoco/fitted"


def test_a_ladder_without_test_motions_owns_up_to_it():
    """The rung was chosen on the motions that it is judged on."""
    runs = three_runs(**{"mujoco/stock": {"val": 0.2}, "mujoco/fitted": {"val": 0.1}})
    ladder = Ladder([Rung("stock", 1.0, {}), Rung("fitted", 9.0, {}, chosen=True)])
    headline = find_headline(runs, ladder)
    assert (headline.run, headline.split) == ("mujoco/fitted", "val")
    assert "too kind" in headline.reason


@pytest.mark.parametrize(
    ("splits", "words"),
    [
        (("train", "val", "test"), "Rungs are fitted on train, chosen on validation and judged on test."),
        (("train", "val"), "Rungs are fitted on train and chosen on validation. There are no test motions, so"),
        (("train", "test"), "Rungs are fitted on train and judged on test."),
        (("all",), "the change against the first rung."),
    ],
)
def test_the_ladder_says_what_its_motions_are_for(splits, words):
    rungs = [Rung(name, 1.0, {split: result(0.1) for split in splits}) for name in ("stock", "fitted")]
    chosen = replace(rungs[1], chosen="val" in splits)
    caption = ladder_chooser(Ladder([rungs[0], chosen])).shown.tables["ladder"].caption
    assert words in caption
    assert ("too kind" in caption) == (splits == ("train", "val"))
    assert ("judged on test" in caption) == ("test" in splits)


def test_a_run_with_an_undefined_error_is_never_the_best():
    runs = three_runs(one={"test": math.nan, "val": math.nan}, two={"test": 0.3, "val": 0.3})
    assert find_headline(runs).run == "two"
    undefined = three_runs(one={"test": math.nan})
    assert "not defined" in gap_sentence(find_headline(undefined), undefined)


def test_only_a_command_is_called_a_command():
    only = three_runs(command={"all": 0.1})
    assert "the command taken as the motion misses" in gap_sentence(find_headline(only), only)


def test_windows_are_mentioned():
    windows = replace(SO101, settings={"window_s": 0.5})
    assert "(restarted from the measured state every 0.5 s)" in gap_sentence(find_headline(windows), windows)


def test_no_rmse_no_headline():
    assert find_headline(gap({"x": {"test": {}}})) is None
    assert find_headline(gap({})) is None


def test_extreme_joints():
    headline = find_headline(SO101)
    worst, best = extreme_joints(headline, SO101)
    assert (worst.joint, best.joint) == ("b", "a")
    assert plain(joints_sentence(worst, best)) == (
        "The joint with the largest error is b, 0.0547 rad (3.14°); the one with the smallest is a, 0.0182 rad (1.05°)."
    )
    assert extreme_joints(headline, replace(SO101, scored_joints=("a",))) is None


@pytest.mark.parametrize(
    ("warned", "dropped", "words"),
    [
        (0, 0, "Quality checks raised no warning on 3 motions; none was left out."),
        (1, 0, "Of 3 motions, 1 carries a quality warning; none was left out."),
        (2, 1, "Of 3 motions, 2 carry a quality warning; 1 was left out."),
        (3, 2, "Of 3 motions, 3 carry a quality warning; 2 were left out."),
    ],
)
def test_quality_in_words(warned, dropped, words):
    episodes = {
        str(number): EpisodeQuality(
            "", (Flag("nan", severity="warning" if number < warned else "note"),), number < dropped
        )
        for number in range(3)
    }
    assert plain(quality_sentence(Quality(episodes))) == words
