"""Steps under late commands are the replay of the same commands with the same delay."""

import numpy as np
import pytest

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.protocols import RolloutRequest, Simulator
from trueup.core.timeseries import TimeSeries, same_units
from trueup.errors import ConfigError
from trueup.robots import find_model, load_robot
from trueup.sim import DelayedSimulator, ReplayPlan, ReplaySettings, make_simulator

ROBOT = load_robot("demo_arm")
# Whole steps, a part of one, none at all.
DELAYS = (0.02, 0.0131, 0.0)


def simulator():
    return make_simulator("mujoco", ROBOT, find_model(ROBOT))


def motion(steps, step_s):
    rng = np.random.default_rng(3)
    time_s = step_s * np.arange(steps + 1)
    command = 0.4 * np.cumsum(rng.normal(0, 0.05, (steps + 1, 3)), axis=0)
    series = TimeSeries(
        time_s, ROBOT.joint_names, {"position": command}, same_units({"position": "rad"}, ROBOT.joint_names)
    )
    return Episode(EpisodeMeta("walk"), series, series), command


def test_steps_and_rollouts_are_those_of_a_replay_with_the_delay():
    inner = simulator()
    episode, command = motion(120, inner.timestep_s)
    plan = ReplayPlan(episode, inner, ReplaySettings(delay_s=DELAYS))
    request = plan.request(DELAYS)
    expected = inner.rollout(request)
    late = DelayedSimulator(inner, DELAYS)
    given = command[None, : request.command["position"].shape[1]]
    rolled = late.rollout(RolloutRequest(request.position, request.velocity, {"position": given}))
    np.testing.assert_array_equal(rolled.position, expected.position)
    late.reset(request.position, request.velocity)
    stepped = [late.step({"position": given[:, row]})["position"] for row in range(given.shape[1])]
    np.testing.assert_allclose(np.stack(stepped, axis=1), expected.position[:, 1:], atol=1e-12)
    # The delay matters, and a reset forgets the commands before it.
    assert (
        np.abs(
            inner.rollout(RolloutRequest(request.position, request.velocity, {"position": given})).position
            - expected.position
        ).max()
        > 1e-3
    )
    late.reset(request.position, request.velocity)
    np.testing.assert_allclose(late.step({"position": given[:, 0]})["position"], stepped[0], atol=1e-12)


def test_it_is_a_simulator_and_without_a_delay_the_same_one():
    inner = simulator()
    late = DelayedSimulator(inner, 0.0)
    assert isinstance(late, Simulator)
    assert (late.joints, late.timestep_s, late.command_signals) == (
        inner.joints,
        inner.timestep_s,
        inner.command_signals,
    )
    start, still = np.full((2, 3), 0.1), np.zeros((2, 3))
    late.reset(start, still)
    found = late.step({"position": start + 0.2})
    inner.reset(start, still)
    for name, values in inner.step({"position": start + 0.2}).items():
        np.testing.assert_array_equal(found[name], values)


def test_what_was_given_may_be_changed_afterwards():
    late = DelayedSimulator(simulator(), 0.004)
    start, still = np.zeros((1, 3)), np.zeros((1, 3))
    command = np.zeros((1, 3))
    late.reset(start, still)
    late.step({"position": command})
    command[:] = 1.0
    late.step({"position": command})
    after = late.step({"position": command})["position"]
    late.reset(start, still)
    for value in (0.0, 1.0, 1.0):
        again = late.step({"position": np.full((1, 3), value)})["position"]
    np.testing.assert_array_equal(after, again)


@pytest.mark.parametrize("delay_s", [-0.01, np.nan, (0.01, 0.02), (0.0, 0.0, np.inf)])
def test_delays_that_are_none_are_refused(delay_s):
    with pytest.raises(ConfigError, match="delays of commands"):
        DelayedSimulator(simulator(), delay_s)
