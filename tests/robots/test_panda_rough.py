"""The bad one of the two nominal Pandas: the same arm, other inertial parameters."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trueup.core.protocols import RolloutRequest
from trueup.robots import find_model, load_robot
from trueup.robots.model import load_spec
from trueup.sim import MujocoSimulator

# cogimon-gazebo-models, franka/model.urdf: mass, center of mass, ixx iyy izz (no products) of links 0 to 7.
ROUGH = np.array(
    [
        [1.2, 0.0, 0.0, 0.055, 0.00229, 0.00216, 0.00229],
        [2.0, 0.0, 0.0, 0.130, 0.0136666666667, 0.0118666666667, 0.003],
        [2.0, 0.0, -0.06, 0.07, 0.0136666666667, 0.0118666666667, 0.003],
        [2.0, 0.0, -0.06, 0.130, 0.0136666666667, 0.0118666666667, 0.003],
        [2.0, 0.0, 0.06, 0.07, 0.0136666666667, 0.0118666666667, 0.003],
        [2.0, 0.0, 0.0, 0.124, 0.0126506666667, 0.0108506666667, 0.003],
        [1.0, 0.0, 0.0, 0.0, 0.00260416666667, 0.00260416666667, 0.00260416666667],
        [0.2, 0.0, 0.0, 0.0, 6.66666666667e-05, 6.66666666667e-05, 0.00012],
    ]
)


def text(name):
    return find_model(load_robot(name)).read_text(encoding="utf-8")


def without(pattern, content):
    return re.sub(pattern, "", content, flags=re.DOTALL)


@pytest.fixture(scope="module")
def models():
    return {name: mujoco.MjModel.from_xml_path(str(find_model(load_robot(name)))) for name in ("panda", "panda_rough")}


def test_only_the_inertial_parameters_differ():
    good, rough = (
        without(r'<!--.*?-->|<inertial .*?/>|model="\w+"|\s+', text(name)) for name in ("panda", "panda_rough")
    )
    assert rough == good
    robots = [load_robot(name) for name in ("panda", "panda_rough")]
    same = {"name": "", "model": "", "description": ""}
    assert replace(robots[1], **same) == replace(robots[0], **same)


def test_the_inertial_parameters_are_those_of_the_source(models):
    model = models["panda_rough"]
    for link, (mass, x, y, z, *moments) in enumerate(ROUGH):
        body = model.body(f"link{link}")
        assert body.mass[0] == pytest.approx(mass)
        np.testing.assert_allclose(body.ipos, [x, y, z], atol=1e-12)
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, body.iquat)
        rotation = rotation.reshape(3, 3)
        np.testing.assert_allclose(rotation @ np.diag(body.inertia) @ rotation.T, np.diag(moments), atol=1e-9)


def test_it_is_rough(models):
    """Root mean square difference of the weight's torque over random poses, joint by joint."""
    rng = np.random.default_rng(7)
    poses = rng.uniform(*models["panda"].jnt_range.T, (200, 7))
    torques = {}
    for name, model in models.items():
        data, rows = mujoco.MjData(model), []
        for pose in poses:
            data.qpos[:] = pose
            mujoco.mj_forward(model, data)
            rows.append(data.qfrc_bias.copy())
        torques[name] = np.array(rows)
    apart = np.sqrt(np.mean((torques["panda"] - torques["panda_rough"]) ** 2, axis=0))
    assert apart[0] == pytest.approx(0.0, abs=1e-9)  # its axis is vertical
    assert (apart[[1, 3]] > 1.0).all()  # Nm: gravity that a controller would have to make good
    assert apart.max() < 0.6 * np.abs(torques["panda"]).max()


def test_a_rough_simulator_is_further_from_a_robot_than_the_good_one():
    """As in tables 2 and 4 of the LSTM thesis: positions hardly differ, torques by a factor of 2 to 10."""

    def follow(name, frictionloss=0.0, heavier=1.0):
        robot = load_robot(name)
        spec = load_spec(find_model(robot))
        for joint in spec.joints:
            joint.frictionloss = frictionloss
        for body in spec.bodies:
            body.mass *= heavier
        simulator = MujocoSimulator.from_spec(spec, robot, origin=find_model(robot))
        time_s = np.arange(3000)[:, None] * simulator.timestep_s
        home = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
        command = home + 0.3 * np.sin(np.linspace(1.0, 2.0, 7) * time_s)
        return simulator.rollout(RolloutRequest(home[None], np.zeros((1, 7)), {"position": command[None]}))

    robot = follow("panda", frictionloss=0.5, heavier=1.03)
    torque, position = {}, {}
    for name in ("panda", "panda_rough"):
        simulated = follow(name)
        torque[name] = np.sqrt(np.mean((robot.torque - simulated.torque) ** 2, axis=(0, 1)))
        position[name] = np.sqrt(np.mean((robot.position - simulated.position) ** 2, axis=(0, 1)))
    assert (torque["panda_rough"][[1, 3]] > 2.0 * torque["panda"][[1, 3]]).all()
    assert torque["panda_rough"].mean() > 2.0 * torque["panda"].mean()
    assert position["panda_rough"].max() < 0.05
