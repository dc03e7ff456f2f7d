"""KickBot and DanceBot: their sizes are those of the paper, and both KickBots are one robot."""

import mujoco
import numpy as np
import pytest

from trueup.core.protocols import RolloutRequest
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator

NAMES = ("kickbot_a", "kickbot_b", "dancebot")


def model_of(name):
    return mujoco.MjModel.from_xml_path(str(find_model(load_robot(name))))


def posed(model, angles):
    data = mujoco.MjData(model)
    for name, angle in angles.items():
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize(
    ("name", "height_m", "mass_kg"), [("kickbot_a", 0.438, 3.08), ("kickbot_b", 0.438, 3.08), ("dancebot", 0.325, 2.58)]
)
def test_sizes_are_those_of_the_paper(name, height_m, mass_kg):
    """SAT, VI: height, mass and number of actuators."""
    model = model_of(name)
    data = posed(model, {})
    assert model.body_mass.sum() == pytest.approx(mass_kg)
    half = [model.geom_rbound[g] if kind == 2 else model.geom_size[g][2] for g, kind in enumerate(model.geom_type)]
    boxes = np.isin(model.geom_type, (2, 6))  # spheres and boxes; rods lie between them
    assert (data.geom_xpos[:, 2] + half)[boxes].max() == pytest.approx(height_m)
    assert (data.geom_xpos[:, 2] - half)[boxes].min() == pytest.approx(0.0, abs=1e-9)
    assert len(load_robot(name).joints) == 12


def test_both_kickbots_are_one_robot():
    """Whatever the pose: seen from its trunk, every part is where it is on the other, with the same inertia."""
    rng = np.random.default_rng(0)
    models = [model_of(name) for name in ("kickbot_a", "kickbot_b")]
    joints = load_robot("kickbot_a").joint_names
    assert joints == load_robot("kickbot_b").joint_names
    names = [models[0].body(number).name for number in range(1, models[0].nbody)]
    for _ in range(5):
        angles = dict(zip(joints, rng.uniform(-0.5, 0.5, 12), strict=True))
        seen = []
        for model in models:
            data, found = posed(model, angles), {}
            trunk = data.body("trunk")
            for name in names:
                body, number = data.body(name), model.body(name).id
                turn = trunk.xmat.reshape(3, 3).T @ data.ximat[number].reshape(3, 3)
                inertia = turn @ np.diag(model.body_inertia[number]) @ turn.T
                found[name] = [*(trunk.xmat.reshape(3, 3).T @ (body.xipos - trunk.xipos)), *inertia.ravel()]
            seen.append(found)
        for name in names:
            np.testing.assert_allclose(seen[0][name], seen[1][name], atol=1e-9)
    for name in joints:
        np.testing.assert_allclose(models[0].joint(name).range, models[1].joint(name).range)


def test_what_is_held_does_not_move():
    for name, held in (("kickbot_a", "trunk"), ("kickbot_b", "right_foot"), ("dancebot", "right_foot")):
        model = model_of(name)
        assert model.body(held).weldid[0] == 0


def test_robot_file_and_model_agree_on_the_limits():
    for name in NAMES:
        model, robot = model_of(name), load_robot(name)
        for joint in robot.joints:
            np.testing.assert_allclose(joint.position_limits, model.joint(joint.name).range)


@pytest.mark.parametrize("name", NAMES)
def test_it_stands_still_where_it_is_told_to(name):
    simulator = MujocoSimulator.from_robot(load_robot(name), find_model(load_robot(name)))
    zero = np.zeros((1, 12))
    result = simulator.rollout(RolloutRequest(zero, zero, {"position": np.zeros((1, 1500, 12))}))
    # On one leg, the hip carries 1.2 Nm by standing off its command: there is no integral.
    assert np.abs(result.position[0, -1]).max() < 0.07
    assert np.abs(result.velocity[0, -1]).max() < 0.01
    assert np.abs(result.further["current"]).max() < 2.3


def test_cranks_move_shank_and_foot_whatever_the_thigh_does():
    """A parallelogram: the crank's angle is that of the part it moves, against the hip."""
    simulator = MujocoSimulator.from_robot(load_robot("dancebot"), find_model(load_robot("dancebot")))
    model, joints = simulator.model, simulator.joints
    targets = {"hip_pitch": -0.3, "knee_crank": 0.35, "ankle_crank": 0.0}
    told = np.array([targets.get(name.partition("_")[2], 0.0) for name in joints])
    data = mujoco.MjData(model)
    for step in range(3000):
        data.ctrl[:] = simulator.control_of({"position": min(1.0, step / 1000) * told[None, None]})[0, 0]
        mujoco.mj_step(model, data)
    q = {model.joint(number).name: data.qpos[model.jnt_qposadr[number]] for number in range(model.njnt)}
    for side in ("left", "right"):
        assert q[f"{side}_hip_pitch"] + q[f"{side}_knee"] == pytest.approx(q[f"{side}_knee_crank"], abs=0.01)
        pitch = q[f"{side}_hip_pitch"] + q[f"{side}_knee"] + q[f"{side}_ankle_pitch"]
        assert pitch == pytest.approx(q[f"{side}_ankle_crank"], abs=0.01)
        assert q[f"{side}_knee_crank"] == pytest.approx(0.35, abs=0.05)
    # Both feet stay, and the loops stay closed.
    assert np.abs(data.efc_pos[: data.ne]).max() < 1e-3
