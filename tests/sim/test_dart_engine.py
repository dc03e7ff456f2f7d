"""DART against MuJoCo on the same numbers, and against what can be worked out by hand."""

import builtins
import pickle
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from sim.arms import two_links
from sim.test_friction import FULL, LAWS, arm, swing
from sim.test_mujoco_engine import KINDS, request, smooth_command
from trueup.core.protocols import RolloutRequest, Simulator
from trueup.errors import ConfigError, DataError, MissingSignal
from trueup.robots import ControllerSpec, JointFriction, JointSpec, RobotSpec, find_model, load_robot
from trueup.robots.model import load_spec
from trueup.sim import DartSimulator, MujocoSimulator
from trueup.sim.dart_model import refuse_unmatched, skeleton_of

IMPLICIT = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
HOME = np.array([0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4])
PUSH = np.array([0.5, -0.3, 0.4, 0.2, -0.6, 0.3, 0.8])


def twin(simulator, *, integrator=IMPLICIT):
    """DART on the compiled model of a MuJoCo simulator; both with this integrator."""
    simulator.model.opt.integrator = integrator
    return DartSimulator(simulator.model, simulator.robot, simulator.channels)


def panda(controller=None, *, step_s=0.001, integrator=None, edit=None):
    """The Panda in both engines, without friction unless `edit` puts some in."""
    robot = load_robot("panda")
    simulation = replace(robot.simulation, timestep_s=step_s, gravity_compensation=False)
    robot = replace(robot, controller=controller or ControllerSpec(kind="torque"), simulation=simulation)
    path = find_model(robot)
    spec = load_spec(path)
    for joint in spec.joints:
        joint.damping[:] = 0.0
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        if edit:
            edit(joint)
    simulator = MujocoSimulator.from_spec(spec, robot, origin=path)
    return simulator, twin(simulator, integrator=IMPLICIT if integrator is None else integrator)


def weird():
    """Two joints on one body off its origin, references, a share of carried weight, a fixed branch, a spring."""
    return mujoco.MjModel.from_xml_string("""
    <mujoco><compiler angle="radian"/><option timestep="0.0005" integrator="implicitfast"/><worldbody>
      <body pos="0 0 1" quat="1 .2 .3 .1" gravcomp="0.3">
        <joint name="s" type="slide" axis="1 1 0" ref="0.3" stiffness="4" springref="0.1"/>
        <joint name="h" axis="0 1 .5" pos=".1 .2 .3" ref="0.7" armature="0.05" damping="0.2"/>
        <inertial pos=".1 0 .2" mass="2" diaginertia=".1 .2 .15" quat="1 .3 .2 .5"/>
        <body pos="0 .2 .1">
          <inertial pos="0 0 0" mass=".3" diaginertia=".01 .01 .01"/>
          <body name="end" pos=".3 0 0" gravcomp="1">
            <joint name="k" axis="1 0 0" pos="0 0 .1" armature="0.01"/><joint name="l" axis="0 1 0" damping="0.1"/>
            <inertial pos="0 .1 0" mass="1" diaginertia=".02 .02 .02"/>
          </body>
        </body>
        <body pos="0 -0.1 0"><site name="bare"/></body>
      </body>
    </worldbody></mujoco>""")


