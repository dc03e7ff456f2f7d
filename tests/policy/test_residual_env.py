"""An environment read through a network: observations are corrected, physics and rewards are not."""

from dataclasses import replace

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import (
    DelayObservation,
    FlattenObservation,
    FrameStackObservation,
    MaxAndSkipObservation,
    RescaleAction,
    TimeLimit,
    TransformObservation,
)

from augment.evaluation_cases import card_of, shift_folder
from policy.residual_cases import SHIFT, Arm, shifting
from trueup.core.model_card import Input
from trueup.errors import ConfigError, NameMismatch
from trueup.policy import ResidualEnv


def test_observations_are_of_the_corrected_state_and_the_physics_is_not_touched(xml, network):
    plain, env = Arm(xml), ResidualEnv(Arm(xml), network)
    rng = np.random.default_rng(0)
    before, _ = plain.reset(seed=0)
    seen, info = env.reset(seed=0)
    # No sample of the network lies before it.
    np.testing.assert_array_equal(seen, before)
    assert info["residual"] == "warming"
    data = mujoco.MjData(plain.model)
    for step in range(50):
        action = rng.uniform(-1, 1, 2)
        before, reward, *_ = plain.step(action)
        seen, own, terminated, truncated, info = env.step(action)
        assert own == reward, step
        assert (terminated, truncated) == (False, False)
        np.testing.assert_allclose(seen[:4], before[:4] + SHIFT, atol=1e-6)
        assert info["residual"] == "ok"
        # What follows from the joints is that of the corrected ones.
        data.qpos[:] = seen[:2]
        mujoco.mj_kinematics(plain.model, data)
        moved = np.array(data.site("tip").xpos)
        data.qpos[:] = before[:2]
        mujoco.mj_kinematics(plain.model, data)
        # MujocoEnv itself sees the tip a physics step late: its correction is added to that.
        np.testing.assert_allclose(seen[4:] - before[4:], moved - data.site("tip").xpos, atol=1e-6)
        assert np.abs(seen[4:] - before[4:]).max() > 1e-3
        np.testing.assert_array_equal(env.unwrapped.data.qpos, plain.data.qpos)
        np.testing.assert_array_equal(env.unwrapped.data.qvel, plain.data.qvel)


def test_a_network_without_corrections_changes_no_bit(xml, tmp_path):
    plain, env = Arm(xml), ResidualEnv(Arm(xml), shifting(tmp_path / "none", np.zeros(4)))
    np.testing.assert_array_equal(env.reset(seed=0)[0], plain.reset(seed=0)[0])
    for _ in range(20):
        np.testing.assert_array_equal(env.step(np.ones(2))[0], plain.step(np.ones(2))[0])


class Fast(Arm):
    """It is rewarded for how fast its tip was, which it reads before its step and after it, as Ant and Walker do."""

    def step(self, action):
        before = self.data.site("tip").xpos.copy()
        self.do_simulation(action, self.frame_skip)
        speed = np.linalg.norm(self.data.site("tip").xpos - before) / self.dt
        return self._get_obs(), float(speed), bool(speed > 1.0), False, {"tip": before}


def test_rewards_of_bodies_are_those_of_the_plain_environment(xml, network):
    """MuJoCo leaves positions of bodies and sensors a physics step behind the joints; they are left so, bit by bit."""
    plain, env = Fast(xml), ResidualEnv(Fast(xml), network)
    rng = np.random.default_rng(1)
    plain.reset(seed=0)
    env.reset(seed=0)
    rewards = []
    for _ in range(50):
        action = rng.uniform(-1, 1, 2)
        _, reward, ended, _, info = plain.step(action)
        _, own, also, _, seen = env.step(action)
        assert (own, also) == (reward, ended)
        np.testing.assert_array_equal(seen["tip"], info["tip"])
        rewards.append(reward)
    assert max(rewards) > 0.1


