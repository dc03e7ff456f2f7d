"""Laws of planned motions, on the Panda in its cell."""

import itertools
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from record.scenes import ACCELERATION, HIGH, JERK, LOW, assert_lawful, flange, panda_scene, touches
from trueup.errors import ConfigError, NameMismatch, NoPlan
from trueup.record import (
    ClockSettings,
    MotionSettings,
    PathSettings,
    cartesian_line,
    joint_motion,
    plan_path,
    random_joint_motion,
    random_line,
    random_pose,
    random_spline,
    straightness_m,
)
from trueup.record.paths import _search
from trueup.record.splines import b_spline

JOINTS = tuple(f"joint{number}" for number in range(1, 8))
SEEDS = st.integers(0, 2**32 - 2)
# Not shrunk: a smaller seed is no simpler motion.
few = settings(max_examples=8, phases=[Phase.explicit, Phase.generate])


@few
@given(SEEDS, st.sampled_from(JOINTS), st.floats(0.2, 1.0))
def test_a_single_joint_motion_moves_one_joint_within_all_limits(seed, joint, share):
    plan = random_joint_motion(panda_scene(), [joint], np.random.default_rng(seed), velocity_share=share)
    assert plan.moving == (joint,)
    assert_lawful(plan, share=share)


@few
@given(SEEDS, st.sets(st.sampled_from(JOINTS), min_size=2), st.floats(0.2, 1.0))
def test_a_motion_of_several_joints_moves_those_and_no_other(seed, joints, share):
    plan = random_joint_motion(panda_scene(), sorted(joints), np.random.default_rng(seed), velocity_share=share)
    assert set(plan.moving) == joints
    assert_lawful(plan, share=share)


