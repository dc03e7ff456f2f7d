import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.results import Estimate, GapResult, Ladder, MetricResult, PairedDifference, Rung
from trueup.errors import DataError, FormatError

finite = st.floats(-1e6, 1e6)
estimates = st.builds(Estimate, finite, st.sampled_from(["rad", "1"]), st.none() | finite, st.none() | finite)
metrics = st.builds(
    MetricResult, estimates, st.dictionaries(st.text(min_size=1), estimates, max_size=3), st.integers(0, 99)
)
trees = st.dictionaries(
    st.sampled_from(["position", "torque"]), st.dictionaries(st.sampled_from(["rmse", "max"]), metrics)
)
gaps = st.builds(
    GapResult,
    runs=st.dictionaries(
        st.sampled_from(["command", "mujoco/stock"]), st.dictionaries(st.sampled_from(["val", "all"]), trees)
    ),
    joints=st.just(("a", "b")),
    scored_joints=st.just(("a",)),
    paired=st.lists(
        st.builds(
            PairedDifference,
            st.text(),
            st.text(),
            st.text(),
            st.text(),
            st.text(),
            estimates,
            finite,
            st.just("better"),
        ),
        max_size=2,
    ).map(tuple),
)


@given(gaps)
def test_a_gap_survives_json(gap):
    assert GapResult.from_json(json.loads(json.dumps(gap.to_json(), allow_nan=False))) == gap


def test_what_is_not_defined_is_null_in_json_and_nan_in_python():
    one = Estimate(math.nan, "1")
    assert one.to_json() == {"value": None, "low": None, "high": None, "unit": "1"}
    assert math.isnan(Estimate.from_json(one.to_json()).value)


def test_the_file_is_the_contract_of_the_design(tmp_path):
    result = MetricResult(Estimate(0.03, "rad", 0.02, 0.04), {"a": Estimate(0.03, "rad")}, 6)
    gap = GapResult(
        runs={"mujoco/stock": {"test": {"position": {"rmse": result}}}}, joints=("a",), scored_joints=("a",)
    )
    gap.save(tmp_path / "gap.json")
    tree = json.loads((tmp_path / "gap.json").read_text())
    assert tree["schema"] == "trueup.gap/1"
    rmse = tree["runs"]["mujoco/stock"]["splits"]["test"]["position"]["rmse"]
    assert (rmse["value"], rmse["low"], rmse["high"], rmse["unit"]) == (0.03, 0.02, 0.04, "rad")
    assert rmse["per_joint"]["a"]["value"] == 0.03
    assert GapResult.load(tmp_path / "gap.json") == gap


def test_a_ladder_survives_json_and_marks_the_chosen_rung(tmp_path):
    result = MetricResult(Estimate(0.03, "rad", 0.02, 0.04), {}, 6)
    rungs = [Rung("command", 0.1, {"val": {"position": {"rmse": result}}}), Rung("stock", 2.0, {}, chosen=True)]
    Ladder(rungs).save(tmp_path / "ladder.json")
    tree = json.loads((tmp_path / "ladder.json").read_text())
    assert [rung.get("chosen") for rung in tree["rungs"]] == [None, True]
    assert Ladder.load(tmp_path / "ladder.json") == Ladder(rungs)


@pytest.mark.parametrize("content", ['{"schema": "trueup.gap/9"}', "[]", "{}", '{"schema": "trueup.ladder/1"}'])
def test_another_schema_is_refused_with_both_names(tmp_path, content):
    (tmp_path / "gap.json").write_text(content)
    with pytest.raises(FormatError, match=r"expected trueup\.gap/1"):
        GapResult.load(tmp_path / "gap.json")


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000])
def test_what_is_not_json_is_refused(tmp_path, content):
    (tmp_path / "gap.json").write_bytes(content)
    with pytest.raises(DataError, match=r"gap\.json"):
        GapResult.load(tmp_path / "gap.json")


@pytest.mark.parametrize("tree", [{}, {"runs": 3}, {"runs": {"a": {}}, "joints": []}, {"rungs": [{"name": "stock"}]}])
def test_a_broken_result_is_a_broken_file_and_no_bug(tmp_path, tree):
    for kind, schema in ((GapResult, "trueup.gap/1"), (Ladder, "trueup.ladder/1")):
        (tmp_path / "result.json").write_text(json.dumps({"schema": schema, **tree}))
        with pytest.raises(DataError, match="is broken"):
            kind.load(tmp_path / "result.json")
