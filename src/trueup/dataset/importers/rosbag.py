"""ROS bags: `.bag` (ROS 1), rosbag2 folders (sqlite3 and MCAP) and bare `.mcap` or `.db3` files.

One bag is one episode. Measured is a `sensor_msgs/JointState` topic (effort is stored as torque), a
`control_msgs/DynamicJointState` or the feedback in a controller's state. The command is another joint state, a
`trajectory_msgs/JointTrajectory`, the reference in a controller's state, a `std_msgs/Float64` for each joint, or a
`std_msgs/Float64MultiArray` whose joints the user states. Joints are matched by the names in each message. Goals and
feedback of `FollowJointTrajectory` are read, too, and Unitree's `LowState` and `LowCmd`, whose motors have no names.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from trueup.core.episode import Episode, EpisodeMeta
from trueup.dataset.importers.bagfile import (
    Bag,
    Topic,
    bag_files,
    choose_command,
    choose_measured,
    find_bags,
    is_bag,
    no_command,
    open_bag,
)
from trueup.dataset.importers.bagseries import choose_clocks, command_series, measured_series
from trueup.dataset.importers.bagtopics import read_topics
from trueup.dataset.importers.bagtypes import LOW_STATES
from trueup.dataset.importers.base import EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.beside import plan_with
from trueup.dataset.importers.files import episode_id, files_hash
from trueup.dataset.importers.gain_setting import agreed_kp_setting
from trueup.dataset.importers.imu import with_sensors
from trueup.dataset.importers.stated import Stated, read_stated, with_units
from trueup.dataset.importers.unitree import named_for
from trueup.errors import DataError, FormatError

NAME = "rosbag"
LOOKS_FOR = ".bag, .mcap or .db3 files, or folders with a rosbag2 metadata.yaml"
EPISODE = "a bag"
ASSUMES = "rad, rad/s, Nm; effort is torque"


def detects(path: Path) -> bool:
    """Whether `path` is a bag, or a folder that holds one directly."""
    try:
        return is_bag(path) or (path.is_dir() and any(is_bag(child) for child in path.iterdir()))
    except OSError:
        return False


def scan(path: Path, options: ImportOptions) -> ImportPlan:
    """List the bags at or below `path`.

    Raises:
        FormatError: there is no bag.
        ConfigError: the mapping file is wrong, or the topics of the first bag leave a choice open.
        DataError: a folder cannot be read, or a link leads out of it.
    """
    stated = read_stated(options)
    bags = find_bags(path)
    if not bags:
        raise FormatError(f"{path} holds no bag", expected=LOOKS_FOR)
    root = path if path not in bags else path.resolve().parent
    episodes = []
    for bag in bags:
        source = _relative(bag, root)
        name = episode_id(source.removesuffix(bag.suffix))
        size = sum(file.stat().st_size for file in bag_files(bag))
        episodes.append(EpisodeSource(name, partial(_load, root, bag, name, options, stated), size, source))
    units = "units are those of ROS: rad, rad/s, Nm; name others with --unit, e.g. for prismatic joints"
    return plan_with(
        NAME, path, root, episodes, robot=stated.robot, notes=(*_first_topics(bags, options, stated), units)
    )


def _relative(bag: Path, root: Path) -> str:
    return bag.resolve().relative_to(root.resolve()).as_posix()


def _first_topics(bags: Sequence[Path], options: ImportOptions, stated: Stated) -> tuple[str, ...]:
    """The topics of the first readable bag, so that an open choice is told before anything is imported."""
    for path in bags:
        try:
            with open_bag(path) as bag:
                measured, command = _topics(bag, options)
                lacking = no_command(bag.topics, measured)
        except DataError:
            continue  # its own episode says so when it is loaded
        notes = [f"measured: {measured}", f"command: {', '.join(map(str, command))}" if command else lacking]
        if measured.type in LOW_STATES and not stated.joints:
            notes.append(
                f"motors are named as those of {named_for(measured.type)}; name others with --mapping: `joints:`"
            )
        return tuple(notes)
    return ()


def _topics(bag: Bag, options: ImportOptions) -> tuple[Topic, tuple[Topic, ...]]:
    measured = choose_measured(bag.topics, options.measured_topic, bag.source)
    return measured, choose_command(bag.topics, options.command_topic, measured, bag.source)


def _load(root: Path, path: Path, name: str, options: ImportOptions, stated: Stated) -> Episode:
    """Read one bag."""
    with open_bag(path) as bag:
        measured_topic, command_topics = _topics(bag, options)
        read = read_topics(bag, measured_topic, command_topics, stated)
    if not read.groups[0]:
        raise DataError(f"{path}: {measured_topic} has no values to import", expected="position, velocity or effort")
    groups, flags = [series for series in read.groups if series], read.flags
    clocks, clock_flag = choose_clocks(groups)
    origin = min(int(clock.min()) for series in clocks for clock in series)
    measured, measured_flags = measured_series(groups[0], clocks[0], origin, f"{path}, {measured_topic.name}")
    flags += (clock_flag, *measured_flags)
    command = None
    if command_topics and len(groups) > 1:
        command, command_flags = command_series(groups[1], clocks[1], origin, f"{path}, {command_topics[0].name}")
        flags += command_flags
    stamped = clocks[0][0] is groups[0][0].stamp_ns
    joints = (*measured.joints, *(command.joints if command is not None else ()))
    measured, sensor_flags = with_sensors(
        with_units(measured, stated.units, joints), read.sensors, origin, stamped=stamped
    )
    flags += sensor_flags
    return Episode(
        meta=EpisodeMeta(
            id=name,
            robot=stated.robot,
            unit=stated.unit,
            payload_kg=stated.payload_kg,
            kp_setting=agreed_kp_setting(read.kp_setting, stated.kp_setting, str(path)),
            condition=stated.condition,
            source=_relative(path, root),
            source_hash=files_hash(bag_files(path)),
            flags=flags,
        ),
        measured=measured,
        command=None if command is None else with_units(command, stated.units, joints),
    )
