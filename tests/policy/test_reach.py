"""Observation, reward and limits of the reaching task are those of the thesis, by numbers worked out apart."""

import math
from dataclasses import replace

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from trueup.errors import ConfigError, NameMismatch
from trueup.policy import ReachConfig, Reward, register
from trueup.policy.arms import EngineArm, MujocoArms
from trueup.policy.config import PolicyConfig
from trueup.policy.environment import PandaReach, ReachVector
from trueup.policy.reaching import Reaching
from trueup.policy.simulated import simulated
from trueup.policy.workspace import Chain, Workspace
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator, make_simulator

PANDA = load_robot("panda_torque")
SIMULATOR = MujocoSimulator.from_robot(PANDA, find_model(PANDA))
MODEL = SIMULATOR.model
HOME = np.array([0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4])
GOAL = np.array([0.4, 0.2, 0.5])


def many(count, **sizes):
    config = ReachConfig(**sizes)
    return Reaching(MujocoArms(SIMULATOR, count, config.control_s), MODEL, config)


def end_of(position):
    data = mujoco.MjData(MODEL)
    data.qpos[:7] = position
    mujoco.mj_kinematics(MODEL, data)
    return data.site("end_effector").xpos.copy()


def by_hand(position, velocity, before, goal, start, step_s):
    """Observation and reward of the thesis's listings, number by number (2.1.3)."""
    away = [math.tanh(a - b) for a, b in zip(end_of(position), goal, strict=True)]
    seen = [math.sin(q) for q in position] + [math.cos(q) for q in position] + [math.tanh(v) for v in velocity] + away
    begun = [math.tanh(a - b) for a, b in zip(end_of(start), goal, strict=True)]
    dist = math.sqrt(sum(x * x for x in seen[21:])) / math.sqrt(sum(x * x for x in begun))
    joint_acc = sum(math.tanh(abs((v - u) / step_s / 100)) for v, u in zip(velocity, before, strict=True))
    dq = sum(math.tanh(abs(v)) for v in velocity)
    reward = -2 * dist - 0.03 * joint_acc / (0.15 + dist) - 0.05 * joint_acc / abs(1.15 - min(1, dist)) - 0.03 * dq
    return seen, reward


def test_numbers_are_those_of_the_thesis():
    config = ReachConfig()
    assert config.torque_nm == (2.0, 3.0, 2.5, 4.0, 2.0, 1.0, 1.0)  # Table 2.2
    assert config.reward == Reward(2.0, 0.03, 0.05, 0.03)
    env = PandaReach()
    np.testing.assert_array_equal(env.action_space.high, np.float32(config.torque_nm))
    np.testing.assert_array_equal(env.action_space.low, -np.float32(config.torque_nm))
    assert env.observation_space.shape == (24,)


@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space")
def test_gymnasiums_checker_passes():
    register()
    register()
    env = gymnasium.make("TrueupPandaReach-v0")
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=3)
    for _ in range(200):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
    assert truncated
    assert not terminated


@pytest.mark.parametrize("engine", ["mujoco", "dart"])
def test_observation_and_reward_are_those_of_the_listings(engine):
    if engine == "dart":
        pytest.importorskip("dartpy")
    env = PandaReach(engine=engine)
    seen, info = env.reset(seed=0, options={"goal": GOAL.tolist()})
    assert info["distance_m"] == pytest.approx(math.dist(end_of(HOME), GOAL))
    expected, _ = by_hand(HOME, np.zeros(7), np.zeros(7), GOAL, HOME, 0.02)
    np.testing.assert_allclose(seen, expected, atol=1e-6)
    rng, before = np.random.default_rng(1), np.zeros(7)
    for _ in range(20):
        seen, reward, _, _, info = env.step(env.action_space.high * rng.uniform(-1, 1, 7).astype(np.float32))
        arms = env.reaching.arms
        expected, worth = by_hand(arms.position[0], arms.velocity[0], before, GOAL, HOME, 0.02)
        np.testing.assert_allclose(seen, expected, atol=1e-6)
        assert reward == pytest.approx(worth, abs=1e-12)
        assert info["distance_m"] == pytest.approx(math.dist(end_of(arms.position[0]), GOAL))
        before = arms.velocity[0].copy()


