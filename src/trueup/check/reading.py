"""How a log is read: what a hypothesis changes, and what is written into robot.yaml for it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import yaml
from jaxtyping import Float64, Int

from trueup.align import JointRule
from trueup.core.config import build
from trueup.core.units import si_factor
from trueup.errors import ConfigError
from trueup.robots import JointSpec, RobotSpec

Side = Literal["measured", "command", "both"]
# Units of positions that logs have, by what one is in SI.
_ANGLES, _LENGTHS = ("deg", "mrad", "rev"), ("mm", "cm")


@dataclass(frozen=True, eq=False)
class Columns:
    """How the columns of a series become joints: `factor * values[:, column] + offset`.

    Attributes:
        column: which column each joint is read from, (J,).
        factor: negative where a joint counts the other way round, (J,).
        offset: (J,) [rad or m].
    """

    column: Int[np.ndarray, "J"]
    factor: Float64[np.ndarray, "J"]
    offset: Float64[np.ndarray, "J"]

    @staticmethod
    def as_they_are(count: int) -> Columns:
        """Every joint from its own column."""
        return Columns(np.arange(count), np.ones(count), np.zeros(count))

    def swapped(self, one: int, other: int) -> Columns:
        """Two joints read from each other's columns."""
        return self.permuted({one: other, other: one})

    def permuted(self, columns: dict[int, int]) -> Columns:
        """Joint -> joint whose column it is read from from now on."""
        order = np.arange(self.column.size)
        for joint, source in columns.items():
            order[joint] = source
        return Columns(self.column[order], self.factor[order], self.offset[order])

    def changed(self, joint: int, *, factor: float = 1.0, offset: float = 0.0) -> Columns:
        """One joint multiplied, then moved."""
        factors, offsets = self.factor.copy(), self.offset.copy()
        factors[joint] *= factor
        offsets[joint] = offsets[joint] * factor + offset
        return Columns(self.column, factors, offsets)

    def of(self, values: Float64[np.ndarray, "N J"], *, moved: bool) -> Float64[np.ndarray, "N J"]:
        """The joints; `moved` adds the offsets, which rates have not."""
        found = values[:, self.column] * self.factor
        return np.asarray(found + self.offset if moved else found)

    @property
    def plain(self) -> bool:
        """Whether nothing is changed."""
        ordered = np.array_equal(self.column, np.arange(self.column.size))
        return bool(ordered and np.all(self.factor == 1.0) and np.all(self.offset == 0.0))


@dataclass(frozen=True, eq=False)
class Reading:
    """One way of reading all motions, relative to what robot.yaml says now.

    Attributes:
        measured: columns of positions.
        command: columns of commands.
        lag_s: commands act this much later [s]; negative where the clock of the commands is late.
        clock_scale: seconds per second of the stamps.
        gravity: in place of the model's [m/s2]; None leaves it.
        end_mass_kg: more than the model has at its end.
        signal: what the log's commands are taken for; empty for what they are called.
        uncompensated: nothing else than the drives carries the weight, whatever the description says.
    """

    measured: Columns
    command: Columns
    lag_s: float = 0.0
    clock_scale: float = 1.0
    gravity: tuple[float, float, float] | None = None
    uncompensated: bool = False
    end_mass_kg: float = 0.0
    signal: str = ""

    @staticmethod
    def as_it_is(count: int, lag_s: float = 0.0) -> Reading:
        """What robot.yaml says now."""
        return Reading(Columns.as_they_are(count), Columns.as_they_are(count), lag_s)

    def with_columns(self, side: Side, change: Any) -> Reading:
        """The same with one side's columns, or both, changed by a function."""
        measured = change(self.measured) if side in ("measured", "both") else self.measured
        command = change(self.command) if side in ("command", "both") else self.command
        return replace(self, measured=measured, command=command)


@dataclass(frozen=True)
class Unit:
    """A unit of positions that a log may have without saying so.

    Attributes:
        name: for people.
        log_unit: for robot.yaml.
        scale: of `log_unit`, for robot.yaml.
        si: what one is in the robot's unit.
        zero: the robot's position where the log says 0.
    """

    name: str
    log_unit: str
    scale: float
    si: float
    zero: float = 0.0


def units_of(unit: str, low: float, high: float) -> tuple[Unit, ...]:
    """Units that a position may be logged in.

    Args:
        unit: SI unit of the joint, `rad` or `m`.
        low: lower end of its range; infinite without.
        high: upper end.
    """
    plain = _ANGLES if unit == "rad" else _LENGTHS
    found = [Unit(name, name, 1.0, si_factor(name)[1]) for name in plain]
    if unit == "rad":
        for counts in (4096, 1024):
            step = 2.0 * math.pi / counts
            found.append(Unit(f"encoder counts, {counts} per turn, centre {counts // 2}", "1", step, step, -math.pi))
            found.append(Unit(f"encoder counts, {counts} per turn", "1", step, step))
        step = 2.0 * math.pi * 300.0 / 360.0 / 1023.0
        found.append(Unit("encoder counts, 1023 per 300 degrees, centre 511.5", "1", step, step, -511.5 * step))
    if unit == "rad" and not math.isfinite(high - low):
        low, high = -math.pi, math.pi  # what turns without end is calibrated over a turn
    if math.isfinite(low) and math.isfinite(high) and high > low:
        width, middle = high - low, 0.5 * (high + low)
        found.append(Unit("percent of the range, -100 to 100", "%", 0.5 * width, 0.005 * width, middle))
        found.append(Unit("percent of the range, 0 to 100", "%", width, 0.01 * width, low))
        found.append(Unit("part of the range, -1 to 1", "1", 0.5 * width, 0.5 * width, middle))
        found.append(Unit("part of the range, 0 to 1", "1", width, width, low))
    return tuple(found)


