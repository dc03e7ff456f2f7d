"""Files of joint angles become plans that go through their angles, as fast as the robot can."""

import numpy as np
import pytest

from trueup.errors import ConfigError, DataError, NameMismatch, TrueupError
from trueup.record import PlanSet, Scene
from trueup.record.motion_files import motion_files, plans_of_files
from trueup.robots import load_robot
from trueup.stages import plans_named

JOINTS = ("yaw", "shoulder", "elbow")
HOME = np.array([0.0, -0.9, 0.4])


@pytest.fixture(scope="module")
def robot():
    return load_robot("demo_arm")


def angles(rows=26, size=0.2):
    phase = np.linspace(0.0, 2 * np.pi, rows)[:, None]
    return HOME + size * (1 - np.cos(phase)) * np.array([1.0, -0.5, 0.5])


def written(path, values, names=JOINTS):
    rows = [",".join(names), *(",".join(f"{value:.9f}" for value in row) for row in values)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(rows) + "\n")
    return path


def test_a_slow_motion_goes_through_its_angles_when_they_are_due(robot, tmp_path):
    values = angles()
    file = written(tmp_path / "wave.txt", values)
    (plan,) = plans_of_files([file], robot, tmp_path / "plans", rate_hz=10.0)
    at = np.round((plan.start_s + np.arange(len(values)) / 10.0) * plan.rate_hz).astype(int)
    np.testing.assert_allclose(plan.position[at], values, atol=1e-8)
    assert plan.id == "wave"
    assert plan.details == {"file": "wave.txt", "speed": 1.0}
    assert plan.end_s - plan.start_s == pytest.approx(2.5)
    for ends in (plan.velocity[[0, -1]], np.diff(plan.position, axis=0)[[0, -1]]):
        assert not ends.any()


def test_a_motion_that_is_too_fast_is_slowed_down_and_no_more_than_that(tmp_path):
    panda = load_robot("panda")
    scene = Scene(panda)
    phase = np.linspace(0.0, 2 * np.pi, 26)[:, None]
    values = scene.home + 0.2 * (1 - np.cos(phase))
    file = written(tmp_path / "wave.txt", values, panda.joint_names)
    (plan,) = plans_of_files([file], panda, tmp_path / "plans", rate_hz=50.0)
    assert plan.details["speed"] < 1.0
    shares = [
        np.abs(getattr(plan, name)).max(axis=0) / getattr(scene.limits, name) for name in ("velocity", "acceleration")
    ]
    assert 0.9 < max(shares[0].max(), np.sqrt(shares[1].max())) <= 1.0
    np.testing.assert_allclose(
        np.ptp(plan.position, axis=0), np.ptp(values, axis=0), atol=3e-3
    )  # peaks lie between rows


def test_where_the_model_has_no_limits_those_of_the_files_hold(robot, tmp_path):
    file = written(tmp_path / "wave.txt", angles())
    plans = plans_of_files([file], robot, tmp_path / "plans", rate_hz=50.0)
    (plan,) = plans
    assert plan.details["speed"] == 1.0
    limits = plans.scene(robot).limits
    np.testing.assert_allclose(limits.velocity, np.abs(plan.velocity).max(axis=0), rtol=0.01)


def test_names_decide_and_not_places(robot, tmp_path):
    values = angles()
    both = [written(tmp_path / "a.txt", values), written(tmp_path / "b.csv", values[:, ::-1], JOINTS[::-1])]
    first, second = plans_of_files(both, robot, tmp_path / "plans", rate_hz=10.0)
    np.testing.assert_array_equal(first.position, second.position)


def test_joints_without_a_column_stay_at_home_and_strange_columns_are_left_out(robot, tmp_path):
    values = angles()[:, :2]
    file = written(tmp_path / "wave.txt", np.column_stack([values[:, 0], values[:, 1]]), ("yaw", "left_toe"))
    (plan,) = plans_of_files([file], robot, tmp_path / "plans", rate_hz=10.0)
    assert plan.moving == ("yaw",)
    np.testing.assert_array_equal(plan.position[:, 1:], np.tile(plan.position[0, 1:], (len(plan.position), 1)))


@pytest.mark.parametrize(
    ("names", "change", "error", "words"),
    [
        (("a", "b", "c"), lambda values: values, NameMismatch, "names no joint of demo_arm"),
        (JOINTS, lambda values: values[:1], DataError, "is no motion"),
        (JOINTS, lambda values: values + 9.0, TrueupError, "."),
        (JOINTS, lambda values: np.where(values > values.mean(), np.nan, values), DataError, "is no motion"),
    ],
)
def test_what_is_no_motion_of_the_robot_is_refused(robot, tmp_path, names, change, error, words):
    file = written(tmp_path / "wave.txt", change(angles()), names)
    with pytest.raises(error, match=words):
        plans_of_files([file], robot, tmp_path / "plans")


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, np.inf, np.nan])
def test_rates_that_are_none_are_refused(robot, tmp_path, rate_hz):
    with pytest.raises(ConfigError, match="rate of motion files"):
        plans_of_files([written(tmp_path / "a.txt", angles())], robot, tmp_path / "plans", rate_hz=rate_hz)


def test_files_and_folders_of_them_are_found_and_plan_sets_are_none(robot, tmp_path):
    file = written(tmp_path / "motions" / "wave.txt", angles())
    assert motion_files(tmp_path / "motions") == (file,)
    assert motion_files(file) == (file,)
    assert motion_files(tmp_path / "nothing") == motion_files(tmp_path / "a.yaml") == ()
    plans_of_files([file], robot, tmp_path / "plans", rate_hz=10.0)
    assert motion_files(tmp_path / "plans") == ()


def test_record_takes_them_by_their_folder(robot, tmp_path):
    written(tmp_path / "motions" / "wave.txt", angles())
    plans = plans_named(str(tmp_path / "motions"), robot=robot, rate_hz=10.0)
    assert isinstance(plans, PlanSet)
    assert list(plans.ids()) == ["wave"]
    with pytest.raises(ConfigError, match="recorded as they are"):
        plans_named(str(tmp_path / "motions"), robot=robot, scale=0.5)
