from pathlib import Path

import mujoco
import numpy as np
import pytest

from sim.arms import PENDULUM, episode, series, two_links
from trueup.core.protocols import RolloutRequest
from trueup.errors import DataError, MissingSignal, NameMismatch
from trueup.robots import ControllerSpec, JointGains, JointSpec, RobotSpec, SimulationSpec
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode

KINDS = [
    ControllerSpec(kind="torque"),
    ControllerSpec(kind="position", kp=40.0, kv=2.0),
    ControllerSpec(kind="pd", kp=40.0, kv=2.0, per_joint={"b": JointGains(kp=15.0)}),
    ControllerSpec(kind="pid", kp=40.0, kv=2.0, ki=30.0),
    ControllerSpec(kind="velocity", kv=8.0),
    ControllerSpec(kind="velocity-integrator", kp=40.0, kv=2.0),
]


def smooth_command(simulator, steps, seed=0, scale=0.4):
    rng = np.random.default_rng(seed)
    time_s = np.arange(steps) * simulator.timestep_s
    waves = scale * np.sin(2 * np.pi * rng.uniform(0.5, 2.0, 2) * time_s[:, None] + rng.uniform(0, 6, 2))
    return dict.fromkeys(simulator.command_signals, waves[None])


def request(command, *, position=(0.2, -0.1), velocity=(0.0, 0.0)):
    return RolloutRequest(np.array([position]), np.array([velocity]), command)


def total_energy(position, velocity):
    """Kinetic and potential energy of the double pendulum, worked out by hand from Lagrange's equations."""
    a, b, da, db = position[:, 0], position[:, 1], velocity[:, 0], velocity[:, 1]
    length, c1, c2, m1, m2, i1, i2, g = 0.5, 0.5, 0.3, 1.0, 0.6, 0.02, 0.01, 9.81
    y1, y2 = -c1 * np.cos(a), -length * np.cos(a) - c2 * np.cos(a + b)
    v1 = (c1 * da) ** 2
    v2 = (length * da) ** 2 + (c2 * (da + db)) ** 2 + 2 * length * c2 * da * (da + db) * np.cos(b)
    return 0.5 * (m1 * v1 + m2 * v2 + i1 * da**2 + i2 * (da + db) ** 2) + g * (m1 * y1 + m2 * y2)


def test_a_free_pendulum_keeps_its_energy(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="torque"))
    result = simulator.rollout(request({"torque": np.zeros((1, 2000, 2))}, position=(1.2, 0.5)))
    energy = total_energy(result.position[0], result.velocity[0])
    assert np.ptp(result.position[0, :, 0]) > 1.0
    assert np.ptp(energy) < 1e-6 * np.ptp(total_energy(result.position[0], 0 * result.velocity[0]))


def test_the_work_of_the_motors_is_the_gain_in_energy(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="torque"))
    command = smooth_command(simulator, 1000)
    result = simulator.rollout(request(command))
    power = (result.torque[0] * result.velocity[0]).sum(axis=1)
    work = np.sum(0.5 * (power[1:] + power[:-1])) * simulator.timestep_s
    energy = total_energy(result.position[0], result.velocity[0])
    assert energy[-1] - energy[0] == pytest.approx(work, rel=2e-3)


@pytest.mark.parametrize("controller", KINDS, ids=lambda spec: spec.kind)
def test_stepping_and_rolling_out_are_the_same_motion(tmp_path, controller):
    simulator = two_links(tmp_path, controller)
    command = smooth_command(simulator, 200)
    result = simulator.rollout(request(command))
    simulator.reset(np.array([[0.2, -0.1]]), np.zeros((1, 2)))
    for row in range(200):
        state = simulator.step({name: values[:, row] for name, values in command.items()})
        np.testing.assert_allclose(state["torque"], result.torque[:, row], atol=1e-12)
        np.testing.assert_allclose(state["position"], result.position[:, row + 1], atol=1e-12)
        np.testing.assert_allclose(state["velocity"], result.velocity[:, row + 1], atol=1e-12)


