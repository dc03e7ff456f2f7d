"""Joint names, signs, offsets, scales and units of a log, brought to those of the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from trueup.align.joint_rule import JointRule, check_keys
from trueup.core.episode import Episode
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.core.units import si_factor
from trueup.errors import ConfigError, MissingSignal, NameMismatch, UnitError


@dataclass(frozen=True)
class JointMap:
    """The joints of a log in the robot's names, order, signs, zeros and units.

    Attributes:
        rules: one per joint of the robot, in the robot's order.
        ignore: joints of the log that the robot does not have; any other unknown joint is an error.
        measured_command: signal whose measurement stands for the command, where that was not recorded; none if empty.
        clock_scale: seconds per second of the stamps, e.g. 0.001 where milliseconds were taken for seconds.
        command_shift_s: the stamps of the commands are this much too early [s], after scaling; negative if too late.

    Raises:
        NameMismatch: a joint stands twice on one side, or is both mapped and ignored.
        ConfigError: a clock that does not run forwards.
    """

    rules: tuple[JointRule, ...]
    ignore: tuple[str, ...] = ()
    measured_command: str = ""
    clock_scale: float = 1.0
    command_shift_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse names that stand twice."""
        commanded = tuple((rule.command or rule).log for rule in self.rules)
        for side, names in (
            ("robot", self.joints),
            ("log", (*self.log_joints, *self.ignore)),
            ("command", (*commanded, *self.ignore)),
        ):
            if len(set(names)) != len(names):
                raise NameMismatch(
                    f"a {side} joint occurs twice in the joint map", left=names, right=sorted(set(names))
                )
        if not (0.0 < self.clock_scale < np.inf and np.isfinite(self.command_shift_s)):
            raise ConfigError(
                "`clock` of the joint map",
                got=f"scale {self.clock_scale:g}, command_shift_s {self.command_shift_s:g}",
                expected="scale > 0, and a finite shift",
            )

    @property
    def joints(self) -> tuple[str, ...]:
        """The robot's names, in order."""
        return tuple(rule.joint for rule in self.rules)

    @property
    def log_joints(self) -> tuple[str, ...]:
        """The log's names, in the robot's order."""
        return tuple(rule.log for rule in self.rules)

    @property
    def of_commands(self) -> JointMap:
        """The map of the command series."""
        return replace(self, rules=tuple(rule.command or rule for rule in self.rules))

    @staticmethod
    def identity(joints: Sequence[str]) -> JointMap:
        """The map that only orders the joints and converts their units to SI."""
        return JointMap(tuple(JointRule(joint=name, log=name) for name in joints))

    def for_series(self, series: TimeSeries) -> JointMap:
        """This map if the series carries the log's names; the identity if it is in the robot's already.

        Where the log's names are the robot's, the two cannot be told apart, and this map is returned.

        Raises:
            NameMismatch: the names are neither the log's nor the robot's; both lists are printed.
            UnitError: the names are the robot's, but the positions are not in its units.
        """
        if set(series.joints) - set(self.ignore) == set(self.log_joints):
            return self
        if set(series.joints) != set(self.joints):
            self._refuse(series)
        if "position" in series:
            units = dict(zip(series.joints, series.units["position"], strict=True))
            for rule in self.rules:
                si, _ = si_factor(units[rule.joint])
                expected = rule.units(si)[1]
                if si != expected:
                    hint = "Rename the joints to the log's names, or give the positions in the robot's units."
                    got = units[rule.joint]
                    raise UnitError(f"position of joint {rule.joint!r}", got=got, expected=expected, hint=hint)
        return JointMap.identity(self.joints)

    def apply(self, series: TimeSeries) -> TimeSeries:
        """The series in the robot's names, order and SI units; its clock and float type are kept.

        Raises:
            NameMismatch: a joint of the log is unknown, or one of the map is not in the log; both lists are printed.
            UnitError: a unit is unknown, or does not fit its signal.
        """
        if set(series.joints) - set(self.ignore) != set(self.log_joints):
            self._refuse(series)
        ordered = series.select(self.log_joints)
        positions = ordered.units.get("position", ("rad",) * len(self.rules))
        signals, units = {}, {}
        for name, values in ordered.signals.items():
            if name.startswith(BODY_PREFIX):
                signals[name], units[name] = _si(values, ordered.units[name])
                continue
            columns = [
                rule.factor(name, unit, position)
                for rule, unit, position in zip(self.rules, ordered.units[name], positions, strict=True)
            ]
            factor = np.array([column[0] for column in columns])
            offset = np.array([rule.offset if name == "position" else 0.0 for rule in self.rules])
            signals[name] = (values.astype(np.float64) * factor + offset).astype(values.dtype)
            units[name] = tuple(column[1] for column in columns)
        return replace(ordered, joints=self.joints, signals=signals, units=units)

    def of_episode(self, episode: Episode) -> Episode:
        """The episode in the robot's names, order and SI units: what was measured, and what was commanded.

        Raises:
            NameMismatch: the log's joints are not those of the map; both lists are printed.
            UnitError: a unit is unknown, or does not fit its signal.
            MissingSignal: what stands for the command was not measured.
        """
        measured = self.for_series(episode.measured).apply(episode.measured)
        if self.clock_scale != 1.0:
            measured = replace(measured, time_s=self.clock_scale * measured.time_s)
        command = episode.command
        if self.measured_command:
            command = _alone(measured, self.measured_command, episode.id)
        elif command is not None:
            command = self.of_commands.for_series(command).apply(command)
            if (self.clock_scale, self.command_shift_s) != (1.0, 0.0):
                command = replace(command, time_s=self.clock_scale * command.time_s + self.command_shift_s)
        return replace(episode, measured=measured, command=command)

    def _refuse(self, series: TimeSeries) -> None:
        unknown = sorted(set(series.joints) - set(self.log_joints) - set(self.ignore))
        missing = sorted(set(self.log_joints) - set(series.joints))
        strangers = not set(self.log_joints) & set(series.joints)
        raise NameMismatch(
            "no joint of the log is one of the robot's"
            if strangers
            else f"joints of the log and of the joint map differ (unknown: {unknown}, missing: {missing})",
            left=series.joints,
            right=self.log_joints,
            left_name="log has",
            right_name="map expects",
            hint="Is --robot the robot of these logs? If so, say what they call each joint: `log` in the joint map."
            if strangers
            else "Correct `log` in the joint map, or list joints that the robot does not have under `ignore`.",
        )

    def to_dict(self) -> dict[str, Any]:
        """A dictionary of plain values, for YAML and JSON; `from_dict` reads it back."""
        joints = {rule.joint: rule.to_dict() for rule in self.rules}
        tree: dict[str, Any] = {"joints": joints} | ({"ignore": list(self.ignore)} if self.ignore else {})
        tree |= {"measured_command": self.measured_command} if self.measured_command else {}
        clock = {"scale": self.clock_scale, "command_shift_s": self.command_shift_s}
        return tree | ({"clock": clock} if clock != {"scale": 1.0, "command_shift_s": 0.0} else {})

    @staticmethod
    def from_dict(data: Any) -> JointMap:
        """Read `{"joints": {ROBOT_JOINT: {"log": NAME, "sign": -1, ...}}, "ignore": [NAME]}`.

        A joint without `log` has the same name in both; the order is that of the mapping.

        Raises:
            ConfigError: a key is unknown, or a value is of the wrong kind.
        """
        check_keys("joint map", data, ("joints", "ignore", "measured_command", "clock"))
        clock = data.get("clock", {})
        check_keys("`clock` of the joint map", clock, ("scale", "command_shift_s"))
        joints, ignore, command = data.get("joints"), data.get("ignore", []), data.get("measured_command", "")
        if not isinstance(joints, Mapping):
            raise ConfigError("`joints` of the joint map", got=type(joints).__name__, expected="a mapping")
        if not isinstance(ignore, Sequence) or isinstance(ignore, str):
            raise ConfigError("`ignore` of the joint map", got=repr(ignore), expected="a list of names")
        rules = tuple(JointRule.from_dict(str(name), entry) for name, entry in joints.items())
        if not isinstance(command, str):
            raise ConfigError("`measured_command` of the joint map", got=repr(command), expected="the name of a signal")
        scale, shift_s = clock.get("scale", 1.0), clock.get("command_shift_s", 0.0)
        if not all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in (scale, shift_s)):
            raise ConfigError("`clock` of the joint map", got=dict(clock), expected="numbers")
        return JointMap(rules, tuple(map(str, ignore)), command, float(scale), float(shift_s))


def _alone(series: TimeSeries, signal: str, episode: str) -> TimeSeries:
    """One signal of a series."""
    if signal not in series:
        raise MissingSignal(
            f"episode {episode!r}: no {signal} was measured, which stands for the command",
            available=series.signals,
            hint="Leave `controller: {source: measured}` out of robot.yaml where commands were recorded.",
        )
    return replace(series, signals={signal: series[signal]}, units={signal: series.units[signal]}, bodies=())


def _si(
    values: Float[np.ndarray, "T B ..."], units: Sequence[str]
) -> tuple[Float[np.ndarray, "T B ..."], tuple[str, ...]]:
    pairs = [si_factor(unit) for unit in units]
    factor = np.array([factor for _, factor in pairs]).reshape(-1, *(1,) * (values.ndim - 2))
    return (values * factor).astype(values.dtype), tuple(si for si, _ in pairs)
