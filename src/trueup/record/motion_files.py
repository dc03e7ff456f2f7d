"""Motions from files of joint angles, as SAGE keeps them: names of joints, then a row of angles for each step."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from trueup.dataset.importers.files import data_files, episode_id, files_hash, read_bytes
from trueup.dataset.importers.text_table import TextTable
from trueup.errors import ConfigError, DataError, NameMismatch
from trueup.record.motion import MotionSettings, as_plan
from trueup.record.plan import Plan
from trueup.record.planreader import PLANS_NAME, PlanSet
from trueup.record.planstore import store_plans
from trueup.record.profile import Profile
from trueup.record.scene import Scene
from trueup.record.workspace import Workspace
from trueup.robots import RobotSpec, find_model

ENDINGS = (".txt", ".csv")
RATE_HZ = 50.0
# Slowed down by so many per cent more than limits ask for, and so often, until all of them hold.
_MORE, _ROUNDS = 1.001, 20
# What a joint may do at least on the way to a motion that does not move it [rad/s, rad/s^2].
_LEAST = (0.5, 2.0)


def motion_files(path: Path) -> tuple[Path, ...]:
    """Files of motions that a path may be meant to name: it, or those in it; none in the folder of a plan set."""
    if path.is_dir():
        return () if (path / PLANS_NAME).exists() else tuple(file for end in ENDINGS for file in data_files(path, end))
    return (path,) if path.suffix.lower() in ENDINGS and path.is_file() else ()


def plans_of_files(
    files: Sequence[Path],
    robot: RobotSpec,
    folder: Path,
    *,
    model: Path | None = None,
    rate_hz: float = RATE_HZ,
    settings: MotionSettings | None = None,
) -> PlanSet:
    """A plan set of motion files: angles joined by a cubic spline that begins and ends at rest.

    A motion that is too fast for the robot is slowed down, which the details of its plan say; where the model has no
    limits of speeds or accelerations, those of the files are taken for them. Joints that a file does not name stay at
    home; names that the robot does not have are left out.

    Args:
        files: of the motions.
        robot: names of joints count, as in the model or in its logs.
        folder: empty, for the set.
        model: its MJCF or URDF; found as for replay if None.
        rate_hz: rows per second [Hz].
        settings: clock of the plans.

    Raises:
        ConfigError: a rate that is none, or a model that cannot be used.
        DataError: a file has no rows of numbers.
        NameMismatch: a file names no joint of the robot.
        NoPlan: a motion breaks a position limit, or something is in its way.
    """
    if not 0 < rate_hz < np.inf:
        raise ConfigError("the rate of motion files", got=rate_hz, expected="rows per second above 0")
    settings = settings or MotionSettings()
    read = {path: _angles(path, robot) for path in files}
    scene = _scene(robot, find_model(robot, given=model), list(read.values()), rate_hz, settings.clock.rate_hz)
    origin = {
        "by": "files",
        "sha256": files_hash(files),
        "rate_hz": rate_hz,
        "workspace": asdict(Workspace(floor_m=None)),
        "limits": {name: getattr(scene.limits, name).tolist() for name in ("low", "high", "velocity", "acceleration")},
    }
    make = partial(_next, list(read.items()), scene, rate_hz, settings)
    store_plans(make, [episode_id(path.stem) for path in files], robot, folder, origin=origin, model=model)
    return PlanSet(folder)


def _scene(
    robot: RobotSpec, model: Path, motions: Sequence[Mapping[str, Float64[np.ndarray, "T"]]], rate_hz: float, hz: float
) -> Scene:
    """The robot alone; speeds and accelerations of the files are its limits where the model states none."""
    speed, thrust = dict.fromkeys(robot.joint_names, _LEAST[0]), dict.fromkeys(robot.joint_names, _LEAST[1])
    for motion in motions:
        largest = _splined(np.column_stack(list(motion.values())), rate_hz, hz).largest(1.0 / hz)
        for kept, own in zip((speed, thrust), largest, strict=True):
            kept |= {name: max(kept[name], _MORE * value) for name, value in zip(motion, own.tolist(), strict=True)}
    with contextlib.suppress(ConfigError):
        return Scene(robot, model=model)
    with contextlib.suppress(ConfigError):
        return Scene(robot, model=model, acceleration=thrust)
    return Scene(robot, model=model, velocity=speed, acceleration=thrust)


def _angles(path: Path, robot: RobotSpec) -> dict[str, Float64[np.ndarray, "T"]]:
    """Joints of the robot that a file names, and their angles."""
    table = TextTable(path, read_bytes(path), delimiter="")
    columns: Mapping[str, str] = {
        joint.name: name for joint in robot.joints for name in (joint.name, joint.log) if name in table.names
    }
    if not columns:
        raise NameMismatch(
            f"{path} names no joint of {robot.name}",
            left=table.names,
            right=robot.joint_names,
            left_name="the file has",
            right_name="the robot has",
        )
    table.load(list(columns.values()))
    found = {name: table.numbers(column) for name, column in columns.items()}
    rows = len(next(iter(found.values())))
    if rows < 2 or not all(values.ndim == 1 and np.isfinite(values).all() for values in found.values()):
        raise DataError(f"{path} is no motion", got=f"{rows} rows", expected="two rows of angles or more")
    return found


def _next(
    read: Sequence[tuple[Path, Mapping[str, Float64[np.ndarray, "T"]]]],
    scene: Scene,
    rate_hz: float,
    settings: MotionSettings,
    made: Sequence[Plan],
) -> Plan:
    path, motion = read[len(made)]
    still = np.tile(scene.home, (len(next(iter(motion.values()))), 1))
    angles = np.column_stack([motion.get(name, still[:, place]) for place, name in enumerate(scene.joints)])
    moving = tuple(name for name, span in zip(scene.joints, np.ptp(angles, axis=0), strict=True) if span > 0)
    speed, clock = 1.0, settings.clock
    for _ in range(_ROUNDS):
        profile = _splined(angles, speed * rate_hz, clock.rate_hz)
        usage = profile.usage(scene.limits, clock.timestep_s)
        if usage <= 1.0:
            break
        speed /= _MORE * usage
    return as_plan(
        profile, scene, clock, kind="file", moving=moving, id="", details={"file": path.name, "speed": round(speed, 6)}
    )


def _splined(angles: Float64[np.ndarray, "T J"], rate_hz: float, clock_hz: float) -> Profile:
    """The angles at the steps of a clock, whose last is that of the last row."""
    from scipy.interpolate import CubicSpline

    rows = len(angles) - 1
    steps = max(1, round(rows / rate_hz * clock_hz))
    spline = CubicSpline(np.linspace(0.0, steps / clock_hz, rows + 1), angles, bc_type="clamped")
    time_s = np.arange(steps + 1) / clock_hz
    return Profile(spline(time_s), spline(time_s, 1), spline(time_s, 2))
