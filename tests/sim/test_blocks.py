"""Bodies and joints of a simulated motion: each body's own equation of motion closes with what was taken out."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from trueup.core.protocols import RolloutRequest
from trueup.errors import DataError, NameMismatch
from trueup.robots import ReplaySpec, find_model, load_robot
from trueup.sim import MujocoSimulator
from trueup.sim.blocks import blocks_of

CLOSED = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body name="a" pos="0 0 1">
      <joint name="j1" axis="0 1 0" damping="0.02" frictionloss="0.01" armature="0.003"/>
      <geom type="capsule" fromto="0 0 0 0.3 0.02 0" size="0.02" mass="0.5"/>
      <body name="b" pos="0.3 0 0">
        <joint name="j2" axis="0 1 0" stiffness="0.5"/>
        <geom type="capsule" fromto="0 0 0 0 0.03 -0.3" size="0.02" mass="0.4"/>
        <geom type="box" pos="0.02 0.05 -0.1" size="0.02 0.01 0.03" mass="0.2"/>
        <body name="d" pos="0 0 -0.1"><joint name="j4" type="slide" axis="1 0 0.2" stiffness="30"/>
          <geom type="sphere" size="0.02" mass="0.1" pos="0 0.04 0"/></body>
      </body>
    </body>
    <body name="c" pos="0 0 0.7">
      <joint name="j3" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.3"/>
    </body>
    <body name="free" pos="0 2 1"><freejoint name="f"/><geom type="box" size="0.1 0.05 0.02" mass="0.7"/></body>
    <body name="still" pos="3 0 0"><geom type="sphere" size="0.1"/></body>
  </worldbody>
  <equality>{equality}</equality>
  <actuator><motor name="m1" joint="j1" gear="2"/><position name="m3" joint="j3" kp="3" kv="0.1"/></actuator>
</mujoco>
"""
CONNECT = '<connect body1="b" body2="c" anchor="0 0 -0.3" solref="0.005 1"/>'


def moved(equality, seconds=0.6):
    model = mujoco.MjModel.from_xml_string(CLOSED.format(equality=equality))
    steps = round(seconds / model.opt.timestep)
    rng = np.random.default_rng(0)
    controls = np.cumsum(rng.normal(size=(steps, 2)), axis=0) * 0.02
    data = mujoco.MjData(model)
    data.qvel[:] = rng.normal(size=model.nv)
    start = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    after, _ = rollout.rollout(model, [data], start[None], controls[None])
    states = np.concatenate([start[None], after[0, :-1]])
    return model, states[::7], controls[::7]


def accelerations(model, state, control, names):
    """Of centers of mass, and of turning, from Jacobians; nothing of what is tested."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    data.ctrl[:] = control
    mujoco.mj_forward(model, data)
    found = []
    for name in names:
        number = model.body(name).id
        jacobians = np.zeros((4, 3, model.nv))
        mujoco.mj_jacBodyCom(model, data, jacobians[0], jacobians[1], number)
        mujoco.mj_jacDot(model, data, jacobians[2], jacobians[3], data.xipos[number], number)
        found.append(
            (jacobians[0] @ data.qacc + jacobians[2] @ data.qvel, jacobians[1] @ data.qacc + jacobians[3] @ data.qvel)
        )
    return data, found


@pytest.mark.parametrize("equality", ["", CONNECT])
def test_the_equation_of_motion_of_every_body_closes(equality):
    model, states, controls = moved(equality)
    bodies = blocks_of(model, states, controls).bodies
    assert bodies.names == ("a", "b", "d", "c", "free")
    largest = np.abs(bodies.force_n).max(), np.abs(bodies.torque_nm).max()
    for row, (state, control) in enumerate(zip(states, controls, strict=True)):
        data, found = accelerations(model, state, control, bodies.names)
        for place, (name, (linear, angular)) in enumerate(zip(bodies.names, found, strict=True)):
            number = model.body(name).id
            axes = data.ximat[number].reshape(3, 3)
            inertia = axes @ np.diag(model.body_inertia[number]) @ axes.T
            spin = bodies.angular_velocity_rad_s[row, place]
            force = model.body_mass[number] * (linear - model.opt.gravity)
            torque = inertia @ angular + np.cross(spin, inertia @ spin)
            np.testing.assert_allclose(bodies.force_n[row, place], force, atol=1e-6 * largest[0], rtol=1e-6)
            np.testing.assert_allclose(bodies.torque_nm[row, place], torque, atol=1e-6 * largest[1], rtol=1e-6)


def test_states_are_those_of_the_motion():
    model, states, controls = moved(CONNECT, 0.1)
    bodies = blocks_of(model, states, controls, bodies=["b"]).bodies
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, states[3], mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.mj_forward(model, data)
    jacobians = np.zeros((2, 3, model.nv))
    mujoco.mj_jacBodyCom(model, data, *jacobians, model.body("b").id)
    np.testing.assert_allclose(bodies.position_m[3, 0], data.xipos[model.body("b").id])
    np.testing.assert_allclose(bodies.rotation[3, 0], data.xmat[model.body("b").id].reshape(3, 3))
    np.testing.assert_allclose(bodies.velocity_m_s[3, 0], jacobians[0] @ data.qvel, atol=1e-12)
    np.testing.assert_allclose(bodies.angular_velocity_rad_s[3, 0], jacobians[1] @ data.qvel, atol=1e-12)


@pytest.mark.parametrize("equality", ["", CONNECT])
def test_the_load_is_what_a_joint_gives_on(equality):
    """Motor, spring and damper, minus dry friction and the armature: what MuJoCo's own vectors say."""
    model, states, controls = moved(equality)
    blocks = blocks_of(model, states, controls)
    assert blocks.joints == ("j1", "j2", "j4", "j3")
    data = mujoco.MjData(model)
    dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in blocks.joints]
    for row, (state, control) in enumerate(zip(states, controls, strict=True)):
        mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        data.ctrl[:] = control
        mujoco.mj_forward(model, data)
        dry = np.zeros(model.nv)
        for number in range(data.nefc):
            if data.efc_type[number] == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF:
                dry[data.efc_id[number]] = data.efc_force[number]
        given = data.qfrc_actuator + data.qfrc_passive + dry - model.dof_armature * data.qacc
        np.testing.assert_allclose(blocks.load[row], given[dofs], atol=1e-6 * np.abs(blocks.load).max())


