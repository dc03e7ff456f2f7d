"""Errors of models on whole motions, and how sure they are."""

from dataclasses import replace

import numpy as np
import pytest

from identify.recovery_cases import Truth, nominal_of
from trueup.core.parameters import ParameterSet
from trueup.identify.scoring import Scorer, Scores
from trueup.robots import ControllerSpec


def scores(rmse, executed=()):
    rmse = np.asarray(rmse)
    names = tuple(f"log{number}" for number in range(len(rmse)))
    return Scores(names, ("shoulder", "elbow"), rmse, np.full(len(rmse), 100), executed=executed)


def test_motions_that_were_recorded_again_are_no_further_evidence(tmp_path):
    robot, nominal = nominal_of(tmp_path)
    logs = [Truth(robot, nominal, {}).log(seed, seconds=2.0, name=f"log{seed}", noise=0.02) for seed in range(4)]

    def again(log, suffix):
        return replace(log, meta=replace(log.meta, id=log.meta.id + suffix, source=f"plans/{log.meta.id}"))

    twice = [again(log, suffix) for log in logs for suffix in "ab"]
    scorer = Scorer(nominal, {"val": logs, "test": twice}, seed=2)
    once, repeated = (scorer.score(ParameterSet(()), {}, split).estimate("rad") for split in ("val", "test"))
    assert (repeated.value, repeated.low, repeated.high) == pytest.approx((once.value, once.low, once.high))
    apart = replace(scorer.score(ParameterSet(()), {}, "test"), executed=()).estimate("rad")
    assert repeated.high - repeated.low > 1.2 * (apart.high - apart.low)


def test_few_motions_of_val_choose_together_with_those_of_train(tmp_path):
    robot, nominal = nominal_of(tmp_path)
    logs = [Truth(robot, nominal, {}).log(seed, seconds=0.5, name=f"log{seed}", noise=0.02) for seed in range(7)]
    again = [replace(log, meta=replace(log.meta, id=f"{log.meta.id}-{n}", source="one")) for n in "ab" for log in logs]
    train, val = logs[:1], logs[1:]

    def error(scorer):
        return scorer.deciding_error(ParameterSet(()), {})

    for own, splits in ((val, ("val",)), (val[1:], ("train", "val")), (again, ("train", "val"))):
        scorer = Scorer(nominal, {"train": train, "val": own})
        assert scorer.deciding == splits
        scores = [scorer.score(ParameterSet(()), {}, split).rmse.mean(axis=1) for split in splits]
        assert error(scorer) == pytest.approx(np.concatenate(scores).mean())
    assert Scorer(nominal, {"train": train}).deciding == ()
    assert Scorer(nominal, {"val": val[:2]}).deciding == ("val",)


def test_a_mean_has_no_interval_where_all_recordings_are_of_one_motion():
    found = scores([[0.1, 0.2], [0.3, 0.4]], executed=("plan", "plan")).estimate("rad")
    assert (found.value, found.low, found.high) == (pytest.approx(0.25), None, None)
    assert scores([[0.1, 0.2]]).estimate("rad").low is None


def test_a_velocity_that_is_commanded_is_a_motion_from_the_measured_start(tmp_path):
    _, nominal = nominal_of(tmp_path, ControllerSpec("velocity", kv=5.0))
    (log,) = [Truth(*nominal_of(tmp_path), {}).log(1, seconds=2.0, name="log")]
    time_s = log.measured.time_s
    speed = np.stack([np.sin(3 * time_s), 0.5 * np.cos(2 * time_s)], axis=1)
    path = 0.2 + np.concatenate([np.zeros((1, 2)), np.cumsum(speed[:-1] * np.diff(time_s)[:, None], axis=0)])
    units = {"velocity": ("rad/s", "rad/s")}
    command = replace(log.command, time_s=time_s, signals={"velocity": speed}, units=units)
    measured = replace(
        log.measured, signals={"position": path + np.array([0.0, 0.03])}, units={"position": ("rad", "rad")}
    )
    off = measured.signals["position"].copy()
    off[1:, 1] += 0.01
    moved = replace(measured, signals={"position": off})
    for series, error in ((measured, 0.0), (moved, 0.5 * 0.01)):
        scorer = Scorer(nominal, {"val": [replace(log, measured=series, command=command)]}, seed=0)
        assert scorer.command("val").value == pytest.approx(error, rel=0.01, abs=1e-9)


def test_a_motion_that_diverged_leaves_no_mean():
    assert np.isnan(scores([[0.1, np.nan], [0.3, 0.4]]).estimate("rad").value)
