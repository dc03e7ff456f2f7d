"""Training policies: all four algorithms learn, the thesis's numbers are the thesis's, and what is interrupted goes on."""

import resource
from dataclasses import replace

import numpy as np
import pytest
import torch
from sb3_contrib import TQC
from stable_baselines3 import DDPG, SAC, TD3

from trueup.augment.checkpoint import read_tensors
from trueup.cli.policy_config import configured
from trueup.errors import ConfigError, DataError, Diverged, OutputExists
from trueup.policy.arms import MujocoArms
from trueup.policy.config import ALGORITHMS, PAPER, LearnerConfig, PolicyConfig
from trueup.policy.environment import ReachVector
from trueup.policy.learners import make_learner
from trueup.policy.randomization import RandomizationConfig
from trueup.policy.reach import ReachConfig
from trueup.policy.reaching import Reaching
from trueup.policy.simulated import simulated
from trueup.policy.thesis_friction import ThesisFriction
from trueup.policy.training import judged, rounds_of, train
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator

PANDA = load_robot("panda_torque")
SIMULATOR = MujocoSimulator.from_robot(PANDA, find_model(PANDA))
SMALL = PolicyConfig(
    learner=LearnerConfig(starts=64, batch=32, updates=2, buffer=2_000, layers=(16,)),
    reach=ReachConfig(control_hz=25.0, episode_s=0.8),
    arms=4,
    steps=480,
    rounds=3,
)


def arms(count, config=SMALL.reach):
    return Reaching(MujocoArms(SIMULATOR, count, config.control_s), SIMULATOR.model, config)


def trained(folder, config=SMALL, **options):
    return train(config, arms(config.arms), arms(8), checkpoint=folder / "checkpoint", inputs="x", **options)


def weights(learner):
    return {name: value.clone() for name, value in learner.policy.state_dict().items()}


@pytest.mark.long
def test_the_thesis_numbers(tmp_path):
    """ES thesis, 2.3 and 2.3.2, those in bold."""
    assert {name: own.rate for name, own in PAPER.items()} == {"ddpg": 2e-3, "sac": 2e-3, "td3": 2e-3, "tqc": 1e-3}
    assert {name: own.gamma for name, own in PAPER.items()} == {"ddpg": 0.95, "sac": 0.99, "td3": 0.99, "tqc": 0.95}
    assert {name: own.tau for name, own in PAPER.items()} == {"ddpg": 0.01, "sac": 0.01, "td3": 0.01, "tqc": 0.9}
    assert {name: own.sigma for name, own in PAPER.items() if name != "tqc"} == {"ddpg": 0.1, "sac": 0.2, "td3": 0.2}
    for own in PAPER.values():
        assert (own.batch, own.buffer, own.starts, own.every, own.updates) == (2048, 1_000_000, 5000, 500, 50)
        assert own.layers == (512, 512, 512)
    # Table 2.1: fifty updates after every five hundred control steps of one arm.
    config = configured("paper", "tqc", None, 2000)
    small = replace(config.learner, batch=8, starts=1, layers=(4,), buffer=3000)
    learner, _ = trained(tmp_path, replace(config, learner=small, reach=SMALL.reach, rounds=1))
    assert learner._n_updates / learner.num_timesteps == pytest.approx(50 / 500, rel=0.3)


def test_policies_that_draw_nothing_explore_on_a_laptop():
    for algorithm in ALGORITHMS:
        own = configured("laptop", algorithm, None, None).learner
        deterministic = algorithm in ("td3", "ddpg")
        assert (own.noise, own.n_steps) == (("normal", 1) if deterministic else ("none", 3))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("noise", ["none", "normal", "ou"])
def test_every_algorithm_gets_its_numbers_and_learns(algorithm, noise):
    learner = replace(
        PAPER[algorithm], noise=noise, starts=8, every=4, updates=1, batch=8, layers=(8, 8, 8), buffer=100
    )
    vector = ReachVector(arms(2), seed=0)
    made = make_learner(replace(SMALL, algorithm=algorithm, learner=learner), vector, device="cpu", seed=0)
    assert type(made).__name__.lower() == algorithm
    assert made.gamma == learner.gamma
    assert made.tau == learner.tau
    assert made.policy.critic.n_critics == (1 if algorithm == "ddpg" else 2)
    assert (made.action_noise is None) == (noise == "none")
    if noise != "none":
        assert made.action_noise._sigma[0] == learner.sigma
    before = weights(made)
    made.learn(40)
    assert made._n_updates > 0
    assert any(not torch.equal(before[name], value) for name, value in weights(made).items())


AHEAD = replace(SMALL, learner=replace(SMALL.learner, n_steps=3, last_rate=1e-4, goal_scale=20.0))
# Of rounds of 160 control steps, the first two only act.
LATE = replace(SMALL, learner=replace(SMALL.learner, starts=340))


