"""Motions of robots with several limbs and closed chains: by keyframes, and by splines of sites and joints."""

import mujoco
import numpy as np
import pytest

from trueup.errors import ConfigError, NameMismatch, NoPlan
from trueup.record import ClockSettings, MotionSettings, Scene, check_plan, load_plans
from trueup.record.keyframes import Animation, animated
from trueup.record.posing import SiteKinematics
from trueup.record.splines import joint_spline, limbs_reference, random_joint_spline
from trueup.robots import find_model, load_robot

SETTINGS = MotionSettings(clock=ClockSettings(rate_hz=250.0, rest_s=0.1))
SHIPPED = {
    "kickbot-splines": "kickbot_a",
    **{f"{name}-animations": name for name in ("kickbot_a", "kickbot_b", "dancebot")},
}


def scene_of(name):
    return Scene(load_robot(name))


def test_a_joint_passes_through_its_keyframes_and_comes_home():
    scene = scene_of("kickbot_a")
    frames = ((1.0, -0.8), (2.0, -0.8), (3.0, 0.4))
    plan = animated(scene, Animation(4.0, {"left_hip_pitch": frames}), settings=SETTINGS)
    own = plan.position[:, plan.joints.index("left_hip_pitch")]
    # Smoothing delays by half of its two windows.
    moved = plan.time_s - plan.start_s - 0.06
    assert np.interp(1.5, moved, own) == pytest.approx(-0.8, abs=1e-9)
    assert np.interp([1.0, 3.0], moved, own) == pytest.approx([-0.8, 0.4], abs=0.02)
    assert own.min() >= -0.8 - 1e-12  # no overshoot
    assert (plan.moving, plan.details["speed"]) == (("left_hip_pitch",), 1.0)
    np.testing.assert_array_equal(plan.position[[0, -1]], [scene.home, scene.home])


def test_speed_and_size_are_of_the_whole_and_limits_slow_down():
    scene = scene_of("kickbot_a")
    animation = Animation(4.0, {"left_knee": ((1.0, 0.5), (2.0, 0.1))})
    plain = animated(scene, animation, settings=SETTINGS)
    twice = animated(scene, animation, speed=1.25, amplitude=1.5, settings=SETTINGS)
    column = plain.joints.index("left_knee")
    assert np.ptp(twice.position[:, column]) == pytest.approx(1.5 * np.ptp(plain.position[:, column]), rel=1e-3)
    assert (twice.end_s - twice.start_s) / (plain.end_s - plain.start_s) == pytest.approx(0.8, abs=0.01)
    hurried = animated(scene, animation, speed=50.0, settings=SETTINGS)
    assert hurried.details["speed"] < 20
    assert not check_plan(hurried, scene.limits)


def test_the_trunk_of_a_closed_chain_goes_where_it_should_and_the_chain_stays_closed():
    scene = scene_of("dancebot")
    frames = ((1.0, 0.0, 0.01, -0.03, 0.0, 0.0, 0.2), (2.0, 0.0, -0.01, -0.02, 0.1, 0.0, 0.0))
    cranks = {f"{side}_knee_crank": ((1.0, 0.4), (2.0, 0.4)) for side in ("left", "right")}
    plan = animated(scene, Animation(3.0, cranks, {"trunk": frames}), settings=SETTINGS)
    model = mujoco.MjModel.from_xml_path(str(find_model(load_robot("dancebot"))))
    data = mujoco.MjData(model)
    columns = [model.joint(name).qposadr[0] for name in plan.joints]
    # An engine of its own finds the same trunk: servos are held where the plan has them, the rest follows.
    row = int(np.argmin(np.abs(plan.time_s - plan.start_s - 0.06 - 1.0)))
    model.opt.gravity[:] = 0
    model.opt.timestep = 0.001
    for step in range(3000):
        data.qfrc_applied[:] = -0.02 * data.qvel
        wanted = min(1.0, step / 2000) * plan.position[row]
        data.qfrc_applied[columns] += 200 * (wanted - data.qpos[columns]) - 2 * data.qvel[columns]
        mujoco.mj_step(model, data)
    assert np.abs(data.efc_pos[: data.ne]).max() < 2e-4
    home = mujoco.MjData(model)
    mujoco.mj_kinematics(model, home)
    moved = data.site("trunk").xpos - home.site("trunk").xpos
    np.testing.assert_allclose(moved, [0.0, 0.01, -0.03], atol=1.5e-3)
    turn = data.site("trunk").xmat.reshape(3, 3) @ home.site("trunk").xmat.reshape(3, 3).T
    assert np.arctan2(turn[1, 0], turn[0, 0]) == pytest.approx(0.2, abs=0.02)


def test_a_chain_that_would_have_to_open_is_refused():
    scene = scene_of("dancebot")
    with pytest.raises(NoPlan, match=r"closed chain would have to open|range"):
        animated(scene, Animation(2.0, {}, {"trunk": ((1.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0),)}), settings=SETTINGS)


