"""Robots that follow measured motions: what they get for it (GapONet, eq. 9), what is seen, and how episodes end."""

from dataclasses import replace

import numpy as np
import pytest

from compensate.fleet_cases import changes, tracks, transitions
from trueup.compensate.ppo_config import PpoConfig
from trueup.errors import ConfigError, DataError

pytest.importorskip("stable_baselines3")
from trueup.compensate.environment import TrackingEnvironment

SCALE = np.array([0.05, 0.02])
CONFIG = PpoConfig(robots=6, steps=8, batch=8, episode=20)


def environment(motions, config=CONFIG, *, past=2, seed=0, scale=SCALE, of=transitions):
    return TrackingEnvironment(motions, of, config, past=past, scale=scale, seed=seed)


def stepped(own, actions):
    own.step_async(np.asarray(actions, np.float32))
    return own.step_wait()


def places(own, motions):
    """Of each robot the motion, and the row in it."""
    starts = np.cumsum([0, *(len(track) for track in motions)])
    number = np.searchsorted(starts, own._at, side="right") - 1
    return [(motions[k], int(at - starts[k]), k) for k, at in zip(number, own._at, strict=True)]


@pytest.mark.parametrize("reward", ["change", "state", "position"])
def test_the_reward_is_that_of_the_paper(reward):
    config = replace(CONFIG, reward=reward, weight=0.3, position_rad=0.05, velocity_rad_s=0.7, smoothness=0.02)
    motions, _ = tracks()
    own = environment(motions, config)
    seen = own.reset()
    last = np.zeros((6, 2))
    rng = np.random.default_rng(1)
    for _ in range(4):
        actions = rng.normal(size=(6, 2)).astype(np.float32)
        where = places(own, motions)
        before = seen[:, 14:18].astype(float)
        seen, rewards, done, _ = stepped(own, actions)
        assert not done.any()
        after = seen[:, 14:18].astype(float)
        for row, (track, at, _) in enumerate(where):
            real, there = track.state[at + 1].astype(float), after[row]
            if reward == "change":  # eq. 9, its state being positions and velocities in units of their sizes
                real, there = real - track.state[at], there - before[row]
            squares = ((real - there) / [0.05, 0.05, 0.7, 0.7]) ** 2
            matched = squares[:2].sum() if reward == "position" else squares.sum()
            jump = (((actions[row] * SCALE - last[row]) / 0.05) ** 2).sum()
            assert rewards[row] == pytest.approx(-0.3 * (matched + 0.02 * jump), rel=1e-4)
        last = actions * SCALE
        assert own.tally().reward == pytest.approx(rewards.mean(), rel=1e-5)


@pytest.mark.parametrize("delay_s", [0.0, 0.01])
@pytest.mark.parametrize("reward", ["change", "state"])
def test_what_the_robot_adds_makes_no_error(reward, delay_s):
    motions, added = tracks(delay_s=delay_s)
    config = replace(CONFIG, reward=reward, smoothness=0.0, episode=100)
    own, other = (environment(motions, config, of=lambda kg: transitions(kg, delay_s)) for _ in range(2))
    own.reset()
    for row, (track, at, k) in enumerate(places(own, motions)):  # as if it had been compensated before, too
        own._before[row] = track.command[at - 1] + added[k][at - 1]
    other.restore(own.memory())
    without = -stepped(other, np.zeros((6, 2)))[1].mean()
    for _ in range(12):
        right = np.stack([added[k][at] for _, at, k in places(own, motions)])
        _, rewards, done, _ = stepped(own, right / SCALE)
        assert -rewards.mean() < 1e-6 * without
        assert not done.any()
    assert without > 1e-3


def test_what_is_seen_is_what_the_network_reads_and_what_the_critic_may_know():
    motions, _ = tracks()
    own = environment(motions, past=2)
    first = own.reset()
    for row, (track, at, _) in enumerate(places(own, motions)):
        history = [np.concatenate([track.state[k], track.command[k], [track.payload_kg]]) for k in (at - 2, at - 1, at)]
        np.testing.assert_allclose(first[row, :21], np.concatenate(history), atol=1e-6)
        np.testing.assert_allclose(first[row, 21:], 0.0, atol=1e-6)
    actions = np.full((6, 2), 2.0)
    where = places(own, motions)
    seen = stepped(own, actions)[0]
    np.testing.assert_array_equal(seen[:, :14], first[:, 7:21])
    for row, (track, at, _) in enumerate(where):
        np.testing.assert_array_equal(seen[row, 18:20], track.command[at + 1])
    sizes = np.repeat([CONFIG.position_rad, CONFIG.velocity_rad_s], 2)
    real = np.stack([track.state[at + 1] for track, at, _ in where])
    error = np.clip((seen[:, 14:18] - real) / sizes, -20, 20)
    np.testing.assert_allclose(seen[:, 21:25], error, atol=1e-3)
    np.testing.assert_allclose(seen[:, 25:], actions)


def test_robots_carry_what_the_data_carry():
    motions, _ = tracks(payloads=(0.0, 1.0, 2.0), of_each=1, count=60)
    longer, _ = tracks(payloads=(2.0,), of_each=4, count=60)
    own = environment([*motions, *longer], replace(CONFIG, robots=24))
    masses, counts = np.unique(own.payload_kg, return_counts=True)
    assert masses.tolist() == [0.0, 1.0, 2.0]
    assert counts.sum() == 24
    np.testing.assert_allclose(counts / 24, [1 / 7, 1 / 7, 5 / 7], atol=0.07)
    own.reset()
    for row, (track, _, _) in enumerate(places(own, [*motions, *longer])):
        assert track.payload_kg == own.payload_kg[row]