@pytest.mark.long
@pytest.mark.parametrize("config", [SMALL, AHEAD, LATE], ids=["plain", "n steps", "no updates in the first rounds"])
def test_an_interrupted_training_ends_with_the_same_weights(tmp_path, config):
    for folder in ("whole", "parts"):
        (tmp_path / folder).mkdir()
    whole, history = trained(tmp_path / "whole", config)

    def stop(done, _):
        if done.number == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trained(tmp_path / "parts", config, on_round=stop)
    parts, again = trained(tmp_path / "parts", config, resume=True)
    assert [item.number for item in again] == [1, 2, 3]
    assert [(item.steps, item.updates) for item in history] == [(item.steps, item.updates) for item in again]
    assert [item.reward for item in history] == [item.reward for item in again]
    for name in ("observations", "actions", "rewards"):
        assert (getattr(whole.replay_buffer, name) == getattr(parts.replay_buffer, name)).all(), name
    for name, value in weights(whole).items():
        assert torch.equal(value, weights(parts)[name]), name
    other, _ = trained(tmp_path, config, seed=1)
    assert any(not torch.equal(value, weights(other)[name]) for name, value in weights(whole).items())


@pytest.mark.long
def test_rewards_are_not_counted_into_another_episode(tmp_path):
    """Of what is remembered, whatever is not followed by what came next is marked as the end of an episode."""
    learner, _ = trained(tmp_path, AHEAD)
    buffer = learner.replay_buffer
    rows = np.arange(buffer.pos - 1)
    after = (buffer.next_observations[rows] == buffer.observations[rows + 1]).all(axis=-1)
    ended = np.maximum(buffer.dones, buffer.timeouts)[rows] > 0
    assert (after | ended).all()
    # Episodes of 20 control steps do not end with rounds of 40.
    assert (~after).sum() >= 2 * SMALL.arms
    # Ends are bootstrapped from, as those of time are.
    assert (buffer.dones * (1 - buffer.timeouts)).sum() == 0


@pytest.mark.long
def test_the_learning_rate_falls_from_round_to_round(tmp_path):
    learner, _ = trained(tmp_path, AHEAD)
    assert learner.actor.optimizer.param_groups[0]["lr"] == pytest.approx(1e-4)
    (tmp_path / "one").mkdir()
    learner, _ = trained(tmp_path / "one", replace(AHEAD, rounds=1))
    assert learner.actor.optimizer.param_groups[0]["lr"] == pytest.approx(AHEAD.learner.rate)
    (tmp_path / "two").mkdir()
    learner, _ = trained(tmp_path / "two", SMALL)
    assert learner.actor.optimizer.param_groups[0]["lr"] == pytest.approx(SMALL.learner.rate)


def test_networks_are_given_the_way_to_the_goal_scaled(tmp_path):
    learner = make_learner(AHEAD, ReachVector(arms(4)), device="cpu", seed=0)
    seen = torch.rand(2, 24)
    expected = seen.clone()
    expected[:, 21:] *= 20.0
    for network in (learner.actor, learner.critic, learner.critic_target):
        torch.testing.assert_close(network.features_extractor(seen), expected)


@pytest.mark.long
def test_the_best_round_is_kept_and_numbers_of_others_are_left_alone(tmp_path):
    torch.manual_seed(5)
    np.random.seed(5)  # noqa: NPY002
    expected = torch.rand(1), np.random.random()  # noqa: NPY002
    torch.manual_seed(5)
    np.random.seed(5)  # noqa: NPY002
    learner, history = trained(tmp_path)
    assert (torch.rand(1), np.random.random()) == expected  # noqa: NPY002
    best = max(history, key=lambda item: item.reward)
    found = judged(learner, ReachVector(arms(8)), 0)
    assert found == (best.reward, best.distance_m, best.worst_m)
    kept, _ = read_tensors(tmp_path / "checkpoint", "x")
    assert torch.equal(learner.log_ent_coef, kept["best.log_ent_coef"])
    assert (best == history[-1]) == torch.equal(kept["log_ent_coef"], kept["best.log_ent_coef"])
    assert history[-1].steps >= SMALL.steps
    assert history[0].cpu_seconds > 0
    assert trained(tmp_path, resume=True)[1] == history