@pytest.mark.parametrize("controller", KINDS, ids=lambda spec: spec.kind)
def test_the_torque_is_the_control_law(tmp_path, controller):
    simulator = two_links(tmp_path, controller, timestep_s=0.0005)
    simulator.model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER  # one evaluation a step, as in the sums below
    command = smooth_command(simulator, 400)
    result = simulator.rollout(request(command))
    q, v, torque = result.position[0, :-1], result.velocity[0, :-1], result.torque[0, :-1]
    dt = simulator.timestep_s
    kp = np.array([controller.gain("kp", joint) for joint in simulator.joints])
    signal = simulator.command_signals[0]
    u = command[signal][0]
    expected = {
        "torque": lambda: u,
        "position": lambda: kp * (u - q) - 2.0 * v,
        # GapONet eq. 10
        "pd": lambda: kp * (u - q) + 2.0 * (command["velocity"][0] - v),
        "velocity": lambda: 8.0 * (u - v),
        "velocity-integrator": lambda: kp * (q[0] + np.vstack([0 * u[:1], np.cumsum(u, axis=0)[:-1]]) * dt - q) - 2 * v,
        # The derivative acts on the measured velocity, the integral includes the present error.
        "pid": lambda: kp * (u - q) - 2.0 * v + 30.0 * np.cumsum(u - q, axis=0) * dt,
    }[controller.kind]()
    np.testing.assert_allclose(torque, expected, atol=1e-9)


def test_pd_without_a_velocity_command_damps_towards_standstill(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="pd", kp=40.0, kv=2.0))
    position = {"position": np.zeros((1, 300, 2))}
    zero = {**position, "velocity": np.zeros((1, 300, 2))}
    left, right = simulator.rollout(request(position)), simulator.rollout(request(zero))
    np.testing.assert_array_equal(left.position, right.position)


def test_a_torque_limit_holds(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="position", kp=400.0, kv=2.0), torque_limit=3.0)
    result = simulator.rollout(request({"position": np.ones((1, 300, 2))}))
    assert np.abs(result.torque).max() == pytest.approx(3.0)


def test_a_fingerprint_does_not_say_from_where_the_model_was_read(tmp_path, monkeypatch):
    (tmp_path / "meshes").mkdir()
    corners = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
    faces = ((1, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4))
    (tmp_path / "meshes" / "a.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(f"f {a} {b} {c}\n" for a, b, c in faces)
    )
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><compiler meshdir="meshes"/><asset><mesh name="a" file="a.obj"/></asset><worldbody><body>'
        '<joint name="a" axis="0 1 0"/><geom type="mesh" mesh="a"/></body></worldbody></mujoco>'
    )
    robot = RobotSpec("arm", (JointSpec("a"),), "arm.xml", controller=ControllerSpec("torque"))
    monkeypatch.chdir(tmp_path)
    here = MujocoSimulator.from_robot(robot, Path("arm.xml"))
    assert "meshes" in str(here.model.paths)
    assert here.fingerprint == MujocoSimulator.from_robot(robot, path).fingerprint
    monkeypatch.chdir(tmp_path.parent)
    assert here.fingerprint == MujocoSimulator.from_robot(robot, Path(tmp_path.name) / "arm.xml").fingerprint


def test_motions_of_a_batch_do_not_touch_each_other(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="position", kp=40.0, kv=2.0))
    rng = np.random.default_rng(3)
    position, velocity = rng.normal(size=(5, 2)), rng.normal(size=(5, 2))
    command = 0.3 * rng.normal(size=(5, 100, 2))
    together = simulator.rollout(RolloutRequest(position, velocity, {"position": command}))
    for row in range(5):
        one = slice(row, row + 1)
        alone = simulator.rollout(RolloutRequest(position[one], velocity[one], {"position": command[one]}))
        np.testing.assert_allclose(together.position[one], alone.position, atol=1e-9)


def test_threads_change_nothing(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="position", kp=40.0, kv=2.0))
    rng = np.random.default_rng(3)
    batch = RolloutRequest(rng.normal(size=(8, 2)), np.zeros((8, 2)), {"position": rng.normal(size=(8, 50, 2))})
    np.testing.assert_array_equal(simulator.rollout(batch).position, simulator.clone(threads=2).rollout(batch).position)


def test_a_diverging_simulation_is_an_error_and_the_next_one_works(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="position", kp=1e7, kv=0.0), timestep_s=0.01)
    command = {"position": np.ones((1, 500, 2))}
    with pytest.raises(DataError, match=r"diverged.*s after its start"):
        simulator.rollout(request(command))
    still = {"position": np.zeros((1, 1, 2))}
    assert np.isfinite(simulator.rollout(request(still, position=(0.0, 0.0))).position).all()


