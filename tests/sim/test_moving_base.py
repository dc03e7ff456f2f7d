"""A base that moves: simulations feel its sensor as the robot feels the base, in both engines, in replays and fits."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.protocols import RolloutRequest
from trueup.core.timeseries import TimeSeries, same_units
from trueup.errors import ConfigError, DataError, MissingSignal
from trueup.robots import Setup, SimulationSpec, find_model, load_robot
from trueup.sim import DartSimulator, MujocoSimulator, ReplaySettings, make_simulator, replay_episode
from trueup.sim.moving_base import SPECIFIC_FORCE, gravity_at

ROBOT = load_robot("upper_body")
ROBOT = replace(ROBOT, simulation=replace(ROBOT.simulation, base_sensor="torso"))
PATH = find_model(ROBOT)
STANDING = np.array([0.0, 0.0, -9.81])
POSE = np.array([-0.9, 0.4, 0.2, -0.8, 0.3, -0.5, -0.2, -0.3, -1.1, -0.2])
STEPS = 300


def request(gravity, count=1):
    start = np.tile(POSE, (count, 1))
    return RolloutRequest(start, np.zeros((count, 10)), {"position": np.repeat(start[:, None], STEPS, axis=1)}, gravity)


def shaking(count=1):
    """Gravity on bases that go to and fro and tilt, (B, N, 3)."""
    t = 0.002 * np.arange(STEPS)
    phase = np.arange(count)[:, None]
    return np.stack([2.0 * np.sin(12 * t + phase), 1.5 * np.cos(9 * t - phase), -9.0 + np.sin(20 * t + phase)], axis=-1)


def turned(angle):
    """A rotation about x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


@pytest.mark.parametrize("engine", ["mujoco", "dart"])
def test_a_base_at_rest_is_the_model_itself(engine):
    if engine == "dart":
        pytest.importorskip("dartpy")
    simulator = make_simulator(engine, ROBOT, PATH, setup=Setup(2.0))
    still, said = (simulator.rollout(request(own)) for own in (None, np.tile(STANDING, (1, STEPS, 1))))
    np.testing.assert_array_equal(said.position, still.position)


@pytest.mark.parametrize("engine", ["mujoco", "dart"])
def test_a_tilted_base_is_a_model_whose_gravity_is_tilted(engine):
    if engine == "dart":
        pytest.importorskip("dartpy")
    pull = turned(0.3) @ STANDING
    simulator = make_simulator(engine, ROBOT, PATH, setup=Setup(2.0))
    found = simulator.rollout(request(np.tile(pull, (1, STEPS, 1))))
    simulator = make_simulator(engine, ROBOT, PATH, setup=Setup(2.0))
    simulator.model.opt.gravity[:] = pull
    expected = simulator.rollout(request(None))
    np.testing.assert_allclose(found.position, expected.position, atol=1e-9)
    straight = make_simulator(engine, ROBOT, PATH, setup=Setup(2.0)).rollout(request(None))
    assert np.abs(expected.position - straight.position).max() > 0.02


def test_both_engines_feel_the_same():
    pytest.importorskip("dartpy")
    ends = []
    for engine in (MujocoSimulator, DartSimulator):
        spec = mujoco.MjSpec.from_file(str(PATH))
        for joint in spec.joints:
            joint.frictionloss = 0.0
        simulator = engine.from_spec(spec, ROBOT, origin=PATH)
        ends.append([simulator.rollout(request(pull, 2)).position for pull in (shaking(2), None)])
    (shaken, still), (dart, _) = ends
    np.testing.assert_allclose(dart, shaken, atol=1e-6)
    assert np.abs(shaken - still).max() > 0.01


def test_arms_move_as_on_a_base_that_really_accelerates():
    spec = mujoco.MjSpec.from_file(str(PATH))
    for axis in np.eye(3):
        spec.body("torso").add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    for joint in spec.joints:
        joint.damping[0], joint.frictionloss = 0.0, 0.0
    carried = spec.compile()
    data = mujoco.MjData(carried)
    simulator = MujocoSimulator.from_robot(ROBOT, PATH)
    simulator.model.dof_damping[:] = simulator.model.dof_frictionloss[:] = 0.0
    simulator.model.actuator_gainprm[:] = simulator.model.actuator_biasprm[:] = 0.0
    a = np.array([1.5, -2.0, 3.0])
    moved = simulator.rollout(request(np.tile(STANDING - a, (1, STEPS, 1))))
    # Inverse dynamics on the base that really accelerates: no joint needs a torque.
    for row in (10, 20, 40):
        q, v = moved.position[0, row], moved.velocity[0, row]
        acceleration = (moved.velocity[0, row + 1] - v) / 0.002
        data.qpos[:], data.qvel[:] = np.concatenate([np.zeros(3), q]), np.concatenate([np.zeros(3), v])
        data.qacc[:] = np.concatenate([a, acceleration])
        mujoco.mj_inverse(carried, data)
        weight = np.abs(data.qfrc_bias[3:]).max()
        assert np.abs(data.qfrc_inverse[3:]).max() < 0.01 * weight