def test_a_checkpoint_of_another_training_or_a_broken_one(tmp_path):
    trained(tmp_path, stop=lambda _: True)
    with pytest.raises(OutputExists, match="another configuration"):
        train(SMALL, arms(4), arms(8), checkpoint=tmp_path / "checkpoint", inputs="y", resume=True)
    content = (tmp_path / "checkpoint").read_bytes()
    (tmp_path / "checkpoint").write_bytes(content[: len(content) // 2])
    with pytest.raises(DataError, match="is no checkpoint"):
        trained(tmp_path, resume=True)
    (tmp_path / "checkpoint").write_bytes(content)
    other = replace(SMALL, learner=replace(SMALL.learner, layers=(8,)))
    with pytest.raises(DataError, match="another version"):
        trained(tmp_path, config=other, resume=True)


@pytest.mark.long
def test_a_full_disk_is_said_and_the_last_checkpoint_stays(tmp_path):
    trained(tmp_path, stop=lambda _: True)
    before = (tmp_path / "checkpoint").read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(DataError, match=r"cannot write .*checkpoint: got .*File too large"):
            trained(tmp_path, resume=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint"]
    assert (tmp_path / "checkpoint").read_bytes() == before
    assert len(rounds_of(tmp_path / "checkpoint", "x")) == 1
    assert len(trained(tmp_path, resume=True)[1]) == SMALL.rounds


def test_a_training_that_diverges_is_said(tmp_path, monkeypatch):
    from trueup.policy import training

    def poisoned(*given, **options):
        learner = make_learner(*given, **options)
        with torch.no_grad():
            next(iter(learner.policy.actor.parameters())).fill_(float("nan"))
        return learner

    monkeypatch.setattr(training, "make_learner", poisoned)
    with pytest.raises(Diverged, match=r"training diverged.*round 1"):
        trained(tmp_path)


def test_configurations_that_learn_nothing():
    for wrong in ({"rate": 0.0}, {"gamma": 1.5}, {"batch": -1}, {"tau": float("nan")}):
        with pytest.raises(ConfigError, match="learner"):
            LearnerConfig(**wrong)
    for wrong in ({"arms": 0}, {"steps": 10, "rounds": 20}):
        with pytest.raises(ConfigError, match="policy"):
            PolicyConfig(**wrong)


def test_arms_are_as_the_configuration_asks():
    config = replace(SMALL, randomization=RandomizationConfig(friction=0.1, noise_rad=1e-3, noise_rad_s=1e-2))
    made = simulated(config, PANDA, find_model(PANDA))
    assert made.arms.count == 4
    vector = ReachVector(made, seed=0)
    seen = vector.reset()
    damping = {model.dof_damping[0] for model in made.arms._models}
    assert len(damping) == 4
    assert 0 < np.abs(seen[:, :7] - np.sin(made.home)).max() < 0.01
    plain = simulated(config, PANDA, find_model(PANDA), count=2, randomized=False)
    seen = ReachVector(plain, seed=0).reset()
    np.testing.assert_allclose(seen[:, :7], np.tile(np.sin(plain.home), (2, 1)), atol=1e-6)
    assert plain.arms._models[0].dof_damping[0] == 1.0
    thesis = simulated(replace(SMALL, friction="thesis"), PANDA, find_model(PANDA), count=1)
    ReachVector(thesis, seed=0).reset()
    assert not thesis.arms._models[0].dof_damping.any()
    assert thesis._friction is not None
    late = replace(PANDA, controller=replace(PANDA.controller, delay_s=0.01))
    delayed = simulated(SMALL, late, find_model(PANDA), count=1)
    ReachVector(delayed, seed=0).reset()
    first = delayed.arms._line.acting(np.ones((1, 7)))
    assert (first == 0.0).sum() == 70  # ten of the physics steps, seven joints


def test_friction_of_actions_is_drawn_for_every_arm_and_for_no_other_robot():
    config = replace(SMALL, friction="thesis", randomization=RandomizationConfig(friction=0.1))
    made = simulated(config, PANDA, find_model(PANDA))
    rng = np.random.default_rng(0)
    made.begin(np.arange(4), rng)
    scale = made._friction_scale
    assert scale.shape == (4, 7, 5)
    assert (scale >= 0.9).all()
    assert (scale <= 1.1).all()
    assert np.unique(scale).size == scale.size
    before = scale.copy()
    made.begin(np.array([2]), rng)
    assert (made._friction_scale != before).any(axis=(1, 2)).tolist() == [False, False, True, False]
    with pytest.raises(ConfigError, match=r"joints of a Panda: got 5 joints; expected 7"):
        Reaching(FiveJoints(), SIMULATOR.model, ReachConfig(torque_nm=(1.0,) * 5), friction=ThesisFriction())


class FiveJoints:
    count, control_s, joints = 1, 0.02, PANDA.joint_names[:5]
    position = velocity = np.zeros((1, 5))

    def begin(self, rows, position, rng):
        pass

    def step(self, torque):
        pass


def test_an_error_that_is_no_divergence_is_not_called_one(tmp_path, monkeypatch):
    def wrong(self, *given, **options):
        raise ValueError("operands could not be broadcast")

    for kind in (DDPG, SAC, TD3, TQC):
        monkeypatch.setattr(kind, "learn", wrong)
    with pytest.raises(ValueError, match="broadcast"):
        trained(tmp_path)
