"""What a network is given by an environment that is read through it: its own samples, in their order, or none."""

import re
from typing import ClassVar

import mujoco
import numpy as np
import pytest
from gymnasium.wrappers import Autoreset, RepeatAction, TimeLimit

from augment.test_simulator import LSTM, SERVO, random_network
from policy.residual_cases import SHIFT, XML, Arm, shifting
from sim.arms import two_links
from trueup.augment import ResidualSimulator
from trueup.errors import ConfigError, NameMismatch
from trueup.policy import ResidualEnv
from trueup.robots import ControllerSpec


class Inside(Arm):
    """The model of a simulator, as an environment that sees its joints."""

    def __init__(self, folder, simulator):
        self.made = simulator.model
        super().__init__(folder / "pendulum.xml", frame_skip=10)

    def _initialize_simulation(self):
        return self.made, mujoco.MjData(self.made)

    def _get_obs(self):
        return np.concatenate([self.data.qpos, self.data.qvel])


@pytest.mark.parametrize("controller", [SERVO, ControllerSpec(kind="torque")], ids=["position", "torque"])
def test_it_says_what_a_corrected_simulator_says(tmp_path, controller):
    """Of a network that reads torque, and of a drive whose torque is another one ten physics steps later."""
    simulator = two_links(tmp_path, controller)
    network = random_network(tmp_path, LSTM)
    env, around = ResidualEnv(Inside(tmp_path, simulator), network), ResidualSimulator(simulator, network)
    rng = np.random.default_rng(4)
    (signal,) = simulator.command_signals[:1]
    for _ in range(2):
        env.reset(seed=0)
        around.reset(np.array([[0.3, -0.2]]), np.zeros((1, 2)))
        for _ in range(20):
            command = rng.uniform(-2, 2, (1, 2))
            seen, *_, info = env.step(simulator.control_of({signal: command[:, None]})[0, 0])
            for _ in range(10):
                said = around.step({signal: command})
            np.testing.assert_allclose(seen, np.hstack([said["position"][0], said["velocity"][0]]), atol=1e-5)
            assert info["residual"] == "ok"
        plain = env.unwrapped._get_obs()
        assert np.abs(np.array(seen) - plain).max() > 0.01


def test_steps_of_another_time_than_a_period_are_refused(xml, network):
    env = ResidualEnv(RepeatAction(Arm(xml), 4), network)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=re.escape("got 0.04 s; expected 0.01 s")) as refused:
        env.step(np.zeros(2))
    assert "around ResidualEnv" in refused.value.hint
    around = RepeatAction(ResidualEnv(Arm(xml), network), 4)
    around.reset(seed=0)
    assert around.step(np.zeros(2))[4]["residual"] == "ok"


def said_by(env, steps):
    """The statuses of so many steps."""
    return [env.step(np.zeros(2))[4]["residual"] for _ in range(steps)]


def test_an_environment_that_is_reset_inside_begins_anew(xml, tmp_path):
    late = shifting(tmp_path / "late", SHIFT, warmup_steps=2)
    env = ResidualEnv(Autoreset(TimeLimit(Arm(xml), 5)), late, warmup=True)
    env.reset(seed=0)
    episode = ["warming"] * 2 + ["ok"] * 3
    assert said_by(env, 11) == [*episode, "warming", *episode]
    # The first observation of an episode is the environment's own.
    env.reset(seed=0)
    for _ in range(6):
        seen, *_ = env.step(np.zeros(2))
    np.testing.assert_array_equal(seen[:4], [0.3, -0.2, 0.0, 0.0])


def test_a_step_that_is_cut_short_begins_anew(xml, tmp_path):
    class Cut(Arm):
        steps = 0

        def step(self, action):
            self.steps += 1
            self.do_simulation(action, 3 if self.steps == 4 else self.frame_skip)
            return self._get_obs(), 0.0, False, False, {}

    late = shifting(tmp_path / "late", SHIFT, warmup_steps=1)
    env = ResidualEnv(Cut(xml), late, warmup=True)
    env.reset(seed=0)
    assert said_by(env, 7) == ["warming", "ok", "ok", "warming", "warming", "ok", "ok"]


def test_time_that_passes_between_steps_is_seen(xml, tmp_path):
    late = shifting(tmp_path / "late", SHIFT, warmup_steps=1)
    env = ResidualEnv(Arm(xml), late, warmup=True)
    env.reset(seed=0)
    assert said_by(env, 2) == ["warming", "ok"]
    env.unwrapped.do_simulation(np.zeros(2), 50)
    assert said_by(env, 2) == ["warming", "ok"]


