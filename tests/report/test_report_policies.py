"""Reports of policies: the numbers of the figures, the figures, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from trueup.core.policy_evaluation import (
    EPISODES_NAME,
    EVALUATION_NAME,
    JudgedGroup,
    JudgedPolicy,
    PlaceResult,
    PolicyEvaluation,
    load_curves,
    save_curves,
)
from trueup.core.results import Estimate, PairedDifference
from trueup.core.trials import Trial
from trueup.errors import DataError, FormatError
from trueup.report import build_report
from trueup.report.curves_page import build_curves
from trueup.report.episode_curves import chosen_episodes, cumulative, spread
from trueup.report.learning_curves import band_of, curves_of, summaries
from trueup.report.palette import Style
from trueup.report.policy_figures import distance_figure, finals_figure, map_figure, reward_figure
from trueup.report.sections.judged import COLUMNS, judged_sections, metric_cell

STYLE = Style("#0072b2", "solid", "circle", "")
GOALS, STEPS = 12, 8


def made(seed, *, lost=0):
    rng = np.random.default_rng(seed)
    distance = rng.uniform(0.01, 0.3, (GOALS, STEPS)).astype(np.float32)
    reward = -rng.uniform(0.1, 2.0, (GOALS, STEPS)).astype(np.float32)
    distance[:lost, 3:] = reward[:lost, 3:] = np.nan
    values = {name: tuple(rng.uniform(0.0, 0.2, GOALS).tolist()) for name in COLUMNS.values() if "median" not in name}
    values["success"] = tuple(float(number % 2) for number in range(GOALS))
    unit = {"distance": "m", "distance_median": "m", "overshoot": "m"}
    estimates = {
        name: Estimate(value := float(rng.uniform(0.1, 0.9)), unit.get(name, "1"), 0.5 * value, 1.1 * value)
        for name in COLUMNS.values()
    }
    goals = tuple(tuple(row) for row in np.random.default_rng(0).uniform(0.1, 0.5, (GOALS, 3)).tolist())
    return PlaceResult(goals, lost, values, estimates), {"distance_m": distance, "reward": reward}


def evaluation(labels=("<one>",), places=("mujoco", "lab-2"), lost=0):
    policies, groups, curves = [], [], {}
    for number, label in enumerate(labels):
        own = {place: made(10 * number + row, lost=lost) for row, place in enumerate(places)}
        policies.append(JudgedPolicy(label, "p", number, {place: item for place, (item, _) in own.items()}))
        groups.append(JudgedGroup(label, (label,), {place: item.estimates for place, (item, _) in own.items()}))
        curves |= {(label, place): made_curves for place, (_, made_curves) in own.items()}
    differences = tuple(
        PairedDifference(
            label, labels[0], place, "reach", name, Estimate(-0.2, "1", -0.3, -0.1), float("nan"), "better"
        )
        for label in labels[1:]
        for place in places
        for name in COLUMNS.values()
        if "median" not in name
    )
    whole = PolicyEvaluation(
        tuple(policies), tuple(groups), differences, (0.3, 0.0, 0.5), 0.04, 0.05, {"robot": "<arm>"}, {"trueup": "1"}
    )
    return whole, curves


def saved(folder, found, curves):
    folder.mkdir(exist_ok=True)
    found.save(folder / EVALUATION_NAME)
    save_curves(folder / EPISODES_NAME, curves, [item.label for item in found.policies])
    return folder


def test_best_median_worst_and_some_between():
    worth = -np.arange(9.0)[::-1]
    assert chosen_episodes(worth) == [
        ("best", 8),
        ("upper quarter", 6),
        ("median", 4),
        ("lower quarter", 2),
        ("lower tenth", 1),
        ("worst", 0),
    ]
    assert chosen_episodes(np.array([0.0, 1.0])) == [("best", 1), ("worst", 0)]
    assert chosen_episodes(np.array([0.0, 2.0, 1.0])) == [("best", 1), ("median", 2), ("worst", 0)]


def test_the_spread_leaves_lost_arms_out():
    curves = np.tile(np.arange(11.0)[:, None], (1, 3))
    curves[0, 1:] = np.nan
    curves[:, 2] = np.nan
    steps, (low, middle, high) = spread(curves)
    np.testing.assert_array_equal(steps, [0, 1])
    np.testing.assert_allclose((low[0], middle[0], high[0]), (1.0, 5.0, 9.0))
    np.testing.assert_allclose((low[1], middle[1], high[1]), (1.9, 5.5, 9.1))
    steps, found = spread(np.full((2, 3), np.nan))
    assert steps.size == 0
    assert found.shape == (3, 0)


def test_shares_of_goals_are_a_staircase():
    values, share = cumulative(np.array([3.0, 1.0, 2.0, 2.0]))
    np.testing.assert_array_equal(values, [1.0, 1.0, 2.0, 2.0, 3.0])
    np.testing.assert_array_equal(share, [0.0, 0.25, 0.5, 0.75, 1.0])


def test_figures_show_the_numbers():
    reward = np.array([[-1.0, -0.5], [-2.0, np.nan]])
    figure = reward_figure("worst", reward, 1, STYLE, control_s=0.5, span=(-2.1, 0.0))
    shade, line = figure["data"]
    assert line["x"] == [0.5, 1.0]
    assert line["y"] == [-2.0, None]
    assert shade["y"] == [-1.0, -0.5, -0.5, -2.0]
    distances = {"a": np.array([[0.1, 0.02], [0.3, 0.04]])}
    (_, middle) = distance_figure(distances, {"a": STYLE}, control_s=0.5, near_m=0.05)["data"]
    assert middle["y"] == [20.0, 3.0]
    assert middle["customdata"][0] == [12.0, 28.0]
    (stairs,) = finals_figure({"a": np.array([0.2, 0.1])}, {"a": STYLE}, near_m=0.05)["data"]
    assert stairs["x"] == [10.0, 10.0, 20.0]
    assert stairs["y"] == [0.0, 50.0, 100.0]
    goals = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    for view, up in (("top", [0.2, 0.5]), ("side", [0.3, 0.6])):
        figure = map_figure(
            view, goals, np.array([0.01, 0.2]), np.array([1.0, 0.0]), start_m=(0.0, 1.0, 2.0), most_m=0.2
        )
        marks, start = figure["data"]
        assert marks["y"] == up
        assert marks["marker"]["symbol"] == ["circle", "x"]
        assert marks["marker"]["color"] == [1.0, 20.0]
        assert start["y"] == [{"top": 1, "side": 2}[view]]


def test_a_page_with_a_section_per_place_and_the_numbers_of_the_file(tmp_path):
    found, curves = evaluation(labels=("<one>", "two"), lost=1)
    folder = saved(tmp_path / "eval", found, curves)
    page = build_report(folder)
    assert page == build_report(folder)
    assert "<one>" not in page
    assert "<arm>" not in page
    assert page.count('<section id="place-') == 2
    for words in (
        '<section id="place-mujoco"',
        '<section id="place-lab-2"',
        "2 policies reached",
        "Compared with &lt;one&gt;",
        "1 arm lost",
    ):
        assert words in page.replace("\N{NO-BREAK SPACE}", " ")
    stored = json.loads((folder / EVALUATION_NAME).read_text())
    result = judged_sections(PolicyEvaluation.load(folder / EVALUATION_NAME), curves)[0]
    variants = result.context["numbers"].variants
    for group in stored["groups"]:
        for place, own in group["places"].items():
            (row,) = (row for row in variants[place].tables["numbers"].rows if row.head == group["label"])
            for cell, name in zip(row.cells, COLUMNS.values(), strict=True):
                factor = 100.0 if cell.text.endswith(("cm", "%")) else 1.0
                shown = float(cell.text.split("\N{NO-BREAK SPACE}")[0])
                assert shown == pytest.approx(factor * own[name]["value"], rel=0.05)  # whole percents
                low, high = map(float, cell.note.split(" to "))
                assert low == pytest.approx(factor * own[name]["low"], rel=0.05)
                assert high == pytest.approx(factor * own[name]["high"], rel=0.05)
            if place == "mujoco":  # the first choice stands in the page itself
                assert all(f'{cell.text}<span class="note">{cell.note}</span>' in page for cell in row.cells)


def test_one_policy_has_a_row_per_place_and_is_compared_with_nothing():
    found, curves = evaluation()
    result, *places = judged_sections(found, curves)
    assert [row.head for row in result.context["numbers"].shown.tables["numbers"].rows] == ["mujoco", "lab-2"]
    assert result.context["differences"] is None
    assert [section.title for section in places] == ["mujoco", "lab-2"]
    assert places[0].context["panels"] == 6


def test_differences_have_signs_and_tones():
    cell = metric_cell(Estimate(-0.012, "m", -0.02, -0.004), "distance", sign=True, tone="better")
    assert (cell.text, cell.note, cell.tone) == ("−1.20\N{NO-BREAK SPACE}cm", "−2.00 to −0.40", "better")
    assert metric_cell(Estimate(0.25, "1", 0.1, 0.4), "success", sign=True).note == "+10.0 to +40.0"
    assert metric_cell(Estimate(0.25, "1"), "success").note == ""


def test_an_evaluation_is_read_back_as_it_was(tmp_path):
    found, curves = evaluation(labels=("a", "b"))
    folder = saved(tmp_path, found, curves)
    again = PolicyEvaluation.load(folder / EVALUATION_NAME)
    assert again.to_json() == found.to_json()
    assert np.isnan(again.differences[0].relative)
    for key, own in load_curves(folder / EPISODES_NAME, again).items():
        for name, values in own.items():
            np.testing.assert_array_equal(values, curves[key][name])


def test_what_does_not_fit_together_is_refused(tmp_path):
    found, curves = evaluation(labels=("a", "b"))
    folder = saved(tmp_path / "x", found, curves)
    (folder / EPISODES_NAME).write_bytes(b"PK")
    with pytest.raises(DataError, match=r"episodes\.npz is missing or broken"):
        build_report(folder)
    fewer = {key: {name: values[:3] for name, values in own.items()} for key, own in curves.items()}
    save_curves(folder / EPISODES_NAME, fewer, ["a", "b"])
    with pytest.raises(DataError, match="of another evaluation"):
        build_report(folder)
    replace(found, groups=found.groups[:1]).save(folder / EVALUATION_NAME)
    with pytest.raises(DataError, match="do not fit together"):
        build_report(folder)
    (folder / EVALUATION_NAME).write_text('{"schema": "trueup.policy-evaluation/1"}')
    with pytest.raises(FormatError):
        build_report(folder)


def rounds(*points):
    return tuple(
        {"steps": steps, "cpu_seconds": 60.0 * minutes, "distance_m": distance, "reward": reward}
        for steps, minutes, distance, reward in points
    )


TRIALS = [
    Trial("a-0", 0, "a", {"folder": "a", "gamma": 0.9}, rounds((10, 1, 0.4, -2.0), (20, 2, 0.2, -1.0))),
    Trial("a-1", 1, "a", {"folder": "a", "gamma": 0.9}, rounds((10, 2, 0.2, -1.0), (20, 3, 0.3, -0.5))),
    Trial("b-0", 0, "b", {"folder": "b", "gamma": 0.99}, rounds((10, 1, 0.5, -3.0), (20, 2, 0.6, -2.0))),
]


def test_bands_are_mean_least_and_largest_on_common_ground():
    first, other = curves_of(TRIALS, "steps", "distance_m")
    np.testing.assert_allclose(first.x, [10, 20])
    np.testing.assert_allclose(first.mean, [0.3, 0.25])
    np.testing.assert_allclose(first.low, [0.2, 0.2])
    np.testing.assert_allclose(first.high, [0.4, 0.3])
    assert (first.runs, other.runs, other.title) == (2, 1, "gamma 0.99")
    # Over minutes they share a stretch of one: both are known there.
    shared = band_of("x", [np.array([[1.0, 2.0, 4.0], [0.0, 2.0, 6.0]]), np.array([[2.0, 3.0], [1.0, 3.0]])])
    np.testing.assert_allclose(shared.x, [2.0, 3.0])
    np.testing.assert_allclose(shared.mean, [1.5, 3.5])
    apart = band_of("x", [np.array([[1.0, 2.0], [0.0, 4.0]]), np.array([[3.0, 5.0], [2.0, 3.0]])])
    np.testing.assert_allclose((apart.x, apart.mean), [[2.0], [3.0]])


def test_a_line_per_group():
    first, other = summaries(TRIALS)
    assert (first.title, first.runs, first.minutes) == ("gamma 0.9", 2, 2.5)
    assert (first.distance_m, first.distances_m) == (0.2, (0.2, 0.2))
    assert (first.reward, first.rewards) == (-0.75, (-1.0, -0.5))
    assert (other.distance_m, other.reward) == (0.5, -2.0)
    (together,) = summaries(TRIALS[:2], ["gamma"])
    assert together.runs == 2


def test_a_page_of_curves():
    page = build_curves(TRIALS)
    assert page == build_curves(TRIALS)
    for words in ("3 trainings in 2 groups", "gamma 0.99", '<th scope="col">Seeds</th>', "What differs: gamma"):
        assert words in page.replace("\N{NO-BREAK SPACE}", " ")
    assert '<th scope="col">Trainings</th>' in build_curves(TRIALS, ["gamma"])
    assert "One training." in build_curves(TRIALS[:1])
