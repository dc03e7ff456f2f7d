"""Mapping files: which columns of which tables are which signals of a robot, in which unit."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from trueup.core.timeseries import BODY_PREFIX
from trueup.core.units import SI_UNIT, UNITS, conversion
from trueup.dataset.importers.pattern import group_names, matches
from trueup.errors import ConfigError, NameMismatch, UnitError

_FIELD = re.compile(r"\{(\w+)\}")
# Of files that are tables, the likeliest first.
ENDINGS = (
    *(".csv", ".tsv", ".parquet", ".xlsx", ".npz", ".npy", ".mat", ".h5", ".hdf5", ".jsonl", ".ndjson", ".json"),
    *(".txt", ".log", ".dat", ".lvm"),
)
COMPONENTS = {"body.position": (3,), "body.rotation": (3, 3), "body.specific_force": (3,)}


def substitute(template: str, values: Mapping[str, str], *, where: str) -> str:
    """Put values in place of `{name}`; nothing else in the template is interpreted.

    Raises:
        ConfigError: a name is not known.
    """

    def value(match: re.Match[str]) -> str:
        if match[1] not in values:
            raise ConfigError(f"{where} uses {{{match[1]}}}", got=template, available=values)
        return values[match[1]]

    return _FIELD.sub(value, template)


@dataclass(frozen=True)
class ClockColumn:
    """Where the stamps of a series are; one of the four.

    Attributes:
        column: name of the column: numbers, or dates as ISO 8601 writes them.
        unit: of numbers, `s`, `ms`, `us` or `ns`.
        columns: whole seconds and nanoseconds, each in a column.
        rate_hz: samples per second, where there is no clock.
        period: name of a single number in the file, the time between two samples in `unit`.
    """

    column: str = ""
    unit: str = "s"
    columns: tuple[str, ...] = ()
    rate_hz: float | None = None
    period: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Of what is read from the file."""
        return tuple(name for name in (self.column, *self.columns, self.period) if name)


@dataclass(frozen=True)
class SignalColumns:
    """Where a signal is.

    Attributes:
        columns: one column per joint, in the order of `joints`; or one template with `{joint}`, `{n}` (1, 2, ...)
            or `{i}` (0, 1, ...); or one column of vectors, `name[3]` being one of its components. Body signals: a
            template with `{body}` or `{n}`, and `{k}`, the component.
        unit: unit of all columns, or one per joint, after `factor` and `offset`.
        optional: leave the signal out of files that have none of its columns.
        dtype: `float64` or `float32`.
        factor: what a number of the file is multiplied by, e.g. a torque per ampere; for all joints or one each.
        offset: added to that.
    """

    columns: str | tuple[str, ...]
    unit: str | tuple[str, ...]
    optional: bool = False
    dtype: str = "float64"
    factor: float | tuple[float, ...] = 1.0
    offset: float | tuple[float, ...] = 0.0


@dataclass(frozen=True)
class SplitRule:
    """Where a file ends one motion and begins the next; one of these.

    Attributes:
        column: a motion for each value of this column, in their order.
        gap_s: where the clock jumps by more than this [s].
        every_s: after so long [s].
        rest_s: where no measured position has changed for so long, which is left out [s].
        back: where the clock jumps back.
    """

    column: str = ""
    gap_s: float | None = None
    every_s: float | None = None
    rest_s: float | None = None
    back: bool = False

    def __post_init__(self) -> None:
        """Refuse several rules, and none."""
        numbers = [value for value in (self.gap_s, self.every_s, self.rest_s) if value is not None]
        if bool(self.column) + self.back + len(numbers) != 1 or not all(0 < value < math.inf for value in numbers):
            raise ConfigError(
                "split", got=[self.column, *numbers], expected="one of column: NAME, gap_s, every_s, rest_s, back: true"
            )


@dataclass(frozen=True)
class SeriesColumns:
    """Where a series is.

    Attributes:
        time: its clock.
        signals: signal name -> columns.
        file: file of the same episode, below the imported folder, with `{group}` of `episodes`; by default the
            file that `episodes` matched.
        optional: an episode without this file, or without any column of the signals, has no such series.
        joints: names of the joints, if they differ from the mapping's.
        joint_column: a row is a sample of one joint, whose name is in this column; `columns` are then one each.
    """

    time: ClockColumn
    signals: Mapping[str, SignalColumns]
    file: str = ""
    optional: bool = False
    joints: tuple[str, ...] = ()
    joint_column: str = ""


@dataclass(frozen=True)
class FileValue:
    """What a file says about itself, in place of a constant of the mapping.

    Attributes:
        column: name of a single number or text in the file; of a column, its first row.
    """

    column: str


# What is known of a motion apart from its samples, in mappings and in tables of metadata.
ABOUT = ("robot", "unit", "payload_kg", "kp_setting", "condition")


