"""What is said of a policy, against motions that are known: arms that go where the test says."""

import numpy as np
import pytest

from trueup.errors import ConfigError, DataError
from trueup.policy.arms import MujocoArms
from trueup.policy.evaluation import NEAR_M, UNITS, evaluate
from trueup.policy.reach import ReachConfig
from trueup.policy.reaching import Reaching, home_of
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator

PANDA = load_robot("panda_torque")
SIMULATOR = MujocoSimulator.from_robot(PANDA, find_model(PANDA))
HOME = home_of(SIMULATOR.model, PANDA.joint_names)
CONFIG = ReachConfig(control_hz=10.0, episode_s=1.0)


class Scripted:
    """Arms whose joints are, after k control steps, `way[k]` away from home."""

    def __init__(self, way, count=2, fall_s=np.inf):
        self.count, self.control_s, self.joints = count, 0.1, PANDA.joint_names
        self.way, self.step_number, self.fall_s = np.asarray(way, float), 0, fall_s
        self.position = np.zeros((count, 7))
        self.velocity = np.zeros((count, 7))

    def begin(self, rows, position, rng):  # noqa: ARG002
        self.step_number = 0
        self.position[rows], self.velocity[rows] = position, 0.0

    def step(self, torque):  # noqa: ARG002
        self.step_number += 1
        before = self.position.copy()
        self.position = np.tile(HOME + self.way[self.step_number], (self.count, 1))
        self.velocity = (self.position - before) / self.control_s
        if self.step_number * self.control_s >= self.fall_s:
            self.position[0] = np.nan


def still(seen):
    return np.zeros((len(seen), 7))


def reaching(way, **options):
    return Reaching(Scripted(way, **options), SIMULATOR.model, CONFIG)


def goals_on(world, shifts):
    """Where the end of the arm is with joint 1 turned so far."""
    poses = np.tile(HOME, (len(shifts), 1))
    poses[:, 0] += shifts
    return world.workspace.chain.place(poses)


def turned(*angles):
    """Joint 1 alone."""
    way = np.zeros((11, 7))
    way[:, 0] = angles
    return way


def test_near_and_far_goals_and_how_they_were_reached():
    # There at the seventh step, a little beyond, and back.
    world = reaching(turned(0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.65, 0.6, 0.6, 0.6))
    goals = goals_on(world, [0.6, 0.3, -0.4])
    found = evaluate(still, world, goals)
    end = goals_on(world, [0.6])[0]
    np.testing.assert_allclose(found.values["distance"], np.linalg.norm(goals - end, axis=1), atol=1e-9)
    np.testing.assert_array_equal(found.values["success"], [1.0, 0.0, 0.0])
    start, farthest = goals_on(world, [0.0, 0.65])
    way = goals[0] - start
    beyond = (farthest - start) @ way / np.linalg.norm(way) - np.linalg.norm(way)
    assert found.values["overshoot"][0] == pytest.approx(max(beyond, 0.0), abs=1e-9)
    assert found.values["overshoot"][2] == 0.0
    assert found.distance_m.shape == found.reward.shape == (3, 10)
    np.testing.assert_allclose(found.values["reward"], found.reward.mean(axis=1))
    assert not found.lost.any()


def test_what_a_policy_demands():
    number = 0

    def pushing(seen):
        nonlocal number
        number += 1
        out = np.zeros((len(seen), 7))
        out[:, 0] = world.most[0] * (2.0 if number % 2 else 0.0)  # half of the time beyond the limit
        return out

    world = reaching(turned(*0.05 * np.arange(11)))
    limit = np.full(7, 0.49)
    found = evaluate(pushing, world, goals_on(world, [0.5, 0.6]), velocity_limit=limit)
    np.testing.assert_allclose(found.values["torque_at_limit"], 0.5)
    # One of seven joints changes by its whole largest torque in every step.
    np.testing.assert_allclose(found.values["smoothness"], 1 / 7)
    np.testing.assert_allclose(found.values["velocity_violation"], 1.0)
    found = evaluate(still, world, goals_on(world, [0.5]), velocity_limit=limit + 0.02)
    assert found.values["velocity_violation"][0] == 0.0
    assert found.values["smoothness"][0] == 0.0


def test_an_arm_that_is_lost_has_not_succeeded():
    way = turned(0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.6, 0.6, 0.6, 0.6)
    world = reaching(way, fall_s=0.85)
    found = evaluate(still, world, goals_on(world, [0.6, 0.6]))
    np.testing.assert_array_equal(found.lost, [True, False])
    np.testing.assert_array_equal(found.values["success"], [0.0, 1.0])
    assert found.values["distance"][0] < NEAR_M  # where it was last seen
    assert np.isnan(found.distance_m[0, 8:]).all()
    at_once = reaching(way, fall_s=0.0)
    found = evaluate(still, at_once, goals_on(at_once, [0.6, 0.6]))
    assert found.values["distance"][0] == pytest.approx(np.linalg.norm(found.goals[0] - at_once.workspace.start))
    assert all(np.isfinite(values).all() for values in found.values.values())


def test_intervals_and_paired_comparisons():
    arms = Reaching(MujocoArms(SIMULATOR, 16, CONFIG.control_s), SIMULATOR.model, CONFIG)
    goals = arms.workspace.draw(np.random.default_rng(0), 40)
    told = []
    one = evaluate(still, arms, goals, on_episodes=lambda *given: told.append(given))
    assert told == [(16, 40), (32, 40), (40, 40)]
    # Who knows the goal pushes towards it more or less.
    other = evaluate(lambda seen: 2.0 * np.sign(seen[:, :7]), arms, goals)
    estimates = one.estimates()
    assert set(estimates) == {*UNITS, "distance_median"}
    # Who stays is always rewarded with -2.
    for own in (estimates["distance"], estimates["distance_median"], other.estimates()["reward"]):
        assert own.low < own.value < own.high
    assert estimates["distance_median"].value == pytest.approx(np.median(one.values["distance"]))
    difference = other.against(one, "distance").difference
    assert difference.value == pytest.approx((other.values["distance"] - one.values["distance"]).mean())
    assert difference.low < difference.value < difference.high
    with pytest.raises(DataError, match="same goals"):
        one.against(evaluate(still, arms, goals[:20]), "distance")
    again = evaluate(still, arms, goals)
    np.testing.assert_array_equal(again.distance_m, one.distance_m)
    with pytest.raises(ConfigError, match="out of reach"):
        evaluate(still, arms, np.array([[2.0, 0.0, 0.3]]))
