"""A motion capture sees the bodies of a virtual robot, and parts that are mounted elsewhere are seen elsewhere."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lab.test_servo_robot import lab, wave
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.protocols import RolloutRequest
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError
from trueup.lab import Truth, VirtualRobot, draw_truth, load_lab
from trueup.lab.spec import Markers, Mounting
from trueup.measure.metrics.body import rotation_distance
from trueup.record.following import follow
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator

BODIES = ("left_foot", "trunk", "right_arm")


def marked(robot="kickbot_a", *effects, bodies=BODIES, mounting=None, **noise):
    spec = lab(robot, *effects, mounting=mounting or Mounting())
    return replace(spec, markers=Markers(bodies, **noise))


def test_they_see_the_frames_that_a_replay_has():
    """Without effects robot and simulator are one, so that bodies are where the simulator has them."""
    command = wave(800)
    robot = VirtualRobot(draw_truth(marked()))
    done = robot.execute({"position": command}, every=4)
    assert done.measured.bodies == done.truth.bodies == BODIES
    assert done.measured["body.position"].shape == (201, 3, 3)
    np.testing.assert_allclose(done.measured["body.position"], done.truth["body.position"], atol=1e-12)
    np.testing.assert_allclose(done.measured["body.rotation"], done.truth["body.rotation"], atol=1e-12)
    description = load_robot("kickbot_a")
    description = replace(description, simulation=replace(description.simulation, bodies=BODIES))
    simulator = MujocoSimulator.from_robot(description, find_model(description))
    # At the joint positions of the virtual robot, the engine's own sensors say the same.
    where = done.measured["position"][[0, 100, 200]]
    found = simulator.rollout(RolloutRequest(where, 0 * where, {"position": np.repeat(where[:, None], 2, axis=1)}))
    assert found.body_names == BODIES
    for name in ("body.position", "body.rotation"):
        np.testing.assert_allclose(done.truth[name][[0, 100, 200]], found.bodies[name][:, 0], atol=1e-9)


def test_closed_chains_are_seen_as_they_are():
    robot = VirtualRobot(draw_truth(marked("dancebot", bodies=("trunk",))))
    done = robot.execute({"position": 0.1 * wave(300, size=0.3)})
    data = mujoco.MjData(robot._plant.model)
    data.qpos[:] = robot._plant.data.qpos
    mujoco.mj_kinematics(robot._plant.model, data)
    np.testing.assert_array_equal(done.truth["body.position"][-1, 0], data.body("trunk").xpos)


@pytest.mark.parametrize("effects", [(), ("friction", "delay", "readings")])
def test_looking_at_a_robot_does_not_move_it(effects):
    spec = marked("kickbot_a", *effects, position_noise_m=1e-3)
    plain = replace(spec, markers=Markers())
    one, other = (VirtualRobot(draw_truth(item), seed=3).execute({"position": wave(300)}) for item in (spec, plain))
    assert set(one.measured.signals) - set(other.measured.signals) == {"body.position", "body.rotation"}
    assert other.measured.bodies == ()
    for name, values in other.measured.signals.items():
        np.testing.assert_array_equal(values, one.measured[name])


def test_noise_and_steps():
    sizes = {"position_noise_m": 5e-4, "position_step_m": 1e-4, "rotation_noise_rad": 0.01}
    done = VirtualRobot(draw_truth(marked(**sizes)), seed=1).execute({"position": wave(2000)})
    seen, true = done.measured, done.truth
    steps = seen["body.position"] / 1e-4
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    error = seen["body.position"] - true["body.position"]
    assert error.std() == pytest.approx(np.hypot(5e-4, 1e-4 / np.sqrt(12)), rel=0.05)
    eye = seen["body.rotation"] @ np.swapaxes(seen["body.rotation"], -1, -2)
    np.testing.assert_allclose(eye, np.broadcast_to(np.eye(3), eye.shape), atol=1e-12)
    angle = rotation_distance(seen["body.rotation"], true["body.rotation"])
    assert np.sqrt((angle**2).mean()) == pytest.approx(0.01 * np.sqrt(3), rel=0.05)


def test_a_motion_in_pieces_is_seen_as_the_whole():
    truth = draw_truth(marked("kickbot_a", "readings", position_noise_m=1e-3, rotation_noise_rad=0.01))
    whole = VirtualRobot(truth, seed=2).execute({"position": wave(40)}).measured
    robot = VirtualRobot(truth, seed=2)
    first = robot.execute({"position": wave(40)[:15]}).measured
    second = robot.execute({"position": wave(40)[15:]}).measured
    for name in whole.signals:
        np.testing.assert_array_equal(np.concatenate([first[name], second[name][1:]]), whole[name])


def test_a_recording_has_them(tmp_path):
    robot = VirtualRobot(draw_truth(marked(position_noise_m=1e-3)))
    done = follow(robot, {"position": wave(400)}, step_s=0.001, every=4, silent_s=0.2)
    assert done.trouble is None
    assert done.measured.bodies == BODIES
    assert done.measured.units["body.position"] == ("m",) * 3
    with DatasetWriter.create(tmp_path / "data", DatasetInfo(robot="kickbot_a")) as writer:
        writer.append(Episode(EpisodeMeta("one"), done.measured, done.command))
    read = Dataset(tmp_path / "data").episode("one").measured
    np.testing.assert_allclose(read["body.rotation"], done.measured["body.rotation"], atol=1e-6)


def test_a_robot_that_only_cameras_see_moving_is_silent():
    from trueup.lab import Fault

    drop = Fault("drop", at_s=0.2, duration_s=1.0, share=1.0)
    robot = VirtualRobot(draw_truth(marked(position_noise_m=1e-3)), faults=[drop])
    done = follow(robot, {"position": wave(900)}, step_s=0.001, every=4, silent_s=0.2)
    assert done.trouble is not None
    assert done.trouble.kind == "silent"


def test_parts_that_are_mounted_elsewhere(tmp_path):
    size = Mounting(position_m=1.5e-3, rotation_rad=0.01)
    spec = marked("kickbot_a", "mounting", mounting=size)
    one, other = draw_truth(spec, unit=1), draw_truth(spec, unit=2)
    offsets = np.array([[mount.offset for mount in truth.mounts.values()] for truth in (one, other)])
    assert offsets.shape[1] == 12  # the trunk is held
    assert offsets.std() == pytest.approx(1.5e-3, rel=0.25)
    turns = np.array([mount.turn for mount in one.mounts.values()])
    assert turns.std() == pytest.approx(0.01, rel=0.3)
    one.save(tmp_path / "truth.json")
    assert Truth.load(tmp_path / "truth.json") == one
    # In the zero pose: the chain of offsets and turns from the trunk to the foot.
    robot = VirtualRobot(one)
    pose = robot.execute({"position": np.zeros((1, 12))}).truth
    model = robot._plant.model
    plain = VirtualRobot(draw_truth(spec.without("mounting")))._plant.model
    place, turn = plain.body("trunk").pos.copy(), np.eye(3)
    for name in ("left_hip", "left_thigh", "left_shank", "left_foot"):
        place = place + turn @ (plain.body(name).pos + one.mounts[name].offset)
        turn = turn @ Rotation.from_rotvec(one.mounts[name].turn).as_matrix()
    np.testing.assert_allclose(pose["body.position"][0, 0], place, atol=1e-9)
    np.testing.assert_allclose(pose["body.rotation"][0, 0], turn, atol=1e-9)
    assert not np.allclose(model.dof_invweight0, plain.dof_invweight0, rtol=1e-6)


def test_other_effects_are_as_before_and_nothing_is_moved_unless_asked():
    spec = marked("kickbot_a", "friction", "inertia", "mounting", mounting=Mounting(position_m=1e-3))
    one, other = draw_truth(spec), draw_truth(spec.without("mounting"))
    assert (one.joints, one.bodies) == (other.joints, other.bodies)
    assert other.mounts == {} == draw_truth(lab("kickbot_a", "mounting")).mounts


def test_what_cannot_be_seen_or_mounted_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="no body 'tail'"):
        VirtualRobot(draw_truth(marked(bodies=("tail",))))
    with pytest.raises(ConfigError, match="twice"):
        marked(bodies=("trunk", "trunk"))
    with pytest.raises(ConfigError, match="position_noise_m"):
        marked(position_noise_m=-1.0)
    with pytest.raises(ConfigError, match="chains are closed"):
        draw_truth(marked("dancebot", "mounting", bodies=(), mounting=Mounting(rotation_rad=0.01)))
    path = tmp_path / "lab.yaml"
    path.write_text("markers: {bodies: [link7], position_noise_m: 0.0002}\nmounting: {position_m: 0.001}\n")
    assert load_lab(path).markers.bodies == ("link7",)
