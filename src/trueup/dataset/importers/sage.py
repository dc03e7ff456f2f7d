"""SAGE folders: one folder per motion with control.csv, state_motor.csv and joint_list.txt.

Stamps are in microseconds, every vector is a JSON list in quotes. Layout of isaac-sim2real/sage.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset.importers.base import EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.beside import plan_with
from trueup.dataset.importers.clock import common_origin, shifted, usable_clock
from trueup.dataset.importers.files import bytes_hash, episode_id, inside, read_bytes, read_text
from trueup.dataset.importers.text_table import TextTable
from trueup.dataset.importers.units import override_units
from trueup.errors import DataError, FormatError, NameMismatch

NAME = "sage"
LOOKS_FOR = "folders with control.csv, state_motor.csv and joint_list.txt"
EPISODE = "a folder"
ASSUMES = "µs; rad, rad/s, Nm"

_FILES = ("control.csv", "state_motor.csv", "joint_list.txt")
_SIGNALS = {"positions": "position", "velocities": "velocity", "torques": "torque"}
_UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
_REQUIRED = {"command": ("positions",), "measured": ("positions", "velocities", "torques")}
_TICKS_PER_SECOND = 1e6
_LONGEST_STEP_S = 0.5

# What a number in a list is about.
_JOINT = "joint of joint_list.txt"


def detects(path: Path) -> bool:
    """Whether `path` is a motion folder or holds one."""
    try:
        return path.is_dir() and (_is_motion(path) or any(_is_motion(child) for child in path.iterdir()))
    except OSError:
        return False


def scan(path: Path, options: ImportOptions) -> ImportPlan:
    """List the motions below `path`, or the one motion that it is.

    For a single motion, `split.json`, the licence and `model/` are looked for beside its folder.

    Raises:
        FormatError: there is no motion.
        ConfigError: an option that is not read.
        DataError: a folder cannot be read or a link leads out of it.
    """
    options.refuse_others(NAME, "units")
    if path.is_dir() and _is_motion(path):
        folders = [path]
        root = path.resolve().parent
    else:
        root = path
        try:
            folders = sorted(child for child in path.iterdir() if child.is_dir() and not child.name.startswith("."))
        except OSError as error:
            raise DataError(f"cannot read the folder {path}", got=error.strerror or str(error)) from error
    motions = {folder: episode_id(folder.resolve().name) for folder in folders if _is_motion(folder)}
    if not motions:
        raise FormatError(f"{path} holds no SAGE motion", expected=LOOKS_FOR)
    skipped = [folder.name for folder in folders if folder not in motions and folder.name != "model"]
    sources = [
        EpisodeSource(
            id=name,
            load=partial(_load, root, folder, name, options),
            bytes=sum((folder / file).stat().st_size for file in _FILES if (folder / file).is_file()),
            source=folder.name,
        )
        for folder, name in motions.items()
    ]
    return plan_with(
        NAME,
        path,
        root,
        sources,
        robot=options.robot,
        notes=(
            "units are SAGE's: rad, rad/s, Nm; state those of other joints, e.g. position.Jaw=1 for parts of a range",
            "torque is stored as logged: on some robots an unsigned estimate from the motor current",
            *([f"skipped {len(skipped)} folders without {_FILES[1]}, e.g. {skipped[0]}"] if skipped else []),
        ),
    )


def _is_motion(folder: Path) -> bool:
    return (folder / "state_motor.csv").is_file() or (folder / "control.csv").is_file()


def _load(root: Path, folder: Path, name: str, options: ImportOptions) -> Episode:
    """Read one motion."""
    paths = [inside(root, inside(folder, folder / file)) for file in _FILES]
    control, state = (read_bytes(path) for path in paths[:2])
    joints = _joints(paths[2])
    command, command_flags = _series(paths[0], control, joints, "command", options.units)
    measured, measured_flags = _series(paths[1], state, joints, "measured", options.units)
    origin = common_origin(command.time_s, measured.time_s)
    command, command_flags = shifted(command, command_flags, origin=origin)
    measured, measured_flags = shifted(measured, measured_flags, origin=origin)
    return Episode(
        meta=EpisodeMeta(
            id=name,
            robot=options.robot,
            source=folder.resolve().name,
            source_hash=bytes_hash((control, state, read_bytes(paths[2]))),
            flags=command_flags + measured_flags,
        ),
        measured=measured,
        command=command,
    )


def _joints(path: Path) -> tuple[str, ...]:
    """Joint names, one a line."""
    joints = tuple(line.strip() for line in read_text(path).splitlines() if line.strip())
    if not joints:
        raise DataError(f"{path} names no joint")
    if len(set(joints)) < len(joints):
        raise NameMismatch(f"{path} names a joint twice", left=joints, right=sorted(set(joints)), right_name="distinct")
    return joints


def _series(
    path: Path, data: bytes, joints: tuple[str, ...], series: str, overrides: Mapping[str, str]
) -> tuple[TimeSeries, tuple[Flag, ...]]:
    """The signals of one file, on a clock in seconds that is not shifted yet."""
    table = TextTable(path, data)
    wanted = [column for column in _SIGNALS if column in table.names or column in _REQUIRED[series]]
    text = table.read(["timestamp", *wanted])
    ticks = table.floats("timestamp", text["timestamp"])
    # Robots' logs count microseconds, and SAGE's simulator seconds.
    in_seconds = ticks.size > 1 and float(np.median(np.diff(ticks))) < _LONGEST_STEP_S
    time_s = ticks if in_seconds else ticks / _TICKS_PER_SECOND
    rows, flags = usable_clock(time_s, source=str(path), series=series)
    signals = {
        _SIGNALS[column]: table.vectors(column, text[column], width=len(joints), of=_JOINT)[rows] for column in wanted
    }
    units = same_units({signal: _UNITS[signal] for signal in signals}, joints)
    return TimeSeries(
        time_s=time_s[rows], joints=joints, signals=signals, units=override_units(units, joints, overrides)
    ), flags
