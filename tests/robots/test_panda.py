from dataclasses import replace

import mujoco
import numpy as np
import pytest

from conftest import shared_folder
from trueup.core.protocols import RolloutRequest
from trueup.robots import find_model, load_robot
from trueup.robots.model import load_spec
from trueup.sim import MujocoSimulator, ReplaySettings

GRAVITY = 9.81
HOME = np.array([0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4])

# Franka's documentation: a [m], d [m], alpha [rad] of joints 1 to 7 and the flange, modified Denavit-Hartenberg.
DH = np.array(
    [
        [0.0, 0.333, 0.0],
        [0.0, 0.0, -np.pi / 2],
        [0.0, 0.316, np.pi / 2],
        [0.0825, 0.0, np.pi / 2],
        [-0.0825, 0.384, -np.pi / 2],
        [0.0, 0.0, np.pi / 2],
        [0.088, 0.0, np.pi / 2],
        [0.0, 0.107, 0.0],
    ]
)

# Gaz et al. 2019, supplementary tables: mass, center of mass x y z, then xx xy xz yy yz zz (not MuJoCo's order) about
# the center of mass.
LINKS = np.array(
    [
        [4.970684, 3.875e-3, 2.081e-3, -4.762e-2, 0.70337, -1.39e-4, 6.772e-3, 0.70661, 1.9169e-2, 9.117e-3],
        [0.646926, -3.141e-3, -2.872e-2, 3.495e-3, 7.962e-3, -3.925e-3, 1.0254e-2, 2.811e-2, 7.04e-4, 2.5995e-2],
        [3.228604, 2.7518e-2, 3.9252e-2, -6.6502e-2, 3.7242e-2, -4.761e-3, -1.1396e-2, 3.6155e-2, -1.2805e-2, 1.083e-2],
        [3.587895, -5.317e-2, 1.04419e-1, 2.7454e-2, 2.5853e-2, 7.796e-3, -1.332e-3, 1.9552e-2, 8.641e-3, 2.8323e-2],
        [1.225946, -1.1953e-2, 4.1065e-2, -3.8437e-2, 3.5549e-2, -2.117e-3, -4.037e-3, 2.9474e-2, 2.29e-4, 8.627e-3],
        [1.666555, 6.0149e-2, -1.4117e-2, -1.0517e-2, 1.964e-3, 1.09e-4, -1.158e-3, 4.354e-3, 3.41e-4, 5.433e-3],
        [0.735522, 1.0517e-2, -4.252e-3, 6.1597e-2, 1.2516e-2, -4.28e-4, -1.196e-3, 1.0027e-2, -7.41e-4, 4.815e-3],
    ]
)


def panda_spec():
    return mujoco.MjSpec.from_file(str(find_model(load_robot("panda"))))


@pytest.fixture(scope="module")
def panda():
    return panda_spec().compile()


@pytest.fixture
def reference():
    shared = shared_folder()
    path = shared and shared / "data" / "models" / "panda_nohand.xml"
    if not path or not path.is_file():
        pytest.skip("reference panda_nohand.xml not found: set TRUEUP_SHARED, or put `shared` beside the project")
    return mujoco.MjModel.from_xml_path(str(path))


def poses(model, count, seed=7):
    return np.random.default_rng(seed).uniform(*model.jnt_range.T, (count, 7))


def at(model, position, velocity=0.0):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = position, velocity
    mujoco.mj_forward(model, data)
    return data


def rigid_body_mass_matrix(model, data):
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full - np.diag(model.dof_armature)


def frames_by_hand(position):
    """Poses of frames 1 to 7 and the flange in the world, from the table alone."""
    frames, world = [], np.eye(4)
    for (a, d, alpha), theta in zip(DH, [*position, 0.0], strict=True):
        ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
        world = world @ [
            [ct, -st, 0, a],
            [st * ca, ct * ca, -sa, -d * sa],
            [st * sa, ct * sa, ca, d * ca],
            [0, 0, 0, 1],
        ]
        frames.append(world)
    return frames


def dynamics_by_hand(position):
    """Mass matrix and gravity torque from both tables: sum over links of J' diag(m, I) J and of -J' m g."""
    frames = frames_by_hand(position)
    mass_matrix, gravity = np.zeros((7, 7)), np.zeros(7)
    axes, origins = (np.array([frame[:3, column] for frame in frames[:7]]) for column in (2, 3))
    for link, (mass, x, y, z, xx, xy, xz, yy, yz, zz) in enumerate(LINKS):
        rotation = frames[link][:3, :3]
        inertia = rotation @ [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] @ rotation.T
        center = frames[link][:3, 3] + rotation @ [x, y, z]
        turning = np.where(np.arange(7)[:, None] <= link, axes, 0.0)
        moving = np.cross(turning, center - origins)
        mass_matrix += mass * moving @ moving.T + turning @ inertia @ turning.T
        gravity += mass * GRAVITY * moving[:, 2]
    return mass_matrix, gravity


