"""What LeRobot's calibration of an arm says of its logs: which angle a number of the log is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json
from trueup.errors import ConfigError
from trueup.robots import RobotSpec

# Counts of an encoder per turn; calibrated arms are at half a turn in the middle pose, where models have their zero.
_COUNTS, _MIDDLE = 4096, 2047
_STEP = 2.0 * math.pi / _COUNTS
_KEYS = ("drive_mode", "range_min", "range_max")
# What is logged from 0 to 100 of its range, and not from -100 to 100.
_ONE_SIDED = "gripper"


@dataclass(frozen=True)
class Motor:
    """One motor of a calibration.

    Attributes:
        low: counts at one end of its range.
        high: counts at the other.
        mirrored: whether it counts the other way round.
    """

    low: float
    high: float
    mirrored: bool


def read_calibration(path: Path) -> dict[str, Motor]:
    """Motors by name, from a JSON file as `lerobot-calibrate` writes it.

    Raises:
        ConfigError: it is no such file.
        DataError: it cannot be read.
    """
    tree: Any = read_json(path)
    motors = {}
    for name, entry in tree.items() if isinstance(tree, Mapping) else ():
        if not isinstance(entry, Mapping) or not all(isinstance(entry.get(key), int | float) for key in _KEYS):
            continue
        if entry["range_max"] > entry["range_min"]:
            motors[str(name)] = Motor(float(entry["range_min"]), float(entry["range_max"]), bool(entry["drive_mode"]))
    if not motors:
        raise ConfigError(
            f"{path} is no calibration of LeRobot",
            expected=f"a JSON file with {', '.join(_KEYS)} for each motor",
            hint="It lies in ~/.cache/huggingface/lerobot/calibration/robots/TYPE/NAME.json.",
        )
    return motors


def calibrated(robot: RobotSpec, motors: Mapping[str, Motor], *, degrees: bool) -> tuple[RobotSpec, list[str]]:
    """The robot whose joints are read from what LeRobot has logged, and the joints of which the calibration speaks.

    With `m` the middle of a motor's range of counts and `w` its width, a log of `v` is the angle
    `(m - 2047) s + v w s / 200` with `s = 2 pi / 4096`; the gripper, from 0 to 100, `(low - 2047) s + v w s / 100`; in
    degrees, `(m - 2047) s + v pi / 180`. Of mirrored motors, shares of the range count from the other end.

    Args:
        robot: whose joints have their names in the logs.
        motors: of the calibration.
        degrees: whether the log was written with `use_degrees`.
    """
    joints, told = [], []
    for joint in robot.joints:
        motor = motors.get((joint.log or joint.name).removesuffix(".pos"))
        if motor is None:
            joints.append(joint)
            continue
        one_sided, width = _ONE_SIDED in (joint.log or joint.name), motor.high - motor.low
        zero, unit, scale = 0.5 * (motor.low + motor.high), "%", 0.5 * width * _STEP
        if one_sided:
            zero, scale = motor.high if motor.mirrored else motor.low, width * _STEP
        elif degrees:
            unit, scale = "deg", 1.0
        sign: Literal[1, -1] = -1 if motor.mirrored and unit == "%" else 1
        offset = float(f"{(zero - _MIDDLE) * _STEP:.7g}")
        joints.append(replace(joint, sign=sign, scale=float(f"{scale:.7g}"), offset=offset, log_unit=unit))
        told.append(joint.name)
    return replace(robot, joints=tuple(joints)), told
