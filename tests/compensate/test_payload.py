"""The payload of a first second: exact where the model is, and near where hardware is not the model."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueup.compensate.payload import PayloadEstimator
from trueup.errors import DataError
from trueup.lab import VirtualRobot, draw_truth, load_lab
from trueup.robots import Setup, find_model, load_robot
from trueup.sim import MujocoSimulator

RATE_HZ = 100.0


@pytest.fixture(scope="module")
def robot():
    return load_robot("upper_body")


@pytest.fixture(scope="module")
def estimator(robot):
    return PayloadEstimator(robot, find_model(robot))


def motion(seed=0, samples=121):
    """Arms that are raised a little; time, position, velocity, acceleration."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(samples)[:, None] / RATE_HZ
    rate, size = rng.uniform(1, 3, 10), rng.uniform(0.1, 0.3, 10)
    middle = np.array([-0.8, 0.4, 0.0, -1.0, 0.0, -0.8, -0.4, 0.0, -1.0, 0.0])
    wave = rate * time_s
    return time_s[:, 0], middle + size * np.sin(wave), size * rate * np.cos(wave), -size * rate**2 * np.sin(wave)


@settings(max_examples=10, deadline=None)
@given(payload_kg=st.floats(0.1, 4.0), seed=st.integers(0, 99))
def test_torques_of_a_known_payload_give_it_back(robot, estimator, payload_kg, seed):
    time_s, position, velocity, _ = motion(seed)
    model = MujocoSimulator.from_robot(robot, find_model(robot), setup=Setup(payload_kg)).model
    torque = np.full(position.shape, 1e6)  # what comes later is not looked at
    second = slice(0, 101)
    given = position[second], velocity[second]
    torque[second] = estimator._needed(model, *given, np.gradient(given[1], time_s[second], axis=0))
    found = estimator.of(time_s, position, velocity, torque)
    assert found.payload_kg == pytest.approx(payload_kg, abs=1e-9)
    assert found.low_kg <= payload_kg <= found.high_kg


def test_torques_that_are_off_in_single_joints_widen_the_interval(robot, estimator):
    time_s, position, velocity, acceleration = motion()
    model = MujocoSimulator.from_robot(robot, find_model(robot), setup=Setup(2.0)).model
    torque = estimator._needed(model, position, velocity, acceleration)
    exact = estimator.of(time_s, position, velocity, torque)
    torque += np.random.default_rng(0).normal(0.0, 4.0, 10)
    found = estimator.of(time_s, position, velocity, torque)
    assert found.low_kg < 2.0 < found.high_kg
    assert found.high_kg - found.low_kg > 1.1 * (exact.high_kg - exact.low_kg)


def test_arms_that_hang_say_little_and_it_is_said(robot, estimator):
    time_s, position, velocity, _ = motion()
    torque = np.zeros_like(position)
    raised = estimator.of(time_s, position, velocity, torque)
    hanging = estimator.of(time_s, position * 0.1, velocity * 0.1, torque)
    assert hanging.high_kg > 3 * raised.high_kg


@pytest.mark.parametrize("payload_kg", [0.0, 2.5])
def test_virtual_hardware_with_gears_that_stick(estimator, payload_kg):
    truth = draw_truth(load_lab("upper_body"), unit=1)
    target = np.repeat(motion()[1], 10, axis=0)
    hardware = VirtualRobot(truth, payload_kg=payload_kg, position=target[0])
    said = hardware.execute({"position": target}, every=10).measured
    found = estimator.of(said.time_s, said["position"], said["velocity"], said["torque"])
    assert abs(found.payload_kg - payload_kg) < 1.2
    assert found.low_kg <= payload_kg <= found.high_kg + 0.5


def test_what_says_nothing_is_refused(estimator):
    time_s, position, velocity, _ = motion()
    torque = np.zeros_like(position)
    with pytest.raises(DataError, match="8 or more"):
        estimator.of(time_s[:5], position[:5], velocity[:5], torque[:5])
    with pytest.raises(DataError, match="finite"):
        estimator.of(time_s, position, velocity, torque * np.nan)
    with pytest.raises(DataError, match="finite"):
        estimator.of(time_s[::-1].copy(), position, velocity, torque)
