"""What the names of columns say: signal, joint, unit, and whether a robot was told it or did it.

A mapping that is made of them is a suggestion: whoever uses it reads it first, or lets the check of the set-up do so.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import yaml

from trueup.dataset.importers.tables import ArrayTable, Table
from trueup.errors import TrueupError

Side = Literal["measured", "command"]

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|°")
_JOINED = re.compile(r"^(d?q|tau|pos|vel)(ref|des|cmd|target|goal|set|meas|act|actual)$")
_IN_BRACKETS = re.compile(r"[\[(]\s*([^\])\d][^\])]*?)\s*[\])]|\[\s*\]")

_TIMES = ("t", "time", "timestamp", "stamp", "zeit", "times", "epoch", "datetime", "date", "clock", "ts", "tm", "temps")
_SECONDS, _NANOSECONDS = ("sec", "secs", "seconds"), ("nanosec", "nsec", "nsecs", "nanosecs", "nanoseconds")
# Single numbers that stand for a clock.
_PERIODS, _RATES = ("dt", "period", "timestep"), ("fps", "hz", "rate", "frequency")
_TOLD = frozenset(
    [
        *("cmd", "cmds", "command", "commands", "commanded", "des", "desired", "target", "targets", "goal", "ref"),
        *("reference", "setpoint", "set", "soll", "sp", "action", "actions", "tgt", "demand", "con", "d", "input"),
        *("ctrl", "control", "planned", "u", "consigne", "as"),
    ]
)
_DONE = frozenset(
    [
        *("meas", "measured", "actual", "act", "present", "ist", "state", "states", "fb", "feedback", "obs"),
        *("observation", "observations", "real", "sensor", "sensed", "estimated", "est", "enc", "encoder"),
        *("mesuree", "ai"),
    ]
)
_SIGNALS: Mapping[str, tuple[str, ...]] = {
    "position": (
        *("pos", "position", "positions", "q", "angle", "angles", "theta", "qpos", "lage", "winkel", "jointpos"),
        *("ticks",),
    ),
    "velocity": (
        *("vel", "velocity", "velocities", "dq", "qd", "qdot", "speed", "omega", "qvel", "geschwindigkeit"),
        *("vitesse",),
    ),
    "torque": ("tau", "torque", "torques", "effort", "efforts", "moment", "drehmoment", "couple"),
    "current": ("current", "currents", "strom", "courant"),
    "voltage": ("voltage", "voltages", "spannung"),
    "temperature": ("temp", "temperature", "temperatures", "temperatur"),
    "acceleration": ("acc", "accel", "acceleration", "accelerations", "ddq", "qdd", "qacc"),
}
_SIGNAL_OF = {word: signal for signal, words in _SIGNALS.items() for word in words}
# Columns that say which joint a row is of, or which motion.
_WHOSE = frozenset(
    ["joint", "joints", "motor", "servo", "name", "axis", "actuator", "dof", "id", "gelenk", "achse", "articulation"]
)
_MOTIONS = frozenset(
    [
        *("trial", "episode", "motion", "run", "demo", "demonstration", "sequence", "trajectory", "rollout", "segment"),
        *("versuch", "essai"),
    ]
)
_MOST_JOINTS, _MOST_CLOCKS = 100, 20
# Words in front of the number of a joint.
_NUMBERED_JOINTS = _WHOSE - {"name", "id"} | {"wrist", "finger", "link", "axle", "leg", "arm", "a", "j", "m", "q"}
# Words of what belongs to no joint, and of what is neither told nor done.
_ELSEWHERE = frozenset(
    ["eef", "ee", "cartesian", "object", "root", "base", "tcp", "pose", "cos", "sin", "gripper", "initial"]
)
_APART = frozenset(["error", "errors", "err", "offset"])
_PICTURES = frozenset(["image", "images", "img", "rgb", "depth", "camera", "cam", "video"])
# Words that say nothing about which joint it is.
_PLAIN = frozenset(("joint", "joints", "field", "motor", "motors", "servo", "data", "value", "values", "robot", "dof"))
_UNITS = {
    **dict.fromkeys(("deg", "degree", "degrees", "°", "grad"), "deg"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("rad/s", "rads", "rad/sec", "radps", "rad_s"), "rad/s"),
    **dict.fromkeys(("deg/s", "degs", "deg/sec", "degps", "°/s", "dps", "deg_s"), "deg/s"),
    "rpm": "rpm",
    **dict.fromkeys(("nm", "n*m", "n.m", "n·m", "n m", "newtonmeter"), "Nm"),
    **dict.fromkeys(("mnm",), "mNm"),
    **dict.fromkeys(("a", "amp", "amps", "ampere"), "A"),
    "ma": "mA",
    **dict.fromkeys(("v", "volt", "volts"), "V"),
    "mv": "mV",
    **dict.fromkeys(("degc", "°c", "celsius"), "degC"),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "µs", "usec", "micros", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), "ns"),
    **{name: name for name in ("mm", "cm", "m", "n", "%", "mrad", "rev")},
}
# Units that end a name without brackets; the short ones are too often something else.
_ENDINGS = frozenset(
    ["deg", "degrees", "rad", "mrad", "radians", "rads", "degs", "rpm", "nm", "mnm", "ma", "ms", "us", "ns", "mm"]
)
_CLOCKS = ("s", "ms", "us", "ns")
# Of the four, the largest step that a log has, and the latest stamp since 1970, in ticks.
_LARGEST_STEPS, _LATEST = (0.5, 500.0, 5e5, np.inf), (1e11, 1e14, 1e17, np.inf)
_OF_TODAY = 1e8
_OF_SIGNAL = {
    "position": ("rad", "deg", "mrad", "rev", "m", "cm", "mm", "1", "%"),
    "velocity": ("rad/s", "deg/s", "rpm", "m/s", "mm/s", "1/s"),
    "torque": ("Nm", "mNm", "N"),
    "current": ("A", "mA"),
    "voltage": ("V", "mV"),
    "temperature": ("degC",),
    "acceleration": ("rad/s^2", "deg/s^2", "m/s^2", "1/s^2"),
}
_USUAL = {signal: units[0] for signal, units in _OF_SIGNAL.items()}
# Angles beyond this are no radians, if they are not turns of a wheel; beyond that, no degrees [rad, deg].
_MOST_RADIANS, _MOST_DEGREES = 7.5, 400.0
_SAMPLE = 2000
# A commanded position goes with the measured one so closely, as a correlation.
_GOES_WITH = 0.9
# Beyond so many columns nobody reads a suggestion.
_MOST_COLUMNS = 20_000
# What is said of a guess.
DEGREES = "positions are taken for degrees: the names do not say, and radians are no more than 6.3"


@dataclass(frozen=True)
class Column:
    """What the name of a column says.

    Attributes:
        name: of the column.
        side: whether the robot was told it or did it.
        signal: `position` and so on; empty if the name does not say.
        words: that are left, of which the joint's name is one.
        unit: if the name says it.
    """

    name: str
    side: Side | None
    signal: str
    words: tuple[str, ...]
    unit: str


@dataclass(frozen=True)
class Suggestion:
    """A mapping, and what is not sure about it.

    Attributes:
        tree: the mapping, as it stands in YAML.
        taken: what was understood, a line each.
        unsure: what somebody should look at, a line each.
        guessed: whether only the size of positions says which unit they have.
    """

    tree: dict[str, Any]
    taken: tuple[str, ...]
    unsure: tuple[str, ...]
    guessed: bool = False

    @property
    def text(self) -> str:
        """The mapping as YAML, a line for each signal."""
        lines = []
        for key, value in self.tree.items():
            if key != "series":
                lines.append(f"{key}: {_flow(value)}")
                continue
            lines.append("series:")
            for name, series in value.items():
                lines.append(f"  {name}:")
                lines += [f"    {own}: {_flow(series[own])}" for own in series if own != "signals"]
                lines += ["    signals:", *(f"      {own}: {_flow(item)}" for own, item in series["signals"].items())]
        return "\n".join(lines) + "\n"


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, allow_unicode=True, width=100_000)
    return str(text).removesuffix("\n").removesuffix("\n...")


def column_of(name: str) -> Column:
    """What the name of a column says."""
    brackets = [found[1] for found in _IN_BRACKETS.finditer(name) if found[1]]
    units = [unit for text in brackets if (unit := _UNITS.get(text.lower().replace(" ", ""), ""))]
    parts = name.split(".")
    said = [part for part in parts[1:-1] if len(part) > 1 and part in _UNITS]  # a row of units between others
    units = units or [_UNITS[part] for part in said]
    plain = ".".join(part for part in parts if part not in said)
    words = _words_of(_IN_BRACKETS.sub(" ", plain) if units else plain)
    words = [part for word in words for part in _JOINED.sub(r"\1 \2", word).split()]
    if not units and len(words) > 1 and words[-1] in _ENDINGS:
        units, words = [_UNITS[words[-1]]], words[:-1]
    signals = [word for word in words if word in _SIGNAL_OF]
    side: Side | None = None
    if any(word in _TOLD for word in words) or ("q", "c") in itertools.pairwise(words):
        side = "command"
    elif any(word in _DONE for word in words):
        side = "measured"
    if len(signals) > 1 and signals[0] == "current":  # `current_position` is a position
        signals.remove("current")
        side = side or "measured"
        words = [word for word in words if word != "current"]
    signal = _SIGNAL_OF[signals[-1]] if signals else ""
    words = [word for word, before in zip(words, ["", *words], strict=False) if (before, word) != ("q", "c")]
    left = [word for word in words if word not in _TOLD | _DONE | _PLAIN and word not in signals]
    return Column(name, side, signal, tuple(left), units[0] if units else "")


def _words_of(name: str) -> list[str]:
    """Words in small letters, without accents."""
    plain = unicodedata.normalize("NFKD", name)
    return [word.lower() for word in _WORD.findall("".join(sign for sign in plain if not unicodedata.combining(sign)))]


def suggest(
    table: Table, side: Side = "measured", units: Mapping[str, str] = MappingProxyType({})
) -> Suggestion | None:
    """A mapping for a table whose columns have names that say what they are.

    Args:
        table: one file.
        side: of columns whose names do not say whether the robot was told it or did it.
        units: of columns, where a line below the names says them.

    Returns:
        None where no joints are found, or there are too many columns to say.
    """
    if len(table.names) > _MOST_COLUMNS:
        return None
    # Libraries keep what is their own under names such as `_i_table`.
    names = [name for name in table.names if not any(part.startswith("_") for part in name.split("/")[:-1])]
    return _Suggesting(table, names, side, units).suggestion()


def units_in(row: Mapping[str, str]) -> dict[str, str]:
    """What a row of texts says if each is a unit or nothing: names of columns -> units; empty if it is another row."""
    said = {name: _UNITS.get(text.strip().strip("[]()").lower(), "") for name, text in row.items() if text.strip()}
    return said if said and all(said.values()) and len(said) > len(row) // 2 else {}


def sounds_told(name: str) -> bool:
    """Whether a file is called as commands are."""
    return any(word in _TOLD for word in _words_of(name))


def names_joints(stem: str) -> bool:
    """Whether a name that a number follows is one of joints: `joint_`, `observation/motor`."""
    words = _words_of(re.split(r"[/.]", stem)[-1])
    return bool(words) and words[-1] in _NUMBERED_JOINTS


class _Suggesting:
    def __init__(self, table: Table, names: list[str], side: Side, units: Mapping[str, str]) -> None:
        self._table, self._side, self._units = table, side, units
        self._split: dict[str, Any] = {}
        self._taken: list[str] = []
        self._unsure: list[str] = []
        self._guessed = False
        self._known: dict[str, np.ndarray | None] = {}
        # Columns with names of joints, and names of the command's joints if they are others.
        self._names_in: list[str] = []
        self._told: tuple[str, ...] = ()
        with contextlib.suppress(TrueupError):  # a column that cannot be read is told apart below
            self._table.load([name for name in names if not _is_picture(name)])
        self._clocks: list[str] = []
        self._beside = False  # whether a side has a clock of its own
        self._time_names, self._time = self._clock(names)
        self._split = self._split or self._motions(names)
        self._whose, joints = self._named_in_rows(names)
        self._in_rows = tuple(joints)
        others = {*self._time_names, self._whose, self._split.get("column", ""), ""}
        self._columns = [self._column(name) for name in names if name not in others]

    def suggestion(self) -> Suggestion | None:
        joints, found = self._joints()
        if not joints:
            return None
        series: dict[str, Any] = {}
        sides: tuple[Side, ...] = ("measured", "command")
        own = {"joint_column": self._whose} if self._whose else {}
        for side in sides:
            signals = {
                signal: self._signal(signal, columns, found.get((side, "position"), []))
                for (own, signal), columns in found.items()
                if own == side
            }
            if signals:
                columns = [column for (own_side, _), part in found.items() if own_side == side for column in part]
                series[side] = {"time": self._time_of(columns[0].name), **self._named(side), **own, "signals": signals}
        if "measured" not in series and self._side == "measured":
            return None
        if "command" not in series and self._side == "measured":
            self._unsure.append("no column sounds like a command")
        used = {column.name for columns in found.values() for column in columns} | {*self._time_names, *self._names_in}
        unused = [name for name in (column.name for column in self._columns) if name not in used]
        if unused:
            self._taken.append(f"not used: {', '.join(unused[:8])}{' …' if len(unused) > 8 else ''}")
        split = {"split": self._split} if self._split else {}
        tree = {"joints": list(joints), **split, "series": series}
        return Suggestion(tree, tuple(self._taken), tuple(self._unsure), self._guessed)

    def _named(self, side: Side) -> dict[str, Any]:
        return {"joints": list(self._told)} if side == "command" and self._told else {}

    def _column(self, name: str) -> Column:
        column = column_of(name)
        return replace(column, unit=column.unit or self._units.get(name, ""))

    # Rows.

    def _motions(self, names: Sequence[str]) -> dict[str, Any]:
        """A column that numbers or names the motions of a file, each of which is in one piece."""
        for name in names:
            words = _words_of(name)
            if name in self._time_names or not set(words) & _MOTIONS or {"frame", "step"} & set(words):
                continue
            motions = [word for word in self._words(name) if word.lower() not in ("", "nan", "none")]
            changes = sum(one != two for one, two in itertools.pairwise(motions))
            if 1 < len(set(motions)) == changes + 1 and len(motions) > 10 * len(set(motions)):
                self._unsure.append(f"each {name} is taken for a motion of its own")
                return {"column": name}
        return {}

    def _named_in_rows(self, names: Sequence[str]) -> tuple[str, list[str]]:
        """The column with the name of each row's joint, and the joints, if stamps are there once for each joint."""
        for name in names:
            words = set(_words_of(name))
            if name in self._time_names or not words or not words <= _WHOSE or len(self._time_names) != 1:
                continue
            rows = self._words(name)
            counts = Counter(rows)
            try:
                ticks = self._table.ticks(self._time_names[0])[0]
            except TrueupError:
                continue
            # Stamps may come again in the next motion, and then stand together.
            changes = 1 + int(np.count_nonzero(np.diff(ticks)))
            stamps = changes if changes * 1.1 < len(rows) else len(np.unique(ticks))
            if 1 < len(counts) <= _MOST_JOINTS and max(counts.values()) <= stamps * 1.1 < len(rows):
                return name, list(counts)
        return "", []

    def _words(self, name: str) -> list[str]:
        try:
            self._table.load([name])
            return self._table.words(name)
        except TrueupError:
            return []

    # The clock.

    def _clock(self, names: Sequence[str]) -> tuple[list[str], Any]:
        words = {name: _words_of(name) for name in names}
        whole = [name for name in names if words[name] and words[name][-1] in _SECONDS]
        parts = [name for name in names if words[name] and words[name][-1] in _NANOSECONDS]
        if len(whole) == 1 and len(parts) == 1:
            return [whole[0], parts[0]], {"columns": [whole[0], parts[0]]}
        named = [name for name in names if any(word in _TIMES for word in words[name])]
        rows = [name for name in names if words[name] and words[name][-1] == "index"]
        self._clocks = [*named, *rows][:_MOST_CLOCKS]
        for name in [*sorted(named, key=lambda own: len(words[own])), *whole]:
            ticks = self._increasing(name)
            if ticks is not None:
                return [name], self._clock_unit(name, *ticks)
        if not named:
            for name in names[:1]:
                ticks = self._increasing(name)
                if ticks is not None and not np.allclose(np.diff(ticks[0].astype(float)), 1.0):
                    self._unsure.append(f"{name or 'the first column'}: taken for the clock, since it rises")
                    return [name], self._clock_unit(name, *ticks)
        for name in names:
            number = self._single(name) if set(words[name]) & {*_PERIODS, *_RATES} else None
            if number is not None and number > 0.0:
                return [name], {"period": name} if set(words[name]) & set(_PERIODS) else {"rate_hz": number}
        self._unsure.append("no column is a clock: write the rate of the log in place of 100 Hz")
        return [], {"rate_hz": 100.0}

    def _time_of(self, column: str) -> Any:
        """The clock of a column, where there are several: the one that stands nearest to it and has as many stamps."""
        one = len(self._time_names) == 1 or self._beside
        if not isinstance(self._table, ArrayTable) or not one:
            return self._time
        count = self._rows(column)
        found = [name for name in self._clocks if self._rows(name) == count]
        own = _WORD.findall(column)
        nearest = max(found, key=lambda name: _common([_WORD.findall(name), own]), default="")
        ticks = self._increasing(nearest) if nearest and nearest != self._time_names[0] else None
        if ticks is None:
            return self._time
        self._beside = True
        self._time_names.append(nearest)
        return self._clock_unit(nearest, *ticks)

    def _rows(self, name: str) -> int:
        try:
            self._table.load([name])
            return len(self._table.numbers(name))
        except TrueupError:
            try:
                return len(self._table.words(name))
            except (TrueupError, KeyError):
                return 0

    def _single(self, name: str) -> float | None:
        """A number that is alone in the file; None for anything else."""
        values = self._numbers(name)
        return float(values.ravel()[0]) if values is not None and values.size == 1 else None

    def _increasing(self, name: str) -> tuple[np.ndarray, bool] | None:
        try:
            self._table.load([name])
            ticks, dates = self._table.ticks(name)
        except TrueupError:
            return None
        numbers = np.asarray(ticks)
        steps = np.diff(numbers.astype(float) if numbers.dtype.kind == "f" else numbers)
        if len(numbers) < 3 or not np.isfinite(numbers).all() or (steps >= 0).mean() <= 0.9 or not np.any(steps > 0):
            return None
        return (numbers, dates) if numbers[-1] > numbers[0] or _times_anew(numbers) else None

    def _clock_unit(self, name: str, ticks: np.ndarray, dates: bool) -> Any:  # noqa: FBT001
        if times := _times_anew(ticks):
            self._split = {"back": True}
            self._unsure.append(f"{name} begins anew {times} times: a motion ends there")
        if dates:
            return name
        said = self._column(name).unit
        words = _words_of(name)
        if said not in _CLOCKS and len(words) > 1:
            said = _UNITS.get(words[-1], "")
        if said in _CLOCKS:
            return {"column": name, "unit": said}
        first, step = abs(float(ticks[0])), float(np.median(np.diff(ticks.astype(float))))
        size, most = (first, _LATEST) if first > _OF_TODAY else (step, _LARGEST_STEPS)
        unit = next(own for own, limit in zip(_CLOCKS, most, strict=True) if size < limit)
        if unit != "s":
            self._unsure.append(f"{name}: taken for {unit}, since its steps are {step:g}")
        return {"column": name, "unit": unit}

    # Joints and signals.

    def _joints(self) -> tuple[tuple[str, ...], dict[tuple[Side, str], list[Column]]]:
        """Names of the joints, and the columns of each signal in their order; of a long table, one for all joints."""
        groups: dict[tuple[Side, str], list[Column]] = {}
        for column in self._columns:
            # A word such as `state` alone says little: beside it, numbers have to stand.
            if not _apart(column) and (column.signal or (column.side and self._is_number(column.name))):
                groups.setdefault((column.side or self._side, column.signal or "position"), []).append(column)
        self._tell_desired(groups)
        plain = [column for column in self._columns if not (column.signal or column.side)]
        plain = [column for column in plain if not _apart(column) and self._is_number(column.name)]
        labels = {label for columns in groups.values() for label in _labels(columns)}
        if (self._side, "position") not in groups:
            alone = plain if not groups and self._time_names else []
            both = zip(plain, _labels(plain), strict=True)
            own = [column for column, label in both if labels & {label, "_".join(column.words)}] or alone
            if own:
                groups[self._side, "position"] = own
        base = groups.get((self._side, "position"), [])
        if not base and self._side == "command" and groups:
            base = next(iter(groups.values()))
        widths = {column.name: width for column in base if (width := self._width(column.name)) > 1}
        if widths:
            return self._vectors(groups, base, widths)
        _without_others(groups)
        base = groups.get((self._side, "position"), base)
        if self._in_rows:
            single = {key: columns for key, columns in groups.items() if len(columns) == 1}
            shown = ", ".join(self._in_rows[:8])
            self._taken.append(f"{len(self._in_rows)} joints by the rows of {self._whose}: {shown}")
            return self._in_rows, single
        joints = _labels(base)
        if not joints or len(set(joints)) < len(joints):
            return (), {}
        found: dict[tuple[Side, str], list[Column]] = {}
        for key, columns in groups.items():
            by_label = dict(zip(_labels(columns), columns, strict=False))
            order = joints if set(joints) <= set(by_label) else _by_number(joints, list(by_label))
            if (
                order is None
                and key[0] == "command"
                and len(by_label) == len(joints)
                and all(map(str.isdigit, by_label))
            ):
                order = sorted(by_label, key=int)
                self._told = tuple(f"joint_{label}" for label in order)
            if order is not None and all(self._is_number(by_label[label].name) for label in order):
                found[key] = [by_label[label] for label in order]
        named = self._said_by_columns(joints) or tuple(
            f"joint_{label}" if label.isdigit() or not label else column.name if _is_joint(column) else label
            for column, label in zip(base, joints, strict=True)
        )
        shown = ", ".join(named[:8]) + (" …" if len(named) > 8 else "")
        self._taken.append(f"{len(named)} joints by the names of columns: {shown}")
        return named, found

    def _said_by_columns(self, joints: Sequence[str]) -> tuple[str, ...]:
        """Names that stand in numbered columns of text beside numbered joints, the same in all rows; empty if none."""
        found: dict[str, str] = {}
        for column in self._columns:
            if not {"name", "names"} & set(column.words) or self._is_number(column.name):
                continue
            words = set(self._words(column.name))
            if len(words) == 1 and column.words[-1].isdigit():
                found[column.words[-1]] = words.pop()
                self._names_in.append(column.name)
        names = tuple(found.get(joint, "") for joint in joints)
        return names if all(names) and len(set(names)) == len(names) else ()

    def _tell_desired(self, groups: dict[tuple[Side, str], list[Column]]) -> None:
        """`qd` is a velocity to some and a desired position to others: values say which."""
        for (side, signal), columns in list(groups.items()):
            position = groups.get(("measured", "position"), [])
            if signal != "velocity" or not position or ("command", "position") in groups:
                continue
            if all("qd" in _words_of(column.name) for column in columns):
                own, done = (self._numbers(part[0].name) for part in (columns, position))
                if own is None or done is None or own.shape != done.shape:
                    continue
                if float(np.nanstd(own - done)) < 0.5 * float(np.nanstd(done)):
                    groups["command", "position"] = [replace(column, signal="position") for column in columns]
                    self._unsure.append(f"{columns[0].name}: taken for desired positions, since it goes with positions")
                    del groups[side, signal]

    def _vectors(
        self, groups: Mapping[tuple[Side, str], list[Column]], base: Sequence[Column], widths: Mapping[str, int]
    ) -> tuple[tuple[str, ...], dict[tuple[Side, str], list[Column]]]:
        """One column of vectors for each signal; joints have no names but their numbers."""
        told = {self._width(column.name) for (side, _), own in groups.items() if side == "command" for column in own}
        first = min(
            (column for column in base if column.name in widths),
            key=lambda column: (
                _elsewhere(column),
                widths[column.name] not in told,
                not column.signal,
                _relative(column),
            ),
        )
        width = widths[first.name]
        found: dict[tuple[Side, str], list[Column]] = {}
        for key, columns in groups.items():
            fitting = [column for column in columns if self._width(column.name) == width]
            fitting = [first] if first in fitting else sorted(fitting, key=_preferred)
            if fitting:
                found[key] = fitting[:1]
            elif key == ("command", "position"):
                found[key] = self._without_gripper(first, columns, width)
        found = {key: columns for key, columns in found.items() if columns}
        named = self._listed(width)
        if named:
            self._taken.append(f"{width} joints by a list of names: {', '.join(named[:8])}")
            return named, found
        self._unsure.append(f"{first.name} has {width} numbers in a row: their joints are only numbered")
        return tuple(f"joint_{number}" for number in range(1, width + 1)), found

    def _without_gripper(self, done: Column, told: Sequence[Column], width: int) -> list[Column]:
        """Components of a vector of actions that has one number more than there are joints, which go with these."""
        measured = self._numbers(done.name)
        for column in sorted(told, key=_preferred):
            values = self._numbers(column.name)
            if measured is None or values is None or values.shape != (len(measured), width + 1):
                continue
            with np.errstate(invalid="ignore", divide="ignore"):
                alike = [np.corrcoef(values[:, place], measured[:, place])[0, 1] for place in range(width)]
            if min(np.nan_to_num(alike)) > _GOES_WITH:
                self._unsure.append(f"{column.name}: its last number is taken for a gripper's")
                return [replace(column, name=f"{column.name}[{place}]") for place in range(width)]
        return []

    def _listed(self, width: int) -> tuple[str, ...]:
        """Names of joints that stand in the file as a list of so many texts, once or in every row; empty if none do."""
        for name in self._table.names:
            words = set(_words_of(name))
            if not words & {"name", "names", "joint", "joints", "dof"} or self._numbers(name) is not None:
                continue
            rows = self._words(name)
            if not isinstance(self._table, ArrayTable):
                rows = [word.strip(" '\"") for word in rows[0].strip("[]()").split(",")] if len(set(rows)) == 1 else []
            elif len(rows) > width and len(rows) % width == 0 and rows == rows[:width] * (len(rows) // width):
                rows = rows[:width]
            if len(rows) == len(set(rows)) == width:
                self._names_in.append(name)
                return tuple(rows)
        return ()

    def _signal(self, signal: str, columns: Sequence[Column], positions: Sequence[Column]) -> dict[str, Any]:
        names = [column.name for column in columns]
        units = [self._unit(signal, column, positions) for column in columns]
        vector = len(names) == 1 and (bool(self._in_rows) or self._width(names[0]) > 1)
        return {"columns": names[0] if vector else names, "unit": units[0] if len(set(units)) == 1 else units}

    def _unit(self, signal: str, column: Column, positions: Sequence[Column]) -> str:
        if column.unit in _OF_SIGNAL[signal]:
            return column.unit
        if signal in ("velocity", "acceleration") and positions:
            per = {"velocity": "/s", "acceleration": "/s^2"}[signal]
            own = self._unit("position", positions[0], ())
            return f"{own}{per}" if f"{own}{per}" in _OF_SIGNAL[signal] else _USUAL[signal]
        if signal == "position":
            largest = self._largest(column.name)
            if _MOST_RADIANS < largest <= _MOST_DEGREES:
                self._unsure += [DEGREES] if DEGREES not in self._unsure else []
                self._guessed = True
                return "deg"
            if largest > _MOST_DEGREES:
                line = "positions are no angles; if they are encoder counts, `factor` and `offset` make them some"
                self._unsure += [line] if line not in self._unsure else []
        return _USUAL[signal]

    # Values.

    def _numbers(self, name: str) -> np.ndarray | None:
        if name not in self._known:
            self._known[name] = None if _is_picture(name) else self._read(name)
        return self._known[name]

    def _read(self, name: str) -> np.ndarray | None:
        try:
            self._table.load([name])
            return np.asarray(self._table.numbers(name))[:_SAMPLE].copy()
        except TrueupError:
            return None

    def _is_number(self, name: str) -> bool:
        values = self._numbers(name)
        return values is not None and bool(np.isfinite(values).any())

    def _width(self, name: str) -> int:
        values = self._numbers(name)
        return 1 if values is None or values.ndim < 2 else int(values.shape[1])

    def _largest(self, name: str) -> float:
        values = self._numbers(name)
        return 0.0 if values is None or not np.isfinite(values).any() else float(np.nanmax(np.abs(values)))


def _times_anew(ticks: np.ndarray) -> int:
    """How often a clock begins anew, as many loggers' do with each motion; 0 if it also jumps back elsewhere."""
    steps = np.diff(ticks.astype(float))
    back = np.flatnonzero(steps < 0)
    early = ticks[0] + 10 * np.median(steps[steps > 0])
    return int(back.size) if back.size <= len(ticks) // 10 and np.all(ticks[back + 1] <= early) else 0


def _without_others(groups: dict[tuple[Side, str], list[Column]]) -> None:
    """Leave out what only a word such as `state` puts beside positions: of a name that no other of them has."""
    sides: tuple[tuple[Side, Side], ...] = (("measured", "command"), ("command", "measured"))
    for side, other in sides:
        own, rest = groups.get((side, "position"), []), groups.get((other, "position"), [])
        words = {column.words for column in rest}
        said = [column for column in own if column.signal] or [column for column in own if column.words in words]
        if said and len(said) < len(own):
            groups[side, "position"] = said


def _elsewhere(column: Column) -> bool:
    """Whether a vector is of something else than joints, or of the first moment alone."""
    return not _ELSEWHERE.isdisjoint(_words_of(column.name))


def _relative(column: Column) -> bool:
    """Whether a vector is what a policy sees, which is often taken from a default pose."""
    return not {"obs", "observation", "observations"}.isdisjoint(_words_of(column.name))


def _preferred(column: Column) -> tuple[bool, bool, bool, bool]:
    """Of vectors that are as long, the one to take sorts first: actions may be scaled, unless they are processed."""
    processed = "processed" in column.words
    raw = not processed and not {"action", "actions"}.isdisjoint(_words_of(column.name))
    return _elsewhere(column), raw, not processed, _relative(column)


def _is_joint(column: Column) -> bool:
    """Whether a column is called as its joint is, without a word for what it holds."""
    said = [word for word in _words_of(column.name) if word not in _WHOSE]
    return column.name.isidentifier() and said == [word for word in column.words if word not in _WHOSE]


def _apart(column: Column) -> bool:
    return not _APART.isdisjoint(column.words)


def _is_picture(name: str) -> bool:
    return any(word in _PICTURES for word in _words_of(name))


def _labels(columns: Sequence[Column]) -> list[str]:
    """What tells the columns of a signal apart: their words without those that all begin or end with."""
    words = [column.words for column in columns]
    if len(words) > 1:
        front = _common(words)
        behind = _common([own[::-1] for own in words])
        words = [own[front : len(own) - behind] or own for own in words]
    return ["_".join(own) for own in words]


def _common(lists: Sequence[Sequence[str]]) -> int:
    count = 0
    for words in zip(*lists, strict=False):
        if len(set(words)) > 1:
            break
        count += 1
    return count


def _by_number(joints: Sequence[str], labels: Sequence[str]) -> list[str] | None:
    """Labels in the order of joints whose numbers they have, counted from another first one."""
    if len(labels) != len(joints) or not all(label.isdigit() for label in (*labels, *joints)):
        return None
    ranks = {label: rank for rank, label in enumerate(sorted(joints, key=int))}
    ordered = sorted(labels, key=int)
    return [ordered[ranks[joint]] for joint in joints]
