"""The simulated robot: the same motion as a rollout, commands held, sensors seeded, time of its own."""

import numpy as np
import pytest

from sim.arms import two_links
from trueup.core.protocols import Clock, RobotIO, RolloutRequest
from trueup.errors import ConfigError, DataError, MissingSignal
from trueup.lab.simulated_robot import Sensors, SimulatedRobot
from trueup.robots import ControllerSpec

TORQUE = ControllerSpec(kind="torque")
START = np.array([0.3, -0.2])


def recorded(robot, torques, period_s):
    """Readings at every tick, the torque of the tick written right after."""
    readings = []
    for tick, torque in enumerate(torques):
        robot.wait_until_s(tick * period_s)
        readings.append(robot.read())
        robot.write({"torque": torque})
    return {name: np.stack([reading[name] for reading in readings]) for name in readings[0]}


def test_it_is_a_robot_and_its_clock(tmp_path):
    robot = SimulatedRobot(two_links(tmp_path, TORQUE))
    assert isinstance(robot, RobotIO)
    assert isinstance(robot, Clock)
    assert robot.joints == ("a", "b")


@pytest.mark.parametrize("steps", [1, 4])
def test_the_motion_is_that_of_a_rollout(tmp_path, steps):
    simulator = two_links(tmp_path, TORQUE)
    torques = np.random.default_rng(0).uniform(-1.0, 1.0, (30, 2))
    truth = simulator.rollout(
        RolloutRequest(START[None], np.zeros((1, 2)), {"torque": np.repeat(torques, steps, axis=0)[None]})
    )
    robot = SimulatedRobot(simulator, position=START, steps_per_control=steps)
    seen = recorded(robot, torques, steps * 0.001)
    np.testing.assert_allclose(seen["position"], truth.position[0, : 30 * steps : steps], atol=1e-12)
    np.testing.assert_allclose(seen["velocity"], truth.velocity[0, : 30 * steps : steps], atol=1e-12)
    np.testing.assert_allclose(seen["torque"][1:], torques[:-1])


def test_time_passes_in_whole_control_steps_and_never_back(tmp_path):
    robot = SimulatedRobot(two_links(tmp_path, TORQUE), position=START, steps_per_control=5)
    robot.wait_until_s(0.0061)
    assert robot.now_s() == pytest.approx(0.010)
    before = robot.read()["position"]
    robot.wait_until_s(0.002)
    assert robot.now_s() == pytest.approx(0.010)
    np.testing.assert_array_equal(robot.read()["position"], before)
    for tick in range(3, 400):  # multiples of a step are not missed by rounding
        robot.wait_until_s(tick * 0.005)
        assert robot.now_s() == pytest.approx(tick * 0.005)


def test_a_position_servo_holds_the_starting_pose_until_it_is_told_otherwise(tmp_path):
    servo = ControllerSpec(kind="position", kp=400.0, kv=20.0)
    robot = SimulatedRobot(two_links(tmp_path, servo), position=START)
    robot.wait_until_s(2.0)
    np.testing.assert_allclose(robot.read()["position"], START, atol=0.02)
    robot.write({"position": START + 0.5})
    robot.wait_until_s(4.0)
    np.testing.assert_allclose(robot.read()["position"], START + 0.5, atol=0.03)


def test_sensors_add_seeded_noise_and_round_to_their_steps(tmp_path):
    simulator = two_links(tmp_path, TORQUE)
    sensors = Sensors(position_noise_rad=0.01, velocity_noise_rad_s=0.2, velocity_step_rad_s=0.05, torque_noise_nm=0.1)

    def run(seed, own):
        return recorded(SimulatedRobot(simulator, position=START, sensors=own, seed=seed), np.zeros((400, 2)), 0.001)

    truth, first, again, other = run(0, Sensors()), run(1, sensors), run(1, sensors), run(2, sensors)
    for name in truth:
        np.testing.assert_array_equal(first[name], again[name])
        assert not np.array_equal(first[name], other[name])
    assert np.std(first["position"] - truth["position"]) == pytest.approx(0.01, rel=0.15)
    assert np.std(first["torque"]) == pytest.approx(0.1, rel=0.15)
    assert np.std(first["velocity"] - truth["velocity"]) == pytest.approx(0.2, rel=0.15)
    np.testing.assert_allclose(first["velocity"] / 0.05, np.round(first["velocity"] / 0.05), atol=1e-9)


def test_a_reading_belongs_to_the_reader(tmp_path):
    robot = SimulatedRobot(two_links(tmp_path, TORQUE), position=START)
    robot.read()["position"][:] = 9.0
    np.testing.assert_array_equal(robot.read()["position"], START)


@pytest.mark.parametrize(
    ("command", "error"),
    [
        ({"position": np.zeros(2)}, MissingSignal),
        ({"torque": np.zeros(3)}, DataError),
        ({"torque": np.array([np.nan, 0.0])}, DataError),
    ],
)
def test_commands_that_are_none_are_refused_and_change_nothing(tmp_path, command, error):
    robot = SimulatedRobot(two_links(tmp_path, TORQUE), position=START)
    robot.write({"torque": np.array([0.5, 0.0])})
    with pytest.raises(error):
        robot.write(command)
    robot.wait_until_s(0.001)
    np.testing.assert_allclose(robot.read()["torque"], [0.5, 0.0])


def test_nonsense_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="steps_per_control"):
        SimulatedRobot(two_links(tmp_path, TORQUE), steps_per_control=0)
    with pytest.raises(ConfigError, match="negative"):
        Sensors(torque_step_nm=-1.0)


def test_a_diverged_simulation_is_an_error(tmp_path):
    robot = SimulatedRobot(two_links(tmp_path, TORQUE), position=START)
    robot.write({"torque": np.array([1e9, 0.0])})
    with pytest.raises(DataError, match="diverged"):
        robot.wait_until_s(1.0)
