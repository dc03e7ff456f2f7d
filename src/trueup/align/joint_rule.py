"""How one joint of a log becomes one joint of the robot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from trueup.core.units import si_factor
from trueup.errors import ConfigError, UnitError

_RATE_UNIT = {
    "velocity": {"rad": "rad/s", "m": "m/s", "1": "1/s"},
    "acceleration": {"rad": "rad/s^2", "m": "m/s^2", "1": "1/s^2"},
}
_EFFORT_UNIT = {"rad": "Nm", "m": "N"}
_POSITION_UNITS = ("rad", "m", "1")


@dataclass(frozen=True)
class JointRule:
    """How one joint of the robot is found in a log: `position = sign * scale * position_log + offset`.

    The position of the log is taken in SI first (deg to rad, mm to m). Velocity and acceleration are mapped
    alike without the offset. A torque is multiplied by `sign / scale`, so that power is the same on both sides:
    `torque * velocity = torque_log * velocity_log`. Current takes the sign only (it belongs to the motor, on
    which a gear ratio changes nothing); voltage and temperature stay as they are.

    `scale` has the dimension `unit / log unit`. Where the two differ (a gripper logged as 0..1 of its range), a
    rate that the log already gives in `unit`/s, or an effort in Nm, needs no scale and takes the sign only.

    Attributes:
        joint: the robot's name.
        log: the log's name.
        sign: +1, or -1 if the log counts the other way round.
        scale: robot units per SI unit of the log; a gripper in 0..1: the width of its range.
        offset: the robot's position where the log says 0, in `unit`; a gripper in 0..1: the low end of its range.
        log_unit: unit of the position in the log; None believes what the log says.
        unit: SI unit of the position in the robot, `rad`, `m` or `1`. None: that of the log, except that a ratio
            that is declared, scaled or offset becomes `rad`.
        command: the rule of the commands, where the log speaks of them otherwise than of what was measured.

    Raises:
        ConfigError: the sign is not 1 or -1, the scale is not a positive number, or `unit` is not one of the three.
        UnitError: `log_unit` is unknown, or measures no position.
    """

    joint: str
    log: str
    sign: int = 1
    scale: float = 1.0
    offset: float = 0.0
    log_unit: str | None = None
    unit: str | None = None
    command: JointRule | None = None

    def __post_init__(self) -> None:
        """Refuse a rule that cannot be inverted."""
        if self.sign not in (1, -1):
            raise ConfigError(f"sign of joint {self.joint!r}", got=self.sign, expected="1 or -1")
        if not (math.isfinite(self.scale) and self.scale > 0.0):
            hint = "A joint that counts the other way round has sign: -1."
            raise ConfigError(f"scale of joint {self.joint!r}", got=self.scale, expected="above 0", hint=hint)
        if not math.isfinite(self.offset):
            raise ConfigError(f"offset of joint {self.joint!r}", got=self.offset, expected="a finite number")
        if self.unit not in (None, *_POSITION_UNITS):
            raise ConfigError(f"unit of joint {self.joint!r}", got=self.unit, available=_POSITION_UNITS)
        if self.log_unit is not None:
            _position_unit(self.log_unit, self.joint)

    def units(self, claimed: str) -> tuple[str, str]:
        """SI unit of the position in the log and in the robot, when the log claims the unit `claimed`."""
        source = _position_unit(self.log_unit or claimed, self.joint)
        plain = self.log_unit is None and self.scale == 1.0 and self.offset == 0.0
        target = self.unit or ("rad" if source == "1" and not plain else source)
        return source, target

    def factor(self, signal: str, unit: str, position_unit: str) -> tuple[float, str]:
        """Factor of one signal of the log into the robot's SI unit, and that unit.

        Args:
            signal: name of the signal.
            unit: its unit in the log; for the position the rule's `log_unit` goes first.
            position_unit: unit of the position in the log.

        Raises:
            UnitError: the unit is unknown, or measures something else.
        """
        source, target = self.units(position_unit)
        if signal == "position":
            return self.sign * self.scale * si_factor(self.log_unit or unit)[1], target
        si, factor = si_factor(unit)
        if signal in _RATE_UNIT:
            share, name = _rate(self, signal, si, source, target)
            return self.sign * factor * share, name
        if signal == "torque":
            share, name = _effort(self, si, source, target)
            return self.sign * factor * share, name
        return (self.sign if signal == "current" else 1) * factor, si

    def to_dict(self) -> dict[str, Any]:
        """The log's name and what is not the default, for YAML and JSON."""
        given, plain = asdict(self), asdict(JointRule(self.joint, self.log))
        tree = {"log": self.log} | {key: value for key, value in given.items() if value != plain[key]}
        if self.command is not None:
            other = asdict(self.command)
            tree["command"] = {key: value for key, value in other.items() if key != "command" and value != given[key]}
        return tree

    @staticmethod
    def from_dict(joint: str, entry: object) -> JointRule:
        """Read what `to_dict` wrote; without `log` the joint has the same name in both.

        Raises:
            ConfigError: a key is unknown, or a value is of the wrong kind.
        """
        known = [field.name for field in fields(JointRule) if field.name != "joint"]
        check_keys(f"rule of joint {joint!r}", entry, known)
        assert isinstance(entry, Mapping)
        values: dict[str, Any] = {"log": joint, **entry}
        command = values.pop("command", None)
        if command is not None:
            check_keys(f"`command` of joint {joint!r}", command, [key for key in known if key != "command"])
            values["command"] = JointRule.from_dict(joint, {**values, **command})
        for key in ("sign", "scale", "offset"):
            if key not in values:
                continue
            if isinstance(values[key], bool) or not isinstance(values[key], (int, float)):
                raise ConfigError(f"{key} of joint {joint!r}", got=repr(values[key]), expected="a number")
            values[key] = float(values[key])
        if "sign" in values:
            if not values["sign"].is_integer():
                raise ConfigError(f"sign of joint {joint!r}", got=values["sign"], expected="1 or -1")
            values["sign"] = int(values["sign"])
        for key in ("log", "log_unit", "unit"):
            if key != "log" and type(values.get(key)) is int and values[key] == 1:  # an unquoted 1 in YAML
                values[key] = "1"
            if not isinstance(values.get(key), str if key == "log" else (str, type(None))):
                raise ConfigError(f"{key} of joint {joint!r}", got=repr(values[key]), expected="text")
        return JointRule(joint=joint, **values)


