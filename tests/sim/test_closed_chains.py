"""Where passive joints are when a simulation begins: on closed chains, wherever the controlled ones are."""

import mujoco
import numpy as np
import pytest

from trueup.core.protocols import RolloutRequest
from trueup.errors import DataError
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator
from trueup.sim.closed_chains import ClosedChains, equalities

FOUR_BAR = """<mujoco><option gravity="0 0 0"/><worldbody>
  <body><joint name="crank" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .1" size=".01"/>
    <body pos="0 0 .1"><joint name="coupler" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .2 0 0" size=".01"/>
      <site name="end" pos=".2 0 0"/></body></body>
  <body pos=".2 0 0"><joint name="rocker" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .1" size=".01"/>
    <site name="tip" pos="0 0 .1"/></body>
</worldbody><equality><connect site1="end" site2="tip"/></equality></mujoco>"""


def four_bar():
    model = mujoco.MjModel.from_xml_string(FOUR_BAR)
    return model, ClosedChains(model, np.array([0]), np.array([0]))


@pytest.mark.parametrize("angle", [-1.0, -0.3, 0.0, 0.7, 1.1])
def test_a_parallelogram_stays_one(angle):
    model, chains = four_bar()
    position, velocity = chains.close(np.array([angle]), np.array([2.0]))
    # Opposite sides are parallel: the rocker turns with the crank, the coupler keeps its direction.
    np.testing.assert_allclose(position, [angle, -angle, angle], atol=1e-8)
    np.testing.assert_allclose(velocity, [2.0, -2.0, 2.0], atol=1e-8)
    data = mujoco.MjData(model)
    data.qpos[:] = position
    mujoco.mj_fwdPosition(model, data)
    np.testing.assert_allclose(equalities(model, data)[1], 0.0, atol=1e-9)


def test_a_pose_that_cannot_be_is_refused():
    model = mujoco.MjModel.from_xml_string(
        FOUR_BAR.replace('pos=".2 0 0"><joint name="rocker"', 'pos=".5 0 0"><joint name="rocker"')
    )
    chains = ClosedChains(model, np.array([0]), np.array([0]))
    with pytest.raises(DataError, match="opens a closed chain"):
        chains.close(np.array([0.2]), np.array([0.0]))


def test_a_motion_that_begins_in_the_middle_goes_on_as_the_whole_one():
    robot = load_robot("dancebot")
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    steps, at = 600, 400
    time_s = simulator.timestep_s * np.arange(steps)
    wave = 0.15 * np.sin(2 * np.pi * time_s)[:, None] * np.ones(len(robot.joints))
    zero = np.zeros((1, len(robot.joints)))
    whole = simulator.rollout(RolloutRequest(zero, zero, {"position": wave[None]}))
    begun = simulator.rollout(
        RolloutRequest(whole.position[:, at], whole.velocity[:, at], {"position": wave[None, at:]})
    )
    apart = np.abs(begun.position[0] - whole.position[0, at:]).max()
    assert apart < 2e-3
    # Where passive joints begin in their zero pose, the first steps throw the chains together.
    assert np.abs(begun.velocity[0, :20] - whole.velocity[0, at : at + 20]).max() < 0.1
    simulator.reset(whole.position[:, at], whole.velocity[:, at])
    for row in range(20):
        stepped = simulator.step({"position": wave[None, at + row]})
    np.testing.assert_allclose(stepped["position"], begun.position[:, 20], atol=1e-9)