def test_the_flange_is_where_the_denavit_hartenberg_table_puts_it(panda):
    for position in [np.zeros(7), HOME, *poses(panda, 20)]:
        data, expected = at(panda, position), frames_by_hand(position)[-1]
        for site in ("payload", "end_effector"):
            np.testing.assert_allclose(data.site(site).xpos, expected[:3, 3], atol=1e-12)
            np.testing.assert_allclose(data.site(site).xmat.reshape(3, 3), expected[:3, :3], atol=1e-12)
    assert frames_by_hand(np.zeros(7))[-1][:3, 3] == pytest.approx([0.088, 0.0, 0.333 + 0.316 + 0.384 - 0.107])


def test_mass_matrix_and_gravity_follow_from_the_published_tables(panda):
    for position in poses(panda, 20):
        data = at(panda, position)
        mass_matrix, gravity = dynamics_by_hand(position)
        np.testing.assert_allclose(rigid_body_mass_matrix(panda, data), mass_matrix, atol=1e-10)
        np.testing.assert_allclose(data.qfrc_bias, gravity, atol=1e-10)


def test_mass_matrix_and_gravity_are_those_of_the_reference(panda, reference):
    for position in poses(panda, 100):
        ours, theirs = at(panda, position), at(reference, position)
        own, expected = rigid_body_mass_matrix(panda, ours), rigid_body_mass_matrix(reference, theirs)
        for mine, other in ((own, expected), (ours.qfrc_bias, theirs.qfrc_bias)):
            # 2 % would do; two models of one table differ by the six digits of the reference only
            assert np.linalg.norm(mine - other) < 1e-5 * np.linalg.norm(other)
        np.testing.assert_allclose(own, expected, atol=1e-5)  # kg m^2
        np.testing.assert_allclose(ours.qfrc_bias, theirs.qfrc_bias, atol=1e-4)  # Nm


@pytest.mark.parametrize("link", range(8))
def test_every_link_is_a_body_that_can_exist(panda, link):
    body = panda.body(f"link{link}")
    moments = np.sort(body.inertia)
    assert body.mass[0] > 0
    assert moments[0] > 0
    # second moments of the mass along the principal axes
    assert (moments.sum() / 2 - moments > 0).all()


def test_a_frictionless_swing_keeps_its_energy():
    spec = panda_spec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    for joint in spec.joints:
        joint.damping[:] = 0.0
    model = spec.compile()
    data = at(model, HOME, velocity=[0.5, -0.3, 0.4, 0.2, -0.6, 0.3, 0.8])
    energy, kinetic = [], []
    for _ in range(2000):
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)  # the energy that a Runge-Kutta step leaves is the one of its last stage
        energy.append(data.energy.sum())
        kinetic.append(data.energy[1])
    assert max(kinetic) > 20.0  # J: it does swing
    assert np.ptp(energy) < 1e-8 * max(kinetic)


def test_nothing_touches_at_home_and_a_folded_arm_touches_its_base(panda):
    home = at(panda, HOME)
    np.testing.assert_allclose(panda.key("home").qpos, HOME, atol=1e-12)
    assert home.ncon == 0
    folded = at(panda, [0, 1.7, 0, -2.9, 0, 2.0, 0])
    touching = {frozenset(panda.geom_bodyid[contact.geom]) for contact in folded.contact}
    assert any({panda.body("link0").id, panda.body("link6").id} == pair for pair in touching)


def test_few_random_poses_collide_and_neighbors_never(panda):
    pairs, colliding = set(), 0
    data = mujoco.MjData(panda)
    for position in poses(panda, 2000):
        data.qpos[:] = position
        mujoco.mj_kinematics(panda, data)
        mujoco.mj_collision(panda, data)
        found = {tuple(sorted(panda.geom_bodyid[contact.geom])) for contact in data.contact}
        pairs |= found
        colliding += bool(found)
    assert 0 < colliding < 0.05 * 2000
    assert min(high - low for low, high in pairs) >= 3


def simulate(robot, torque):
    """Position after 0.2 s of constant torque from standstill at home."""
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    command = {"torque": np.tile(torque, (1, 200, 1))}
    return simulator.rollout(RolloutRequest(HOME[None], np.zeros((1, 7)), command)).position[0, -1]


@pytest.mark.parametrize(
    ("name", "signal", "step_s"), [("panda", "position", 0.0008), ("panda_torque", "torque", 0.001)]
)
def test_the_robot_loads_by_its_name(name, signal, step_s):
    robot = load_robot(name)
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    assert simulator.joints == tuple(f"joint{number}" for number in range(1, 8))
    assert simulator.command_signals == (signal,)
    assert simulator.timestep_s == step_s
    assert tuple(simulator.torque_limits.values()) == (87.0,) * 4 + (12.0,) * 3


