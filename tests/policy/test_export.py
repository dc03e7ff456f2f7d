"""A policy on a robot says what it said in training; one of another robot or rate, or a broken one, is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from trueup.core.atomic import json_hash
from trueup.core.policy_card import POLICY_CARD, POLICY_GRAPH, Kinematics, PolicyCard
from trueup.deploy.policy import Policy
from trueup.errors import ConfigError, DataError, FormatError, NameMismatch
from trueup.policy.arms import MujocoArms
from trueup.policy.config import ALGORITHMS, LearnerConfig, PolicyConfig, task_of
from trueup.policy.environment import ReachVector
from trueup.policy.export import export
from trueup.policy.learners import make_learner
from trueup.policy.reach import ReachConfig
from trueup.policy.reaching import Reaching
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator

PANDA = load_robot("panda_torque")
SIMULATOR = MujocoSimulator.from_robot(PANDA, find_model(PANDA))
TASK = ReachConfig(control_hz=25.0)


def arms(count=4):
    return Reaching(MujocoArms(SIMULATOR, count, TASK.control_s), SIMULATOR.model, TASK)


def exported(folder, algorithm="tqc"):
    reaching = arms()
    config = PolicyConfig(
        algorithm=algorithm, reach=TASK, learner=LearnerConfig(layers=(32, 16), buffer=100, goal_scale=7.0)
    )
    torch.manual_seed(3)
    learner = make_learner(config, ReachVector(reaching), device="cpu", seed=3)
    with torch.no_grad():  # far from zero, so that torques reach their limits
        for part in learner.policy.actor.parameters():
            part.mul_(3.0)
    card = export(learner, reaching, folder, name="reach", robot=PANDA.name, provenance={"seed": 3})
    return learner, card


def loaded(folder, **options):
    return Policy.load(folder, **{"joints": PANDA.joint_names, "rate_hz": 25.0} | options)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_it_says_what_the_learner_says(tmp_path, algorithm):
    learner, card = exported(tmp_path, algorithm)
    assert (card.joints, card.rate_hz, card.torque_nm) == (PANDA.joint_names, 25.0, TASK.torque_nm)
    policy, reaching, rng = loaded(tmp_path), arms(1), np.random.default_rng(0)
    seen = reaching.begin(np.zeros(1, int), rng)
    torques = []
    for _ in range(25):
        expected, _ = learner.predict(seen.astype(np.float32), deterministic=True)
        said = policy.step(reaching.arms.position[0], reaching.arms.velocity[0], reaching.goal[0])
        assert said.sound
        np.testing.assert_allclose(said.torque, expected[0], atol=2e-5)
        done = reaching.step(expected, rng)
        seen = done.observation
        torques.append(said.torque)
        after = policy.step(reaching.arms.position[0], reaching.arms.velocity[0], reaching.goal[0])
        assert after.distance_m == pytest.approx(done.distance_m[0])
    assert np.abs(torques).max() > 0.5
    assert (np.abs(torques) <= np.array(TASK.torque_nm) + 1e-9).all()


def test_another_robot_or_another_rate(tmp_path):
    exported(tmp_path)
    with pytest.raises(NameMismatch, match="another robot") as caught:
        loaded(tmp_path, joints=("a", "b"))
    assert "joint1" in str(caught.value)
    with pytest.raises(ConfigError, match=r"another rate.*100 Hz.*25 Hz"):
        loaded(tmp_path, rate_hz=100.0)


def test_what_is_no_number_moves_nothing_and_is_said(tmp_path):
    exported(tmp_path)
    policy, home = loaded(tmp_path), np.zeros(7)
    for position, velocity, goal in (
        (np.full(7, np.nan), home, np.ones(3)),
        (home, np.full(7, np.inf), np.ones(3)),
        (home, home, np.array([0.1, np.nan, 0.2])),
    ):
        said = policy.step(position, velocity, goal)
        assert not said.sound
        assert not said.torque.any()
    assert policy.step(home, home, np.ones(3)).sound
    with pytest.raises(DataError, match="a step of a policy"):
        policy.step(home[:6], home[:6], np.ones(3))


def test_a_network_that_says_nothing_moves_nothing(tmp_path):
    learner, _ = exported(tmp_path)
    with torch.no_grad():
        learner.policy.actor.mu.bias.fill_(float("nan"))
    export(learner, arms(), tmp_path / "nan", name="x", robot="panda", provenance={})
    said = loaded(tmp_path / "nan").step(np.zeros(7), np.zeros(7), np.ones(3))
    assert not said.sound
    assert not said.torque.any()


@pytest.mark.long
@pytest.mark.parametrize("said", ["none", 3, {"reach": 2}, {"reach": ["a"]}, None])
def test_a_card_whose_training_is_no_configuration_is_refused(tmp_path, said):
    _, card = exported(tmp_path)
    assert task_of(card).reach.site == card.site  # one that says nothing has the usual task
    with pytest.raises(ConfigError, match="policy 'reach'"):
        task_of(replace(card, provenance={"config": said}))


def test_broken_files(tmp_path):
    exported(tmp_path)
    card, graph = (tmp_path / name for name in (POLICY_CARD, POLICY_GRAPH))
    whole, tree = graph.read_bytes(), json.loads(card.read_text())
    graph.write_bytes(whole[:-10])
    with pytest.raises(DataError, match="is not the file that"):
        loaded(tmp_path)
    graph.unlink()
    with pytest.raises(DataError, match="cannot read"):
        loaded(tmp_path)
    graph.write_bytes(whole)
    card.write_text(json.dumps({**tree, "rate_hz": 50.0}))
    with pytest.raises(DataError, match="was changed"):
        loaded(tmp_path)
    card.write_text(json.dumps({**tree, "schema": "trueup.policy/9"}))
    with pytest.raises(FormatError, match="no policy of this version"):
        loaded(tmp_path)
    for key, value in (
        ("torque_nm", [1.0]),
        ("rate_hz", -1.0),
        ("kinematics", {**tree["kinematics"], "columns": [9] * 7}),
    ):
        content = {**{k: v for k, v in tree.items() if k != "sha256"}, key: value}
        card.write_text(json.dumps({**content, "sha256": json_hash(content)}))
        with pytest.raises(DataError, match="is broken"):
            loaded(tmp_path)
    card.unlink()
    with pytest.raises(DataError):
        loaded(tmp_path)


def test_a_graph_of_another_policy(tmp_path):
    _, card = exported(tmp_path)
    names = tuple("abcdef")
    fewer = replace(card, joints=names, torque_nm=(1.0,) * 6, kinematics=_short(card.kinematics))
    fewer.save(tmp_path)
    with pytest.raises(DataError, match="no policy of its card"):
        loaded(tmp_path, joints=names)
    assert PolicyCard.load(tmp_path).joints == names


def _short(whole):
    return Kinematics(whole.columns[:6], whole.axes[:6], whole.hinges[:6], whole.turns[:7], whole.shifts[:7])
