"""The virtual Panda beside its twin: how far apart they are, against what the papers measured on real ones."""

from dataclasses import replace

import numpy as np
import pytest

from trueup.core.protocols import RolloutRequest
from trueup.identify.experiments import Limits, RampPlan, RunSettings, estimate_breakaway, run_breakaway
from trueup.lab import LabSpec, VirtualRobot, draw_truth
from trueup.lab.spec import Controller
from trueup.robots import ControllerSpec, find_model, load_robot
from trueup.robots.spec import JointGains
from trueup.sim import MujocoSimulator

# Multi-joint moves, simulation against robot.
TABLE_II_NM2 = np.array([36.4, 25.2, 24.2, 19.6, 12.3, 7.17, 7.15])  # Realeasy, Table II
TABLE_2_RAD = 0.068  # LSTM thesis, Table 2: largest RMSE of a joint's position, and of its velocity below
TABLE_2_RAD_S = 0.0927
MOVING_AVERAGE_KEEPS = 1 - 0.505  # LSTM thesis, 6.1: share of the torque RMSE after averaging over 50 samples

TABLE_3_2_NM = (  # ES thesis: torques that break joints away, positive and negative
    (0.65, 0.88, 0.51, 0.61, 0.44, 0.40, 0.32),
    (-0.62, -0.81, -0.42, -0.51, -0.67, -0.23, -0.35),
)

VELOCITY = np.array([2.175] * 4 + [2.61] * 3)  # ES thesis, Table 2.1
ACCELERATION = np.array([15, 7.5, 10, 12.5, 15, 20, 20])
LIMITS = np.array([joint.position_limits for joint in load_robot("panda").joints])
MOTIONS = 12

# A stiff, poorly damped effort PID, as Gazebo's were: its commands come at 100 Hz and each is a kick. The gains are chosen
# so that the errors have the papers' size; theirs are not published. What is tested is that a twin of this kind exists.
KP = (1500, 2000, 2300, 2800, 1100, 4000, 1600)
KD = (25, 50, 20, 20, 10, 15, 14)


def twin():
    """The Panda as its model says, driven as Gazebo's: no compensation of the weight, PID on effort."""
    robot = load_robot("panda")
    gains = {
        name: JointGains(kp=float(kp), kv=float(kd)) for name, kp, kd in zip(robot.joint_names, KP, KD, strict=True)
    }
    robot = replace(
        robot,
        controller=ControllerSpec(kind="pid", kp=1.0, per_joint=gains),
        simulation=replace(robot.simulation, gravity_compensation=False),
    )
    return MujocoSimulator.from_robot(robot, find_model(robot))


def random_move(rng):
    """All joints from pose to pose, at 20 to 100 % of the velocity limits, between rests; 1 kHz."""
    low, high = LIMITS[:, 0] + 0.1, LIMITS[:, 1] - 0.1
    start = rng.uniform(low, high)
    way = 0.6 * (rng.uniform(low, high) - start)
    speed = (rng.uniform(0.2, 1.0) * VELOCITY / np.abs(way)).min()
    push = (ACCELERATION / np.abs(way)).min()
    speed = min(speed, np.sqrt(push))
    ramp, total = speed / push, 1 / speed + speed / push
    time_s = np.clip(np.arange(-0.5, total + 0.5, 0.001), 0.0, total)
    share = np.select(
        [time_s < ramp, time_s < total - ramp],
        [0.5 * push * time_s**2, 0.5 * push * ramp**2 + speed * (time_s - ramp)],
        1 - 0.5 * push * (total - time_s) ** 2,
    )
    return start + way * share[:, None]


def averaged(values):
    """Mean over 50 samples, half a second."""
    return np.stack([np.convolve(column, np.ones(50) / 50, "valid") for column in values.T], axis=1)


@pytest.fixture(scope="module")
def errors():
    """Twin minus robot on a few moves of two individuals: signal -> list of (T, J)."""
    simulator, rng = twin(), np.random.default_rng(5)
    found = {"position": [], "velocity": [], "torque": []}
    for unit in (1, 2):
        robot = VirtualRobot(draw_truth(unit=unit), seed=unit)
        for _ in range(MOTIONS):
            command = random_move(rng)
            robot.place(command[0])
            measured = robot.execute({"position": command}, every=10).measured
            held = np.repeat(command[::10], 10, axis=0)[: len(command)]
            result = simulator.rollout(RolloutRequest(command[:1], np.zeros((1, 7)), {"position": held[None]}))
            # Gazebo's readings are not taken in step with its commands.
            rows = np.arange(len(measured)) * 10 + rng.integers(0, 10, len(measured))
            rows = np.minimum(rows, len(command))
            for signal, own in found.items():
                own.append(getattr(result, signal)[0, rows] - measured[signal])
    return found


def mean_square(parts):
    return np.mean([np.mean(np.square(part), axis=0) for part in parts], axis=0)


def test_torque_is_wrong_by_as_much_as_table_ii(errors):
    mse = mean_square(errors["torque"])
    assert (mse > 5.0).all()
    assert (mse < 40.0).all()
    assert 0.4 < np.exp(np.mean(np.log(mse / TABLE_II_NM2))) < 2.5


def test_the_torque_error_oscillates_about_the_trend(errors):
    whole, trend = (np.sqrt(mean_square(parts)) for parts in (errors["torque"], map(averaged, errors["torque"])))
    assert (trend < MOVING_AVERAGE_KEEPS * whole).all()


def test_position_and_velocity_are_close(errors):
    assert (np.sqrt(mean_square(errors["position"])) < TABLE_2_RAD).all()
    assert (np.sqrt(mean_square(errors["velocity"])) < TABLE_2_RAD_S).all()


def test_the_robot_itself_is_calm():
    """What oscillates is the simulation: at rest between moves, the robot's torque varies by its sensor's noise."""
    command = random_move(np.random.default_rng(0))
    robot = VirtualRobot(position=command[0])
    torque = robot.execute({"position": command}).measured["torque"]
    assert np.std(torque[300:490], axis=0).max() < 0.1


def test_joints_break_away_as_in_table_3_2():
    """The thesis's experiment (3.1.2) on an individual with everything but an error of its gravity compensation."""
    spec = replace(LabSpec().without("gravity"), controller=Controller(kind="torque"))
    robot = VirtualRobot(draw_truth(spec, unit=3))
    plan = RampPlan(ramp_nm_per_s=0.4, repetitions=1, rest_s=0.3, settle_s=0.1)
    limits = Limits(dict.fromkeys(robot.joints, 1.5))
    episodes = list(run_breakaway(robot, robot, limits=limits, plan=plan, settings=RunSettings(rate_hz=500.0)))
    found = estimate_breakaway(episodes, delay_s=spec.delay.delay_s).joints
    positive, negative = (
        np.array([found[joint][sign].estimate.value for joint in robot.joints]) for sign in ("positive", "negative")
    )
    # Besides friction as in the table there is ripple, which shifts both, friction by load, and the individual.
    for torque, table in zip((positive, negative), TABLE_3_2_NM, strict=True):
        assert (torque / table > 0.5).all()
        assert (torque / table < 2.0).all()
    np.testing.assert_allclose((positive - negative) / np.subtract(*TABLE_3_2_NM), 1.0, atol=0.4)