@few
@given(SEEDS, st.sampled_from(["xz", "xy", "yz"]), st.floats(0.2, 1.0))
def test_a_line_is_straight_within_a_millimeter_and_in_its_plane(seed, plane, share):
    scene = panda_scene()
    plan = random_line(scene, plane, np.random.default_rng(seed), velocity_share=share)
    assert_lawful(plan, share=share)
    points = np.array([flange(pose) for pose in plan.position[::5]])
    along = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    offsets = points - points[0]
    assert np.linalg.norm(offsets - np.outer(offsets @ along, along), axis=1).max() < 1e-3
    assert straightness_m(scene, plan) < 1e-3
    third = "xyz".index(*set("xyz") - set(plane))
    assert np.abs(offsets[:, third]).max() < 1e-3
    assert np.linalg.norm(offsets[-1]) + 1e-5 >= 0.1
    rotations = [scene.pose(pose)[1] for pose in (plan.start, plan.position[len(plan.position) // 2], plan.goal)]
    for rotation in rotations:
        np.testing.assert_allclose(rotation, rotations[0], atol=1e-3)


@pytest.mark.long
@few
@given(SEEDS, st.sampled_from([0, 1, 2, 3, 4]), st.floats(0.3, 1.0))
def test_spline_references_keep_the_limits(seed, order, share):
    plan = random_spline(panda_scene(), order, np.random.default_rng(seed), velocity_share=share)
    assert_lawful(plan, share=share)


@pytest.mark.parametrize("order", [0, 1, 2, 3, 4])
def test_the_end_effector_comes_by_its_spline(order):
    plan = random_spline(panda_scene(), order, np.random.default_rng(order), velocity_share=0.5)
    curve = b_spline(np.array(plan.details["points_m"]), order)
    wanted = curve(np.linspace(0, 1 - 1e-12, 200))
    reached = np.array([flange(pose) for pose in plan.position[::5]])
    distance = np.linalg.norm(wanted[:, None] - reached[None], axis=2).min(axis=1)
    # Smoothing cuts what bends: corners most, and a smooth curve hardly.
    assert np.median(distance) < (0.002 if order == 0 else 0.03)
    assert distance[[0, -1]].max() < 1e-4


def test_a_spline_of_order_0_is_steps_and_one_of_order_1_a_polyline():
    points = np.arange(15.0).reshape(5, 3) ** 1.5
    np.testing.assert_array_equal(b_spline(points, 0)(np.array([0.0, 0.19, 0.21, 0.99])), points[[0, 0, 1, 4]])
    np.testing.assert_allclose(
        b_spline(points, 1)(np.array([0.0, 0.125, 1.0])), [points[0], points[:2].mean(0), points[4]]
    )


@pytest.mark.parametrize(("order", "count"), [(5, 8), (-1, 8), (4, 4), (0, 1)])
def test_splines_that_are_none_are_refused(order, count):
    with pytest.raises(ConfigError):
        b_spline(np.zeros((count, 3)), order)


def test_the_jerk_limit_of_the_panda_is_kept_too():
    rng = np.random.default_rng(3)
    plan = random_joint_motion(panda_scene(), JOINTS, rng, velocity_share=1.0)
    jerk = np.diff(plan.position, n=3, axis=0) * 1e9
    assert np.all(np.abs(jerk) < JERK)


def test_a_long_motion_of_one_joint_is_as_fast_as_a_trapezoid_can_be():
    scene, share = panda_scene("empty"), 0.5
    goal = scene.home.copy()
    goal[0] = 2.5
    clock = ClockSettings(smoothing_s=0.0, rest_s=0.0)
    plan = joint_motion(
        scene, scene.home, goal, moving=["joint1"], velocity_share=share, settings=MotionSettings(clock=clock)
    )
    speed = share * 2.175
    # From rest to rest over a distance x with speed v and acceleration a: x / v + v / a.
    assert plan.duration_s == pytest.approx(2.5 / speed + speed / 15, rel=0.01)
    np.testing.assert_array_equal(plan.start, scene.home)
    np.testing.assert_array_equal(plan.goal, goal)


def test_rest_rate_and_smoothing_are_what_was_asked_for():
    clock = ClockSettings(rate_hz=250.0, rest_s=1.0, smoothing_s=0.0)
    scene = panda_scene("empty")
    goal = scene.home + 0.3
    plan = joint_motion(scene, scene.home, goal, settings=MotionSettings(clock=clock))
    assert plan.rate_hz == pytest.approx(250.0)
    assert plan.start_s == pytest.approx(1.0)
    assert plan.duration_s - plan.end_s == pytest.approx(1.0)
    moving = np.flatnonzero(np.abs(plan.velocity).max(axis=1) > 0)
    assert plan.time_s[moving[0] - 1] == pytest.approx(plan.start_s)
    assert plan.time_s[moving[-1] + 1] == pytest.approx(plan.end_s)


def blocked_pair(seed):
    """Two free poses between which the straight line is blocked."""
    scene, rng = panda_scene(), np.random.default_rng(seed)
    while True:
        start, goal = random_pose(scene, rng), random_pose(scene, rng)
        if not scene.edge_free(start, goal):
            return start, goal


@few
@given(SEEDS)
def test_a_blocked_way_is_gone_around(seed):
    scene = panda_scene()
    start, goal = blocked_pair(seed)
    try:
        way = plan_path(scene, start, goal, moving=JOINTS, seed=seed)
    except NoPlan:
        return
    assert len(way) > 2
    np.testing.assert_array_equal(way[[0, -1]], [start, goal])
    for a, b in itertools.pairwise(way):
        assert not any(touches(a + s * (b - a)) for s in np.linspace(0, 1, 100))


def test_the_same_path_is_found_alone_and_after_others():
    scene = panda_scene()
    start, goal = blocked_pair(5)
    first = plan_path(scene, start, goal, moving=JOINTS, seed=7)
    for seed in range(3):
        plan_path(scene, *blocked_pair(seed + 20), moving=JOINTS, seed=seed)
    np.testing.assert_array_equal(plan_path(scene, start, goal, moving=JOINTS, seed=7), first)
    assert plan_path(scene, start, goal, moving=JOINTS, seed=8).shape != first.shape or not np.array_equal(
        plan_path(scene, start, goal, moving=JOINTS, seed=8), first
    )


def test_the_planner_writes_nothing(capfd):
    start, goal = blocked_pair(5)
    plan_path(panda_scene(), start, goal, moving=JOINTS, seed=1)
    _search(panda_scene(), start, goal, list(range(7)), 1, PathSettings())
    assert capfd.readouterr() == ("", "")


def test_a_process_that_has_planned_leaves_without_a_word():
    start, goal = blocked_pair(5)
    code = (
        "import numpy as np, sys; from trueup.record import Scene, load_workspace, plan_path; "
        "from trueup.robots import load_robot; scene = Scene(load_robot('panda'), workspace=load_workspace('cell')); "
        "start, goal = np.array(eval(sys.argv[1])); "
        "assert len(plan_path(scene, start, goal, moving=scene.joints, seed=1)) > 2"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str([start.tolist(), goal.tolist()])], capture_output=True, text=True, check=True
    )
    assert run.stdout + run.stderr == ""


def test_a_planner_that_finds_nothing_in_time_says_so():
    start, goal = blocked_pair(5)
    with pytest.raises(NoPlan, match="no path around the obstacles"):
        plan_path(panda_scene(), start, goal, moving=JOINTS, seed=1, settings=PathSettings(checks=3))


def test_distances_agree_with_mujoco_and_edges_hide_nothing():
    scene, rng = panda_scene(), np.random.default_rng(0)
    for _ in range(300):
        pose = rng.uniform(LOW, HIGH)
        assert touches(pose) == (scene.distance_m(pose) <= 0)
    for _ in range(40):
        start, goal = rng.uniform(LOW, HIGH, (2, 7))
        seen = [scene.distance_m(start + s * (goal - start)) > scene.clearance_m for s in np.linspace(0, 1, 500)]
        # The edge may be refused for what lies between the 500, never be let through against them.
        assert all(seen) or not scene.edge_free(start, goal)
        positions = start + np.linspace(0, 1, 500)[:, None] * (goal - start)
        hits = np.flatnonzero([touches(pose) for pose in positions])
        assert scene.first_collision(positions) == (hits[0] if hits.size else None)


def test_the_reach_of_a_joint_bounds_what_moves():
    """No point of a geom moves farther than the reach of each joint times what it turns."""
    scene, rng = panda_scene(), np.random.default_rng(1)
    model = scene.model
    data = mujoco.MjData(model)

    def centers(pose):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        return data.geom_xpos.copy()

    for _ in range(200):
        start = rng.uniform(LOW, HIGH)
        change = rng.normal(0, 0.2, 7)
        moved = np.linalg.norm(centers(start + change) - centers(start), axis=1).max()
        assert moved <= np.abs(change) @ scene._reach


def test_poses_out_of_limits_and_in_collision_are_refused():
    scene = panda_scene()
    outside = scene.home.copy()
    outside[3] = 0.5
    with pytest.raises(ConfigError, match=r"the goal is out of the limits of joint 'joint4'.*0.5000.*-0.0698"):
        joint_motion(scene, scene.home, outside)
    below = np.array([0.0, 1.7, 0.0, -0.3, 0.0, 1.5, 0.0])
    with pytest.raises(NoPlan, match=r"the goal is in collision.*mm apart"):
        joint_motion(scene, scene.home, below)
    with pytest.raises(ConfigError, match="no pose of these joints"):
        joint_motion(scene, scene.home, np.full(7, np.nan))


def test_bad_requests_are_refused():
    scene, rng = panda_scene(), np.random.default_rng(0)
    goal = scene.home + 0.1
    with pytest.raises(NameMismatch, match="elbow"):
        random_joint_motion(scene, ["elbow"], rng, velocity_share=1.0)
    with pytest.raises(ConfigError, match="moves joint 'joint4', which must not move"):
        joint_motion(scene, scene.home, goal, moving=["joint2"])
    with pytest.raises(ConfigError, match="does not move"):
        joint_motion(scene, scene.home, scene.home.copy())
    with pytest.raises(ConfigError, match="at least one joint"):
        random_joint_motion(scene, [], rng, velocity_share=1.0)
    for share in (0.0, -0.2, 1.2, np.nan):
        with pytest.raises(ConfigError, match="no share"):
            joint_motion(scene, scene.home, goal, velocity_share=share)
    for wrong in ({"rate_hz": -100.0}, {"rate_hz": 0.0}, {"rest_s": -1.0}, {"smoothing_s": np.inf}):
        with pytest.raises(ConfigError):
            ClockSettings(**wrong)
    with pytest.raises(ConfigError, match="range of lengths"):
        random_line(scene, "xz", rng, velocity_share=1.0, length_m=(0.2, 0.1))


def test_lines_out_of_reach_are_refused():
    scene = panda_scene("empty")
    with pytest.raises(NoPlan, match=r"cannot reach .* mm short of point"):
        cartesian_line(scene, scene.home, np.array([1.0, 0.0, 0.0]))
    with pytest.raises(ConfigError, match="needs a length"):
        cartesian_line(scene, scene.home, np.zeros(3))
    with pytest.raises(NoPlan, match="touch"):
        cartesian_line(panda_scene(), scene.home, np.array([0.0, 0.0, -0.6]))


def test_a_motion_that_is_never_found_ends():
    scene = panda_scene()
    with pytest.raises(NoPlan, match="in 3 attempts"):
        random_line(
            scene,
            "xy",
            np.random.default_rng(0),
            velocity_share=1.0,
            length_m=(3.0, 3.0),
            settings=MotionSettings(attempts=3),
        )


def test_slower_is_slower():
    scene = panda_scene("empty")
    goal = scene.home + 0.4
    durations = [joint_motion(scene, scene.home, goal, velocity_share=share).duration_s for share in (0.2, 0.5, 1.0)]
    assert durations[0] > durations[1] > durations[2]
    assert ACCELERATION.min() > 0