@pytest.mark.parametrize("shift", [0.0, 0.01])
def test_gymnasium_s_own_environment_is_rewarded_as_without_a_network(tmp_path, shift):
    """Ant, whose contacts and speed of the body are in its rewards."""
    plain, inner = gymnasium.make("Ant-v5"), gymnasium.make("Ant-v5")
    joints = tuple(f"{part}_{number}" for number in range(1, 5) for part in ("hip", "ankle"))
    rate_hz = 1.0 / plain.unwrapped.dt
    env = ResidualEnv(inner, shifting(tmp_path / "ant", np.full(16, shift), joints=joints, rate_hz=rate_hz))
    before, _ = plain.reset(seed=3)
    seen, _ = env.reset(seed=3)
    np.testing.assert_array_equal(seen, before)
    rng = np.random.default_rng(2)
    for _ in range(40):
        action = rng.uniform(-1, 1, 8)
        before, reward, *ends, info = plain.step(action)
        seen, own, *also, told = env.step(action)
        assert own == reward
        assert also == ends
        np.testing.assert_allclose(seen[:5], before[:5], atol=1e-6)  # the trunk is none of the network's joints
        np.testing.assert_allclose(seen[5:13] - before[5:13], shift, atol=1e-6)
        assert told["residual"] == "ok"
        assert {name: told[name] for name in info} == info
        for name in ("qpos", "qvel", "xpos", "cfrc_ext", "qacc_warmstart", "sensordata"):
            np.testing.assert_array_equal(getattr(env.unwrapped.data, name), getattr(plain.unwrapped.data, name), name)


def test_observations_in_parts_are_corrected_part_by_part(xml, network):
    class InParts(Arm):
        def _get_obs(self):
            joints, high = self.data.qpos, bool(self.data.qpos[0] > 0.31)
            return {"pair": (joints.copy(), high), "image": np.zeros(3, np.uint8)}

    plain, env = InParts(xml), ResidualEnv(InParts(xml), network)
    plain.reset(seed=0)
    env.reset(seed=0)
    before, seen = (each.step(np.zeros(2))[0] for each in (plain, env))
    np.testing.assert_allclose(seen["pair"][0], before["pair"][0] + SHIFT[:2], atol=1e-6)
    assert (bool(seen["pair"][1]), before["pair"][1]) == (True, False)
    assert seen["image"].dtype == np.uint8
    assert not seen["image"].any()


def test_joints_are_found_by_name_and_one_of_them_is_enough(xml, tmp_path):
    env = ResidualEnv(Arm(xml), shifting(tmp_path / "b", [0.5], joints=("b",), signals=("position",)))
    plain = Arm(xml)
    plain.reset(seed=0)
    env.reset(seed=0)
    before, seen = (each.step(np.zeros(2))[0] for each in (plain, env))
    np.testing.assert_allclose(seen[:4] - before[:4], [0.0, 0.5, 0.0, 0.0], atol=1e-6)


def test_every_episode_begins_anew(xml, tmp_path):
    env = ResidualEnv(Arm(xml), shifting(tmp_path / "warm", SHIFT, warmup_steps=3), warmup=True)
    for _ in range(2):
        said = [env.reset(seed=0)[1]["residual"], *(env.step(np.zeros(2))[4]["residual"] for _ in range(5))]
        assert said[:4] == ["warming"] * 4
        assert set(said[4:]) == {"ok"}


def test_warming_observations_are_left_alone_if_asked(xml, tmp_path):
    env = ResidualEnv(Arm(xml), shifting(tmp_path / "warm", SHIFT, warmup_steps=3), warmup=True)
    plain = Arm(xml)
    plain.reset(seed=0)
    env.reset(seed=0)
    np.testing.assert_array_equal(env.step(np.ones(2))[0], plain.step(np.ones(2))[0])