def test_actions_are_bounded():
    motions, _ = tracks()
    own = environment(motions, replace(CONFIG, largest_rad=0.03))
    own.reset()
    np.testing.assert_allclose(own.action_space.high, 0.03 / SCALE, rtol=1e-6)
    seen = stepped(own, np.full((6, 2), 100.0))[0]
    np.testing.assert_allclose(seen[:, 25:] * SCALE, 0.03, rtol=1e-5)


def still(count, seed):
    return np.zeros((count, 2))


class TestEpisodes:
    def test_they_end_after_so_many_steps_and_begin_elsewhere(self):
        motions, _ = tracks(count=200, changed=still)
        own = environment(motions, replace(CONFIG, episode=5))
        own.reset()
        for step in range(1, 11):
            where = places(own, motions)
            seen, _, done, infos = stepped(own, np.zeros((6, 2)))
            assert done.all() == (step % 5 == 0)
            if not done.any():
                assert infos == [{}] * 6
                continue
            for row, (track, at, _) in enumerate(where):
                last = infos[row]["terminal_observation"]
                np.testing.assert_allclose(last[14:18], track.state[at + 1], atol=1e-4)
                assert infos[row]["TimeLimit.truncated"] is True
                assert infos[row]["episode"]["l"] == 5
                assert not np.array_equal(last, seen[row])
            for row, (track, at, _) in enumerate(places(own, motions)):
                np.testing.assert_allclose(seen[row, 14:18], track.state[at], atol=1e-6)
        tally = own.tally()
        assert (tally.steps, tally.episodes, tally.left, tally.lost) == (60, 12, 0, 0)
        assert own.tally().steps == 0

    def test_they_end_with_the_motion(self):
        motions, _ = tracks(count=24, of_each=1)
        own = environment(motions, replace(CONFIG, episode=1000))
        own.reset()
        for _ in range(60):
            where = places(own, motions)
            done = stepped(own, np.zeros((6, 2)))[2]
            assert done.tolist() == [at + 2 == len(track) for track, at, _ in where]
        assert own.tally().left == 0

    def test_they_end_where_the_motion_is_left(self):
        motions, _ = tracks(count=200)
        own = environment(motions, replace(CONFIG, leave_rad=0.2, largest_rad=1.0, episode=1000))
        own.reset()
        ended = 0
        for _ in range(30):
            _, _, done, infos = stepped(own, np.full((6, 2), 1.0) / SCALE)
            ended += done.sum()
            for row in np.flatnonzero(done):
                error = infos[row]["terminal_observation"][21:23] * CONFIG.position_rad
                assert np.abs(error).max() > 0.2
        tally = own.tally()
        assert ended == tally.left > 0
        assert tally.lost == 0

    def test_one_that_diverges_ends_alone(self):
        motions, _ = tracks(count=200)
        own = environment(motions, replace(CONFIG, episode=1000))
        first = own.reset()
        memory = own.memory()
        memory["fleet"][2, 1:5] = 1e9
        own.restore(memory)
        seen, rewards, done, infos = stepped(own, np.zeros((6, 2)))
        assert done.tolist() == [False, False, True, False, False, False]
        assert np.isfinite(seen).all()
        assert np.isfinite(rewards).all()
        assert rewards[2] < 10 * np.delete(rewards, 2).min()
        assert np.isfinite(infos[2]["terminal_observation"]).all()
        assert own.tally().lost == 1
        assert np.isfinite(stepped(own, np.zeros((6, 2)))[0]).all()
        assert first.shape == seen.shape


def walk(own, steps=30, seed=3):
    rng = np.random.default_rng(seed)
    made = [own.reset()]
    for _ in range(steps):
        seen, rewards, done, _ = stepped(own, rng.normal(size=(own.num_envs, 2)))
        made += [seen, rewards, done]
    return made


def test_a_seed_decides_about_everything():
    motions, _ = tracks()
    first, again, other = (walk(environment(motions, seed=seed)) for seed in (4, 4, 5))
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.array_equal(first[0], other[0])
    own = environment(motions, seed=5)
    own.seed(4)
    np.testing.assert_array_equal(own.reset(), first[0])


def test_it_goes_on_from_its_memory():
    motions, _ = tracks()
    own = environment(motions, seed=1)
    walk(own)
    memory = own.memory()
    other = environment(motions, seed=2)
    other.reset()
    kept = other.restore(memory)
    for each in (own, other):
        each.seed(7)
    np.testing.assert_array_equal(kept, own._observed())
    for _ in range(25):
        for one, two in zip(stepped(own, np.ones((6, 2)))[:3], stepped(other, np.ones((6, 2)))[:3], strict=True):
            np.testing.assert_array_equal(one, two)
    memory["at"] = memory["at"][:3]
    with pytest.raises(DataError, match="memory"):
        other.restore(memory)


def test_what_cannot_be_is_refused():
    motions, _ = tracks(payloads=(0.0, 1.0, 2.0), of_each=1, count=30)
    with pytest.raises(ConfigError, match="fewer than payloads"):
        environment(motions, replace(CONFIG, robots=2))
    with pytest.raises(DataError, match="long enough"):
        environment(motions, past=29)
    for wrong in ({"batch": 7}, {"gamma": 1.5}, {"rate": 0.0}, {"robots": 0}, {"smoothness": -1.0}):
        with pytest.raises(ConfigError, match="ppo"):
            replace(CONFIG, **wrong)


def test_changes_are_not_nothing():
    assert np.abs(changes(100, 0)).max() > 0.05
