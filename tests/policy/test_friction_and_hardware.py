"""What becomes of actions on the way to an arm: the thesis's friction in simulations, its offset on hardware."""

import math
from dataclasses import replace

import numpy as np
import pytest

from trueup.errors import ConfigError, DataError, RobotStopped
from trueup.lab import LabSpec, VirtualRobot, draw_truth
from trueup.lab.spec import Controller
from trueup.policy.arms import Arms, HardwareArm, MujocoArms
from trueup.policy.environment import PandaReach
from trueup.policy.reach import ReachConfig
from trueup.policy.reaching import Reaching
from trueup.policy.thesis_friction import BREAKAWAY_NEGATIVE, BREAKAWAY_POSITIVE, OFFSET, PUBLISHED, ThesisFriction
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator

PANDA = load_robot("panda_torque")
SIMULATOR = MujocoSimulator.from_robot(PANDA, find_model(PANDA))
CONFIG = ReachConfig()
LAB = LabSpec(controller=Controller(kind="torque"))


class Noted:
    """Arms that stand, or move as they are told to, and note what they are told."""

    def __init__(self, velocity):
        self.count, self.control_s, self.joints = 1, 0.02, PANDA.joint_names
        self.position, self.velocity, self.told = np.zeros((1, 7)), np.array([velocity]), []

    def begin(self, rows, position, rng):  # noqa: ARG002
        self.position = position.copy()

    def step(self, torque):
        self.told.append(torque[0].copy())


def sigmoid(joint, velocity):
    """Eq. 2.1, by hand."""
    level, slope, shift = PUBLISHED[joint]
    return level / (1 + math.exp(-slope * (velocity + shift))) - level / (1 + math.exp(-slope * shift))


def test_tables_are_those_of_the_thesis():
    assert [row[0] for row in PUBLISHED] == [0.5462, 0.8722, 0.6407, 1.2794, 0.8390, 0.3030, 0.5649]  # Table 2.3
    assert [row[1] for row in PUBLISHED] == [5.1181, 9.0657, 10.1360, 5.5903, 8.3469, 17.1330, 10.3360]
    assert [row[2] for row in PUBLISHED] == [0.0395, 0.0259, -0.0461, 0.0362, 0.0262, -0.0210, 0.0036]
    assert OFFSET == (-0.127, -0.725, 0.027, 0.53, 0.0, -0.06, 0.0)  # Table 3.1
    assert BREAKAWAY_POSITIVE == (0.65, 0.88, 0.51, 0.61, 0.44, 0.40, 0.32)  # Table 3.2
    assert BREAKAWAY_NEGATIVE == (-0.62, -0.81, -0.42, -0.51, -0.67, -0.23, -0.35)


def test_a_moving_joint_is_braked_by_the_sigmoid():
    velocity = np.array([[0.5, -0.5, 0.04, -0.04, 2.0, -2.0, 100.0]])
    action = np.full((1, 7), 0.2)
    expected = [0.2 - sigmoid(joint, velocity[0, joint]) for joint in range(7)]
    np.testing.assert_allclose(ThesisFriction().applied(action, velocity)[0], expected, atol=1e-12)
    assert (ThesisFriction().dynamic(np.zeros((1, 7))) == 0).all()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_standing_joint_moves_only_if_it_is_broken_away(sign):
    edge = np.array(BREAKAWAY_POSITIVE if sign > 0 else BREAKAWAY_NEGATIVE)
    slow, fast = np.full((1, 7), 0.029 * sign), np.full((1, 7), 0.031 * sign)
    friction = ThesisFriction()
    assert (friction.applied(0.99 * edge[None], slow) == 0).all()
    over = friction.applied(1.01 * edge[None], slow)
    np.testing.assert_allclose(over[0], [1.01 * e - sigmoid(j, 0.029 * sign) for j, e in enumerate(edge)], atol=1e-12)
    assert (friction.applied(0.5 * edge[None], fast) != 0).all()