def test_a_missing_command_signal_is_named(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="torque"))
    with pytest.raises(MissingSignal, match=r"'torque'.*available: position"):
        simulator.rollout(request({"position": np.zeros((1, 5, 2))}))


def test_step_before_reset_says_so(tmp_path):
    with pytest.raises(DataError, match="reset"):
        two_links(tmp_path, ControllerSpec(kind="torque")).step({"torque": np.zeros((1, 2))})


def test_joints_that_the_model_lacks_are_listed_with_those_it_has(tmp_path):
    two_links(tmp_path, ControllerSpec(kind="torque"))
    robot = RobotSpec(name="other", joints=(JointSpec("a"), JointSpec("c")), model="pendulum.xml")
    with pytest.raises(NameMismatch, match=r"robot \[a, c\], model \[a, b\]"):
        MujocoSimulator.from_robot(robot, tmp_path / "pendulum.xml")


@pytest.mark.parametrize("controller", KINDS, ids=lambda spec: spec.kind)
def test_defaults_of_the_model_do_not_leak_into_the_controller(tmp_path, controller):
    """A <default> that gives motors gears, limits and gains is for the model's own actuators."""
    plain = two_links(tmp_path, controller)
    command = smooth_command(plain, 200)
    expected = plain.rollout(request(command))
    hostile = (
        '<mujoco><default><general gear="100" ctrlrange="-0.01 0.01" forcerange="-1 1" gainprm="7" biastype="affine"'
        ' biasprm="1 2 3" dyntype="filter" dynprm="0.1"/></default>'
    )
    (tmp_path / "hostile.xml").write_text(PENDULUM.replace("<mujoco>", hostile))
    result = MujocoSimulator.from_robot(plain.robot, tmp_path / "hostile.xml").rollout(request(command))
    np.testing.assert_allclose(result.position, expected.position, atol=1e-12)
    np.testing.assert_allclose(result.torque, expected.torque, atol=1e-12)


def test_a_limit_behind_a_gear_is_the_limit_of_the_joint(tmp_path):
    path = tmp_path / "geared.xml"
    motors = '<actuator><motor name="a" joint="a" gear="-50" forcerange="-2 2"/><motor name="b" joint="b"/></actuator>'
    path.write_text(PENDULUM.replace("</mujoco>", f"{motors}</mujoco>"))
    joints = (JointSpec("a"), JointSpec("b"))
    controller = ControllerSpec(kind="model", command="torque")
    robot = RobotSpec(name="geared", joints=joints, model=path.name, controller=controller)
    simulator = MujocoSimulator.from_robot(robot, path)
    assert simulator.torque_limits == {"a": 100.0}
    result = simulator.rollout(request({"torque": np.full((1, 20, 2), 9.0)}))
    assert np.abs(result.torque[0, :, 0]).max() == pytest.approx(100.0)


@pytest.mark.parametrize("bad", [0, 2])
def test_one_diverging_motion_of_a_batch_is_seen(tmp_path, bad):
    simulator = two_links(tmp_path, ControllerSpec(kind="position", kp=2000.0, kv=0.0), timestep_s=0.02)
    position = np.zeros((3, 2))
    command = np.zeros((3, 400, 2))
    command[bad] = 1.0
    with pytest.raises(DataError, match="diverged"):
        simulator.rollout(RolloutRequest(position, np.zeros((3, 2)), {"position": command}))


def test_a_diverging_candidate_loses_and_the_others_stand(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="position", kp=40.0, kv=2.0), timestep_s=0.01)
    wild = two_links(tmp_path, ControllerSpec(kind="position", kp=1e7, kv=0.0), timestep_s=0.01)
    command = smooth_command(simulator, 300)["position"]
    alone = simulator.rollout(request({"position": command}))
    three = RolloutRequest(
        np.tile([[0.2, -0.1]], (3, 1)), np.zeros((3, 2)), {"position": np.repeat(command, 3, axis=0)}
    )
    for threads in (1, 2):
        result = simulator.clone(threads=threads).rollout_candidates(
            three, [simulator.model, wild.model, simulator.model]
        )
        for values, expected in (
            (result.position, alone.position),
            (result.velocity, alone.velocity),
            (result.torque, alone.torque),
        ):
            assert np.isnan(values[1]).all()
            np.testing.assert_allclose(values[[0, 2]], np.repeat(expected, 2, axis=0), atol=1e-10)
    # The next rollout is not disturbed by what is left of the lost one.
    again = simulator.rollout_candidates(three, [simulator.model] * 3)
    np.testing.assert_allclose(again.position, np.repeat(alone.position, 3, axis=0), atol=1e-10)


