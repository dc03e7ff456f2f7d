"""An environment with a compensation: what it adds, and what a policy's library asks of it."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from deploy.compensation_cases import compensation
from trueup.compensate.compensated_env import CompensatedEnv
from trueup.deploy import Compensator, CompensatorSettings, Limits, Why
from trueup.errors import ConfigError, MissingSignal

WIDE = Limits((-2.0, -2.0), (2.0, 2.0))


class Reach(gymnasium.Env):
    """Two joints that follow their targets; the observation has both positions and velocities."""

    def __init__(self, *, told=True):
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (4,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.5, 1.5, (2,), np.float64)
        self.told, self.taken = told, []
        self.state = np.zeros(4)

    def info(self):
        named = {"position": self.state[:2].copy(), "velocity": self.state[2:].copy(), "payload_kg": 2.0}
        return named if self.told else {}

    def reset(self, *, seed=None, options=None):  # noqa: ARG002
        super().reset(seed=seed)
        self.state = np.concatenate([self.np_random.uniform(-1, 1, 2), np.zeros(2)])
        return self.state.copy(), self.info()

    def step(self, action):
        self.taken.append(np.array(action))
        pulled = 100.0 * (action - self.state[:2]) - 15.0 * self.state[2:]
        self.state[2:] = np.clip(self.state[2:] + 0.02 * pulled, -3, 3)
        self.state[:2] += 0.02 * self.state[2:]
        return self.state.copy(), float(-np.abs(self.state[:2]).sum()), False, False, self.info()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    compensation(folder, direction="simulator", reach=4.0)
    return folder


def made(folder, **options):
    settings = CompensatorSettings(largest=0.1)
    given = {"joints": ("a", "b"), "limits": WIDE, "settings": settings, "payload_kg": 1.0, **options}
    return Compensator.load(folder, **given)


@pytest.mark.filterwarnings("ignore")  # the checker's advice on what the environment itself chose
@pytest.mark.parametrize("told", [True, False])
def test_the_checker_of_gymnasium_accepts_it(folder, told):
    state = ("position", "velocity") if told else lambda seen, _: (seen[:2], seen[2:])
    check_env(CompensatedEnv(Reach(told=told), made(folder), state=state), skip_render_check=True)


def test_the_environment_gets_the_action_and_what_it_lacks(folder):
    env = CompensatedEnv(Reach(), made(folder), payload="payload_kg")
    seen, _ = env.reset(seed=1)
    by_hand = made(folder, payload_kg=2.0)
    rng = np.random.default_rng(0)
    for _ in range(30):
        action = rng.uniform(-0.2, 0.2, 2)
        wanted = by_hand.step(seen[:2], seen[2:], action).target.copy()
        seen, _, _, _, info = env.step(action)
        np.testing.assert_array_equal(env.unwrapped.taken[-1], wanted)
        np.testing.assert_allclose(info["delta"], wanted - action, atol=1e-12)
        assert Why(info["compensation"]) in (Why.NONE, Why.LIMITED)
    assert np.abs(info["delta"]).max() > 0.01


def test_actions_stay_in_their_space(folder):
    env = CompensatedEnv(Reach(), made(folder))
    env.reset(seed=2)
    for action in (np.array([1.5, -1.5]), np.array([np.inf, 0.0]), np.array([np.nan, 9.0])):
        for _ in range(20):
            env.step(action)
            assert env.action_space.contains(env.unwrapped.taken[-1])


def test_actions_of_another_kind_are_translated(folder):
    env = Reach()
    env.action_space = gymnasium.spaces.Discrete(3)
    poses = np.array([[-0.5, 0.0], [0.0, 0.0], [0.5, 0.0]])
    with pytest.raises(ConfigError, match="no positions of the joints"):
        CompensatedEnv(env, made(folder))
    with pytest.raises(ConfigError, match="belong together"):
        CompensatedEnv(env, made(folder), target=lambda action: poses[action])
    wrapped = CompensatedEnv(env, made(folder), target=lambda action: poses[action], action=lambda _, pose: pose)
    wrapped.reset(seed=0)
    wrapped.step(2)
    assert 0 < np.abs(env.taken[0] - poses[2]).max() < 0.2


def test_what_is_not_told_is_an_error(folder):
    env = CompensatedEnv(Reach(told=False), made(folder))
    with pytest.raises(ConfigError, match="reset before"):
        env.step(np.zeros(2))
    with pytest.raises(MissingSignal, match="position"):
        env.reset()
    with pytest.raises(MissingSignal, match="payload_kg"):
        CompensatedEnv(Reach(told=False), made(folder), payload="payload_kg").reset()


def test_a_compensation_for_a_robot_is_none_for_a_simulator(tmp_path):
    compensation(tmp_path, direction="robot")
    with pytest.raises(ConfigError, match="corrects the commands of a robot"):
        CompensatedEnv(Reach(), made(tmp_path))
