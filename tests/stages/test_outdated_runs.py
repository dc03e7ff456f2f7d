"""Corrected runs whose base was simulated again."""

import json

import pytest

from augment.evaluation_cases import card_of, shift_folder
from trueup.dataset import Dataset
from trueup.robots import load_robot
from trueup.stages import evaluate, gap, replay
from trueup.stages.demonstrating import demo_dataset

LABEL = "mujoco/stock+shift"


def warnings(path):
    return gap(Dataset(path), draws=100).gap.settings["warnings"]


@pytest.mark.long
def test_a_correction_of_an_earlier_run_is_warned_of_until_it_is_made_again(tmp_path):
    path = demo_dataset(tmp_path / "data")
    robot = load_robot("demo_arm")
    replay(Dataset(path), robot)
    data = Dataset(path)
    card = card_of(
        "shift", joints=data.run_info("mujoco/stock")["joints"], signals=("position",), rate_hz=data[0].measured.rate_hz
    )
    model = shift_folder(tmp_path / "model", card, (0.01, 0.0, 0.0))
    evaluate(data, [model], tmp_path / "a", split="all", draws=100)
    replay(Dataset(path), robot, resume=True)  # nothing is missing, nothing is made again
    assert warnings(path) == []
    replay(Dataset(path), robot, overwrite=True)
    file = path / "simulated" / "mujoco" / "stock" / "run.json"
    info = json.loads(file.read_text())
    info["info"]["provenance"]["created"] = "2031-01-01T00:00:00+00:00"  # stamps tell seconds apart, not less
    file.write_text(json.dumps(info))
    (said,) = warnings(path)
    assert f"The run {LABEL} corrects an earlier version of mujoco/stock" in said
    evaluate(Dataset(path), [model], tmp_path / "b", split="all", draws=100)
    assert warnings(path) == []
