"""Robots that are off: possible bodies, closed chains, and draws that depend on the seed and nothing else."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.protocols import RolloutRequest
from trueup.errors import ConfigError
from trueup.robots import JointSpec, RobotSpec, find_model, load_robot
from trueup.robots.model import load_spec
from trueup.sim import MujocoSimulator, Perturbation, perturbed
from trueup.sim.perturbation import LEAST_FACTOR, drawn_factor

SHIPPED = ("demo_arm", "panda", "kickbot_a", "kickbot_b", "dancebot")
LARGE = Perturbation(mass=0.5, com_m=0.01, joint_m=0.002)
SIZES = st.builds(
    Perturbation,
    mass=st.floats(0, 3),
    com_m=st.floats(0, 0.1),
    joint_m=st.floats(0, 0.05),
)


def plain(name):
    return load_spec(find_model(load_robot(name))).compile()


def off(name, size, seed=0):
    robot = load_robot(name)
    return perturbed(robot, find_model(robot), size, seed=seed)[1].compile()


def content(model):
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def written(folder, xml, **robot):
    path = folder / "model.xml"
    path.write_text(xml)
    return RobotSpec(name="made", joints=(JointSpec("j"),), model="model.xml", **robot), path


@pytest.mark.parametrize("name", SHIPPED)
def test_a_size_of_zero_is_the_same_model(name):
    robot = load_robot(name)
    same, spec = perturbed(robot, find_model(robot), Perturbation(), seed=3)
    assert content(spec.compile()) == content(plain(name))
    assert same == robot


@pytest.mark.parametrize("name", SHIPPED)
def test_the_same_seed_draws_the_same_robot_and_another_one_another(name):
    first, again, other = (content(off(name, LARGE, seed)) for seed in (1, 1, 2))
    assert first == again
    assert first != other


@given(size=SIZES, seed=st.integers(0, 1000))
def test_whatever_is_drawn_is_a_possible_body(size, seed):
    model = off("demo_arm", size, seed)
    assert (model.body_mass[1:] > 0).all()
    a, b, c = np.sort(model.body_inertia[1:], axis=1).T
    assert (a > 0).all()
    assert (a + b >= c * (1 - 1e-9)).all()


@pytest.mark.long
@given(share=st.floats(0.01, 1), seed=st.integers(0, 50))
def test_a_share_of_the_size_is_off_by_that_share(share, seed):
    size = Perturbation(mass=0.1, com_m=0.01, joint_m=0.002)  # small enough that no factor is cut
    base, whole, part = plain("kickbot_a"), off("kickbot_a", size, seed), off("kickbot_a", size.times(share), seed)
    for field in ("body_mass", "body_ipos", "body_pos", "body_inertia"):
        own, most = (getattr(model, field) - getattr(base, field) for model in (part, whole))
        np.testing.assert_allclose(own, share * most, atol=1e-12)


def test_what_one_quantity_draws_does_not_depend_on_the_others():
    alone, together = off("dancebot", Perturbation(com_m=0.01)), off("dancebot", LARGE)
    np.testing.assert_array_equal(alone.body_ipos, together.body_ipos)
    np.testing.assert_array_equal(off("dancebot", Perturbation(joint_m=0.002)).body_pos, together.body_pos)


@pytest.mark.long
def test_spreads_are_those_that_were_asked_for():
    base = plain("kickbot_a")
    drawn = [off("kickbot_a", Perturbation(mass=0.2, com_m=0.01, joint_m=0.002), seed) for seed in range(60)]
    moved = base.body_jntnum > 0
    factors = np.array([model.body_mass[1:] / base.body_mass[1:] for model in drawn])
    shifts = np.array([model.body_ipos[1:] - base.body_ipos[1:] for model in drawn])
    places = np.array([model.body_pos - base.body_pos for model in drawn])
    assert factors.mean() == pytest.approx(1.0, abs=0.03)
    assert factors.std() == pytest.approx(0.2, rel=0.1)
    assert shifts.std() == pytest.approx(0.01, rel=0.05)
    assert places[:, moved].std() == pytest.approx(0.002, rel=0.05)
    assert not places[:, ~moved].any()


@pytest.mark.parametrize("size", [Perturbation(mass=0.5), Perturbation(com_m=0.02), LARGE])
def test_a_resting_arm_carries_what_its_drawn_bodies_weigh(size):
    model = off("demo_arm", size, 4)
    data = mujoco.MjData(model)
    data.qpos[:] = np.linspace(-0.4, 0.5, model.nq)
    mujoco.mj_forward(model, data)
    for joint in range(model.njnt):
        axis, anchor = data.xaxis[joint], data.xanchor[joint]
        body, torque = model.jnt_bodyid[joint], 0.0
        for other in range(1, model.nbody):
            above = other
            while above not in (0, body):
                above = model.body_parentid[above]
            if above == body:
                weight = model.body_mass[other] * model.opt.gravity
                torque += axis @ np.cross(data.xipos[other] - anchor, weight)
        assert data.qfrc_bias[model.jnt_dofadr[joint]] == pytest.approx(-torque, abs=1e-9)


def test_factors_are_cut_so_that_they_stay_positive():
    assert drawn_factor(0.5, -4.0) == LEAST_FACTOR
    assert drawn_factor(0.5, 1.0) == 1.5


def test_motors_have_another_resistance():
    robot = load_robot("kickbot_b")
    ohms = []
    for seed in range(40):
        own, spec = perturbed(robot, find_model(robot), Perturbation(resistance=0.3), seed=seed)
        ohms.append(own.motor.resistance_ohm / robot.motor.resistance_ohm)
        assert own.motor.voltage_v == robot.motor.voltage_v
    assert content(spec.compile()) == content(plain("kickbot_b"))
    assert min(ohms) >= LEAST_FACTOR
    assert np.std(ohms) == pytest.approx(0.3, rel=0.3)


@pytest.mark.parametrize("name", ["demo_arm", "panda"])
def test_where_no_motor_moves_the_robot_its_resistance_is_refused(name):
    robot = load_robot(name)
    with pytest.raises(ConfigError, match="the resistance of its motors moves nothing"):
        perturbed(robot, find_model(robot), Perturbation(resistance=0.1), seed=0)


@pytest.mark.parametrize("size", [{"mass": -0.1}, {"com_m": float("nan")}, {"joint_m": float("inf")}])
def test_what_is_no_spread_is_refused(size):
    with pytest.raises(ConfigError, match=rf"perturbation: {next(iter(size))}"):
        Perturbation(**size)


def violation(model, data):
    mujoco.mj_forward(model, data)
    rows = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    assert rows.any()
    return np.abs(data.efc_pos[rows]).max()


@pytest.mark.parametrize("seed", range(3))
def test_closed_chains_stay_closed_also_in_motion(seed):
    robot = load_robot("dancebot")
    own, spec = perturbed(robot, find_model(robot), Perturbation(joint_m=0.002), seed=seed)
    worst = {}
    for name, simulator in {
        "as it is": MujocoSimulator.from_robot(robot, find_model(robot)),
        "off": MujocoSimulator.from_spec(spec, own, origin=find_model(robot)),
    }.items():
        model, data = simulator.model, mujoco.MjData(simulator.model)
        assert violation(model, data) < 1e-9
        worst[name] = 0.0
        command = np.zeros((1, 1, 12))
        for step in range(400):
            command[0, 0] = 0.2 * np.sin(0.01 * step) * np.array([0, 0, 1, 1, -1, 0] * 2)
            data.ctrl[:] = simulator.control_of({"position": command})[0, 0]
            mujoco.mj_step(model, data)
            if step % 40 == 39:
                worst[name] = max(worst[name], violation(model, data))
    assert worst["off"] < 2 * worst["as it is"] + 1e-5


def test_a_chain_that_would_come_apart_is_refused(tmp_path):
    xml = """<mujoco><worldbody>
      <body name="a"><joint name="j" axis="0 1 0"/><geom size=".1" mass="1"/>
        <body name="b" pos="0 0 1"><joint name="k" axis="0 1 0"/><geom size=".1" mass="1"/></body></body>
      </worldbody><equality><weld body1="b" {}/></equality></mujoco>"""
    robot, path = written(tmp_path, xml.format('relpose="0 0 -1 1 0 0 0"'))
    perturbed(robot, path, Perturbation(mass=0.3, com_m=0.1), seed=0)
    with pytest.raises(ConfigError, match="closed chains would come apart") as error:
        perturbed(robot, path, Perturbation(joint_m=0.01), seed=0)
    assert "relpose" in error.value.hint
    robot, path = written(tmp_path, xml.format(""))
    perturbed(robot, path, Perturbation(joint_m=0.01), seed=0)


@pytest.mark.parametrize("inferred", ["true", "false", "auto"])
def test_stated_inertias_are_off_like_those_of_shapes(tmp_path, inferred):
    xml = f"""<mujoco><compiler inertiafromgeom="{inferred}"/><worldbody>
      <body name="a"><joint name="j" axis="0 1 0"/><geom size=".1" mass="2"/>
        <inertial pos="0 0 .1" mass="1" fullinertia="1 1 1 .1 .1 .1"/></body></worldbody></mujoco>"""
    robot, path = written(tmp_path, xml)
    base, drawn = load_spec(path).compile(), perturbed(robot, path, Perturbation(mass=0.4), seed=1)[1].compile()
    factor = 1 + 0.4 * np.random.default_rng(1).standard_normal()
    assert drawn.body_mass[1] == pytest.approx(factor * base.body_mass[1])
    np.testing.assert_allclose(drawn.body_inertia[1], factor * base.body_inertia[1])
    np.testing.assert_allclose(drawn.body_iquat[1], base.body_iquat[1])


def test_bodies_that_are_merged_cannot_be_told_apart(tmp_path):
    xml = """<mujoco><compiler fusestatic="true"/><worldbody><body name="base"><geom size=".1" mass="1"/>
      <body name="a"><joint name="j" axis="0 1 0"/><geom size=".1" mass="2"/></body></body></worldbody></mujoco>"""
    robot, path = written(tmp_path, xml)
    with pytest.raises(ConfigError, match="merged"):
        perturbed(robot, path, Perturbation(mass=0.4), seed=1)


def test_a_robot_that_is_off_moves_otherwise():
    robot = load_robot("kickbot_b")
    own, spec = perturbed(robot, find_model(robot), Perturbation(resistance=0.5), seed=0)
    command = 0.3 * np.sin(np.linspace(0, 6, 500))[None, :, None] * np.ones(12)
    request = RolloutRequest(np.zeros((1, 12)), np.zeros((1, 12)), {"position": command})
    same = MujocoSimulator.from_robot(robot, find_model(robot)).rollout(request)
    other = MujocoSimulator.from_spec(spec, own, origin=find_model(robot)).rollout(request)
    assert np.abs(same.position - other.position).max() > 1e-3
