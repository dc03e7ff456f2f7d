"""What the user states about logs that do not say it themselves: joint names, units, robot, payload.

The mapping file of the formats with a fixed layout (bags, HDF5, LeRobot); every key is optional:

    joints: [shoulder, elbow]        # names of the columns in the file's order; or one list per group
    command_joints: [elbow]          # only if the command has other columns than the measurement
    command_signal: torque           # what an array without names commands; else read from its topic
    units: {position: deg, position.gripper: "%"}
    time_unit: ms
    robot: so101
    unit: left arm of lab 2
    payload_kg: 0.5
    kp_setting: 400                  # of the drives' position gain, in the unit of their firmware
    condition: standing
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from trueup.core.config import parse_yaml, refuse_large_yaml
from trueup.core.timeseries import TimeSeries
from trueup.core.units import SI_UNIT, UNITS
from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.files import read_text
from trueup.dataset.importers.gain_setting import kp_setting_of
from trueup.dataset.importers.units import override_units
from trueup.errors import ConfigError, DataError

_KEYS = (
    "joints",
    "command_joints",
    "command_signal",
    "units",
    "time_unit",
    "robot",
    "unit",
    "payload_kg",
    "kp_setting",
    "condition",
)


class UnnamedCommand(ConfigError):
    """Commands in arrays without names of joints.

    Attributes:
        count: of joints.
    """

    count = 0


@dataclass(frozen=True)
class Stated:
    """The content of a mapping file, joined with the options (options win).

    Attributes:
        joints: group name -> joint names; the group is "" when one list is given.
        command_joints: names of the command's columns, or empty when they are those of the measurement.
        command_signal: signal that an array without names commands, or empty.
        units: `signal` or `signal.joint` -> unit.
        time_unit: unit of the stamps.
        robot: name of the kind of robot.
        unit: which individual robot.
        payload_kg: payload [kg].
        kp_setting: of the drives' position gain, in the unit of their firmware.
        condition: base condition or gait.
    """

    joints: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    command_joints: tuple[str, ...] = ()
    command_signal: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    time_unit: str = "s"
    robot: str = ""
    unit: str = ""
    payload_kg: float | None = None
    kp_setting: float | None = None
    condition: str = ""


def read_stated(options: ImportOptions) -> Stated:
    """Read the mapping file of the options, if there is one.

    Raises:
        ConfigError: the file is no YAML mapping, has a key that is not known, or a value of the wrong kind.
    """
    if options.mapping is None:
        return Stated(units=options.units, robot=options.robot)
    source = options.mapping
    content = _read_yaml(source)
    unknown = [str(key) for key in content if key not in _KEYS]
    if unknown:
        raise ConfigError(f"{source} has keys that this importer does not know", got=unknown, available=_KEYS)
    signal = _text(content, "command_signal", source)
    if signal and signal not in SI_UNIT:
        raise ConfigError(f"{source}: `command_signal` is no signal", got=signal, available=SI_UNIT)
    time_unit = _text(content, "time_unit", source) or "s"
    if UNITS.get(time_unit, ("",))[0] != "time":
        raise ConfigError(f"{source}: `time_unit` is no unit of time", got=time_unit, expected="s, ms, us or ns")
    return Stated(
        joints=_joint_lists(content.get("joints"), f"{source}: `joints`"),
        command_joints=_names(content.get("command_joints") or [], f"{source}: `command_joints`"),
        command_signal=signal,
        units={**_units(content.get("units"), source), **options.units},
        time_unit=time_unit,
        robot=options.robot or _text(content, "robot", source),
        unit=_text(content, "unit", source),
        payload_kg=_payload(content.get("payload_kg"), source),
        kp_setting=kp_setting_of(content.get("kp_setting"), f"{source}: `kp_setting`", error=ConfigError),
        condition=_text(content, "condition", source),
    )


def with_units(series: TimeSeries, units: Mapping[str, str], joints: Collection[str]) -> TimeSeries:
    """A series with the units that the user stated in place of those that the format implies.

    Args:
        series: command or measured.
        units: `signal` or `signal.joint` -> unit.
        joints: all joints of the episode; the series may have fewer.

    Raises:
        UnitError: a unit is unknown.
        ConfigError: a signal is unknown.
        NameMismatch: a joint is not in the episode.
    """
    elsewhere = set(joints) - set(series.joints)
    own = {key: unit for key, unit in units.items() if key.partition(".")[2] not in elsewhere}
    return replace(series, units=override_units(series.units, series.joints, own))


def _read_yaml(path: Path) -> dict[Any, Any]:
    refuse_large_yaml(path)
    try:
        text = read_text(path)
    except DataError as error:
        raise ConfigError(str(error)) from error
    content = parse_yaml(text, str(path))
    if not isinstance(content, dict):
        raise ConfigError(f"{path} is no YAML mapping", got=type(content).__name__, expected="keys such as `joints:`")
    return content


def _joint_lists(value: Any, where: str) -> dict[str, tuple[str, ...]]:
    if value is None:
        return {}
    if isinstance(value, dict):
        return {str(group): _names(names, f"{where} of {group}") for group, names in value.items()}
    return {"": _names(value, where)}


def _names(value: Any, where: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(name, str) and name for name in value):
        raise ConfigError(f"{where} is no list of names", got=value, expected="a list such as [shoulder, elbow]")
    if len(set(value)) != len(value):
        raise ConfigError(f"{where} names a joint twice", got=value)
    return tuple(value)


def _text(content: Mapping[Any, Any], key: str, source: Path) -> str:
    value = content.get(key)
    if value is not None and not isinstance(value, str | int | float):
        raise ConfigError(f"{source}: `{key}` is no text", got=value)
    return "" if value is None else str(value)


def _units(value: Any, source: Path) -> dict[str, str]:
    if value is None:
        return {}
    if not isinstance(value, dict) or not all(isinstance(unit, str | int) for unit in value.values()):
        raise ConfigError(f"{source}: `units` is no mapping of signals to units", got=value, expected="{position: deg}")
    return {str(key): str(unit) for key, unit in value.items()}


def _payload(value: Any, source: Path) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
        raise ConfigError(f"{source}: `payload_kg` is no mass", got=value, expected="kilograms, 0 or more")
    return float(value)
