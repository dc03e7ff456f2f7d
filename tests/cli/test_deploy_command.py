"""`trueup deploy run`: from a policy's folder to an arm that is driven, and what it refuses."""

import numpy as np
import pytest

from deploy.test_policy_loop import policy_of
from trueup.cli.main import main
from trueup.dataset import Dataset
from trueup.policy.thesis_friction import OFFSET
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator
from trueup.stages import replay
from trueup.stages.policy_driving import drive, guard_settings
from trueup.stages.policy_judging import judge_policies


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    policy_of(tmp_path / "still", np.zeros(7))
    policy_of(tmp_path / "strong", [2.0, 3.0, 2.5, 4.0, 2.0, 1.0, 1.0])

    def call(*arguments):
        with pytest.raises(SystemExit) as caught:
            main(["deploy", "run", *map(str, arguments)])
        printed = capsys.readouterr()
        return caught.value.code, printed.out, printed.err

    return call


@pytest.mark.long
def test_goals_one_after_the_other_and_a_log_that_can_be_replayed(run, tmp_path):
    code, out, _ = run("still", "--goals", 2, "--seconds", 0.4, "--unit", 2, "--out", "log")
    assert code == 0
    assert out.count("done") == 2
    data = Dataset(tmp_path / "log")
    assert [(meta.unit, meta.warned) for meta in data.metas] == [("lab-2", False)] * 2
    robot = load_robot("panda_torque")
    assert replay(data, robot).replayed == 2
    code, _, err = run("still", "--goals", 1, "--out", "log")
    assert code == 2
    assert "log" in err
    assert run("still", "--goals", 1, "--seconds", 0.2, "--out", "log", "--overwrite")[0] == 0
    assert len(Dataset(tmp_path / "log")) == 1


@pytest.mark.long
def test_an_emergency_stop_ends_with_2_says_why_and_no_other_goal_is_gone_for(run, tmp_path):
    box = ("--workspace", 0.2, 0.9, -0.1, 0.25, 0.1, 1.2)
    code, _, err = run("strong", "--goals", 3, "--seed", 1, *box, "--out", "log")
    if code == 2 and "outside of the workspace" in err:  # a goal that was drawn
        code, _, err = run("strong", "--goal", 0.4, 0.2, 0.5, *box, "--out", "log")
    assert code == 2
    assert "stopped: the end of the arm left its workspace" in err
    assert "the arm stands" in err
    assert len(Dataset(tmp_path / "log")) == 1


@pytest.mark.long
def test_real_time_says_how_punctual_it_was(run):
    code, out, err = run("still", "--goal", 0.4, 0.2, 0.5, "--seconds", 0.3, "--real-time", "--late-ms", 1e4)
    assert (code, "error" in err) == (0, False)
    assert "not in time; a tick takes" in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere",), "policy.json"),
        (("still", "--goal", 3, 0, 0), "reach"),
        (("still", "--goal", 0.4, 0.2, 0.5, "--goals", 2), "one of them"),
        (("still", "--goal", 0.4, 0.2, 0.5, "--workspace", 0, 1, 0, 0.1, 0, 1), "outside of the workspace"),
        (("still", "--hz", 990), "whole multiple"),
        (("still", "--torque-rate", -1), "torque_rate"),
        (("still", "--seconds", 0), "seconds"),
        (("still", "--late-ms", 0), "late_s"),
        (("still", "--robot", "panda"), "takes"),
        (("zoo:nothing",), "the zoo has no 'nothing'"),
        (("zoo:panda-realeasy-rt",), "holds no policy: got a network"),
    ],
)
def test_bad_input(run, tmp_path, arguments, said):
    code, out, err = run(*arguments, "--out", "log")
    assert (code, out) == (2, "")
    assert len(err.strip().splitlines()) <= 2
    assert said in err
    assert not (tmp_path / "log").exists()


@pytest.mark.long
def test_what_was_driven_can_be_identified_from(tmp_path):
    policy_of(tmp_path / "still", np.zeros(7))
    drive(tmp_path / "still", load_robot("panda_torque"), 5, seconds=0.2, out=tmp_path / "driven")
    data = Dataset(tmp_path / "driven")
    assert [len(data.select(split=split)) for split in ("train", "val", "test")] == [3, 1, 1]


@pytest.mark.long
def test_goals_that_are_driven_to_are_not_those_that_are_judged_on(tmp_path):
    """With the seeds that nobody has chosen: what is identified from the runs is not tested on their goals."""
    policy_of(tmp_path / "still", np.zeros(7))
    robot = load_robot("panda_torque")
    driven = [run.goal for run in drive(tmp_path / "still", robot, 20, seconds=0.05)]
    (own,) = judge_policies([tmp_path / "still"], robot, places=["mujoco"], goals=20).episodes.values()
    judged = own["mujoco"].goals
    assert np.linalg.norm(np.array(driven)[:, None] - judged[None], axis=-1).min() > 1e-6


def test_torques_may_be_larger_by_what_is_added_to_them(tmp_path):
    """As where a policy with the thesis's friction is judged: its torques are cut, and then the offset is added."""
    card = policy_of(tmp_path / "strong", np.zeros(7)).card
    robot = load_robot("panda_torque")
    model = MujocoSimulator.from_robot(robot, find_model(robot)).model
    plain, more = guard_settings(card, robot, model), guard_settings(card, robot, model, offset_nm=np.array(OFFSET))
    np.testing.assert_allclose(np.array(more.torque_nm) - plain.torque_nm, np.abs(OFFSET))
    assert all(own <= joint.torque_limit for own, joint in zip(more.torque_nm, robot.joints, strict=True))