@pytest.mark.parametrize(
    ("tracks", "message"),
    [
        ({}, "needs joints or sites"),
        ({"joints": {"left_knee": ((1.0, 0.1), (0.5, 0.2))}}, "not in order"),
        ({"joints": {"left_knee": ((3.0, 0.1),)}}, "not in order"),
        ({"joints": {"left_knee": ((1.0, float("nan")),)}}, "not finite"),
    ],
)
def test_keyframes_that_make_no_motion_are_refused(tracks, message):
    with pytest.raises(ConfigError, match=message):
        Animation(2.0, **tracks)


def test_unknown_names_are_refused_by_name():
    scene = scene_of("kickbot_a")
    with pytest.raises(NameMismatch, match="tail"):
        animated(scene, Animation(2.0, {"tail": ((1.0, 0.1),)}), settings=SETTINGS)
    with pytest.raises(ConfigError, match="no site 'tail'"):
        animated(scene, Animation(2.0, {}, {"tail": ((1.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0),)}), settings=SETTINGS)
    with pytest.raises(ConfigError, match="speed and amplitude"):
        animated(scene, Animation(2.0, {"left_knee": ((1.0, 0.1),)}), speed=0.0, settings=SETTINGS)


def test_limbs_come_as_near_to_their_splines_as_they_reach():
    """Feet, with four joints, are where they should be; an arm of two joints is at the nearest point of its sphere."""
    scene = scene_of("kickbot_a")
    solver = SiteKinematics(scene, ("left_foot", "left_hand"))
    start = scene.home + 0.2
    there = solver.poses(start)
    targets = {name: np.tile(np.eye(4), (3, 1, 1)) for name in there}
    for name, (position, _) in there.items():
        targets[name][:, :3, 3] = position + np.linspace(0, 0.03, 3)[:, None] * [1.0, 0.3, 0.5]
    pose = solver.follow(start, targets)[-1]
    reached = solver.poses(pose)
    np.testing.assert_allclose(reached["left_foot"][0], targets["left_foot"][-1, :3, 3], atol=1e-4)
    shoulder = there["left_hand"][0] * 0 + [0.0, 0.075, 0.345]
    wanted, got = (place - shoulder for place in (targets["left_hand"][-1, :3, 3], reached["left_hand"][0]))
    assert got @ wanted / np.linalg.norm(got) / np.linalg.norm(wanted) > 0.99


@pytest.mark.parametrize("order", range(5))
def test_splines_of_limbs_and_joints_keep_the_limits(order):
    scene = scene_of("kickbot_a")
    rng = np.random.default_rng(order)
    points = {name: rng.uniform(-0.08, 0.08, (6, 3)) for name in ("left_foot", "right_hand")}
    plan = limbs_reference(scene, scene.home + 0.1, points, order, settings=SETTINGS)
    assert not check_plan(plan, scene.limits)
    assert not np.ptp(plan.position[:, plan.joints.index("right_ankle")]) > 1e-3  # no site of its leg is led
    plan = random_joint_spline(scene, ("left_knee", "left_ankle"), order, rng, velocity_share=0.5, settings=SETTINGS)
    assert not check_plan(plan, scene.limits.scaled(0.5, 1.0))
    assert plan.moving == ("left_knee", "left_ankle")


def test_a_joint_follows_its_own_spline():
    scene = scene_of("kickbot_a")
    points = {"left_knee": np.array([0.0, 0.5, 1.0, 0.5, 0.0])}
    plan = joint_spline(scene, points, 1, span_s=2.0, settings=SETTINGS)
    own = plan.position[:, plan.joints.index("left_knee")]
    time_s = plan.time_s - plan.start_s - 1.0  # of the averages
    assert np.interp([1.0, 3.0, 5.0], time_s, own) == pytest.approx([0.25, 0.75, 0.75], abs=0.01)
    assert own.max() < 1.0


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_sets_can_be_planned(name):
    spec = load_plans(name).scaled(0.01)
    scene = spec.scene(load_robot(SHIPPED[name]))
    for number in range(len(spec)):
        plan = spec.plan(scene, number)
        assert not check_plan(plan, scene.limits, scene)
    if name.endswith("animations"):
        assert {spec.split(number) for number in range(len(spec))} == {"test"}
        np.testing.assert_array_equal(plan.start, scene.home)


def test_joints_rest_each_for_itself():
    scene = scene_of("kickbot_a")
    rng = np.random.default_rng(3)
    plan = random_joint_spline(
        scene, scene.joints, 1, rng, velocity_share=1.0, control_points=40, pause_share=0.7, settings=SETTINGS
    )
    rests = (plan.velocity == 0)[(plan.time_s > plan.start_s) & (plan.time_s < plan.end_s)]
    assert (rests.mean(axis=0) > 0.2).all()
    assert rests.all(axis=1).mean() < 0.1