def test_the_load_of_a_rollout_is_that_of_its_blocks(tmp_path):
    """By sensors in the engine, and by taking its states apart."""
    robot = replace(load_robot("kickbot_b"), replay=ReplaySpec())
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    model, rng, steps = simulator.model, np.random.default_rng(1), 400
    command = {"position": np.cumsum(rng.normal(size=(1, steps, 12)), axis=1) * 0.01}
    zero = np.zeros((1, 12))
    found = simulator.rollout(RolloutRequest(zero, zero, command)).further["load"][0]
    data = mujoco.MjData(model)
    start = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    control = simulator.control_of(command)
    after, _ = rollout.rollout(model, [data], start[None], control)
    states = np.concatenate([start[None], after[0, :-1]])
    load = blocks_of(model, states, control[0], joints=robot.joint_names).load
    np.testing.assert_allclose(found[:-1], load, atol=1e-6 * np.abs(load).max())
    assert np.abs(load).max() > 0.5


@pytest.mark.parametrize("name", ["kickbot_b", "dancebot"])
def test_bodies_of_a_rollout_are_its_blocks(name):
    """By sensors in the engine, and by taking its states apart; closed chains and fixed feet included."""
    robot = load_robot(name)
    bodies = ("trunk", "left_foot", "left_thigh")
    robot = replace(robot, simulation=replace(robot.simulation, bodies=bodies))
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    model, rng, steps = simulator.model, np.random.default_rng(1), 300
    command = {"position": np.cumsum(rng.normal(size=(1, steps, 12)), axis=1) * 0.003}
    zero = np.zeros((1, 12))
    result = simulator.rollout(RolloutRequest(zero, zero, command))
    assert result.body_names == bodies
    data = mujoco.MjData(model)
    start = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    control = simulator.control_of(command)
    after, _ = rollout.rollout(model, [data], start[None], control)
    blocks = blocks_of(model, np.concatenate([start[None], after[0, :-1]]), control[0], bodies=bodies).bodies
    found = {signal: values[0, :-1] for signal, values in result.bodies.items()}
    np.testing.assert_allclose(found["body.rotation"], blocks.rotation, atol=1e-9)
    np.testing.assert_allclose(found["body.angular_velocity"], blocks.angular_velocity_rad_s, atol=1e-9)
    for signal, values in (("body.force", blocks.force_n), ("body.torque", blocks.torque_nm)):
        np.testing.assert_allclose(found[signal], values, atol=1e-5 * np.abs(values).max())
    local = np.array([model.body(item).ipos for item in bodies])
    com = found["body.position"] + np.einsum("tbij,bj->tbi", found["body.rotation"], local)
    np.testing.assert_allclose(com, blocks.position_m, atol=1e-9)
    lever = com - found["body.position"]
    moved = found["body.velocity"] + np.cross(found["body.angular_velocity"], lever)
    np.testing.assert_allclose(moved, blocks.velocity_m_s, atol=1e-9)


def test_a_chosen_few_come_in_the_order_asked():
    model, states, controls = moved("", 0.05)
    every = blocks_of(model, states, controls)
    some = blocks_of(model, states, controls, bodies=["c", "a"], joints=["j3"])
    assert (some.bodies.names, some.joints) == (("c", "a"), ("j3",))
    np.testing.assert_array_equal(some.bodies.force_n, every.bodies.force_n[:, [3, 0]])
    np.testing.assert_array_equal(some.load, every.load[:, [3]])


def test_what_is_not_there_is_said():
    model, states, controls = moved("", 0.05)
    with pytest.raises(NameMismatch, match="still"):
        blocks_of(model, states, controls, bodies=["still"])
    with pytest.raises(NameMismatch, match="j9"):
        blocks_of(model, states, controls, joints=["j1", "j9"])
    with pytest.raises(DataError, match="another model"):
        blocks_of(model, states[:, 1:], controls)
    with pytest.raises(DataError, match="another model"):
        blocks_of(model, states, controls[1:])
    rigid = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(DataError, match="no building blocks"):
        blocks_of(
            rigid, np.zeros((2, mujoco.mj_stateSize(rigid, mujoco.mjtState.mjSTATE_FULLPHYSICS))), np.zeros((2, 0))
        )