def test_an_arm_is_told_what_is_left_and_hardware_what_its_gravity_lacks():
    velocity = [0.5, 0.0, -0.3, 0.01, 0.2, 0.0, 0.0]
    action = np.array([[1.0, 0.5, 9.0, -0.4, 0.1, 0.35, -0.1]])
    arms = Noted(velocity)
    assert isinstance(arms, Arms)
    rng = np.random.default_rng(0)
    Reaching(arms, SIMULATOR.model, CONFIG, friction=ThesisFriction()).step(action, rng)
    cut = [1.0, 0.5, 2.5, -0.4, 0.1, 0.35, -0.1]
    moving = [0, 2, 4]
    expected = [cut[j] - sigmoid(j, velocity[j]) if j in moving else 0.0 for j in range(7)]
    np.testing.assert_allclose(arms.told[0], expected, atol=1e-12)
    Reaching(arms, SIMULATOR.model, CONFIG, offset_nm=np.array(OFFSET)).step(action, rng)
    np.testing.assert_allclose(arms.told[1], np.array(cut) + OFFSET, atol=1e-12)


def hardware(lab, seed=3):
    return HardwareArm(lab, CONFIG.control_s, place=lambda pose, _: lab.restart(position=pose, seed=seed))


def test_hardware_without_effects_moves_as_the_simulator_does():
    """The same episode on virtual hardware and in MuJoCo."""
    spec = replace(PANDA, simulation=replace(PANDA.simulation, timestep_s=0.0005))
    simulator = MujocoSimulator.from_robot(spec, find_model(PANDA))
    simulator.model.dof_damping[:] = 0.0
    lab = VirtualRobot(draw_truth(LAB.only()))
    goal = np.array([[0.4, 0.2, 0.5]])
    both = [
        Reaching(arms, simulator.model, CONFIG) for arms in (hardware(lab), MujocoArms(simulator, 1, CONFIG.control_s))
    ]
    rng = np.random.default_rng(0)
    for reaching in both:
        reaching.begin(np.zeros(1, int), rng, goals=goal)
    for action in rng.uniform(-1, 1, (25, 1, 7)) * both[0].most:
        real, simulated = (reaching.step(action, rng) for reaching in both)
    np.testing.assert_allclose(real.observation, simulated.observation, atol=2e-3)
    assert real.reward == pytest.approx(simulated.reward, abs=5e-3)
    assert lab.now_s() == pytest.approx(25 * CONFIG.control_s)


@pytest.mark.long
def test_an_environment_drives_hardware_and_episodes_are_repeatable():
    lab = VirtualRobot(draw_truth(LAB, unit=2))
    env = PandaReach(reaching=Reaching(hardware(lab), SIMULATOR.model, CONFIG))
    ways = []
    for _ in range(2):
        env.reset(seed=5)
        ways.append([env.step(env.action_space.high)[0] for _ in range(20)])
    np.testing.assert_array_equal(*ways)
    lab.stop()
    with pytest.raises(RobotStopped):
        env.step(env.action_space.high)


def test_hardware_whose_simulation_diverges_is_lost(monkeypatch):
    lab = VirtualRobot(draw_truth(LAB))
    reaching = Reaching(hardware(lab), SIMULATOR.model, CONFIG)
    rng = np.random.default_rng(0)
    reaching.begin(np.zeros(1, int), rng)

    def diverged(time_s):
        raise DataError("the simulation diverged")

    monkeypatch.setattr(lab, "wait_until_s", diverged)
    done = reaching.step(np.zeros((1, 7)), rng)
    assert done.lost.tolist() == [True]
    assert np.isfinite(done.observation).all()
    assert np.isfinite(done.reward).all()


def test_a_robot_that_takes_no_torques_or_says_too_little():
    with pytest.raises(ConfigError, match="takes no torques"):
        hardware(VirtualRobot(draw_truth(LabSpec())))
    lab = VirtualRobot(draw_truth(LAB))
    arm = hardware(lab)
    lab.read = lambda: {"position": np.zeros(7)}
    with pytest.raises(RobotStopped, match="does not say its velocity"):
        arm.begin(np.zeros(1, int), np.zeros((1, 7)), np.random.default_rng(0))