def _effort(rule: JointRule, si: str, source: str, target: str) -> tuple[float, str]:
    log, robot = _EFFORT_UNIT.get(source), _EFFORT_UNIT.get(target)
    if source == target and log in (None, si):
        return 1.0 / rule.scale, si
    if robot in (None, si):  # the joint's own effort already; to a ratio belongs no unit of effort
        return 1.0, si
    if si != log:
        raise UnitError(f"torque of joint {rule.joint!r}", got=si, expected=log or robot)
    return 1.0 / rule.scale, str(robot)


def _rate(rule: JointRule, signal: str, si: str, source: str, target: str) -> tuple[float, str]:
    names = _RATE_UNIT[signal]
    if si == names[source]:
        return rule.scale, names[target]
    # The joint's own rate already; of a joint that stays a ratio, the motor's.
    if si == names[target] or (target == "1" and si in names.values()):
        return 1.0, si
    raise UnitError(f"{signal} of joint {rule.joint!r}", got=si, expected=names[source])


def _position_unit(unit: str, joint: str) -> str:
    si, _ = si_factor(unit)
    if si not in _POSITION_UNITS:
        raise UnitError(f"position of joint {joint!r}", got=unit, expected="an angle, a length or a ratio")
    return si


def check_keys(what: str, data: object, known: Sequence[str]) -> None:
    """Refuse what is not a mapping, and keys that nobody knows.

    Raises:
        ConfigError: either; the known keys are printed.
    """
    if not isinstance(data, Mapping):
        raise ConfigError(what, got=type(data).__name__, expected="a mapping")
    unknown = [key for key in data if key not in known]
    if unknown:
        raise ConfigError(f"unknown keys {unknown} in {what}", available=known)