def test_candidates_of_a_fit_have_their_own_weights():
    simulator = MujocoSimulator.from_robot(ROBOT, PATH)
    models = [MujocoSimulator.from_robot(ROBOT, PATH).model for _ in range(2)]
    models[1].body_mass[:] *= 1.3
    models[1].body_inertia[:] *= 1.3
    together = simulator.rollout_candidates(request(shaking(2), 2), models).position
    for row, model in enumerate(models):
        alone = MujocoSimulator(model, ROBOT, simulator.channels)
        one = RolloutRequest(POSE[None], np.zeros((1, 10)), request(None).command, shaking(2)[row : row + 1])
        np.testing.assert_array_equal(together[row], alone.rollout(one).position[0])
    assert np.abs(together[0] - together[1]).max() > 1e-3


def test_many_motions_do_not_need_their_memory_at_once(monkeypatch):
    whole = MujocoSimulator.from_robot(ROBOT, PATH).rollout(request(shaking(5), 5)).position
    monkeypatch.setattr("trueup.sim.mujoco_engine._FORCES_AT_ONCE", 1)
    parts = MujocoSimulator.from_robot(ROBOT, PATH, threads=2).rollout(request(shaking(5), 5)).position
    np.testing.assert_array_equal(parts, whole)


def test_axes_are_those_of_the_base():
    spec = mujoco.MjSpec.from_file(str(PATH))
    pull = turned(0.3) @ STANDING
    expected = MujocoSimulator.from_spec(spec, ROBOT, origin=PATH).rollout(request(np.tile(pull, (1, STEPS, 1))))
    spec = mujoco.MjSpec.from_file(str(PATH))
    frame = spec.worldbody.add_body(name="sensor", quat=[np.cos(0.35), 0, np.sin(0.35), 0])
    axes = np.array([[np.cos(0.7), 0, np.sin(0.7)], [0, 1, 0], [-np.sin(0.7), 0, np.cos(0.7)]])
    robot = replace(ROBOT, simulation=replace(ROBOT.simulation, base_sensor=frame.name))
    simulator = MujocoSimulator.from_spec(spec, robot, origin=PATH)
    found = simulator.rollout(request(np.tile(axes.T @ pull, (1, STEPS, 1))))
    np.testing.assert_allclose(found.position, expected.position, atol=1e-12)


def log(felt, body="torso"):
    """A second at rest in a pose, and what the base's sensor said."""
    clock = 0.01 * np.arange(101)
    still = np.repeat(POSE[None], 101, axis=0)
    names = ROBOT.joint_names
    signals = {"position": still, **({} if felt is None else {SPECIFIC_FORCE: felt[:, None]})}
    units = same_units({"position": "rad"}, names) | ({} if felt is None else {SPECIFIC_FORCE: ("m/s^2",)})
    bodies = () if felt is None else (body,)
    command = TimeSeries(clock, names, {"position": still}, same_units({"position": "rad"}, names))
    return Episode(EpisodeMeta("log"), TimeSeries(clock, names, signals, units, bodies), command)


def test_a_replay_reads_the_sensor_between_its_samples():
    clock = 0.01 * np.arange(101)
    felt = -(STANDING + np.stack([2 * np.sin(7 * clock), 0 * clock, np.cos(9 * clock)], axis=1))
    simulator = MujocoSimulator.from_robot(ROBOT, PATH)
    found = replay_episode(log(felt), simulator, ReplaySettings.of(ROBOT))
    middle = np.clip(0.002 * (np.arange(1000) - 500 + 0.5), 0.001, None)
    pull = -np.stack([np.interp(middle, clock, column) for column in felt.T], axis=1)
    by_hand = simulator.rollout(
        RolloutRequest(POSE[None], np.zeros((1, 10)), {"position": np.tile(POSE, (1, 1000, 1))}, pull[None])
    )
    np.testing.assert_allclose(found["position"], by_hand.position[0, 500::5], atol=1e-12)
    still = replay_episode(log(felt), simulator, replace(ReplaySettings.of(ROBOT), base_sensor=""))
    assert np.abs(found["position"] - still["position"]).max() > 1e-3


def test_what_does_not_fit_is_said():
    with pytest.raises(MissingSignal, match="how its base moved") as caught:
        replay_episode(log(None), MujocoSimulator.from_robot(ROBOT, PATH), ReplaySettings.of(ROBOT))
    assert "base_sensor" in caught.value.hint
    with pytest.raises(MissingSignal, match="'torso'"):
        gravity_at(log(np.tile(-STANDING, (101, 1)), body="pelvis"), "torso", np.zeros(1))
    broken = np.tile(-STANDING, (101, 1))
    broken[40, 1] = np.nan
    with pytest.raises(DataError, match="not finite") as caught:
        gravity_at(log(broken), "torso", np.zeros(1))
    assert "0.400 s" in str(caught.value)
    for body, why in (("left_hand", "moves with"), ("head", "no body")):
        other = replace(ROBOT, simulation=replace(ROBOT.simulation, base_sensor=body))
        with pytest.raises(ConfigError, match=why):
            MujocoSimulator.from_robot(other, PATH)
    with pytest.raises(ConfigError, match="base at rest"):
        SimulationSpec(base_sensor="torso", load=True)


def test_runs_on_a_base_at_rest_are_those_from_before():
    plain = load_robot("upper_body")
    assert "base_sensor" not in plain.to_dict()["simulation"]
    assert "base_sensor" not in ReplaySettings.of(plain).to_dict()
    assert ReplaySettings.of(ROBOT).to_dict()["base_sensor"] == ROBOT.to_dict()["simulation"]["base_sensor"] == "torso"
