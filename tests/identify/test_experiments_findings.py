"""Results of experiments: JSON both ways, words, and what must not be overlooked."""

import json
import math

import pytest

from trueup.core.results import Estimate
from trueup.errors import DataError, FormatError, MissingSignal
from trueup.identify.experiments import ExperimentResult, Finding, Rejection
from trueup.identify.experiments.findings import of_friction, said

RESULT = ExperimentResult(
    experiment="breakaway",
    joints={
        "a": {
            "positive": Finding(Estimate(0.5, "Nm", 0.4, 0.6), "Starts at 0.5."),
            "negative": Finding(Estimate(math.nan, "Nm", high=-2.0), "No motion up to -2.", "no_motion"),
        }
    },
    notes={"a": ("b moved",)},
    runs=({"episode": "a_1", "threshold": 0.5}, {"episode": "a_2", "threshold": math.nan}),
    rejected=(Rejection("a_3", "a", "no ramp"),),
    settings={"delay_s": 0.0},
    provenance={"seed": 0},
)


def test_json_has_the_schema_units_and_no_nan():
    tree = json.loads(json.dumps(RESULT.to_json(), allow_nan=False))
    assert tree["schema"] == "trueup.experiment/1"
    assert tree["joints"]["a"]["positive"] == {
        "value": 0.5,
        "low": 0.4,
        "high": 0.6,
        "unit": "Nm",
        "status": "ok",
        "sentence": "Starts at 0.5.",
    }
    assert tree["joints"]["a"]["negative"]["value"] is None
    assert tree["joints"]["a"]["negative"]["high"] == -2.0
    assert tree["runs"][1]["threshold"] is None


def test_it_reads_back(tmp_path):
    RESULT.save(tmp_path / "experiment.json")
    back = ExperimentResult.load(tmp_path / "experiment.json")
    assert back.to_json() == RESULT.to_json()
    assert math.isnan(back.finding("a", "negative").estimate.value)


def test_other_and_broken_files_are_refused():
    with pytest.raises(FormatError):
        ExperimentResult.from_json({"schema": "trueup.gap/1"})
    with pytest.raises(FormatError):
        ExperimentResult.from_json([])
    with pytest.raises(DataError):
        ExperimentResult.from_json({**RESULT.to_json(), "joints": {"a": {"positive": {}}}})


def test_everything_that_is_not_fine_is_a_problem():
    assert RESULT.problems == ("a: No motion up to -2.", "a: b moved", "a_3, a: no ramp")


def test_an_unknown_joint_or_quantity_lists_what_there_is():
    with pytest.raises(MissingSignal, match="available: a"):
        RESULT.finding("b", "positive")
    with pytest.raises(MissingSignal, match="available: positive, negative"):
        RESULT.finding("a", "midpoint")


@pytest.mark.parametrize(
    ("estimate", "words"),
    [
        (Estimate(0.65234, "Nm", 0.6331, 0.6709), "0.6523 Nm (95 %: 0.6331 to 0.6709)"),
        (Estimate(0.65234, "Nm", 0.1, 1.2), "0.652 Nm (95 %: 0.1 to 1.2)"),
        (Estimate(0.2, "1"), "0.2 (no interval)"),
        (Estimate(0.5, "Nm", 0.5, 0.5), "0.5 Nm (95 %: 0.5 to 0.5)"),
    ],
)
def test_numbers_are_as_precise_as_their_intervals(estimate, words):
    assert said(estimate) == words


def test_a_negative_friction_is_implausible_and_one_about_zero_is_said_to_be():
    assert of_friction(Estimate(0.5, "Nm", 0.4, 0.6), "F.").status == "ok"
    assert of_friction(Estimate(-0.5, "Nm", -0.6, -0.4), "F.").status == "implausible"
    unclear = of_friction(Estimate(0.1, "Nm", -0.1, 0.3), "F.")
    assert unclear.status == "ok"
    assert "do not tell it from zero" in unclear.sentence