def test_position_and_torque_driven_pandas_are_one_arm():
    by_position, by_torque = load_robot("panda"), load_robot("panda_torque")
    assert (by_position.joints, by_position.model) == (by_torque.joints, by_torque.model)
    assert ReplaySettings.of(by_position).window_s is None
    assert ReplaySettings.of(by_torque).window_s == 0.5


def test_the_twin_carries_its_weight_by_standing_off_its_command():
    robot = load_robot("panda")
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    command = {"position": np.tile(HOME, (1, 5000, 1))}
    rest = simulator.rollout(RolloutRequest(HOME[None], np.zeros((1, 7)), command))
    stiffness = np.array([robot.controller.gain("kp", joint) for joint in robot.joint_names])
    gravity = dynamics_by_hand(rest.position[0, -1])[1]
    assert np.abs(gravity).max() > 15.0
    np.testing.assert_allclose(rest.torque[0, -1], gravity, atol=1e-3)
    np.testing.assert_allclose(HOME - rest.position[0, -1], gravity / stiffness, atol=1e-6)


def test_the_twin_falls_behind_a_steady_command_by_its_damping():
    """At constant speed v the PID lags by kv v / kp, and by what the joint's own damping and the weight take."""
    robot = load_robot("panda")
    model = load_spec(find_model(robot))
    model.option.gravity = np.zeros(3)
    simulator = MujocoSimulator.from_spec(model, robot, origin=find_model(robot))
    speed, steps = 0.3, 2000
    command = np.tile(HOME, (1, steps, 1))
    command[0, :, 6] += speed * np.arange(steps) * simulator.timestep_s
    ask = RolloutRequest(HOME[None], np.zeros((1, 7)), {"position": command})
    result = simulator.rollout(ask)
    stiffness, damping = (robot.controller.gain(gain, "joint7") for gain in ("kp", "kv"))
    own = simulator.model.dof_damping[6]
    lag = command[0, -1, 6] - result.position[0, steps - 1, 6]
    assert lag == pytest.approx((damping + own) * speed / stiffness, rel=0.02)


def test_the_torque_driven_robot_carries_its_weight_unless_told_otherwise():
    robot = load_robot("panda_torque")
    heavy = replace(robot, simulation=replace(robot.simulation, gravity_compensation=False))
    np.testing.assert_allclose(simulate(robot, np.zeros(7)), HOME, atol=1e-9)
    np.testing.assert_allclose(simulate(heavy, dynamics_by_hand(HOME)[1]), HOME, atol=1e-9)
    assert np.abs(simulate(heavy, np.zeros(7)) - HOME).max() > 0.05


def test_torque_turns_the_joint_it_is_commanded_on():
    for joint in range(7):
        torque = np.where(np.arange(7) == joint, 1.0, 0.0)
        assert simulate(load_robot("panda_torque"), torque)[joint] > HOME[joint] + 0.001


def test_robot_file_and_model_agree_on_the_limits(panda):
    robot = load_robot("panda_torque")
    for joint in robot.joints:
        assert tuple(panda.joint(joint.name).range) == joint.position_limits
        assert tuple(panda.actuator(joint.name).forcerange) == (-joint.torque_limit, joint.torque_limit)
        assert tuple(panda.actuator(joint.name).ctrlrange) == (-joint.torque_limit, joint.torque_limit)
    assert panda.opt.timestep == robot.simulation.timestep_s
    assert not panda.dof_frictionloss.any()
    # Franka reaches its acceleration limit in 2 ms at the jerk limit.
    acceleration, jerk = panda.numeric("acceleration_limit").data, panda.numeric("jerk_limit").data
    np.testing.assert_allclose(jerk * 0.002, acceleration)
    np.testing.assert_allclose(panda.numeric("velocity_limit").data, [2.175] * 4 + [2.61] * 3)
    np.testing.assert_allclose(panda.numeric("torque_rate_limit").data, [1000.0] * 7)


def test_a_payload_hangs_at_the_flange():
    spec = panda_spec()
    # MuJoCo takes `pos` for an `ipos` that is not given.
    box = {"pos": [0.0, 0.0, 0.05], "ipos": [0.0, 0.0, 0.0], "mass": 3.0, "inertia": [0.01] * 3}
    spec.frame("flange").add_body(name="box", explicitinertial=True, **box)
    model = spec.compile()
    bare = panda_spec().compile()
    for position in poses(bare, 5):
        loaded, unloaded = at(model, position), at(bare, position)
        jacobian = np.zeros((3, 7))
        frame = frames_by_hand(position)[-1]
        mujoco.mj_jac(bare, unloaded, jacobian, None, frame[:3, 3] + 0.05 * frame[:3, 2], bare.body("link7").id)
        np.testing.assert_allclose(loaded.qfrc_bias - unloaded.qfrc_bias, 3.0 * GRAVITY * jacobian[2], atol=1e-9)