def dynamics(model, skeleton, position, velocity):
    """Mass matrix without armature and bias force, of MuJoCo and of DART."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = position, velocity
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    skeleton.setPositions(position)
    skeleton.setVelocities(velocity)
    ours = mass - np.diag(model.dof_armature), data.qfrc_bias - data.qfrc_gravcomp
    return (*ours, skeleton.getMassMatrix(), skeleton.getCoriolisAndGravityForces())


# ---- the model


@pytest.mark.parametrize("which", ["panda", "carried panda", "weird"])
def test_mass_matrix_and_gravity_are_those_of_mujoco_at_random_poses(which):
    model = weird()
    if which != "weird":
        spec = load_spec(find_model(load_robot("panda")))
        for body in spec.bodies:
            body.gravcomp = 1.0 if which == "carried panda" else 0.0
        model = spec.compile()
    skeleton, rng = skeleton_of(model), np.random.default_rng(7)
    for moving in (False, True):
        for _ in range(50):
            position, velocity = rng.uniform(-2, 2, model.nv), moving * rng.normal(size=model.nv)
            mass, bias, other_mass, other_bias = dynamics(model, skeleton, position, velocity)
            np.testing.assert_allclose(other_mass, mass, atol=1e-6)
            np.testing.assert_allclose(other_bias, bias, atol=1e-6)


def test_bodies_are_where_mujoco_has_them():
    model = weird()
    skeleton, data = skeleton_of(model), mujoco.MjData(model)
    for seed in range(5):
        data.qpos[:] = np.random.default_rng(seed).normal(size=model.nq)
        mujoco.mj_forward(model, data)
        skeleton.setPositions(data.qpos)
        place = skeleton.getBodyNode("end").getWorldTransform()
        np.testing.assert_allclose(np.ravel(place.translation()), data.body("end").xpos, atol=1e-12)
        np.testing.assert_allclose(place.rotation(), data.body("end").xmat.reshape(3, 3), atol=1e-12)


def test_a_payload_at_its_site_is_in_both():
    spec = load_spec(find_model(load_robot("panda")))
    box = {"pos": [0.0, 0.0, 0.05], "ipos": [0.0, 0.0, 0.0], "mass": 3.0, "inertia": [0.01] * 3}
    spec.frame("flange").add_body(name="box", explicitinertial=True, **box)
    model = spec.compile()
    mass, bias, other_mass, other_bias = dynamics(model, skeleton_of(model), HOME, PUSH)
    np.testing.assert_allclose(other_mass, mass, atol=1e-9)
    np.testing.assert_allclose(other_bias, bias, atol=1e-9)


@pytest.mark.parametrize(
    ("xml", "reason"),
    [
        ('<worldbody><body><freejoint/><geom size="1"/></body></worldbody>', "other than hinges and slides"),
        (
            '<worldbody><body><joint name="a"/><geom size="1"/></body><geom type="plane" size="1 1 1"/></worldbody>',
            "contacts",
        ),
        (
            '<worldbody><body><joint name="a"/><joint name="b"/><geom size="1"/></body></worldbody><equality><joint joint1="a" joint2="b"/></equality>',
            "equality",
        ),
        (
            '<worldbody><body><joint name="a"/><geom size="1"/></body></worldbody><tendon><fixed><joint joint="a" coef="1"/></fixed></tendon>',
            "tendons",
        ),
        ('<option density="1.2"/><worldbody><body><joint/><geom size="1"/></body></worldbody>', "medium"),
        ('<worldbody><body gravcomp="2"><joint/><geom size="1"/></body></worldbody>', "gravcomp outside 0..1"),
    ],
)
def test_what_dart_cannot_match_is_refused_by_its_name(xml, reason):
    with pytest.raises(ConfigError, match=f"DART cannot simulate.*{reason}.*\n.*mujoco"):
        refuse_unmatched(mujoco.MjModel.from_xml_string(f"<mujoco>{xml}</mujoco>"))


@pytest.mark.parametrize(
    ("actuator", "reason"),
    [
        ('<cylinder joint="a" timeconst="0.1" area="1"/>', "dynamics of its own"),
        ('<damper joint="a" kv="1" ctrlrange="0 1"/>', "gain is not fixed"),
        ('<motor site="s" gear="0 0 0 0 0 1"/>', "does not act on a joint"),
    ],
)
def test_actuators_of_other_kinds_are_refused(actuator, reason):
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body><joint name="a"/><geom size="0.1"/><site name="s"/></body></worldbody>'
        f"<actuator><motor name='own' joint='a'/>{actuator.replace(' ', ' name=' + chr(34) + 'b' + chr(34) + ' ', 1)}</actuator></mujoco>"
    )
    model = spec.compile()
    robot = RobotSpec(name="x", joints=(JointSpec("a"),), model="x.xml")
    with pytest.raises(ConfigError, match=f"actuator 'b'.*{reason}"):
        DartSimulator(model, robot, ())


def test_without_dartpy_the_extra_is_named(monkeypatch):
    model = weird()
    real = builtins.__import__

    def without(name, *rest, **options):
        if name == "dartpy":
            raise ImportError("No module named 'dartpy'")
        return real(name, *rest, **options)

    monkeypatch.delitem(sys.modules, "dartpy", raising=False)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match=r"DART is not installed.*\n.*\.\[dart\]"):
        skeleton_of(model)


# ---- motions


def test_passive_and_driven_motions_of_the_panda_agree():
    """1e-3 rad after 1 s is asked for; the same discretization on the same numbers leaves rounding."""
    mine, other = panda()
    time_s = np.arange(1000)[:, None] * mine.timestep_s
    drive = [3.0, 30.0, 3.0, 20.0, 1.0, 2.0, 0.5] * np.sin(
        2 * np.pi * np.array([1, 0.7, 1.3, 0.9, 2, 1.7, 2.3]) * time_s
    )
    for torque in (np.zeros((1000, 7)), drive):
        ask = RolloutRequest(HOME[None], PUSH[None], {"torque": torque[None]})
        first, second = mine.rollout(ask), other.rollout(ask)
        assert np.abs(first.position - HOME).max() > 1.0
        np.testing.assert_allclose(second.position, first.position, atol=1e-9)
        np.testing.assert_allclose(second.velocity, first.velocity, atol=1e-8)
        np.testing.assert_array_equal(second.torque, first.torque)


def test_the_engines_agree_ever_better_with_smaller_steps_whatever_the_integrator():
    apart = []
    for step_s in (0.0002, 0.0001):
        mine, other = panda(step_s=step_s, integrator=int(mujoco.mjtIntegrator.mjINT_RK4))
        ask = RolloutRequest(HOME[None], PUSH[None], {"torque": np.zeros((1, round(0.2 / step_s), 7))})
        apart.append(np.abs(mine.rollout(ask).position[0, -1] - other.rollout(ask).position[0, -1]).max())
    assert apart[1] < 1e-3
    # DART is of first order, so half the step halves what they differ by.
    assert apart[0] / apart[1] == pytest.approx(2.0, rel=0.05)


def energy(model, position, velocity):
    data, total = mujoco.MjData(model), []
    for q, v in zip(position, velocity, strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        total.append(data.energy.sum())
    return np.array(total)


@pytest.mark.parametrize(("engine", "order"), [("dart", 1), ("implicitfast", 1), ("RK4", 4)])
def test_energy_is_conserved_as_well_as_the_integrator_promises(engine, order):
    """Semi-implicit Euler errs in proportion to the step, Runge and Kutta's fourth power of it."""
    steps_s, wrong = (0.002, 0.001, 0.0005), []
    for step_s in steps_s:
        integrator = int(mujoco.mjtIntegrator.mjINT_RK4) if engine == "RK4" else IMPLICIT
        mine, other = panda(step_s=step_s, integrator=integrator)
        rows = round(0.5 / step_s)
        ask = RolloutRequest(HOME[None], PUSH[None], {"torque": np.zeros((1, rows, 7))})
        result = (other if engine == "dart" else mine).rollout(ask)
        total = energy(mine.model, result.position[0], result.velocity[0])
        swung = np.ptp(energy(mine.model, result.position[0], 0.0 * result.velocity[0]))
        wrong.append(np.abs(total - total[0]).max() / swung)
    assert wrong[-1] < (1e-2 if order == 1 else 1e-8)
    rates = np.log2(np.array(wrong[:-1]) / np.array(wrong[1:]))
    assert rates == pytest.approx(order, abs=0.25 * order)