def joint_lines(
    robot: RobotSpec,
    reading: Reading,
    units: Mapping[tuple[str, int], Unit],
    *,
    signal: str,
    lengths: Sequence[str],
    only: Collection[str],
) -> str:
    """The lines of robot.yaml under `joints` for a reading; empty if nothing changes.

    Args:
        robot: its description, which the reading is relative to.
        reading: how the logs are read from now on.
        units: side and joint -> the unit that a factor is, where it is one.
        signal: that the log commands.
        lengths: SI unit of each joint's position.
        only: names of joints whose lines are wanted.
    """
    entries = []
    for index, joint in enumerate(robot.joints):
        measured = _resolved(robot, reading.measured, index, "measured", units.get(("measured", index)))
        if signal == "position":
            command = _resolved(robot, reading.command, index, "command", units.get(("command", index)))
        else:
            command = _of_rate(robot, reading.command, index, measured, signal, lengths[index])
        lines = _difference(joint, measured, command)
        if lines and joint.name in only:
            entries.append({"name": joint.name, **lines})
    return yaml_lines({"joints": entries}) if entries else ""


def _resolved(robot: RobotSpec, columns: Columns, index: int, side: str, unit: Unit | None) -> dict[str, Any]:
    """log, sign, scale, offset and log_unit of the positions of one joint and side."""
    source = robot.joints[int(columns.column[index])]
    rule = _base_rule(source, side)
    factor = float(columns.factor[index])
    offset = factor * rule["offset"] + float(columns.offset[index])
    sign = rule["sign"] * (-1 if factor < 0 else 1)
    scale, log_unit = rule["scale"] * abs(factor), rule["log_unit"]
    if unit is not None and rule["scale"] == 1.0 and rule["log_unit"] in (None, "rad", "m"):
        scale, log_unit = unit.scale * abs(factor) / unit.si, unit.log_unit
    scale, offset = _rounded(scale), _rounded(offset)
    return {"log": rule["log"], "sign": sign, "scale": scale, "offset": offset, "log_unit": log_unit}


def _of_rate(
    robot: RobotSpec, columns: Columns, index: int, measured: Mapping[str, Any], signal: str, length: str
) -> dict[str, Any]:
    """The rule of commanded velocities or torques: what the measurement's makes of them, unless they need another."""
    before = _base_rule(robot.joints[int(columns.column[index])], "command")
    wanted = _effect(before, signal, length) * float(columns.factor[index])
    rule = {**measured, "log": before["log"]}
    if wanted * _effect(rule, signal, length) < 0:
        rule["sign"] = -rule["sign"]
    for log_unit in (rule["log_unit"], length):
        rule["log_unit"] = log_unit
        off = abs(wanted / _effect(rule, signal, length))
        if abs(off - 1.0) < 1e-6:
            break
        other = {**rule, "scale": _rounded(rule["scale"] * (1.0 / off if signal == "torque" else off))}
        if abs(abs(wanted / _effect(other, signal, length)) - 1.0) < 1e-5:
            return other
    return rule


def _effect(rule: Mapping[str, Any], signal: str, length: str) -> float:
    """Factor of a commanded velocity or torque under a rule."""
    unit = {"velocity": f"{length}/s", "torque": "Nm" if length == "rad" else "N"}[signal]
    return JointRule(joint="joint", **rule).factor(signal, unit, length)[0]


def _base_rule(joint: JointSpec, side: str) -> dict[str, Any]:
    rule = {
        "log": joint.log or joint.name,
        "sign": joint.sign,
        "scale": joint.scale,
        "offset": joint.offset,
        "log_unit": joint.log_unit,
    }
    return rule | (joint.command.given if side == "command" and joint.command is not None else {})


def _difference(joint: JointSpec, measured: Mapping[str, Any], command: Mapping[str, Any]) -> dict[str, Any]:
    """What is written for a joint: what robot.yaml has otherwise, of the command what the measurement has otherwise."""
    old = _base_rule(joint, "measured")
    lines: dict[str, Any] = {key: value for key, value in measured.items() if value != old[key]}
    given = {} if joint.command is None else joint.command.given
    other = {key: value for key, value in command.items() if value != measured[key]}
    if "log_unit" in other and other["log_unit"] is None:  # nothing says `as the log has it`
        other["log_unit"] = "rad"
    if other != given:
        lines["command"] = other or None
    return lines


def _rounded(value: float) -> float:
    return float(f"{value:.7g}")


def yaml_lines(tree: Any) -> str:
    """A tree as the lines of a YAML file."""
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120).rstrip("\n")


def mended(robot: RobotSpec, lines: str) -> RobotSpec:
    """The robot with lines of a finding merged in: joints by name, mappings key by key.

    Raises:
        ConfigError: a joint that the robot does not have, or keys that make no robot.
    """
    tree = yaml.safe_load(lines)
    whole = robot.to_dict()
    for entry in tree.pop("joints", []):
        own = next((joint for joint in whole["joints"] if joint["name"] == entry["name"]), None)
        if own is None:
            raise ConfigError(f"there is no joint {entry['name']!r}", available=robot.joint_names)
        own |= entry
    for key, value in tree.items():
        whole[key] = {**whole.get(key, {}), **value} if isinstance(value, dict) else value
    return replace(build(RobotSpec, whole, "mended robot.yaml"), folder=robot.folder)
