"""Evaluation of corrections: laws, an independent computation, and how often intervals and warnings hold."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from augment.evaluation_cases import RUN, card_of, comparison_of
from trueup.augment.evaluation import Candidate, EvaluationBuilder
from trueup.core.augment_result import ALL_JOINTS, ANY_CONDITION, AugmentResult
from trueup.core.step_times import StepTimes
from trueup.errors import DataError, FormatError, MissingSignal, NameMismatch


def label(name):
    return f"{RUN}+{name}"


def torque_card(name="net", **changes):
    return card_of(name, signals=("torque",), **changes)


def evaluated(motions, *cards, draws=400, scored=None, conditions=None, **options):
    """The result over motions given as (measured, stock, corrected, ...) arrays of shape (T, 2)."""
    candidates = [Candidate(label(card.name), card) for card in cards]
    builder = EvaluationBuilder(RUN, candidates, scored_joints=scored)
    for number, (measured, stock, *others) in enumerate(motions):
        runs = {RUN: stock, **{item.run: values for item, values in zip(candidates, others, strict=True)}}
        condition = conditions[number] if conditions else ""
        builder.add(comparison_of(number, measured, runs, condition=condition, **options))
    return builder.result(split="test", draws=draws)


def random_motions(rng, count=12, left=0.3):
    """Motions of different lengths and difficulties, corrected so that a share of the error is left."""
    motions = []
    for _ in range(count):
        samples = int(rng.integers(50, 200))
        measured = rng.normal(size=(samples, 2))
        stock = measured + rng.exponential() * rng.normal(size=(samples, 2))
        motions.append((measured, stock, measured + left * (stock - measured)))
    return motions


def test_a_correction_of_zero_is_worth_nothing_and_undecided():
    motions = [(m, s, s) for m, s, _ in random_motions(np.random.default_rng(0))]
    cuts = evaluated(motions, torque_card()).models[0].cuts[ANY_CONDITION]["torque"]
    for cut in cuts.values():
        assert (cut.factor.value, cut.factor.low, cut.factor.high, cut.verdict) == (1.0, 1.0, 1.0, "undecided")


def test_a_perfect_correction_leaves_nothing():
    motions = [(m, s, m) for m, s, _ in random_motions(np.random.default_rng(0))]
    for cut in evaluated(motions, torque_card()).models[0].cuts[ANY_CONDITION]["torque"].values():
        assert cut.rmse.value == cut.mse.value == cut.rmse.high == 0.0
        assert math.isnan(cut.factor.value)
        assert cut.verdict == "better"


def test_errors_where_there_were_none_are_worse():
    motions = [(m, m, s) for m, s, _ in random_motions(np.random.default_rng(0))]
    for cut in evaluated(motions, torque_card()).models[0].cuts[ANY_CONDITION]["torque"].values():
        assert (cut.factor.value, cut.verdict) == (0.0, "worse")


def test_the_same_share_left_everywhere_has_an_interval_of_no_width():
    cuts = evaluated(random_motions(np.random.default_rng(0), left=0.5), torque_card()).models[0].cuts
    for cut in cuts[ANY_CONDITION]["torque"].values():
        assert [cut.factor.value, cut.factor.low, cut.factor.high] == pytest.approx([4.0] * 3)
        assert cut.verdict == "better"


def test_pooled_errors_against_all_samples_put_together():
    rng = np.random.default_rng(1)
    motions = [(m, s, s + 0.3 * rng.normal(size=s.shape)) for m, s, _ in random_motions(rng)]
    for measured, *_ in motions:
        measured[rng.random(measured.shape) < 0.1] = np.nan  # samples that were not measured
    result = evaluated(motions, torque_card())
    measured, stock, corrected = (np.concatenate(parts) for parts in zip(*motions, strict=True))
    errors = {"stock": (measured - stock) ** 2, "corrected": (measured - corrected) ** 2}
    simulated, cuts = result.simulated[ANY_CONDITION]["torque"], result.models[0].cuts[ANY_CONDITION]["torque"]
    for column, joint in enumerate(("a", "b")):
        before, after = (np.nanmean(errors[name][:, column]) for name in ("stock", "corrected"))
        assert simulated[joint].mse.value == pytest.approx(before)
        assert cuts[joint].rmse.value == pytest.approx(math.sqrt(after))
        assert cuts[joint].factor.value == pytest.approx(before / after)
    assert cuts[ALL_JOINTS].mse.value == pytest.approx(np.nanmean(errors["corrected"]))
    assert (simulated["a"].mse.unit, simulated["a"].rmse.unit) == ("(Nm)^2", "Nm")


def test_only_scored_joints_of_one_unit_are_put_together():
    motions = random_motions(np.random.default_rng(2))
    one = evaluated(motions, torque_card(), scored=("b",)).models[0].cuts[ANY_CONDITION]["torque"]
    assert one[ALL_JOINTS].mse == one["b"].mse
    mixed = evaluated(motions, torque_card(), units=("Nm", "N")).models[0].cuts[ANY_CONDITION]["torque"]
    assert set(mixed) == {"a", "b"}
    assert mixed["b"].mse.unit == "N^2"


def test_each_condition_has_its_own_table_and_the_papers_come_first():
    motions = random_motions(np.random.default_rng(3), count=6)
    names = ["waving", "cartesian", "multi-joint", "multi-joint", "", "waving"]
    result = evaluated(motions, torque_card(), conditions=names)
    assert dict(result.motions) == {ANY_CONDITION: 6, "multi-joint": 2, "cartesian": 1, "waving": 2}
    assert result.conditions == ("multi-joint", "cartesian", "waving", ANY_CONDITION)
    alone = evaluated([motions[1]], torque_card())
    found = result.models[0].cuts["cartesian"]["torque"]["a"]
    assert found.mse.value == pytest.approx(alone.models[0].cuts[ANY_CONDITION]["torque"]["a"].mse.value)
    assert found.factor.low is None  # one motion has no interval
    assert found.verdict == "undecided"
    assert result.conditions_of["motion4"] == ""
    same = evaluated(motions, torque_card(), conditions=["cartesian"] * 6)
    assert same.conditions == ("cartesian",)


def test_repetitions_of_a_motion_are_drawn_together():
    rng = np.random.default_rng(8)
    motions = [(m, s, s + 0.6 * rng.normal(size=s.shape)) for m, s, _ in random_motions(rng, count=8)]
    builders = {name: EvaluationBuilder(RUN, [Candidate(label("net"), torque_card())]) for name in ("once", "twice")}
    for number, (measured, stock, corrected) in enumerate(motions):
        runs = {RUN: stock, label("net"): corrected}
        builders["once"].add(comparison_of(number, measured, runs))
        for again in range(2):
            builders["twice"].add(comparison_of(2 * number + again, measured, runs, source=f"plans/{number}"))
    cuts = [item.result(split="test", draws=400).models[0].cuts[ANY_CONDITION]["torque"] for item in builders.values()]
    for joint, cut in cuts[0].items():
        ends = (cut.factor.value, cut.factor.low, cut.factor.high, cut.mse.low)
        other = cuts[1][joint]
        assert (other.factor.value, other.factor.low, other.factor.high, other.mse.low) == pytest.approx(ends)


def test_networks_are_compared_with_each_other_on_the_same_motions():
    rng = np.random.default_rng(4)
    motions = [(m, s, m + 0.5 * (s - m), m + 0.1 * (s - m)) for m, s, _ in random_motions(rng)]
    result = evaluated(motions, torque_card("first"), torque_card("second"))
    (pair,) = [item for item in result.pairs if item.condition == ANY_CONDITION]
    assert (pair.model, pair.baseline, pair.verdict) == ("second", "first", "better")
    assert pair.factor.value == pytest.approx(25.0)
    assert result.best("torque").name == "second"


def test_a_signal_that_a_network_does_not_correct_is_as_simulated():
    motions = [(m, s, s) for m, s, _ in random_motions(np.random.default_rng(5))]
    card = torque_card()
    cut = evaluated(motions, replace(card, outputs=card.outputs[:1])).models[0].cuts[ANY_CONDITION]["torque"]["b"]
    assert (cut.factor.value, cut.verdict) == (1.0, "undecided")


def test_the_main_signal_is_one_that_a_network_corrects():
    result = evaluated(random_motions(np.random.default_rng(5)), torque_card())
    assert result.main_signal == "torque"
    tables = {ANY_CONDITION: {**result.simulated[ANY_CONDITION], "position": {}}}
    other = replace(result, simulated=tables, models=(replace(result.models[0], signals=("position",)),))
    assert other.main_signal == "position"
    assert replace(other, models=()).main_signal == "torque"


def test_intervals_cover_the_cut_at_the_stated_rate():
    """The truth is the ratio of the expected sums: 1 / 0.1 by construction; 60 sets of 30 motions."""
    covered = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        motions = []
        for _ in range(30):
            size, share = np.exp(0.5 * rng.normal()), np.exp(0.4 * rng.normal() - 0.08)
            measured = rng.normal(size=(60, 2))
            stock = measured + size * rng.normal(size=(60, 2))
            motions.append((measured, stock, measured + size * math.sqrt(0.1 * share) * rng.normal(size=(60, 2))))
        factor = evaluated(motions, torque_card(), draws=300).models[0].cuts[ANY_CONDITION]["torque"]["a"].factor
        covered += factor.low <= 10.0 <= factor.high
    assert 0.85 <= covered / 60 <= 1.0


def test_coverage_of_an_interval_that_is_right_and_of_one_that_is_too_narrow():
    """Errors are uniform within the size of the correction: a half width of 0.8 |c| covers 80 %."""
    rng = np.random.default_rng(6)
    motions = []
    for _ in range(25):
        stock, correction = rng.normal(size=(200, 2)), rng.normal(size=(200, 2))
        corrected = stock + correction
        motions.append((corrected + correction * rng.uniform(-1, 1, size=(200, 2)), stock, corrected))
    says = {("torque", "a"): {"interval": (0.0, 0.8)}, ("torque", "b"): {"interval": (0.0, 0.4)}}
    model = evaluated(motions, torque_card(outputs=says, coverage=0.8)).models[0]
    right, narrow = (model.coverage[ANY_CONDITION]["torque"][joint] for joint in ("a", "b"))
    assert right.share.low <= 0.8 <= right.share.high
    assert narrow.share.value == pytest.approx(0.4, abs=0.03)
    assert narrow.share.high < model.coverage_target
    expected = 0.8 * np.mean([np.abs(c - s)[:, 0].mean() for _, s, c in motions])
    assert right.half_width.value == pytest.approx(expected)
    assert right.half_width.unit == "Nm"


def test_an_output_without_interval_has_no_coverage():
    model = evaluated(random_motions(np.random.default_rng(7)), torque_card()).models[0]
    assert model.coverage == {}
    assert model.reliability == {}


def far_motions(rng, truth):
    """Motions in which a simulator is far off (by 3 against 0.1) with a probability that depends on the correction."""
    motions = []
    for _ in range(30):
        correction = rng.uniform(0, 1, size=(300, 2))
        far = rng.random((300, 2)) < truth(correction)
        stock = rng.normal(size=(300, 2))
        motions.append((stock + np.where(far, 3.0, 0.1), stock, stock + correction * rng.choice([-1, 1], (300, 2))))
    return motions


FAR = {"far": 1.0, "far_correction": (0.0, 1.0), "far_probability": (0.0, 1.0)}


def test_a_warning_that_is_right_as_often_as_it_says_is_reliable():
    says = {("torque", joint): FAR for joint in ("a", "b")}
    motions = far_motions(np.random.default_rng(8), lambda correction: correction)
    curve = evaluated(motions, torque_card(outputs=says)).models[0].reliability[ANY_CONDITION]["torque"]
    assert curve.predicted == pytest.approx(np.arange(0.05, 1, 0.1), abs=0.01)
    for predicted, observed in zip(curve.predicted, curve.observed, strict=True):
        assert observed.value == pytest.approx(predicted, abs=0.05)
    assert sum(item.low <= p <= item.high for p, item in zip(curve.predicted, curve.observed, strict=True)) >= 8
    assert curve.error < 0.02
    assert sum(curve.weight) == pytest.approx(1.0)
    # Brier score of a forecast p = c, c uniform: E c (1 - c) = 1/6; always saying 1/2 has 1/4.
    assert curve.skill == pytest.approx(1 - (1 / 6) / (1 / 4), abs=0.03)
    assert curve.far == pytest.approx(0.5, abs=0.02)


def test_warnings_about_repetitions_of_a_motion_are_drawn_together():
    card = torque_card(outputs={("torque", joint): FAR for joint in ("a", "b")})
    motions = far_motions(np.random.default_rng(11), lambda correction: correction)[:6]
    builders = {name: EvaluationBuilder(RUN, [Candidate(label("net"), card)]) for name in ("once", "twice")}
    for number, (measured, stock, corrected) in enumerate(motions):
        runs = {RUN: stock, label("net"): corrected}
        builders["once"].add(comparison_of(number, measured, runs))
        for again in range(2):
            builders["twice"].add(comparison_of(2 * number + again, measured, runs, source=f"plans/{number}"))
    once, twice = (
        item.result(split="test", draws=400).models[0].reliability[ANY_CONDITION]["torque"].observed
        for item in builders.values()
    )
    assert len(once) == 10
    for found, expected in zip(twice, once, strict=True):
        assert (found.value, found.low, found.high) == pytest.approx((expected.value, expected.low, expected.high))


def test_a_warning_that_exaggerates_is_found_out():
    """It says c where the truth is c / 2: off by a quarter on average."""
    says = {("torque", joint): FAR for joint in ("a", "b")}
    motions = far_motions(np.random.default_rng(9), lambda correction: correction / 2)
    curve = evaluated(motions, torque_card(outputs=says)).models[0].reliability[ANY_CONDITION]["torque"]
    assert curve.error == pytest.approx(0.25, abs=0.02)
    assert curve.observed[-1].high < curve.predicted[-1]


def test_an_output_that_is_switched_off_is_named_and_gives_no_warnings():
    off = {"gate": 0.0, "reason": "no better on val"}
    says = {("torque", "a"): {**FAR, **off}, ("torque", "b"): FAR}
    motions = far_motions(np.random.default_rng(10), lambda correction: correction)
    both = evaluated(motions, torque_card(outputs={**says, ("torque", "a"): FAR})).models[0]
    model = evaluated(motions, torque_card(outputs=says)).models[0]
    assert [(item.signal, item.joint, item.reason) for item in model.gated] == [("torque", "a", "no better on val")]
    assert model.is_off("torque", "a")
    assert not model.is_off("torque", "b")
    assert model.reliability[ANY_CONDITION]["torque"] != both.reliability[ANY_CONDITION]["torque"]


def test_all_joints_are_off_if_those_that_stand_for_all_are():
    motions = random_motions(np.random.default_rng(10), count=3)
    off = {"gate": 0.0, "reason": "no better on val"}
    one, two = (torque_card(outputs={("torque", joint): off for joint in joints}) for joints in ("a", "ab"))
    for card, scored, expected in ((one, None, False), (two, None, True), (one, ("a",), True), (one, ("b",), False)):
        result = evaluated(motions, card, scored=scored)
        assert result.is_off(result.models[0], "torque", ALL_JOINTS) == expected
        assert result.is_off(result.models[0], "torque", "a")
        assert result.is_off(result.models[0], "torque", "b") == (card is two)


def test_joints_and_unit_of_a_group():
    result = evaluated(random_motions(np.random.default_rng(10), count=3), torque_card())
    assert result.joints_of(ANY_CONDITION, "torque") == ["a", "b", ALL_JOINTS]
    assert result.joints_of(ANY_CONDITION, "position") == []
    assert result.unit_of(ANY_CONDITION, "torque", "mse") == "(Nm)^2"
    assert result.unit_of(ANY_CONDITION, "torque", "rmse") == "Nm"
    mixed = evaluated(random_motions(np.random.default_rng(10), count=3), torque_card(), units=("Nm", "N"))
    assert mixed.unit_of(ANY_CONDITION, "torque", "rmse") == ""


def test_the_file_gives_back_what_was_written(tmp_path):
    says = {("torque", "a"): {**FAR, "interval": (0.1, 0.2)}, ("torque", "b"): {"gate": 0.0, "reason": "why"}}
    motions = [(m, s, m) for m, s, _ in random_motions(np.random.default_rng(11), count=3)]
    result = evaluated(motions, torque_card(outputs=says), conditions=["x", "x", "y"])
    times = StepTimes(3, 1.0, 2.0, 2.0, 2.5, ((0.5, 1.5, 2), (1.5, 2.5, 1)), 1000.0, 0, "here")
    result = replace(result, models=(replace(result.models[0], latency=times),), notes=("careful",))
    result.save(tmp_path / "augment.json")
    text = (tmp_path / "augment.json").read_text()
    assert "NaN" not in text
    again = AugmentResult.load(tmp_path / "augment.json")
    assert json.dumps(again.to_json()) == json.dumps(result.to_json())
    assert math.isnan(again.models[0].cuts[ANY_CONDITION]["torque"]["a"].factor.value)
    assert again.models[0].latency == times


def test_other_and_broken_files_are_refused(tmp_path):
    with pytest.raises(FormatError, match=r"trueup.augment/1"):
        AugmentResult.from_json({"schema": "trueup.gap/1"})
    result = evaluated(random_motions(np.random.default_rng(12), count=2), torque_card()).to_json()
    with pytest.raises(DataError, match="broken"):
        AugmentResult.from_json({**result, "models": [{"name": 1}]})
    with pytest.raises(DataError, match="broken"):
        AugmentResult.from_json({key: value for key, value in result.items() if key != "simulated"})


def test_what_cannot_be_evaluated_is_refused():
    (motion,) = random_motions(np.random.default_rng(13), count=1)
    measured, stock, corrected = motion
    builder = EvaluationBuilder(RUN, [Candidate(label("net"), torque_card())])
    with pytest.raises(DataError, match="no motion"):
        builder.result(split="test")
    with pytest.raises(MissingSignal, match=r"stock\+net"):
        builder.add(comparison_of(0, measured, {RUN: stock}))
    broken = corrected.copy()
    broken[3, 1] = np.nan
    with pytest.raises(DataError, match="not finite"):
        builder.add(comparison_of(0, measured, {RUN: stock, label("net"): broken}))
    builder.add(comparison_of(0, measured, {RUN: stock, label("net"): corrected}))
    with pytest.raises(NameMismatch, match=r"torque.b \[N\]"):
        builder.add(comparison_of(1, measured, {RUN: stock, label("net"): corrected}, units=("Nm", "N")))
    assert builder.result(split="test").motions == {ANY_CONDITION: 1}  # a refused motion leaves no trace
