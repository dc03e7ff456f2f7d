"""`trueup init`: a robot.yaml from a model and logs, which reads the logs as they were meant."""

import json
from dataclasses import replace

import numpy as np
import pytest

from check.arm_logs import arm, changed, logs, mirrored, scaled
from dataset.test_import_rosbag import ARRAY, JOINT_STATE, ROS2, START_NS, array, state, write_bag
from trueup.align import JointMap
from trueup.cli.main import main
from trueup.core.check_result import Finding, Mend
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import ConfigError, DataError, OutputExists, TrueupError
from trueup.robots import load_robot
from trueup.stages import draft, plan_import
from trueup.stages.importing import checked
from trueup.stages.motions import motions_of

NAMES = {"yaw": "J1_rotation", "lift": "J2_lift", "elbow": "J3_elbow"}
DEGREES = [scaled(joint, 180 / np.pi) for joint in range(3)]
# Middle and half the width of the range that the model states for each joint.
RANGES = [np.radians((0.5 * (high + low), 0.5 * (high - low))) for low, high in ((-170, 170), (-100, 120), (-30, 145))]
# What is done to the logs, and what robot.yaml says of each joint then, and of the mirrored one.
CHANGES = {
    "as they are": ([], {}, {}),
    "mirrored": ([mirrored(1)], {}, {"sign": -1}),
    "degrees": (DEGREES, {"log_unit": "deg"}, {}),
    "mirrored and in degrees": ([mirrored(1), *DEGREES], {"log_unit": "deg"}, {"sign": -1}),
    "ticks": (
        [scaled(joint, 4096 / (2 * np.pi), 2048.0) for joint in range(3)],
        {"offset": -np.pi, "scale": 2 * np.pi / 4096},
        {},
    ),
    "percent": (
        [scaled(joint, 100 / half, -100 * middle / half) for joint, (middle, half) in enumerate(RANGES)],
        {"log_unit": "%"},
        {"scale": RANGES[1][1], "offset": RANGES[1][0]},
    ),
}


@pytest.fixture(scope="module", params=["position", "torque"])
def made(request, tmp_path_factory):
    robot, path = arm(tmp_path_factory.mktemp("arm"), request.param)
    return robot, path, logs(robot, path, np.random.default_rng(1))


def renamed(series, names, order):
    columns = [series.joints.index(joint) for joint in order]
    return TimeSeries(
        series.time_s,
        tuple(names[joint] for joint in order),
        {key: values[:, columns] for key, values in series.signals.items()},
        {key: tuple(units[column] for column in columns) for key, units in series.units.items()},
    )


def written(folder, episodes, *, names=NAMES, order=("elbow", "yaw", "lift")):
    """A dataset of these motions, its joints called and ordered otherwise than the model's."""
    with DatasetWriter.create(folder, DatasetInfo(robot="")) as writer:
        for episode in episodes:
            measured, command = (renamed(item, names, order) for item in (episode.measured, episode.command))
            writer.append(replace(episode, measured=measured, command=command))
    return folder


@pytest.mark.long
@pytest.mark.parametrize("change", CHANGES)
def test_logs_are_read_as_they_were_meant(made, change, tmp_path):
    robot, path, episodes = made
    changes, all_of_them, second = CHANGES[change]
    strange = episodes
    for own in changes:
        strange = changed(strange, own)
    found = draft(path, written(tmp_path / "data", strange), out=tmp_path / "out")
    if change == "mirrored and in degrees":
        assert any("lift counts the other way round" in line for line in found.taken), found.taken
    described = load_robot(tmp_path / "out" / "robot.yaml")
    assert described.joints == found.robot.joints
    assert described.controller.signal == robot.controller.signal
    read = JointMap.from_dict(described.joint_rules()).of_episode(next(iter(Dataset(tmp_path / "data"))))
    np.testing.assert_allclose(
        read.measured.select(robot.joint_names)["position"], episodes[0].measured["position"], atol=2e-3
    )
    for joint in described.joints:
        assert joint.log == NAMES[joint.name]
        for key, value in (all_of_them | second if joint.name == "lift" else all_of_them).items():
            said = getattr(joint, key)
            assert said == (pytest.approx(value) if isinstance(value, float) else value)