@pytest.mark.parametrize("controller", KINDS, ids=lambda spec: spec.kind)
@pytest.mark.parametrize("limit", [None, 3.0])
def test_controllers_do_what_mujocos_do(tmp_path, controller, limit):
    mine = two_links(tmp_path, controller, torque_limit=limit)
    other = twin(mine)
    ask = request(smooth_command(mine, 500, scale=2.0 if limit else 0.4))
    first, second = mine.rollout(ask), other.rollout(ask)
    assert (limit is not None and controller.kind != "torque") == (
        np.abs(first.torque).max() == pytest.approx(limit or 0)
    )
    if (
        limit and controller.kind == "pd"
    ):  # where a limit holds, MuJoCo takes derivatives of the pair that are not there
        q, v = second.position[0, :-1], second.velocity[0, :-1]
        kp = [controller.gain("kp", joint) for joint in mine.joints]
        torque = kp * (ask.command["position"][0] - q) + 2.0 * (ask.command["velocity"][0] - v)
        np.testing.assert_allclose(second.torque[0, :-1], np.clip(torque, -limit, limit), atol=1e-9)
        np.testing.assert_allclose(second.position, first.position, atol=0.05)
        return
    np.testing.assert_allclose(second.position, first.position, atol=1e-9)
    np.testing.assert_allclose(second.torque, first.torque, atol=1e-7)


