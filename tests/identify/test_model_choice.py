"""Which model is kept: what the motions show, judged on motions that were not fitted where there are any."""

from dataclasses import replace

import mujoco
import pytest

from identify.recovery_cases import SERVO, Truth, arm, nominal_of
from trueup.identify import IdentifyConfig, Nominal, identify
from trueup.identify.config import DataChoice

pytestmark = pytest.mark.long


def logs_of(truth, *splits):
    """One motion of 6 s for each of the splits that are named."""
    found = {}
    for seed, split in enumerate(splits):
        found.setdefault(split, []).append(truth.log(seed, seconds=6.0, name=f"{split}{seed}"))
    return found


@pytest.mark.parametrize("splits", [("train", "train"), ("train", "train", "val")], ids=["train only", "with val"])
def test_what_the_robot_has_none_of_ends_on_zero_and_not_on_what_the_model_said(splits, tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    truth = Truth(robot, nominal, {"damping[shoulder]": 0.8, "damping[elbow]": 0.5})
    late = replace(robot, controller=replace(SERVO, delay_s=0.03))
    config = IdentifyConfig(data=DataChoice(budget_s=12.0), models={})
    found = identify(logs_of(truth, *splits), late, tmp_path / "arm.xml", config=config)
    for joint in robot.joint_names:
        assert found.result[f"delay_s[{joint}]"].value == pytest.approx(0.0, abs=2e-3)
    assert found.result.errors["fitted"][splits[-1]].value < 2e-3  # the noise is 1e-3
    assert not any("left as they are" in text and "delay_s" in text for text in found.result.statements)


def test_a_law_that_the_robot_has_is_tried_and_kept(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    truth = Truth(robot, nominal, {"load[shoulder]": 0.25, "load[elbow]": 0.25})
    mujoco.set_mjcb_control(None)
    mujoco.set_mjcb_passive(None)
    config = IdentifyConfig(data=DataChoice(budget_s=24.0), models={"load": ("load",)})
    found = identify(logs_of(truth, "train", "train", "val", "val"), robot, tmp_path / "arm.xml", config=config)
    base, richer = found.result.models[:2]
    assert richer.name == "load"
    assert richer.splits["val"].value < 0.8 * base.splits["val"].value
    assert found.result["load[shoulder]"].value == pytest.approx(0.25, rel=0.2)


def test_parameters_that_move_nothing_are_left_as_the_model_has_them(tmp_path):
    robot, path = arm(tmp_path)
    robot = replace(robot, joints=tuple(replace(joint, torque_limit=90.0) for joint in robot.joints))
    truth = Truth(robot, Nominal(robot, path), {"load[shoulder]": 0.25, "load[elbow]": 0.25})
    config = IdentifyConfig(data=DataChoice(budget_s=24.0), models={"two": ("torque_limit", "load")})
    found = identify(logs_of(truth, "train", "train", "val", "val"), robot, path, config=config)
    assert next(row for row in found.result.models if row.chosen).name.startswith("two")
    for joint in robot.joint_names:
        limit = found.result[f"torque_limit[{joint}]"]
        assert limit.frozen
        assert limit.value == limit.nominal == 90.0


@pytest.mark.parametrize(
    "models", [{}, pytest.param({"load": ("load",)}, marks=pytest.mark.slow)], ids=["base alone", "with another model"]
)
def test_motions_that_show_nothing_give_a_status_and_no_error(models, tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    truth = Truth(robot, nominal, {})
    logs = {
        split: [truth.log(seed, seconds=3.0, size=0.02, noise=0.3, name=f"{split}{seed}")]
        for seed, split in enumerate(("train", "val"))
    }
    found = identify(logs, robot, tmp_path / "arm.xml", config=IdentifyConfig(models=models))
    assert found.result.status in ("not-identifiable", "no-better")


def test_effort_and_start_of_the_chosen_model_are_those_of_its_whole_search(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    truth = Truth(robot, nominal, {"kp[shoulder]": 60.0, "kp[elbow]": 60.0})
    fit = {"kp": {"start": 10.0}, "damping": "all"}
    told = []
    found = identify(
        logs_of(truth, "train", "val"),
        robot,
        tmp_path / "arm.xml",
        config=IdentifyConfig(fit=fit, models={"load": ("load",)}, data=DataChoice(budget_s=6.0)),
        on_progress=lambda name, progress: told.append((name, progress.phase, progress.evaluations)),
    )
    searched = [(name, count) for name, phase, count in told if phase == "gauss-newton"]  # and not what is verified
    base = max(count for name, count in searched if name == "base")
    end = max(count for name, count in searched if name == "base, to the end")
    assert found.result.solver["evaluations"] >= base + end
    assert [row.name for row in found.result.models if row.chosen] == ["base"]
    assert found.result["kp[shoulder]"].value == pytest.approx(60.0, rel=0.05)
    assert found.result["kp[shoulder]"].start != pytest.approx(found.result["kp[shoulder]"].value, rel=1e-3)