def test_candidates_are_simulated_each_on_its_own_model(tmp_path):
    simulator = two_links(tmp_path, ControllerSpec(kind="position", kp=40.0, kv=2.0))
    models = []
    for damping in (0.0, 0.5, 3.0):
        models.append(two_links(tmp_path, simulator.robot.controller).model)
        models[-1].dof_damping[:] = damping
    command = {"position": np.repeat(smooth_command(simulator, 200)["position"], 3, axis=0)}
    result = simulator.rollout_candidates(
        RolloutRequest(np.tile([[0.2, -0.1]], (3, 1)), np.zeros((3, 2)), command), models
    )
    for row, model in enumerate(models):
        own = MujocoSimulator(model, simulator.robot, simulator.channels)
        one = request({"position": command["position"][:1]})
        np.testing.assert_allclose(result.position[row], own.rollout(one).position[0], atol=1e-12)
    assert np.abs(np.diff(result.position[:, -1], axis=0)).min() > 1e-4


@pytest.mark.parametrize("compensated", [True, False])
def test_a_robot_whose_weight_is_carried_needs_no_torque_to_stand(tmp_path, compensated):
    two_links(tmp_path, ControllerSpec(kind="torque"))
    robot = RobotSpec(
        name="pendulum",
        joints=(JointSpec("a"), JointSpec("b")),
        model="pendulum.xml",
        controller=ControllerSpec(kind="torque"),
        simulation=SimulationSpec(gravity_compensation=compensated),
    )
    simulator = MujocoSimulator.from_robot(robot, tmp_path / "pendulum.xml")
    result = simulator.rollout(request({"torque": np.zeros((1, 500, 2))}, position=(0.9, -0.4)))
    fallen = np.abs(result.position[0, -1] - [0.9, -0.4])
    if compensated:
        assert fallen.max() < 1e-12
    else:
        assert fallen.max() > 0.1


def test_a_position_servo_has_no_standing_error_where_the_weight_is_carried(tmp_path):
    two_links(tmp_path, ControllerSpec(kind="torque"))
    robot = RobotSpec(
        name="pendulum",
        joints=(JointSpec("a"), JointSpec("b")),
        model="pendulum.xml",
        controller=ControllerSpec(kind="position", kp=40.0, kv=4.0),
        simulation=SimulationSpec(gravity_compensation=True),
    )
    simulator = MujocoSimulator.from_robot(robot, tmp_path / "pendulum.xml")
    command = {"position": np.tile([0.9, -0.4], (1, 4000, 1))}
    result = simulator.rollout(request(command))
    np.testing.assert_allclose(result.position[0, -1], [0.9, -0.4], atol=1e-4)
    np.testing.assert_allclose(result.torque[0, -1], 0.0, atol=2e-3)


def test_delays_per_joint_act_on_their_joint_alone(tmp_path):
    """A joint delayed by 7 steps sees what an undelayed one is told, 7 steps later; the other joint sees it at once."""
    controller = ControllerSpec(
        kind="torque", delay_s=0.002, per_joint={"b": JointGains(delay_s=0.007), "a": JointGains(kp=3.0)}
    )
    simulator = two_links(tmp_path, controller)
    assert simulator.robot.delay_s == (0.002, 0.007)
    time_s = np.arange(200) * simulator.timestep_s
    torque = np.column_stack([np.sin(30 * time_s), np.cos(20 * time_s)])
    log = episode(series(time_s, position=np.zeros((200, 2))), series(time_s, torque=torque))
    settings = ReplaySettings.of(simulator.robot)
    result = replay_episode(log, simulator, settings)
    expected = np.column_stack(
        [np.r_[np.repeat(torque[0, 0], 2), torque[:-2, 0]], np.r_[np.repeat(torque[0, 1], 7), torque[:-7, 1]]]
    )
    np.testing.assert_allclose(result["torque"], expected, atol=1e-12)
