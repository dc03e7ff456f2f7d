"""The plan checker finds what is wrong, whatever the plan claims."""

from dataclasses import replace

import numpy as np
import pytest

from record.scenes import panda_scene
from trueup.errors import DataError, NameMismatch, NoPlan
from trueup.record import Plan, check_plan, joint_motion, require_valid


@pytest.fixture(scope="module")
def plan():
    scene = panda_scene()
    goal = scene.home.copy()
    goal[0] += 0.6
    return joint_motion(scene, scene.home, goal, moving=["joint1"], id="right")


def kinds(plan, scene=None):
    return {violation.kind for violation in check_plan(plan, panda_scene().limits, scene)}


def test_a_right_plan_passes(plan):
    assert check_plan(plan, panda_scene().limits, panda_scene()) == ()
    assert require_valid(plan, panda_scene().limits, panda_scene()) is plan


def test_a_joint_that_must_not_move_is_seen(plan):
    position = plan.position.copy()
    position[700:, 4] += 1e-6
    assert "moves" in kinds(replace(plan, position=position))
    velocity = plan.velocity.copy()
    velocity[700, 4] = 1e-3
    assert "moves" in kinds(replace(plan, velocity=velocity))
    assert "moves" in kinds(replace(plan, moving=("joint2",)))


@pytest.mark.parametrize("faster", [4.0, 8.0])
def test_a_plan_that_is_played_faster_breaks_limits(plan, faster):
    hurried = replace(
        plan,
        time_s=plan.time_s / faster,
        start_s=plan.start_s / faster,
        end_s=plan.end_s / faster,
        velocity=plan.velocity * faster,
        acceleration=plan.acceleration * faster**2,
    )
    assert {"velocity", "acceleration"} <= kinds(hurried)
    # What the plan says of its own speed does not count for more than its positions.
    silent = replace(hurried, velocity=plan.velocity * 0, acceleration=plan.acceleration * 0)
    assert {"velocity", "acceleration", "inconsistent"} <= kinds(silent)


def test_positions_out_of_range_and_restless_ends_are_seen(plan):
    shifted = plan.position.copy()
    shifted[:, 0] += 3.0
    assert "position" in kinds(replace(plan, position=shifted))
    assert "rest" in kinds(replace(plan, start_s=plan.start_s + 0.2))
    assert "rest" in kinds(replace(plan, end_s=plan.end_s - 0.2))


def test_a_collision_of_a_single_sample_is_seen(plan):
    scene = panda_scene()
    position = plan.position.copy()
    position[900] = [0.0, 1.7, 0.0, -0.3, 0.0, 1.5, 0.0]
    found = check_plan(replace(plan, position=position), scene.limits, scene)
    collision = next(violation for violation in found if violation.kind == "collision")
    assert collision.time_s == pytest.approx(0.9)
    with pytest.raises(NoPlan, match="plan 'right' is refused"):
        require_valid(replace(plan, position=position), scene.limits, scene)


def test_what_is_no_plan_cannot_be_made(plan):
    series = plan.to_series()
    with pytest.raises(DataError, match="damaged"):
        Plan.from_row({**plan.to_row(), "moving": None}, series)
    with pytest.raises(DataError, match="not finite"):
        replace(plan, position=np.where(plan.position > 1, np.nan, plan.position))
    with pytest.raises(DataError, match="not even"):
        replace(plan, time_s=plan.time_s**1.01)
    with pytest.raises(NameMismatch):
        replace(plan, moving=("elbow",))


def test_a_plan_of_another_robot_is_refused(plan):
    other = replace(plan, joints=tuple(name.upper() for name in plan.joints), moving=("JOINT1",))
    with pytest.raises(NameMismatch, match="another robot"):
        check_plan(other, panda_scene().limits)
