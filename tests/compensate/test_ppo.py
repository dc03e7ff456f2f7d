"""PPO finds what commands lack, leaves the network as other trainings do, and goes on as if nothing had happened."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from compensate.fleet_cases import corrector, tracks, transitions
from trueup.augment.networks.operator import OperatorConfig
from trueup.compensate.ppo_config import PAPER, PpoConfig
from trueup.compensate.training import delta_of
from trueup.errors import DataError, OutputExists

pytest.importorskip("stable_baselines3")
from trueup.compensate.environment import TrackingEnvironment
from trueup.compensate.ppo import Learner, train_ppo

OFFSET = np.array([0.06, 0.0])
SHORT = PpoConfig(samples=4 * 64, robots=8, steps=8, batch=32, epochs=2, critic=(16,))


def offset(count, seed):
    return np.tile(OFFSET, (count, 1))


@pytest.fixture(scope="module")
def motions():
    return tracks(changed=offset)[0]


def weights(network):
    return {name: value.clone() for name, value in network.state_dict().items()}


def same(one, two):
    return all(torch.equal(one[name], two[name]) for name in one)


@pytest.mark.long
def test_it_finds_a_constant_offset(motions):
    network = corrector(motions)
    config = PpoConfig(samples=24 * 512, robots=32, steps=16, batch=128, gamma=0.8, rate=1e-2, critic=(32, 32))
    history = train_ppo(network, motions, transitions, config)
    assert len(history) == 24
    assert history[-1].samples == 24 * 512
    rewards = [line.reward for line in history]
    assert np.mean(rewards[-3:]) > 0.2 * np.mean(rewards[:3])  # they are negative
    track = motions[0]
    rows = np.concatenate([track.state, track.command, np.zeros((len(track), 1), np.float32)], axis=1)
    with torch.no_grad():
        found = torch.stack([delta_of(network, torch.from_numpy(rows[k - 1 : k + 1, None])) for k in range(5, 100)])
    assert found.numpy()[:, 0].mean(axis=0) == pytest.approx(OFFSET, abs=0.015)
    assert not network.training


def test_actions_are_drawn_around_what_the_network_says(motions):
    network = corrector(motions)
    own = TrackingEnvironment(motions, transitions, SHORT, past=1, scale=np.array([0.05, 0.05]))
    learner = Learner(network, own, SHORT)
    seen = torch.from_numpy(own.reset())
    policy = learner.policy
    window = seen[:, :14].reshape(-1, 2, 7).transpose(0, 1)
    said = delta_of(network, window) / 0.05
    torch.testing.assert_close(policy.get_distribution(seen).distribution.mean, said)
    actions, values, odds = policy(seen, deterministic=True)
    torch.testing.assert_close(actions, said)
    again, same_odds, _ = policy.evaluate_actions(seen, actions)
    torch.testing.assert_close((values, odds), (again, same_odds))
    with torch.no_grad():
        drawn = torch.stack([policy(seen)[0] for _ in range(400)])
    torch.testing.assert_close(drawn.std(0), torch.full_like(said, SHORT.noise), rtol=0.2, atol=0)
    # The critic knows how far the simulator is from the motion; the actor does not.
    seen[:, 14:] += 1.0
    torch.testing.assert_close(policy.get_distribution(seen).distribution.mean, said)
    assert not torch.allclose(policy.predict_values(seen), values)


def test_a_seed_decides_about_everything_and_no_other_draw_is_changed(motions):
    networks = [corrector(motions) for _ in range(3)]
    before = torch.get_rng_state(), np.random.get_state()[1]  # noqa: NPY002
    histories = [
        train_ppo(network, motions, transitions, SHORT, seed=seed)
        for network, seed in zip(networks, (0, 0, 1), strict=True)
    ]
    assert torch.equal(torch.get_rng_state(), before[0])
    np.testing.assert_array_equal(np.random.get_state()[1], before[1])  # noqa: NPY002
    assert same(weights(networks[0]), weights(networks[1]))
    assert not same(weights(networks[0]), weights(networks[2]))
    assert [line.reward for line in histories[0]] == [line.reward for line in histories[1]]


class TestResume:
    def test_it_goes_on_as_if_it_had_not_been_interrupted(self, motions, tmp_path):
        whole, parts = corrector(motions), corrector(motions)
        expected = train_ppo(whole, motions, transitions, SHORT)
        path = tmp_path / "ppo.safetensors"
        stopped = train_ppo(parts, motions, transitions, SHORT, checkpoint=path, stop=lambda line: line.number == 2)
        assert len(stopped) == 2
        parts = corrector(motions)
        history = train_ppo(parts, motions, transitions, SHORT, checkpoint=path)
        assert history[:2] == stopped
        assert [line.reward for line in history] == [line.reward for line in expected]
        assert same(weights(parts), weights(whole))
        # And once it is done, nothing happens any more.
        parts = corrector(motions)
        assert train_ppo(parts, motions, transitions, SHORT, checkpoint=path) == history
        assert same(weights(parts), weights(whole))

    def test_another_training_is_refused(self, motions, tmp_path):
        path = tmp_path / "ppo.safetensors"
        train_ppo(corrector(motions), motions, transitions, SHORT, checkpoint=path)
        for config, seed, data in (
            (replace(SHORT, gamma=0.5), 0, motions),
            (SHORT, 1, motions),
            (SHORT, 0, motions[:3]),
        ):
            with pytest.raises(OutputExists, match="another configuration"):
                train_ppo(corrector(motions), data, transitions, config, seed=seed, checkpoint=path)

    def test_a_broken_file_is_refused(self, motions, tmp_path):
        path = tmp_path / "ppo.safetensors"
        train_ppo(corrector(motions), motions, transitions, SHORT, checkpoint=path)
        whole = path.read_bytes()
        for broken in (whole[:100], b"", whole[:-8] + bytes(8), whole.replace(b'"state"', b'"stale"')):
            path.write_bytes(broken)
            with pytest.raises(DataError):
                train_ppo(corrector(motions), motions, transitions, SHORT, checkpoint=path)


def test_a_further_loss_is_minimized_along(motions):
    network = corrector(
        motions, network=OperatorConfig(hidden=(16,), trunk=(16,), predictor=(16,), sensors=3, features=4)
    )
    x = torch.randn(network.network.past + 1, 64, 7, generator=torch.Generator().manual_seed(0))
    wanted = 0.3 * torch.tanh(x[-1, :, :4]).repeat(1, 3)

    def sensors(generator):
        rows = torch.randint(64, (32,), generator=generator)
        return (network.network.sensors(x[:, rows])[-1] - wanted[rows]).pow(2).mean()

    def loss():
        with torch.no_grad():
            return float((network.network.sensors(x)[-1] - wanted).pow(2).mean())

    before = loss()
    config = replace(SHORT, samples=20 * 64, rate=1e-2, decays=False)
    train_ppo(network, motions, transitions, config, auxiliary=sensors)
    assert loss() < 0.7 * before


def test_the_history_counts_what_it_took(motions):
    told = []
    history = train_ppo(corrector(motions), motions, transitions, SHORT, report=told.append)
    assert tuple(told) == history
    assert [line.number for line in history] == [1, 2, 3, 4]
    assert all(line.effort.seconds > 0 and line.effort.cpu_seconds > 0 for line in history)
    assert history[0].noise == pytest.approx(SHORT.noise * 0.05, rel=0.05)


def test_the_paper_is_a_configuration():
    assert (PAPER.batch, PAPER.clip, PAPER.gamma, PAPER.trace, PAPER.episode) == (4096, 0.2, 0.99, 0.95, 300)
    assert PAPER.robots * PAPER.steps == 131072
    assert (PAPER.reward, PAPER.smoothness) == ("change", 0.01)
