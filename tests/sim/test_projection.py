"""How far bodies have come apart, and the robot that is nearest to them."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trueup.core.timeseries import TimeSeries
from trueup.errors import MissingSignal, NameMismatch
from trueup.robots import find_model, load_robot
from trueup.robots.model import compile_spec, load_spec
from trueup.sim.projection import JointGaps, Projection

BODIES = {
    "kickbot_a": ("left_hip", "left_thigh", "left_shank", "left_foot", "right_shoulder", "right_arm"),
    "dancebot": None,
}


def robot_of(name):
    robot = load_robot(name)
    path = find_model(robot)
    model = compile_spec(load_spec(path), path)
    bodies = BODIES[name] or tuple(
        model.body(number).name for number in range(1, model.nbody) if model.body_weldid[number]
    )
    return robot, model, bodies


def bodies_at(model, joints, bodies, positions):
    """A series of poses with all constraints kept; closed chains are closed where they were built, at zero."""
    data = mujoco.MjData(model)
    column = [model.joint(name).qposadr[0] for name in joints]
    place, turn = [], []
    for row in positions:
        data.qpos[column] = row
        mujoco.mj_fwdPosition(model, data)
        assert np.abs(data.efc_pos[: data.ne]).max(initial=0) < 1e-9
        place.append([data.body(name).xpos.copy() for name in bodies])
        turn.append([data.body(name).xmat.reshape(3, 3).copy() for name in bodies])
    signals = {"position": np.array(positions), "body.position": np.array(place), "body.rotation": np.array(turn)}
    units = {"position": ("rad",) * len(joints), "body.position": ("m",) * len(bodies)}
    units["body.rotation"] = ("1",) * len(bodies)
    return TimeSeries(0.01 * np.arange(len(positions)), tuple(joints), signals, units, tuple(bodies))


def with_signals(series, **signals):
    return replace(series, signals={**series.signals, **{name.replace("_", "."): v for name, v in signals.items()}})


def poses(joints, count):
    return np.random.default_rng(0).uniform(-0.3, 0.3, (count, len(joints)))


@pytest.mark.parametrize("name", ["kickbot_a", "dancebot"])
def test_bodies_of_a_robot_are_joined_and_are_their_own_projection(name):
    robot, model, bodies = robot_of(name)
    # What both feet hold is not free to be posed joint by joint.
    pose = np.zeros((1, 12)) if name == "dancebot" else poses(robot.joint_names, 5)
    series = bodies_at(model, robot.joint_names, bodies, pose)
    found = JointGaps(model, bodies).of(series)
    assert found.apart_m.max() < 1e-8
    assert found.turned_rad.max() < 1e-7
    nearest = Projection(model, robot.joint_names, bodies).nearest(series)
    for signal in ("position", "body.position", "body.rotation"):
        np.testing.assert_allclose(nearest[signal], series[signal], atol=1e-8)


def test_gaps_are_what_was_moved_and_turned():
    robot, model, bodies = robot_of("kickbot_a")
    series = bodies_at(model, robot.joint_names, bodies, poses(robot.joint_names, 4))
    gaps = JointGaps(model, bodies)
    # Hips hang on the trunk, which is fixed; the arm's other neighbor is there, too.
    assert gaps.joints == (
        *("left_hip_roll", "left_hip_pitch", "left_knee", "left_ankle"),
        *("right_shoulder_pitch", "right_shoulder_roll"),
    )
    foot = bodies.index("left_foot")
    moved = series["body.position"].copy()
    moved[:, foot] += [0.003, 0, 0.004]
    found = gaps.of(with_signals(series, body_position=moved))
    np.testing.assert_allclose(found.apart_m[:, 3], 0.005, atol=1e-9)
    assert found.apart_m[:, [0, 1, 2, 4, 5]].max() < 1e-8
    # About the ankle's own axis (y) it may turn; about another it is off.
    own = series["body.rotation"][:, foot]
    for axis, angle in (([0, 0.2, 0], 0.0), ([0.1, 0, 0], 0.1)):
        turned = series["body.rotation"].copy()
        turned[:, foot] = own @ Rotation.from_rotvec(axis).as_matrix()
        found = gaps.of(with_signals(series, body_rotation=turned))
        np.testing.assert_allclose(found.turned_rad[:, 3], angle, atol=1e-7)


@pytest.mark.parametrize("signals", [("body.position", "body.rotation"), ("body.position",)])
def test_a_projection_is_a_robot_and_no_farther_from_the_truth(signals):
    robot, model, bodies = robot_of("kickbot_a")
    joints = robot.joint_names
    true = bodies_at(model, joints, bodies, poses(joints, 40))
    rng = np.random.default_rng(1)
    given = {
        "position": true["position"] + 0.02 * rng.standard_normal(true["position"].shape),
        "body.position": true["body.position"] + 0.003 * rng.standard_normal(true["body.position"].shape),
        "body.rotation": Rotation.from_rotvec(0.05 * rng.standard_normal((40 * len(bodies), 3))).as_matrix().reshape(
            true["body.rotation"].shape
        ) @ true["body.rotation"],
    }  # fmt: skip
    noisy = replace(
        true,
        signals={name: given[name] for name in ("position", *signals)},
        units={name: true.units[name] for name in ("position", *signals)},
    )
    nearest = Projection(model, joints, bodies).nearest(noisy)
    again = bodies_at(model, joints, bodies, nearest["position"])
    for name in signals:
        np.testing.assert_allclose(again[name], nearest[name], atol=1e-9)
    if len(signals) == 2:
        found = JointGaps(model, bodies).of(nearest)
        assert max(found.apart_m.max(), found.turned_rad.max()) < 1e-7
    before, after = (
        np.linalg.norm(item["body.position"] - true["body.position"], axis=-1).mean() for item in (noisy, nearest)
    )
    assert after < 0.9 * before
    unseen = [joints.index(joint) for joint in ("right_knee", "left_shoulder_pitch")]
    np.testing.assert_allclose(nearest["position"][:, unseen], noisy["position"][:, unseen], atol=1e-9)


def test_closed_chains_stay_closed():
    robot, model, bodies = robot_of("dancebot")
    joints = robot.joint_names
    true = bodies_at(model, joints, bodies, np.zeros((6, 12)))
    rng = np.random.default_rng(2)
    moved = true["body.position"] + 0.002 * rng.standard_normal(true["body.position"].shape)
    given = with_signals(true, body_position=moved)
    gaps = JointGaps(model, bodies)
    assert len(gaps.joints) > model.njnt - 2
    assert gaps.of(given).apart_m.mean() > 1e-3
    nearest = Projection(model, joints, bodies).nearest(given)
    found = gaps.of(nearest)
    assert found.apart_m.max() < 1e-7
    assert found.turned_rad.max() < 1e-6
    before, after = (
        np.linalg.norm(item["body.position"] - true["body.position"], axis=-1).mean() for item in (given, nearest)
    )
    assert after < before


def test_a_slide_is_free_along_its_axis():
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody><body name="rail" pos="0 0 1" euler="0 0 30">
      <body name="cart" pos="0.1 0 0"><joint name="way" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/>
        <body name="pole" pos="0 0 0.1"><joint name="swing" axis="0 1 0" pos="0 0 -0.1"/><geom size="0.1" mass="1"/>
    </body></body></body></worldbody></mujoco>""")
    bodies = ("cart", "pole")
    series = bodies_at(model, ("way", "swing"), bodies, np.array([[0.3, -0.5], [-0.2, 1.0]]))
    gaps = JointGaps(model, bodies)
    assert gaps.joints == ("way", "swing")
    assert gaps.of(series).apart_m.max() < 1e-12
    axis = series["body.rotation"][:, 0, :, 0]
    across = series["body.rotation"][:, 0, :, 1]
    both = np.stack([0.05 * axis + 0.01 * across] * 2, axis=1)
    found = gaps.of(with_signals(series, body_position=series["body.position"] + both))
    np.testing.assert_allclose(found.apart_m, [[0.01, 0], [0.01, 0]], atol=1e-12)
    turn = Rotation.from_rotvec([0.02, 0, 0]).as_matrix()
    turned = turn @ series["body.rotation"]
    np.testing.assert_allclose(gaps.of(with_signals(series, body_rotation=turned)).turned_rad[:, 0], 0.02, atol=1e-9)


def test_what_cannot_be_projected_is_refused():
    robot, model, bodies = robot_of("kickbot_a")
    with pytest.raises(NameMismatch, match="tail"):
        JointGaps(model, ("tail",))
    with pytest.raises(NameMismatch, match="elbow"):
        Projection(model, ("elbow",), bodies)
    series = bodies_at(model, robot.joint_names, bodies, np.zeros((2, 12)))
    plain = replace(series, signals={"position": series["position"]}, units={"position": series.units["position"]})
    with pytest.raises(MissingSignal, match="poses of bodies"):
        Projection(model, robot.joint_names, bodies).nearest(plain)
    with pytest.raises(MissingSignal, match=r"body\.position"):
        JointGaps(model, bodies).of(plain)