def test_a_limit_of_the_integral_holds_as_in_mujoco(tmp_path):
    mine = two_links(tmp_path, ControllerSpec(kind="pid", kp=5.0, kv=2.0, ki=60.0, integral_limit=1.5))
    ask = request({"position": np.full((1, 800, 2), 0.8)})
    np.testing.assert_allclose(twin(mine).rollout(ask).torque, mine.rollout(ask).torque, atol=1e-9)


@pytest.mark.parametrize("name", ["panda", "panda_rough"])
def test_the_shipped_twins_follow_steps_of_100_hz_as_in_mujoco(name):
    """Commands that jump at 100 Hz, some so far that the wrist's torques saturate."""
    robot = load_robot(name)
    mine, other = (engine.from_robot(robot, find_model(robot)) for engine in (MujocoSimulator, DartSimulator))
    time_s = np.floor(np.arange(1500) * mine.timestep_s / 0.01 + 1e-9)[:, None] * 0.01
    command = HOME + 0.4 * (1 - np.cos(np.array([2, 1.5, 2.5, 1.8, 4, 5, 5]) * time_s))
    ask = RolloutRequest(HOME[None], np.zeros((1, 7)), {"position": command[None]})
    first, second = mine.rollout(ask), other.rollout(ask)
    assert np.ptp(first.position[0], axis=0).min() > 0.4
    assert (np.abs(first.torque[0, :, 4:]).max(axis=0) == 12.0).any()
    np.testing.assert_allclose(second.position, first.position, atol=1e-9)
    np.testing.assert_allclose(second.torque, first.torque, atol=1e-6)


def test_the_models_own_actuators_with_gears_and_ranges():
    spec = mujoco.MjSpec.from_string("""
    <mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody><body>
      <joint name="a" axis="0 1 0" armature="0.02"/><inertial pos="0 0 -0.4" mass="1" diaginertia="0.02 0.02 0.01"/>
      <body pos="0 0 -0.5"><joint name="b" axis="0 1 0" damping="0.1"/>
        <inertial pos="0 0 -0.3" mass="0.5" diaginertia="0.01 0.01 0.01"/></body>
    </body></worldbody><actuator>
      <position name="a" joint="a" gear="-3" kp="4" kv="0.3" ctrlrange="-1 1" forcerange="-2 2"/>
      <general name="b" joint="b" gear="2" gainprm="1.5" biastype="affine" biasprm="0.1 -1 -0.2"/>
    </actuator></mujoco>""")
    robot = RobotSpec(name="geared", joints=(JointSpec("a"), JointSpec("b")), model="geared.xml")
    mine = MujocoSimulator.from_spec(spec, robot, origin=Path("geared.xml"))
    command = np.stack([1.5 * np.sin(np.arange(600) * 0.01), 0.4 * np.cos(np.arange(600) * 0.02)], axis=-1)
    ask = RolloutRequest(np.zeros((1, 2)), np.zeros((1, 2)), {"position": command[None]})
    first, second = mine.rollout(ask), twin(mine).rollout(ask)
    np.testing.assert_allclose(second.torque, first.torque, atol=1e-9)
    assert np.abs(first.torque[..., 0]).max() == pytest.approx(6.0)
    assert mine.torque_limits == twin(mine).torque_limits == {"a": 6.0}