def test_out_of_the_range_of_training_nothing_is_corrected(xml, tmp_path):
    channel = ("position", "a", "rad")
    card = card_of(joints=("a",), signals=("position",))
    card = replace(card, inputs=(Input(*channel, low=-0.1, high=0.1),))
    env = ResidualEnv(Arm(xml), shift_folder(tmp_path / "narrow", card, [0.5]))
    plain = Arm(xml)
    plain.reset(seed=0)
    env.reset(seed=0)  # a begins at 0.3
    before, (seen, *_, info) = plain.step(np.zeros(2))[0], env.step(np.zeros(2))
    assert info["residual"] == "fallback"
    np.testing.assert_array_equal(seen, before)


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version", "ignore:.*WARN")
def test_it_passes_gymnasium_s_checker(xml, network):
    check_env(ResidualEnv(Arm(xml), network), skip_render_check=True)


@pytest.mark.parametrize(
    ("about", "error", "words"),
    [
        ({"rate_hz": 50.0}, ConfigError, "50"),
        ({"causal": False}, ConfigError, "future"),
        ({"series": "command"}, ConfigError, "does not say"),
        ({"joints": ("a", "elbow")}, NameMismatch, "elbow"),
        ({"signals": ("torque", "torque")}, ConfigError, "neither position nor velocity"),
    ],
)
def test_a_network_that_does_not_fit_is_refused(xml, tmp_path, about, error, words):
    if about.get("signals"):
        about = {**about, "signals": ("torque",)}
        shift = np.zeros(2)
    else:
        shift = np.zeros(4)
    folder = shifting(tmp_path / "other", shift, **about)
    with pytest.raises(error, match=words):
        ResidualEnv(Arm(xml), folder)


def tenfold(env):
    """Another unit, in a space of the same limits."""
    return TransformObservation(env, lambda seen: 10.0 * seen, env.observation_space)


class OfItsOwn(gymnasium.Wrapper):
    """Nobody's class; only its space says that it changes something."""

    def __init__(self, env):
        super().__init__(env)
        self.observation_space = Box(-1.0, 1.0, (7,), np.float64)


@pytest.mark.parametrize(
    ("wrap", "told"),
    [
        (tenfold, "TransformObservation"),
        (lambda env: FrameStackObservation(env, 3), "FrameStackObservation"),
        (lambda env: TimeLimit(FlattenObservation(env), 20), "FlattenObservation"),
        (lambda env: DelayObservation(env, 1), "DelayObservation"),
        (lambda env: MaxAndSkipObservation(env, 2), "MaxAndSkipObservation"),
        (OfItsOwn, "OfItsOwn"),
    ],
)
def test_observations_that_are_no_longer_the_environment_s_are_refused(xml, network, wrap, told):
    with pytest.raises(ConfigError, match=told) as refused:
        ResidualEnv(wrap(Arm(xml)), network)
    assert "innermost" in refused.value.hint
    wrap(ResidualEnv(Arm(xml), network)).reset(seed=0)  # the other way around it goes


def test_two_networks_one_after_the_other_are_refused(xml, network):
    """The second would correct what the simulator says, not what the first makes of it."""
    with pytest.raises(ConfigError, match="ResidualEnv"):
        ResidualEnv(ResidualEnv(Arm(xml), network), network)


def test_wrappers_that_leave_observations_alone_are_welcome(xml, network):
    env = ResidualEnv(RescaleAction(TimeLimit(Arm(xml), 20), np.float32(-2), np.float32(2)), network)
    plain = Arm(xml)
    plain.reset(seed=0)
    env.reset(seed=0)
    before, seen = plain.step(np.full(2, 0.5))[0], env.step(np.ones(2))[0]
    np.testing.assert_allclose(seen[:4], before[:4] + SHIFT, atol=1e-6)


def test_an_environment_without_mujoco_is_refused(network):
    with pytest.raises(ConfigError, match="no environment over MuJoCo"):
        ResidualEnv(gymnasium.make("CartPole-v1"), network)


def test_others_train_on_it_with_one_line(xml, network):
    """Stable-Baselines3 takes it as any environment."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.monitor import Monitor

    env = gymnasium.wrappers.TimeLimit(ResidualEnv(Arm(xml), network), 20)
    model = PPO("MlpPolicy", Monitor(env), n_steps=64, batch_size=32, n_epochs=1, device="cpu").learn(128)
    assert model.num_timesteps == 128
