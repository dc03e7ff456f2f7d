"""What a robot carries weighs on its joints as a mass at its grip does, in both engines and in a replay."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.protocols import RolloutRequest
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError
from trueup.lab import VirtualRobot, draw_truth, load_lab
from trueup.robots import PayloadSpec, Setup, find_model, load_robot
from trueup.sim import MujocoSimulator, make_simulator
from trueup.stages import replay

ROBOT = load_robot("upper_body")
PATH = find_model(ROBOT)
POSE = np.array([-0.9, 0.4, 0.2, -0.8, 0.3, -0.5, -0.2, -0.3, -1.1, -0.2])


def weight_of(simulator, position):
    """Torques that hold the pose, without friction, (J,) [Nm]."""
    data = mujoco.MjData(simulator.model)
    data.qpos[:] = position
    mujoco.mj_forward(simulator.model, data)
    return data.qfrc_bias.copy()


@pytest.mark.parametrize("payload_kg", [0.5, 3.0])
def test_each_hand_holds_it(payload_kg):
    empty, loaded = (MujocoSimulator.from_robot(ROBOT, PATH, setup=Setup(mass)) for mass in (0.0, payload_kg))
    # By hand: the moment of the weight about each joint is the slope of its potential energy.
    model, data = empty.model, mujoco.MjData(empty.model)

    def energy(position):
        data.qpos[:] = position
        mujoco.mj_kinematics(model, data)
        total = 0.0
        for name in ROBOT.payload.sites:
            site = data.site(name)
            total += payload_kg * 9.81 * (site.xpos + ROBOT.payload.offset_m * site.xmat.reshape(3, 3)[:, 2])[2]
        return total

    slope = [(energy(POSE + step) - energy(POSE - step)) / 2e-6 for step in 1e-6 * np.eye(10)]
    np.testing.assert_allclose(weight_of(loaded, POSE) - weight_of(empty, POSE), slope, atol=1e-6)
    assert loaded.model.body_mass.sum() - empty.model.body_mass.sum() == pytest.approx(2 * payload_kg)


def test_both_engines_carry_it():
    pytest.importorskip("dartpy")
    command = {"position": np.tile(POSE, (1, 200, 1))}
    request = RolloutRequest(POSE[None], np.zeros((1, 10)), command)
    ends = [
        make_simulator(engine, ROBOT, PATH, setup=Setup(mass)).rollout(request).position[0, -1]
        for engine in ("mujoco", "dart")
        for mass in (0.0, 3.0)
    ]
    empty, loaded, dart_empty, dart_loaded = ends
    np.testing.assert_allclose(dart_loaded - dart_empty, loaded - empty, rtol=0.05, atol=2e-3)
    assert np.abs(loaded - empty).max() > 0.02


def test_what_carries_nothing_is_refused():
    with pytest.raises(ConfigError, match="does not say where a payload hangs"):
        MujocoSimulator.from_robot(replace(ROBOT, payload=None), PATH, setup=Setup(1.0))
    with pytest.raises(ConfigError, match="no site 'hook'"):
        MujocoSimulator.from_robot(replace(ROBOT, payload=PayloadSpec(("hook",))), PATH, setup=Setup(1.0))
    with pytest.raises(ConfigError, match="needs a mass"):
        MujocoSimulator.from_robot(ROBOT, PATH, setup=Setup(-1.0))
    with pytest.raises(ConfigError, match="sites must be there and differ"):
        PayloadSpec(())


def test_a_replay_carries_what_the_log_says(tmp_path):
    time_s = np.linspace(0.0, 1.0, 51)
    joints = ROBOT.joint_names
    still = np.tile(POSE, (51, 1))
    units = same_units({"position": "rad"}, joints)
    with DatasetWriter.create(tmp_path / "data", DatasetInfo(robot=ROBOT.name)) as writer:
        for payload_kg in (0.0, 2.0, None):
            series = TimeSeries(time_s, joints, {"position": still}, units)
            meta = EpisodeMeta(id=f"with-{payload_kg}", robot=ROBOT.name, payload_kg=payload_kg, split="test")
            writer.append(Episode(meta, series, series))
    data = Dataset(tmp_path / "data")
    replay(data, ROBOT, jobs=1)
    replay(data, replace(ROBOT, payload=None), label="mujoco/empty", jobs=1)
    ends = {
        (name, run): Dataset(data.path).episode(name, runs=[run]).run(run)["position"][-1]
        for name in data.ids
        for run in ("mujoco/stock", "mujoco/empty")
    }
    np.testing.assert_array_equal(ends["with-0.0", "mujoco/stock"], ends["with-0.0", "mujoco/empty"])
    np.testing.assert_array_equal(ends["with-None", "mujoco/stock"], ends["with-0.0", "mujoco/stock"])
    np.testing.assert_array_equal(ends["with-2.0", "mujoco/empty"], ends["with-0.0", "mujoco/empty"])
    assert np.abs(ends["with-2.0", "mujoco/stock"] - ends["with-0.0", "mujoco/stock"]).max() > 0.02


def test_plain_pd_hangs_lower_the_more_it_holds():
    quiet = load_lab("upper_body").only()  # no effects: what is left is the model under its controller
    sags = []
    for payload_kg in (0.0, 3.0):
        robot = VirtualRobot(draw_truth(quiet, unit=1), payload_kg=payload_kg)
        robot.place(POSE)
        done = robot.execute({"position": np.tile(POSE, (6000, 1))}, every=100)
        sags.append(done.measured["position"][-1] - POSE)
    empty, loaded = (MujocoSimulator.from_robot(ROBOT, PATH, setup=Setup(mass)) for mass in (0.0, 3.0))
    kp = np.array([ROBOT.controller.gain("kp", name) for name in ROBOT.joint_names])
    for sag, simulator in zip(sags, (empty, loaded), strict=True):
        # At rest the spring of each joint carries its weight.
        np.testing.assert_allclose(-kp * sag, weight_of(simulator, POSE + sag), atol=0.05)