@pytest.mark.parametrize("controller", KINDS, ids=lambda spec: spec.kind)
def test_stepping_and_rolling_out_are_the_same_motion(tmp_path, controller):
    simulator = twin(two_links(tmp_path, controller))
    assert isinstance(simulator, Simulator)
    command = smooth_command(simulator, 100)
    command = {name: np.concatenate([values, -values]) for name, values in command.items()}
    position, velocity = np.array([[0.2, -0.1], [0.0, 0.4]]), np.zeros((2, 2))
    result = simulator.rollout(RolloutRequest(position, velocity, command))
    simulator.reset(position, velocity)
    for row in range(100):
        state = simulator.step({name: values[:, row] for name, values in command.items()})
        if row == 50:  # a rollout in between leaves the stepped copies alone
            again = simulator.rollout(RolloutRequest(position, velocity, command))
            np.testing.assert_array_equal(again.position, result.position)
        np.testing.assert_array_equal(state["torque"], result.torque[:, row])
        np.testing.assert_array_equal(state["position"], result.position[:, row + 1])
        np.testing.assert_array_equal(state["velocity"], result.velocity[:, row + 1])


def test_a_resting_robot_does_not_fall_asleep():
    """DART stops bodies that have been slow for half a second; a push of 1e-5 Nm must still move them."""
    robot = RobotSpec(name="x", joints=(JointSpec("a"),), model="x.xml", controller=ControllerSpec(kind="torque"))
    spec = mujoco.MjSpec.from_string(
        '<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body><joint name="a" axis="0 1 0"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody></mujoco>'
    )
    simulator = DartSimulator.from_spec(spec, robot, origin=Path("x.xml"))
    result = simulator.rollout(
        RolloutRequest(np.zeros((1, 1)), np.zeros((1, 1)), {"torque": np.full((1, 2000, 1), 1e-5)})
    )
    assert result.position[0, -1, 0] == pytest.approx(0.5 * 1e-4 * 2.0**2, rel=1e-3)


def test_a_pickled_simulator_is_the_same_simulator(tmp_path):
    simulator = twin(two_links(tmp_path, KINDS[1]))
    ask = request(smooth_command(simulator, 50))
    for copy in (pickle.loads(pickle.dumps(simulator)), simulator.clone()):
        np.testing.assert_array_equal(copy.rollout(ask).position, simulator.rollout(ask).position)
        assert copy.fingerprint == simulator.fingerprint


def test_errors_are_those_of_every_simulator(tmp_path):
    simulator = twin(two_links(tmp_path, ControllerSpec(kind="torque")))
    with pytest.raises(MissingSignal, match=r"'torque'.*available: position"):
        simulator.rollout(request({"position": np.zeros((1, 5, 2))}))
    with pytest.raises(DataError, match="reset"):
        simulator.step({"torque": np.zeros((1, 2))})
    wild = DartSimulator.from_robot(
        replace(simulator.robot, controller=ControllerSpec(kind="position", kp=1e9)), tmp_path / "pendulum.xml"
    )
    with pytest.raises(DataError, match=r"diverged.*s after its start"):
        wild.rollout(request({"position": np.ones((1, 500, 2))}))


# ---- friction


@pytest.mark.parametrize("name", [*LAWS, "full"])
def test_friction_laws_move_the_arm_as_in_mujoco(name):
    """MuJoCo's rows are hard but not rigid, so that some of it is equal to rounding and all of it nearly so."""
    simulator, ask = arm(FULL if name == "full" else LAWS[name]), swing(3)
    other = twin(simulator)
    frictionless = MujocoSimulator(simulator.model, simulator.robot, simulator.channels)
    first, second = simulator.rollout(ask), other.rollout(ask)
    apart = np.abs(first.position - second.position).max()
    frictionless.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)
    effect = np.abs(first.position - frictionless.rollout(ask).position).max()
    assert apart < 1e-3
    assert apart < 0.02 * effect