@pytest.mark.long
@pytest.mark.parametrize("change", ["degrees", "ticks"])
@pytest.mark.parametrize("made", ["position"], indirect=True)
def test_units_that_no_log_states_break_no_motion(made, change, tmp_path):
    """What robot.yaml says of units counts for the quality of a recording, also where that was imported without it."""
    _, path, episodes = made
    still = [stuck(episode) for episode in episodes]
    strange = still
    for own in CHANGES[change][0]:
        strange = changed(strange, own)
    robot = draft(path, written(tmp_path / "data", strange), out=tmp_path / "out").robot
    assert not any(kinds(checked(episode)) for episode in still)
    assert not any(kinds(checked(episode, robot)) for episode in Dataset(tmp_path / "data"))
    with DatasetWriter.create(tmp_path / "imported", DatasetInfo(robot="")) as writer:
        for episode in map(checked, Dataset(tmp_path / "data")):
            assert "frozen" in kinds(episode)
            writer.append(replace(episode, meta=replace(episode.meta, split="train")))
    fitted = motions_of(Dataset(tmp_path / "imported"), robot).by_split["train"]
    assert not any(kinds(episode) for episode in fitted)


def stuck(episode):
    """Stiction holds the robot for a second, while its command goes on by half a degree."""
    rows = slice(0, int(np.searchsorted(episode.measured.time_s, episode.measured.time_s[0] + 1.0)))
    position, velocity = (episode.measured[name].copy() for name in ("position", "velocity"))
    position[rows], velocity[rows] = position[rows.stop], 0.0
    told = episode.command["position"].copy()
    early = episode.command.time_s < episode.command.time_s[0] + 1.0
    told[early] = position[0] + np.linspace(0.0, np.radians(0.5), np.count_nonzero(early))[:, None]
    signals = {**episode.measured.signals, "position": position, "velocity": velocity}
    return replace(
        episode,
        measured=replace(episode.measured, signals=signals),
        command=replace(episode.command, signals={**episode.command.signals, "position": told}),
    )


def kinds(episode):
    return sorted({flag.kind for flag in episode.meta.flags if flag.severity == "warning"})


@pytest.mark.parametrize("made", ["torque"], indirect=True)
def test_a_robot_follows_what_most_motions_command(made, tmp_path):
    """Some recordings of a torque-driven rig hold the path of a controller above it, too."""
    _, path, episodes = made
    command = episodes[0].command
    path_too = {**command.signals, "position": episodes[0].measured["position"][: len(command)]}
    units = {**command.units, "position": ("rad",) * len(command.joints)}
    first = replace(episodes[0], command=replace(command, signals=path_too, units=units))
    found = draft(path, written(tmp_path / "data", [first, *episodes[1:]]), out=tmp_path / "out")
    assert found.robot.controller.signal == "torque"
    assert "invented" not in (tmp_path / "out" / "robot.yaml").read_text()
    assert not found.robot.controller.per_joint


@pytest.mark.long
def test_names_that_say_nothing_leave_it_to_the_motion(made, tmp_path):
    """In an order that is not the model's, and that no single exchange mends."""
    _, path, episodes = made
    names = {"elbow": "q1", "yaw": "q2", "lift": "q3"}
    found = draft(path, written(tmp_path / "data", episodes, names=names), ask=lambda _: True)
    assert {joint.name: joint.log for joint in found.robot.joints} == names


def test_what_is_left_over_on_either_side_is_said(made, tmp_path):
    _, path, episodes = made
    names = {"yaw": "yaw", "lift": "lift", "elbow": "camera"}
    found = draft(path, written(tmp_path / "data", episodes, names=names))
    # One name and one joint that are left over belong together, and somebody should look.
    assert any("elbow" in line and "order" in line for line in found.unsure)
    assert found.files == ()


def test_another_robot_is_refused_with_both_lists(made, tmp_path):
    _, path, episodes = made
    names = {"yaw": "left_knee", "lift": "left_hip", "elbow": "left_ankle"}
    with pytest.raises(DataError, match="no joint of the logs"):
        draft(path, written(tmp_path / "data", episodes, names=names, order=("yaw", "lift")))


