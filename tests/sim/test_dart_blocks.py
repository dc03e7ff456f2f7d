"""Bodies and loads of a rollout in DART: they close their equations of motion, and are those of MuJoCo."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from sim.test_dart_engine import HOME, PUSH, twin
from trueup.core.protocols import RolloutRequest
from trueup.errors import ConfigError, NameMismatch
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, SimulationSpec, find_model, load_robot
from trueup.robots.model import load_spec
from trueup.sim import DartSimulator, MujocoSimulator

# Two trees; a body of two joints, a share of carried weight and one carried all, a welded part, a spring, armature,
# dampers, dry friction, and a stop that is reached.
MODEL = """
<mujoco><compiler angle="radian"/><option timestep="0.0005" integrator="implicitfast"/><worldbody>
  <body name="base" pos="0 0 1" quat="1 .2 .3 .1" gravcomp="0.3">
    <joint name="s" type="slide" axis="1 1 0" ref="0.3" stiffness="4" springref="0.1"/>
    <inertial pos=".1 0 .2" mass="2" diaginertia=".1 .2 .15" quat="1 .3 .2 .5"/>
    <body name="turn"><joint name="h" axis="0 1 .5" pos=".1 .2 .3" ref="0.7" armature="0.05" damping="0.2"/>
      <inertial pos=".1 0 0" mass=".5" diaginertia=".01 .02 .015"/>
      <body name="part" pos="0 .2 .1">
        <inertial pos="0 0 0" mass=".3" diaginertia=".01 .01 .01"/>
        <body name="end" pos=".3 0 0" gravcomp="1">
          {first}<joint name="l" axis="0 1 0" damping="0.1" frictionloss="0.2"/>
          <inertial pos="0 .1 0" mass="1" diaginertia=".02 .02 .02"/>
        </body>
      </body>
    </body>
  </body>
  <body name="flap" pos="1 0 1"><joint name="f" axis="0 1 0" limited="true" range="-0.3 0.3"/>
    <inertial pos=".2 0 0" mass=".4" diaginertia=".01 .01 .01"/></body>
  <body name="shelf" pos="0 2 0"><inertial pos="0 0 .1" mass="3" diaginertia=".1 .1 .1"/></body>