def one_joint(friction=None, *, frictionloss=0.0, armature=0.05, damping=0.1, static=False):
    spec = mujoco.MjSpec.from_string(
        '<mujoco><option timestep="0.001" gravity="0 0 0" integrator="implicitfast"/><worldbody><body>'
        f'<joint name="a" axis="0 1 0" armature="{armature}" frictionloss="{frictionloss}" damping="{damping}"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody></mujoco>'
    )
    robot = RobotSpec(
        name="x",
        joints=(JointSpec("a"),),
        model="x.xml",
        controller=ControllerSpec(kind="torque"),
        friction={"a": friction} if friction else {},
    )
    return DartSimulator.from_spec(spec, robot, origin=Path("x.xml"))


def test_a_geared_joint_slides_to_a_stop_and_sticks():
    simulator = one_joint(frictionloss=0.4)
    torque = np.concatenate([np.zeros((1, 2000, 1)), np.full((1, 2000, 1), 0.399)])
    result = simulator.rollout(RolloutRequest(np.zeros((2, 1)), np.array([[3.0], [0.0]]), {"torque": torque}))
    expected = [3.0]
    for _ in range(2000):  # (I + armature) dv = -(friction + damping * v) dt, damping taken implicitly
        speed = expected[-1]
        expected.append(max(0.0, speed - 0.001 * (0.4 + 0.1 * speed) / (0.15 + 0.001 * 0.1)))
    np.testing.assert_allclose(result.velocity[0, :, 0], expected, atol=1e-9)
    assert np.abs(result.position[1]).max() < 1e-12


def test_static_threshold_and_stribeck_set_when_a_joint_starts():
    def moved(law, torque):
        simulator = one_joint(law, damping=0.0)
        command = {"torque": np.full((1, 300, 1), torque)}
        return simulator.rollout(RolloutRequest(np.zeros((1, 1)), np.zeros((1, 1)), command)).position[0, -1, 0]

    threshold = JointFriction(static_positive=0.5, static_negative=0.3)
    assert moved(threshold, 0.49) == 0.0 < 0.01 < moved(threshold, 0.51)
    assert moved(threshold, -0.29) == 0.0 > -0.01 > moved(threshold, -0.31)
    stribeck = JointFriction(stribeck=0.5, stribeck_velocity=0.05)
    assert abs(moved(stribeck, 0.499)) < 1e-12
    assert moved(stribeck, 0.52) > 0.01


def test_friction_never_adds_energy():
    def rub(joint):
        joint.frictionloss = 2.0

    mine, other = panda(edit=rub, step_s=0.0005)
    ask = RolloutRequest(HOME[None], PUSH[None], {"torque": np.zeros((1, 1000, 7))})
    result = other.rollout(ask)
    total = energy(mine.model, result.position[0], result.velocity[0])
    assert total[-1] < total[0] - 1.0
    assert np.diff(total).max() < 1e-4 * (total[0] - total[-1])


def test_a_limit_stops_a_joint():
    spec = mujoco.MjSpec.from_string(
        '<mujoco><compiler angle="radian"/><option timestep="0.001"/><worldbody><body>'
        '<joint name="a" axis="0 1 0" range="-0.5 0.5"/><inertial pos="0 0 -0.5" mass="1" diaginertia="0.1 0.1 0.1"/>'
        "</body></worldbody></mujoco>"
    )
    robot = RobotSpec(name="x", joints=(JointSpec("a"),), model="x.xml", controller=ControllerSpec(kind="torque"))
    simulator = DartSimulator.from_spec(spec, robot, origin=Path("x.xml"))
    ask = RolloutRequest(np.array([[0.3]]), np.array([[3.0]]), {"torque": np.zeros((1, 1500, 1))})
    position = simulator.rollout(ask).position
    assert position.max() == pytest.approx(0.5, abs=1e-6)
    assert position.min() > -0.5 - 1e-6