def test_an_arm_that_stays_at_rest_is_as_far_away_as_at_the_start():
    """The distance is divided by its own value at the start, so that it is 1 there, whatever the goal (2.1.3)."""
    reaching = many(5)
    rng = np.random.default_rng(0)
    reaching.begin(np.arange(5), rng)
    np.testing.assert_allclose(reaching.step(np.zeros((5, 7)), rng).reward, -2.0, atol=0.02)
    reaching.arms.velocity[:] = reaching._velocity[:] = 0.0
    reaching.arms.position[:] = HOME
    reaching._look(rng)
    np.testing.assert_allclose(reaching._reward, -2.0, rtol=1e-12)


@pytest.mark.parametrize("delay_s", [0.0, 0.0104, 0.02, 0.033])
def test_a_late_robot_is_late_wherever_it_is_simulated(delay_s):
    """Trained on, judged in MuJoCo, in DART, in one environment: torques act as late as the description says."""
    pytest.importorskip("dartpy")
    late = replace(PANDA, controller=replace(PANDA.controller, delay_s=delay_s))
    config, path = PolicyConfig(arms=2), find_model(PANDA)
    every = [
        simulated(config, late, path),
        simulated(config, late, path, count=1, randomized=False),
        simulated(config, late, path, engine="dart"),
        PandaReach(late).reaching,
        PandaReach(late, engine="dart").reaching,
    ]
    ends = []
    for reaching in every:
        rng = np.random.default_rng(3)
        reaching.begin(np.arange(reaching.arms.count), rng, goals=np.tile(GOAL, (reaching.arms.count, 1)))
        for action in np.random.default_rng(1).uniform(-1, 1, (4, 7)) * reaching.most:
            reaching.step(np.tile(action, (reaching.arms.count, 1)), rng)
        ends.append(reaching.arms.position[0].copy())
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], atol=2e-4)  # joints of this robot have friction: engines differ
    prompt = simulated(config, PANDA, path)
    prompt.begin(np.arange(2), np.random.default_rng(3), goals=np.tile(GOAL, (2, 1)))
    for action in np.random.default_rng(1).uniform(-1, 1, (4, 7)) * prompt.most:
        prompt.step(np.tile(action, (2, 1)), np.random.default_rng(0))
    assert (np.abs(prompt.arms.position[0] - ends[0]).max() > 1e-3) == (delay_s > 0)


def test_a_torque_is_held_for_a_control_step_and_cut_to_the_largest():
    reaching = many(2)
    rng = np.random.default_rng(0)
    reaching.begin(np.arange(2), rng)
    reaching.step(np.stack([np.full(7, 100.0), reaching.most]), rng)
    np.testing.assert_array_equal(reaching.arms.position[0], reaching.arms.position[1])
    data = mujoco.MjData(MODEL)
    data.qpos[:7], data.ctrl[:] = HOME, reaching.most
    mujoco.mj_step(MODEL, data, 20)
    np.testing.assert_allclose(reaching.arms.position[0], data.qpos[:7], atol=1e-12)


def test_many_arms_move_as_one_in_an_engine():
    config = ReachConfig()
    engine = make_simulator("mujoco", PANDA, find_model(PANDA))
    one = Reaching(EngineArm(engine, config.control_s), MODEL, config)
    two = many(2)
    goals = np.stack([GOAL, GOAL + np.array([0.0, -0.3, 0.1])])
    rng = np.random.default_rng(0)
    two.begin(np.arange(2), rng, goals=goals)
    one.begin(np.arange(1), rng, goals=goals[1:])
    for action in rng.uniform(-1, 1, (30, 2, 7)) * two.most:
        both, alone = two.step(action, rng), one.step(action[1:], rng)
    np.testing.assert_allclose(both.observation[1:], alone.observation, atol=1e-12)
    np.testing.assert_allclose(both.reward[1:], alone.reward, atol=1e-12)


