import numpy as np
import pytest

from trueup.lab import DemoHardware, record_demo
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode


@pytest.fixture(scope="module")
def episodes():
    return list(record_demo())


def test_the_same_seed_gives_the_same_recording(episodes):
    for left, right in zip(episodes, record_demo(seed=0), strict=True):
        assert left.meta == right.meta
        np.testing.assert_array_equal(left.measured["torque"], right.measured["torque"])
    other = next(record_demo(seed=1))
    assert not np.array_equal(other.commanded()["position"], episodes[0].commanded()["position"])


def test_the_arm_rests_at_both_ends_and_stays_within_its_range(episodes):
    robot = load_robot("demo_arm")
    limits = MujocoSimulator.from_robot(robot, find_model(robot)).position_limits
    for episode in episodes:
        position = episode.measured["position"]
        assert np.ptp(position[:40], axis=0).max() < 0.01
        for column, joint in enumerate(episode.measured.joints):
            assert limits[joint][0] < position[:, column].min()
            assert position[:, column].max() < limits[joint][1]


def test_hardware_like_the_model_leaves_only_the_sensors_as_a_gap():
    twin = DemoHardware(
        kp=60.0, kv=1.5, damping=0.4, frictionloss=0.05, delay_s=0.0, position_step_rad=1e-9, hard_friction=False
    )
    robot = load_robot("demo_arm")
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    for episode in record_demo(hardware=twin):
        simulated = replay_episode(episode, simulator, ReplaySettings.of(robot))
        error = np.sqrt(np.mean((simulated["position"] - episode.measured["position"]) ** 2))
        # The payload is the only physics left that the model does not know: it sags by at most m g l / kp.
        sag = 0.4 * 9.81 * 0.47 / 60.0
        assert error < (sag if episode.meta.payload_kg else 1e-6)


def test_the_hardware_is_far_from_its_model(episodes):
    robot = load_robot("demo_arm")
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    for episode in episodes:
        simulated = replay_episode(episode, simulator, ReplaySettings.of(robot))
        assert np.sqrt(np.mean((simulated["position"] - episode.measured["position"]) ** 2)) > 0.02