@dataclass(frozen=True)
class TableMapping:
    """A mapping file.

    Attributes:
        joints: names of the joints, in the order of the columns; none where `joint_pattern` finds them.
        series: `measured`, and optionally `command` and `simulated/LABEL`.
        episodes: regular expression, as RE2 has them, that the path of one file per episode, below the imported folder,
            matches in full; its named groups can be used as `{group}` in `id`, `file` and the constants below. Without
            one, all files of the first of `ENDINGS` that there are.
        id: the episode's id; by default the path without its ending.
        robot: name of the robot.
        unit: which individual robot.
        payload_kg: payload [kg], a number or `{group}`; not recorded if empty.
        kp_setting: of the drives' position gain, in the unit of their firmware, a number or `{group}`; not recorded if
            empty.
        condition: base condition or gait.
        licence: licence of the recording.
        metadata: CSV file with a column `id` and any of `robot`, `unit`, `payload_kg`, `kp_setting`,
            `condition`, over the above.
        delimiter: of text files, one character or `whitespace`; found by the header if empty.
        header: names of the columns if text files have no header line; `none` calls them `0`, `1`, ...
        skip_lines: lines before the header.
        header_rows: lines of the header; what stands below each other is one name, with dots.
        units_row: whether a line of units follows the header.
        decimal: `,` or `.`; found by the cells if empty.
        encoding: of text files, such as `latin-1`; UTF-8, or what their byte order mark says, if empty.
        skip_bad_rows: leave out rows of another length than the header, and those with cells that are no numbers.
        split: where a file ends one motion and begins the next.
        group: regular expression, as RE2 has them, of groups in a file of arrays that are a motion each; names of
            columns are then those within.
        keep_origin: keep the stamps as they are instead of counting from the episode's first.
        bodies: names of the bodies of `body.` signals.
        joint_pattern: regular expression, as RE2 has them, of names of columns, whose group `joint` is a joint's name.
        name: how messages call the mapping.
    """

    joints: tuple[str, ...]
    series: Mapping[str, SeriesColumns]
    episodes: str = ""
    id: str = ""
    robot: str | FileValue = ""
    unit: str | FileValue = ""
    payload_kg: str | FileValue = ""
    kp_setting: str | FileValue = ""
    condition: str | FileValue = ""
    licence: str = ""
    metadata: str = ""
    delimiter: str = ""
    header: tuple[str, ...] = ()
    skip_lines: int = 0
    header_rows: int = 1
    units_row: bool = False
    decimal: str = ""
    encoding: str = ""
    skip_bad_rows: bool = False
    split: SplitRule | None = None
    group: str = ""
    keep_origin: bool = False
    bodies: tuple[str, ...] = ()
    joint_pattern: str = ""
    name: str = "mapping"

    def __post_init__(self) -> None:
        """Refuse what cannot work for any file."""
        if "measured" not in self.series:
            raise ConfigError(f"{self.name} has no series `measured`", available=self.series)
        if self.delimiter and (
            (len(self.delimiter) != 1 and self.delimiter != "whitespace") or self.delimiter in '"\r\n'
        ):
            raise ConfigError(
                f"{self.name}: delimiter", got=repr(self.delimiter), expected="one character, or whitespace"
            )
        if self.header_rows < 1:
            raise ConfigError(f"{self.name}: header_rows", got=self.header_rows, expected="1 or more")
        if self.decimal not in ("", ",", "."):
            raise ConfigError(f"{self.name}: decimal", got=repr(self.decimal), expected="`,` or `.`")
        if self.group and self.split is not None:
            raise ConfigError(f"{self.name}: group and split both say where motions are", expected="one of them")
        group_names(self.group, where=f"{self.name}: group")
        groups = group_names(self.episodes, where=f"{self.name}: episodes")
        about = [said for key in ABOUT if isinstance(said := getattr(self, key), str)]
        for template in (self.id, *about, *(series.file for series in self.series.values())):
            substitute(template, dict.fromkeys(groups, ""), where=self.name)
        if self.joint_pattern and "joint" not in group_names(self.joint_pattern, where=f"{self.name}: joints"):
            raise ConfigError(
                f"{self.name}: joints",
                got=self.joint_pattern,
                expected="a list of names, or an expression of columns with a group `(?P<joint>…)`",
            )
        if not self.joint_pattern or self.joints:
            for series in self.series:
                self._check_series(series)

    def _check_series(self, series: str) -> None:
        where = f"{self.name}: {series}"
        joints, spec = self.joints_of(series), self.series[series]
        if series not in {"measured", "command"} and not series.startswith("simulated/"):
            raise ConfigError(f"{where} is no series", available=["measured", "command", "simulated/LABEL"])
        if len(set(joints)) < len(joints) or not joints:
            raise ConfigError(f"{where}: joints are missing or named twice", got=list(joints))
        if spec.time.unit not in UNITS:
            raise UnitError(f"{where}: unknown unit {spec.time.unit!r} of the clock", available=["s", "ms", "us", "ns"])
        conversion(spec.time.unit, "s")
        ways = (spec.time.column, spec.time.columns, spec.time.rate_hz, spec.time.period)
        if sum(map(bool, ways)) != 1 or len(spec.time.columns) not in (0, 2):
            expected = "one of column: NAME, columns: [SECONDS, NANOSECONDS], rate_hz: NUMBER, period: NAME"
            raise ConfigError(f"{where}: time", got=[way for way in ways if way], expected=expected)
        for signal, item in spec.signals.items():
            if signal not in SI_UNIT:
                raise ConfigError(f"{where} has an unknown signal", got=signal, available=SI_UNIT)
            columns, slots = self.columns(series, signal), self.slots(series, signal)
            if self.is_vector(series, signal):
                self._check_units(f"{where}: {signal}", item, slots)
                continue
            if len(columns) != len(slots) * math.prod(COMPONENTS.get(signal, ())) or len(set(columns)) < len(columns):
                raise ConfigError(f"{where}: {signal} needs one column each for {', '.join(slots)}", got=list(columns))
            self._check_units(f"{where}: {signal}", item, slots)

    def _check_units(self, where: str, item: SignalColumns, slots: tuple[str, ...]) -> None:
        units = (item.unit,) if isinstance(item.unit, str) else item.unit
        unknown = [unit for unit in units if unit not in UNITS]
        if unknown:
            raise UnitError(f"{where}: unknown unit {', '.join(unknown)}", available=UNITS)
        if not isinstance(item.unit, str) and len(units) != len(slots):
            raise ConfigError(f"{where} needs one unit, or one each for {', '.join(slots)}", got=list(units))
        for key, own in (("factor", item.factor), ("offset", item.offset)):
            numbers = (own,) if isinstance(own, int | float) else own
            if len(numbers) not in (1, len(slots)) or not all(math.isfinite(number) for number in numbers):
                raise ConfigError(
                    f"{where}: {key}", got=list(numbers), expected=f"one number, or one each for {', '.join(slots)}"
                )
        if item.dtype not in {"float64", "float32"}:
            raise ConfigError(f"{where}: dtype", got=item.dtype, available=["float64", "float32"])

    def of_columns(self, names: Sequence[str]) -> TableMapping:
        """This mapping with the joints that the columns of a file are named after.

        Raises:
            NameMismatch: none is.
        """
        if not self.joint_pattern:
            return self
        found = matches(self.joint_pattern, names, where=f"{self.name}: joints")
        joints = tuple(dict.fromkeys(groups["joint"] for groups in found if groups is not None))
        if not joints:
            raise NameMismatch(
                f"no column says the name of a joint as {self.name} expects",
                left=[self.joint_pattern],
                right=names,
                left_name="needed",
                right_name="the file has",
            )
        return replace(self, joints=joints)

    def joints_of(self, series: str) -> tuple[str, ...]:
        """Names of the joints of a series."""
        return self.series[series].joints or self.joints

    def slots(self, series: str, signal: str) -> tuple[str, ...]:
        """What the columns of a signal belong to: joints or bodies."""
        return self.bodies if signal.startswith(BODY_PREFIX) else self.joints_of(series)

    def units(self, series: str, signal: str) -> tuple[str, ...]:
        """One unit per joint or body."""
        unit = self.series[series].signals[signal].unit
        return (unit,) * len(self.slots(series, signal)) if isinstance(unit, str) else unit

    def is_vector(self, series: str, signal: str) -> bool:
        """Whether one column has all joints: of vectors, or of a table in which a row is a sample of one joint."""
        columns = self.series[series].signals[signal].columns
        if not isinstance(columns, str) or _FIELD.search(columns):
            return False
        several = len(self.slots(series, signal)) * math.prod(COMPONENTS.get(signal, ())) > 1
        return several or bool(self.series[series].joint_column)

    def columns(self, series: str, signal: str) -> tuple[str, ...]:
        """Names of the columns of a signal, joint by joint, or body by body and component by component."""
        columns = self.series[series].signals[signal].columns
        if not isinstance(columns, str):
            return columns
        if self.is_vector(series, signal):
            return (columns,)
        if signal.startswith(BODY_PREFIX):
            return tuple(
                substitute(columns, {"body": body, "n": str(i + 1), "i": str(i), "k": str(k)}, where=signal)
                for i, body in enumerate(self.bodies)
                for k in range(math.prod(COMPONENTS[signal]))
            )
        return tuple(
            substitute(columns, {"joint": joint, "n": str(i + 1), "i": str(i)}, where=signal)
            for i, joint in enumerate(self.joints_of(series))
        )