def test_one_arm_that_begins_anew_leaves_the_others_alone():
    """What an arm does in the middle of its episode does not depend on what ends beside it."""
    config = ReachConfig(episode_s=0.2)
    alone, beside = many(1, episode_s=0.2), many(3, episode_s=0.2)
    goals = np.stack([GOAL, GOAL + np.array([0.0, -0.3, 0.1]), GOAL + np.array([0.05, 0.0, 0.0])])
    alone.begin(np.zeros(1, int), np.random.default_rng(0), goals=goals[1:2])
    beside.begin(np.arange(3), np.random.default_rng(0), goals=goals)
    rng = np.random.default_rng(5)
    for step, action in enumerate(rng.uniform(-1, 1, (config.steps, 3, 7)) * beside.most):
        if step == 4:
            beside.begin(np.array([0, 2]), rng, goals=goals[[2, 0]])
        one, three = alone.step(action[1:2], rng), beside.step(action, rng)
        np.testing.assert_allclose(three.observation[1], one.observation[0], atol=1e-12)
        np.testing.assert_allclose(three.reward[1], one.reward[0], atol=1e-12)
    assert three.ended.tolist() == [False, True, False]


def test_threads_change_nothing():
    ends = []
    for threads in (1, 2):
        reaching = Reaching(MujocoArms(SIMULATOR, 6, 0.02, threads=threads), MODEL, ReachConfig())
        reaching.begin(np.arange(6), np.random.default_rng(0))
        for action in np.random.default_rng(1).uniform(-1, 1, (10, 6, 7)) * reaching.most:
            done = reaching.step(action, np.random.default_rng(0))
        ends.append(done.observation)
    np.testing.assert_array_equal(*ends)


def test_an_episode_that_ends_is_followed_by_another_and_the_others_go_on():
    vector = ReachVector(many(3, episode_s=0.2), seed=4)
    vector.reset()
    goals = vector.reaching.goal.copy()
    sums = np.zeros(3)
    for step in range(1, 11):
        vector.step_async(np.zeros((3, 7)))
        seen, reward, over, infos = vector.step_wait()
        sums += reward
        assert over.all() == (step == 10)
    assert all(info["TimeLimit.truncated"] for info in infos)
    assert [info["episode"]["l"] for info in infos] == [10] * 3
    np.testing.assert_allclose([info["episode"]["r"] for info in infos], sums, rtol=1e-5)
    assert (np.abs(vector.reaching.goal - goals).max(axis=1) > 1e-3).all()
    np.testing.assert_allclose(seen[:, :7], np.tile(np.sin(HOME), (3, 1)), atol=1e-6)
    assert not np.allclose(infos[0]["terminal_observation"], seen[0])


def test_draws_depend_on_the_seed_alone():
    def seen(seed):
        vector = ReachVector(many(2), seed=9)
        vector.seed(seed)
        vector.reset()
        return vector.reaching.goal.copy()

    np.testing.assert_array_equal(seen(1), seen(1))
    assert not np.array_equal(seen(1), seen(2))


def test_what_is_no_number_ends_an_episode_and_is_counted():
    vector = ReachVector(many(3), seed=0)
    vector.reset()
    action = np.zeros((3, 7))
    action[1, 2] = np.nan
    vector.step_async(action)
    seen, reward, over, infos = vector.step_wait()
    np.testing.assert_array_equal(over, [False, True, False])
    assert infos[1]["TimeLimit.truncated"]
    assert np.isfinite(seen).all()
    assert np.isfinite(reward).all()
    assert vector.reaching.lost_episodes == 1


def test_an_arm_that_diverges_is_lost_and_the_others_are_not():
    spec = replace(PANDA, simulation=replace(PANDA.simulation, timestep_s=0.02))
    simulator = MujocoSimulator.from_robot(spec, find_model(PANDA))
    models = [simulator.model, MujocoSimulator.from_robot(spec, find_model(PANDA)).model]
    models[1].dof_damping[:] = -1e4
    turns = iter([models[0], models[0], models[1], models[0]])  # the first is for the structure
    config = ReachConfig()
    arms = MujocoArms(simulator, 2, config.control_s, draw=lambda _: (next(turns), np.zeros(7)))
    vector = ReachVector(Reaching(arms, simulator.model, config), seed=0)
    vector.reset()
    lost = np.zeros(2, int)
    for _ in range(60):
        vector.step_async(0.1 * np.ones((2, 7)))
        seen, reward, over, infos = vector.step_wait()
        lost += over
        # No end of the task: what would have come is guessed from what was seen last.
        assert all(infos[row]["TimeLimit.truncated"] for row in np.flatnonzero(over))
        assert np.isfinite(seen).all()
        assert np.isfinite(reward).all()
    assert lost.tolist() == [0, 1]