@pytest.mark.long
def test_what_is_likely_is_asked(made, tmp_path):
    """A servo whose commands are stamped late is nothing that stops a fit, and may be written down."""
    robot, path, episodes = made
    if robot.controller.signal != "position":
        pytest.skip("positions tell it")
    late = [replace(item, command=replace(item.command, time_s=item.command.time_s + 0.05)) for item in episodes]
    data = written(tmp_path / "data", late)
    asked = []
    left = draft(path, data, ask=lambda finding: bool(asked.append(finding)))
    assert asked
    assert left.robot.clock.command_shift_s == 0.0
    assert [finding.kind for finding in left.findings] == [finding.kind for finding in asked]
    taken = draft(path, data, ask=lambda _: True)
    assert taken.robot != left.robot


def test_what_is_said_in_words_only_is_left_as_a_finding(made, tmp_path, monkeypatch):
    """Some findings about robot.yaml have no lines to copy: they used to end `init --yes` as a bug."""
    _robot, path, episodes = made
    finding = Finding("unlike", "likely", "Nothing explains it.", (), (Mend("robot.yaml", "", "look at the model"),))
    monkeypatch.setattr("trueup.check.check_motions", lambda *_: ([finding], []))
    found = draft(path, written(tmp_path / "data", episodes), ask=lambda _: True)
    assert found.findings == (finding,)


def test_nothing_is_written_over(made, tmp_path):
    _, path, _ = made
    (tmp_path / "robot.yaml").write_text("mine")
    with pytest.raises(OutputExists):
        draft(path, out=tmp_path)
    assert (tmp_path / "robot.yaml").read_text() == "mine"


def test_a_call_that_failed_does_not_stand_in_the_way_of_the_next(made, tmp_path, capsys):
    """Names of columns are found, and written down, before the model turns out to be broken."""
    robot, path, episodes = made
    signal = robot.controller.signal
    own = episodes[0]
    told, names = own.command[signal], own.measured.joints
    columns = [own.command.time_s, *own.measured["position"].T, *told.T]
    head = ["t_s", *(f"{name}_pos_actual" for name in names), *(f"{name}_{signal}_cmd" for name in names)]
    np.savetxt(tmp_path / "run.csv", np.stack(columns, axis=1), delimiter=",", header=",".join(head), comments="")
    out, broken = tmp_path / "out", tmp_path / "broken.xml"
    broken.write_text(path.read_text().replace("<mujoco", "<mujoco><compiler angle='x'/", 1))
    with pytest.raises(TrueupError):
        draft(broken, tmp_path / "run.csv", out=out)
    assert (out / "mapping.yaml").exists()
    found = draft(path, tmp_path / "run.csv", out=out)
    assert out / "mapping.yaml" in found.files
    # What init has left beside robot.yaml reads these logs elsewhere, too.
    with pytest.raises(SystemExit) as left:
        main(["check", str(tmp_path / "run.csv"), "--robot", str(out / "robot.yaml")])
    assert left.value.code == 0, capsys.readouterr().err
    # Somebody else's is not written over.
    (out / "robot.yaml").unlink()
    (out / "mapping.yaml").write_text("mine: true")
    with pytest.raises(OutputExists):
        draft(path, tmp_path / "run.csv", out=out)
    assert (out / "mapping.yaml").read_text() == "mine: true"


def test_a_close_needs_no_robot_yaml(made, tmp_path, capsys):
    robot, path, episodes = made
    data = written(tmp_path / "data", episodes, names={name: name for name in NAMES})
    with pytest.raises(SystemExit) as left:
        main(["close", str(data), "--model", str(path), "--until", "gap", "--out", str(tmp_path / "out")])
    assert left.value.code == 0, capsys.readouterr().err
    assert load_robot(tmp_path / "out" / "robot.yaml").joint_names == robot.joint_names


def test_a_close_of_no_robot_says_what_is_missing(made, tmp_path, capsys):
    _, _, episodes = made
    data = written(tmp_path / "data", episodes)
    with pytest.raises(SystemExit) as left:
        main(["close", str(data), "--out", str(tmp_path / "out")])
    assert left.value.code == 2
    assert "--model" in capsys.readouterr().err