class Redrawn(Arm):
    """It compiles a model for each episode, with a rail in front of the joints that were there; in the third one has another name."""

    names: ClassVar = [("a", "b"), ("a", "b"), ("a", "elbow")]
    episode = 0

    def reset_model(self):
        first, second = self.names[self.episode]
        self.episode += 1
        rail = '<body name="rail"><joint name="rail" type="slide"/><geom size="0.1"/></body><body name="upper">'
        xml = XML.replace('<body name="upper">', rail).replace('"a"', f'"{first}"').replace('"b"', f'"{second}"')
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        self.set_state(np.array([0.0, 0.3, -0.2]), np.zeros(3))
        return self._get_obs()


def test_a_model_that_is_made_anew_is_looked_at_anew(xml, network):
    plain, env = Redrawn(xml), ResidualEnv(Redrawn(xml), network)
    for _ in range(2):
        plain.reset(seed=0)
        env.reset(seed=0)
        for _ in range(3):
            before, (seen, *_, info) = plain.step(np.ones(2))[0], env.step(np.ones(2))
            np.testing.assert_allclose(seen[[1, 2, 4, 5]], before[[1, 2, 4, 5]] + SHIFT, atol=1e-6)
            np.testing.assert_array_equal(seen[[0, 3]], before[[0, 3]])
            assert info["residual"] == "ok"
    with pytest.raises(NameMismatch, match="elbow"):
        env.reset(seed=0)


def test_noise_is_in_an_observation_once_and_random_numbers_go_on(xml, network):
    class Noisy(Arm):
        def _get_obs(self):
            return super()._get_obs() + self.np_random.normal(0.0, 0.1, 7)

    plain, env = Noisy(xml), ResidualEnv(Noisy(xml), network)
    np.testing.assert_array_equal(env.reset(seed=0)[0], plain.reset(seed=0)[0])
    for _ in range(5):
        before, (seen, *_, info) = plain.step(np.ones(2))[0], env.step(np.ones(2))
        np.testing.assert_allclose(seen[:4], before[:4] + SHIFT, atol=1e-6)
        assert info["residual"] == "ok"
    assert env.unwrapped.np_random.bit_generator.state == plain.np_random.bit_generator.state


class Changing(Arm):
    """It changes what `_get_obs()` says before it gives it away."""

    def __init__(self, xml, change):
        self.change = change
        super().__init__(xml)

    def step(self, action):
        seen, *rest = super().step(action)
        return self.change(seen), *rest


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda seen: 10.0 * seen, "expected"),
        (lambda seen: np.clip(seen, -0.1, 0.1), "0.1"),
        (lambda seen: seen[:4], "shape"),
        (lambda seen: {"joints": seen}, "joints"),
    ],
)
def test_an_environment_that_changes_what_it_observes_is_refused(xml, network, change, told):
    env = ResidualEnv(Changing(xml, change), network)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=re.escape("not what _get_obs() says")) as refused:
        env.step(np.ones(2))
    assert told in refused.value.summary
    assert "wrapper around ResidualEnv" in refused.value.hint


def test_what_the_correction_does_not_move_may_change_after_it_was_observed(xml, network):
    class Remembering(Arm):
        action = np.zeros(2)

        def _get_obs(self):
            return np.concatenate([super()._get_obs(), self.action])

        def step(self, action):
            seen, *rest = super().step(action)
            self.action = action
            return seen.astype(np.float32), *rest

    env = ResidualEnv(Remembering(xml), network)
    env.reset(seed=0)
    for action in (np.ones(2), np.zeros(2)):
        seen, *_, info = env.step(action)
        assert info["residual"] == "ok"
        np.testing.assert_array_equal(seen[7:], 1.0 - action)
        assert seen.dtype == np.float32


class Looking(Arm):
    """What it says is a view of the state."""

    def _get_obs(self):
        return self.data.qpos


class Writing(Arm):
    """What it says is written to where the last one was."""

    room = np.zeros(2)

    def _get_obs(self):
        self.room[:] = self.data.qpos
        return self.room


@pytest.mark.parametrize("kind", [Looking, Writing])
def test_observations_may_be_views(xml, network, kind):
    plain, env = Arm(xml), ResidualEnv(kind(xml), network)
    plain.reset(seed=0)
    env.reset(seed=0)
    for _ in range(2):
        before, seen = plain.step(np.ones(2))[0], env.step(np.ones(2))[0]
        np.testing.assert_allclose(seen, before[:2] + SHIFT[:2], atol=1e-6)
