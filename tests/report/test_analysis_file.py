"""analysis.json and quality.json: round trips and refusals."""

import json

import numpy as np
import pytest

from trueup.core.analysis import Analysis, BinnedCurve, HorizonCurve, Lag
from trueup.core.quality import Quality
from trueup.errors import DataError, FormatError

NAN = float("nan")


def test_analysis_comes_back(tmp_path):
    curve = BinnedCurve((0.1, 0.2), (1.0, NAN), (0.5, NAN), (2.0, NAN), (7, 0), "rad/s", "rad")
    analysis = Analysis(
        bins={"mujoco/stock": {"position": {"a": {"velocity": curve}}}},
        lags={"command": {"a": Lag(0.08, 0.07, None), "b": Lag(NAN)}},
        horizon={"mujoco/stock": {"position": {"a": HorizonCurve((0.0, 0.5), (0.0, 0.1), "rad")}}},
    )
    analysis.save(tmp_path / "analysis.json")
    loaded = Analysis.load(tmp_path / "analysis.json")
    back = loaded.bins["mujoco/stock"]["position"]["a"]["velocity"]
    np.testing.assert_array_equal(back.median, curve.median)
    assert (back.centers, back.count, back.x_unit, back.y_unit) == ((0.1, 0.2), (7, 0), "rad/s", "rad")
    assert loaded.lags["command"]["a"] == Lag(0.08, 0.07, None)
    assert np.isnan(loaded.lags["command"]["b"].value_s)
    assert loaded.horizon == analysis.horizon


def test_columns_of_unequal_length_are_refused():
    with pytest.raises(DataError, match="unequal"):
        BinnedCurve((0.1, 0.2), (1.0,), (1.0,), (1.0,), (1,), "rad", "rad")
    with pytest.raises(DataError, match="unequal"):
        HorizonCurve((0.1, 0.2), (1.0,), "rad")


@pytest.mark.parametrize("text", ["[]", "{}", '{"schema": "trueup.gap/1"}', "null", "3"])
def test_other_json_is_no_analysis_and_no_quality(tmp_path, text):
    (tmp_path / "file.json").write_text(text)
    with pytest.raises(FormatError):
        Analysis.load(tmp_path / "file.json")
    with pytest.raises(FormatError):
        Quality.load(tmp_path / "file.json")


@pytest.mark.parametrize("key", ["bins", "lags", "horizon"])
@pytest.mark.parametrize("value", [None, 3, {"run": 3}, {"run": {"position": {"a": {"velocity": {"centers": 1}}}}}])
def test_a_broken_analysis_is_a_data_error(run_folder, key, value):
    data = json.loads((run_folder / "analysis.json").read_text())
    data[key] = value
    with pytest.raises(DataError):
        Analysis.from_json(data)


def test_quality_comes_back(run_folder, tmp_path):
    quality = Quality.load(run_folder / "quality.json")
    assert quality.episodes["stopped_early"].dropped
    assert quality.episodes["single_joint_wrist_roll"].flags[0].start_s == 9.1
    quality.save(tmp_path / "quality.json")
    assert (tmp_path / "quality.json").read_bytes() == (run_folder / "quality.json").read_bytes()


def test_a_broken_flag_is_a_data_error(run_folder):
    data = json.loads((run_folder / "quality.json").read_text())
    data["episodes"]["chirp_sweep"]["flags"] = [{"kind": 3}]
    with pytest.raises(DataError, match="chirp_sweep"):
        Quality.from_json(data)