</worldbody></mujoco>"""
FIRST = '<joint name="k" axis="1 0 0" pos="0 0 .1" armature="0.01"/>'
JOINTS = ("s", "h", "l", "f")
BODIES = ("end", "base", "turn", "part", "flap", "shelf")


def simulator(first="", **simulation):
    robot = RobotSpec(
        name="odd",
        joints=tuple(JointSpec(name) for name in JOINTS),
        model="odd.xml",
        controller=ControllerSpec(kind="torque"),
        simulation=SimulationSpec(**simulation),
    )
    spec = mujoco.MjSpec.from_string(MODEL.format(first=first))
    return DartSimulator.from_spec(spec, robot, origin=Path("odd.xml"))


def pushed(steps=150):
    rng = np.random.default_rng(0)
    torque = 0.1 * np.cumsum(rng.normal(size=(2, steps, len(JOINTS))), axis=1)
    return RolloutRequest(
        rng.normal(size=(2, len(JOINTS))) * 0.2, rng.normal(size=(2, len(JOINTS))), {"torque": torque}
    )


def test_the_equation_of_motion_of_every_body_closes():
    """Accelerations from Jacobians at the states of the rollout; nothing of what is tested."""
    dart = simulator(bodies=BODIES)
    result, model = dart.rollout(pushed()), dart.model
    assert result.body_names == BODIES
    assert np.abs(result.position[..., 3]).max() > 0.29  # the stop
    force, torque = result.bodies["body.force"], result.bodies["body.torque"]
    largest = np.abs(force).max(), np.abs(torque).max()
    data, jacobians = mujoco.MjData(model), np.zeros((4, 3, model.nv))
    for motion, row in np.ndindex(2, 150):
        data.qpos[:], data.qvel[:] = result.position[motion, row], result.velocity[motion, row]
        change = (result.velocity[motion, row + 1] - result.velocity[motion, row]) / dart.timestep_s
        mujoco.mj_forward(model, data)
        for place, name in enumerate(BODIES):
            number = model.body(name).id
            mujoco.mj_jacBodyCom(model, data, jacobians[0], jacobians[1], number)
            mujoco.mj_jacDot(model, data, jacobians[2], jacobians[3], data.xipos[number], number)
            linear, angular = jacobians[:2] @ change + jacobians[2:] @ data.qvel
            axes = data.ximat[number].reshape(3, 3)
            inertia = axes @ np.diag(model.body_inertia[number]) @ axes.T
            spin = jacobians[1] @ data.qvel
            moved = model.body_mass[number] * (linear - model.opt.gravity)
            turned = inertia @ angular + np.cross(spin, inertia @ spin)
            np.testing.assert_allclose(force[motion, row, place], moved, atol=1e-6 * largest[0], rtol=1e-6)
            np.testing.assert_allclose(torque[motion, row, place], turned, atol=1e-6 * largest[1], rtol=1e-6)


def test_poses_and_velocities_are_those_of_the_states():
    dart = simulator(bodies=BODIES)
    result, model = dart.rollout(pushed(50)), dart.model
    data, jacobians = mujoco.MjData(model), np.zeros((2, 3, model.nv))
    for row in (0, 20, 49):
        data.qpos[:], data.qvel[:] = result.position[1, row], result.velocity[1, row]
        mujoco.mj_forward(model, data)
        own = {signal: values[1, row] for signal, values in result.bodies.items()}
        for place, name in enumerate(BODIES):
            mujoco.mj_jacBody(model, data, *jacobians, model.body(name).id)
            np.testing.assert_allclose(own["body.position"][place], data.body(name).xpos, atol=1e-12)
            np.testing.assert_allclose(own["body.rotation"][place], data.body(name).xmat.reshape(3, 3), atol=1e-12)
            np.testing.assert_allclose(own["body.velocity"][place], jacobians[0] @ data.qvel, atol=1e-12)
            np.testing.assert_allclose(own["body.angular_velocity"][place], jacobians[1] @ data.qvel, atol=1e-12)
    for values in result.bodies.values():
        np.testing.assert_array_equal(values[:, -1], values[:, -2])


def test_the_load_is_what_moves_the_parts():
    """Friction, armature, damper, spring and stop are between the motor and what it moves; carried weight is not."""
    dart = simulator(load=True)
    result, model = dart.rollout(pushed()), dart.model
    load, data, given = result.further["load"], mujoco.MjData(model), np.empty(4)
    for motion, row in np.ndindex(2, 150):
        data.qpos[:], data.qvel[:] = result.position[motion, row], result.velocity[motion, row]
        mujoco.mj_forward(model, data)
        data.qacc[:] = (result.velocity[motion, row + 1] - result.velocity[motion, row]) / dart.timestep_s
        mujoco.mj_rne(model, data, 1, given)
        np.testing.assert_allclose(load[motion, row], given, atol=1e-6 * np.abs(load).max(), rtol=1e-6)
    assert np.abs(load[:, :-1] - result.torque[:, :-1]).max(axis=(0, 1)).min() > 0.05


def panda_in_both(step_s, *, damped):
    robot = load_robot("panda")
    bodies = tuple(body.name for body in load_spec(find_model(robot)).bodies)[1:]
    simulation = replace(robot.simulation, timestep_s=step_s, load=True, bodies=bodies)
    spec = load_spec(find_model(robot))
    for joint in spec.joints:
        joint.damping[0] = 5.0 if damped else 0.0
    robot = replace(robot, controller=ControllerSpec(kind="torque"), simulation=simulation)
    mine = MujocoSimulator.from_spec(spec, robot, origin=find_model(robot))
    other = twin(mine)
    time_s = np.arange(round(0.3 / step_s))[:, None] * step_s
    drive = np.array([3.0, 30.0, 3.0, 20.0, 1.0, 2.0, 0.5]) * np.sin(9.0 * time_s)
    ask = RolloutRequest(HOME[None], PUSH[None], {"torque": drive[None]})
    return mine.rollout(ask), other.rollout(ask)


def furthest(first, second):
    """Signal -> largest difference, as a share of the largest value."""
    pairs = [(name, one, second.further[name]) for name, one in first.further.items()]
    pairs += [(name, one, second.bodies[name]) for name, one in first.bodies.items()]
    return {name: np.abs(one - other).max() / np.abs(one).max() for name, one, other in pairs}


def test_both_engines_say_the_same_of_a_smooth_motion():
    apart = furthest(*panda_in_both(0.001, damped=False))
    assert set(apart) >= {"load", "body.position", "body.rotation", "body.velocity", "body.force", "body.torque"}
    assert max(apart.values()) < 1e-11


def test_what_is_taken_implicitly_makes_a_difference_of_the_size_of_a_step():
    """MuJoCo's sensors have the acceleration before its implicit terms, DART's step the one after them."""
    coarse, fine = (furthest(*panda_in_both(step_s, damped=True)) for step_s in (0.001, 0.0005))
    for name in ("load", "body.force", "body.torque"):
        assert 1e-6 < coarse[name] < 0.02
        assert coarse[name] / fine[name] == pytest.approx(2.0, rel=0.1)


def test_a_body_that_cannot_move_is_held_against_its_weight_in_both():
    first, second = panda_in_both(0.001, damped=False)
    weight = second.bodies["body.force"][0, :, 0]
    np.testing.assert_allclose(first.bodies["body.force"][0, :, 0], weight)
    assert weight[0, 2] > 1.0
    assert not weight[:, :2].any()


def test_only_what_is_asked_for_is_said():
    result = simulator().rollout(pushed(5))
    assert (result.further, result.bodies, result.body_names) == ({}, {}, ())
    result = simulator(load=True).rollout(pushed(5))
    assert (set(result.further), result.bodies) == ({"load"}, {})
    result = simulator(FIRST, bodies=("end",)).rollout(pushed(5))
    assert (result.further, result.bodies["body.rotation"].shape) == ({}, (2, 6, 1, 3, 3))


def servos(engine, step_s):
    robot = load_robot("kickbot_a")
    robot = replace(robot, simulation=replace(robot.simulation, timestep_s=step_s))
    time_s = np.arange(round(0.3 / step_s))[:, None] * step_s
    command = 0.15 * (1 - np.cos(np.linspace(6, 12, 12) * time_s)) * np.array([1] * 11 + [-1])
    ask = RolloutRequest(np.zeros((1, 12)), np.zeros((1, 12)), {"position": command[None]})
    result = engine.from_robot(robot, find_model(robot)).rollout(ask)
    return result.further["load"][0, : -1 : round(0.001 / step_s)][50:, :5]


def test_loads_of_servos_are_those_that_mujoco_comes_to_with_small_steps():
    """The back-EMF of a servo brakes so hard that MuJoCo's sensors at 1 ms are off by tenths."""
    coarse, fine = servos(MujocoSimulator, 0.001), servos(MujocoSimulator, 0.0001)
    dart = servos(DartSimulator, 0.001)
    scale = fine.std(axis=0)
    off, other = (np.sqrt(np.mean((load - fine) ** 2, axis=0)) / scale for load in (coarse, dart))
    assert scale.max() > 0.01
    assert other.max() < 0.05
    assert (other < off / 4).all()


def test_what_cannot_be_said_is_refused():
    with pytest.raises(NameMismatch, match="bodies \\['elbow'\\] are not in the model"):
        simulator(bodies=("end", "elbow"))
    robot = replace(simulator(load=True).robot, joints=tuple(JointSpec(name) for name in "khlf"))
    with pytest.raises(ConfigError, match=r"load: joint 'k' shares its body with 'l'.*\n.*a body of its own"):
        MujocoSimulator.from_spec(mujoco.MjSpec.from_string(MODEL.format(first=FIRST)), robot, origin=Path("odd.xml"))
    with pytest.raises(NameMismatch, match="bodies \\['world'\\] are not in the model"):
        simulator(bodies=("world",))
    dancebot = load_robot("dancebot")
    with pytest.raises(ConfigError, match=r"DART cannot simulate.*equality constraints"):
        DartSimulator.from_robot(dancebot, find_model(dancebot))