@pytest.mark.parametrize("name", ["panda_torque", "upper_body"])
def test_kinematics_are_mujocos(name):
    robot = load_robot(name)
    model = MujocoSimulator.from_robot(robot, find_model(robot)).model
    site = {"panda_torque": "end_effector", "upper_body": "left_grip"}[name]
    joints = robot.joint_names if name == "panda_torque" else robot.joint_names[:5]
    chain, data = Chain(model, joints, site), mujoco.MjData(model)
    position = np.random.default_rng(0).uniform(-3, 3, (40, len(joints)))
    for row, place in zip(position, chain.place(position), strict=True):
        data.qpos[: len(joints)] = row
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(place, data.site(site).xpos, atol=1e-12)


SLIDES = """
<mujoco><worldbody><body pos="0 0 0.3" euler="10 20 30">
  <joint name="a" axis="0 0 1" pos="0.1 0 0.2"/><joint name="b" type="slide" axis="1 1 0" pos="0 0.3 0"/>
  <geom size="0.1"/><body pos="0.2 0 0" euler="0 40 0"><body pos="0 0.1 0" euler="50 0 0">
  <joint name="c" axis="0 1 0" pos="0 0.05 0.1"/><geom size="0.1"/><site name="end" pos="0.1 0.2 0.3"/></body></body></body>
</worldbody></mujoco>"""


def test_kinematics_of_slides_anchors_and_fixed_bodies():
    model = mujoco.MjModel.from_xml_string(SLIDES)
    chain, data = Chain(model, ("c", "a", "b"), "end"), mujoco.MjData(model)
    for q in np.random.default_rng(0).uniform(-1, 1, (20, 3)):
        data.qpos[:] = q[1], q[2], q[0]
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(chain.place(q[None])[0], data.site("end").xpos, atol=1e-12)
    with pytest.raises(ConfigError, match="'b' is on the way"):
        Chain(model, ("a", "c"), "end")
    with pytest.raises(NameMismatch, match="no site 'hand'"):
        Chain(model, ("a", "b", "c"), "hand")


@pytest.mark.long
def test_goals_are_within_reach_and_others_are_refused():
    space = Workspace(Chain(MODEL, PANDA.joint_names, "end_effector"), HOME, nearest_m=0.2, farthest_m=0.5)
    goals = space.draw(np.random.default_rng(0), 500)
    away = np.linalg.norm(goals - end_of(HOME), axis=1)
    assert 0.2 <= away.min() < 0.25
    assert 0.45 < away.max() <= 0.5
    assert goals[:, 2].min() >= 0.1
    for goal in goals[:50]:
        space.check(goal)
    with pytest.raises(ConfigError, match="out of reach") as caught:
        PandaReach().reset(options={"goal": [1.5, 0.0, 0.5]})
    assert "nearest place" in str(caught.value)
    # Anything that a pose within the ranges reaches is no goal out of reach, also between the poses that stand for all.
    low, high = space.chain.ranges.T
    poses = np.random.default_rng(7).uniform(low, high, (60, 7))
    for place in space.chain.place(poses):
        space.check(place)
    farthest = space.chain.place(poses)[np.argmax(np.linalg.norm(space.chain.place(poses), axis=1))]
    with pytest.raises(ConfigError, match="out of reach"):
        space.check(farthest * 1.4)
    for goal in ("there", [0.1, 0.2], [0.3, np.nan, 0.4]):
        with pytest.raises(ConfigError, match="a goal is a place"):
            PandaReach().reset(options={"goal": goal})
    with pytest.raises(ConfigError, match="options of a reset"):
        PandaReach().reset(options={"target": [0.4, 0.2, 0.5]})
    with pytest.raises(ConfigError, match="no goal is left"):
        many(1, nearest_m=3.0, farthest_m=4.0)


def test_robots_and_rates_that_do_not_fit():
    with pytest.raises(ConfigError, match="follows them"):
        PandaReach(robot="panda")
    with pytest.raises(ConfigError, match="number of physics steps"):
        many(1, control_hz=333.0)
    with pytest.raises(ConfigError, match="one number for each joint"):
        many(1, torque_nm=(1.0, 2.0))
    for sizes in ({"control_hz": 0.0}, {"episode_s": math.inf}, {"torque_nm": (1.0, -1.0)}, {"nearest_m": 0.9}):
        with pytest.raises(ConfigError, match="reach"):
            ReachConfig(**sizes)