@pytest.mark.long
def test_a_calibration_of_lerobot_says_units_and_zeros(made, tmp_path):
    """Logs as LeRobot writes them from the counts of calibrated motors, back to the angles that made them."""
    _, path, episodes = made
    motors = {"q1": (100, 4000, 0), "q2": (800, 3500, 1), "q3_gripper": (1600, 3800, 0)}
    names = dict(zip(("yaw", "lift", "elbow"), motors, strict=True))
    calibration = tmp_path / "arm.json"
    calibration.write_text(
        json.dumps(
            {
                name: {"id": 1, "drive_mode": mode, "homing_offset": -5, "range_min": low, "range_max": high}
                for name, (low, high, mode) in motors.items()
            }
        )
    )
    strange = episodes
    for joint, (low, high, mode) in enumerate(motors.values()):
        step, share = 2 * np.pi / 4096, 100.0 if joint == 2 else 200.0
        by, more = share / (high - low) / step, (2047 - low) * share / (high - low) - (0.0 if joint == 2 else 100.0)
        strange = changed(strange, scaled(joint, -by if mode else by, -more if mode else more))
    data = written(tmp_path / "data", strange, names=names)
    found = draft(path, data, calibration=calibration)
    read = JointMap.from_dict(found.robot.joint_rules()).of_episode(next(iter(Dataset(data))))
    np.testing.assert_allclose(
        read.measured.select(found.robot.joint_names)["position"], episodes[0].measured["position"], atol=1e-5
    )
    with pytest.raises(ConfigError, match="no calibration of LeRobot"):
        draft(path, data, calibration=_file(tmp_path / "other.json", "{}"))
    with pytest.raises(DataError, match="another robot"):
        draft(path, data, calibration=_file(tmp_path / "other.json", calibration.read_text().replace('"q', '"w')))


def _file(path, text):
    path.write_text(text)
    return path


def bag_of_arrays(path, episode, order, *, still=False):
    """A bag whose commands come in an array, in another order than the joint states."""
    times = (START_NS + np.round(1e9 * episode.measured.time_s).astype(int)).tolist()
    told = episode.command["position"][:, order] * (0.0 if still else 1.0)
    rows = np.searchsorted(episode.command.time_s, episode.measured.time_s, side="right") - 1
    measured = [
        (ns, state(ROS2, ns, episode.measured.joints, row))
        for ns, row in zip(times, episode.measured["position"], strict=True)
    ]
    commands = [(ns, array(ROS2, told[max(row, 0)])) for ns, row in zip(times, rows, strict=True)]
    topics = {"/joint_states": (JOINT_STATE, measured), "/forward_position_controller/commands": (ARRAY, commands)}
    return write_bag(path, topics)


def test_commands_in_an_array_get_the_names_of_those_that_followed(tmp_path):
    robot, path = arm(tmp_path, "position")
    (episode, *_) = logs(robot, path, np.random.default_rng(1))
    order = [2, 0, 1]
    source = bag_of_arrays(tmp_path / "run", episode, order)
    found = draft(path, source, out=tmp_path / "out")
    names = [episode.measured.joints[place] for place in order]
    assert f"command_joints: [{', '.join(names)}]" in (tmp_path / "out" / "mapping.yaml").read_text()
    assert any("unnamed command columns, matched by motion" in line for line in found.taken)
    plan = plan_import(source, options=ImportOptions(mapping=tmp_path / "out" / "mapping.yaml"))
    assert plan.episodes[0].load().command.joints == tuple(names)


@pytest.mark.parametrize("case", ["nothing moves", "two move alike"])
def test_commands_in_an_array_that_could_be_those_of_other_joints_stay_without_names(tmp_path, case):
    robot, path = arm(tmp_path, "position")
    (episode, *_) = logs(robot, path, np.random.default_rng(1))
    if case == "two move alike":
        for series in (episode.measured, episode.command):
            series["position"][:, 1] = 0.5 * series["position"][:, 0]
    source = bag_of_arrays(tmp_path / "run", episode, [2, 0, 1], still=case == "nothing moves")
    with pytest.raises(ConfigError, match="carries no joint names"):
        draft(path, source, out=tmp_path / "out")
    assert not (tmp_path / "out" / "mapping.yaml").exists()
