"""Mapping files: which columns of which CSV files are which signals of a robot, in which unit."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from trueup.core.timeseries import BODY_PREFIX
from trueup.core.units import SI_UNIT, UNITS, conversion
from trueup.dataset.importers.pattern import group_names
from trueup.errors import ConfigError, UnitError

_FIELD = re.compile(r"\{(\w+)\}")
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
    """Where the stamps of a series are.

    Attributes:
        column: name of the column.
        unit: `s`, `ms`, `us` or `ns`.
    """

    column: str
    unit: str = "s"


@dataclass(frozen=True)
class SignalColumns:
    """Where a signal is.

    Attributes:
        columns: one column per joint, in the order of `joints`; or one template with `{joint}`, `{n}` (1, 2, ...)
            or `{i}` (0, 1, ...). Body signals: a template with `{body}` or `{n}`, and `{k}`, the component.
        unit: unit of all columns, or one per joint.
        optional: leave the signal out of files that have none of its columns.
        dtype: `float64` or `float32`.
    """

    columns: str | tuple[str, ...]
    unit: str | tuple[str, ...]
    optional: bool = False
    dtype: str = "float64"


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
    """

    time: ClockColumn
    signals: Mapping[str, SignalColumns]
    file: str = ""
    optional: bool = False
    joints: tuple[str, ...] = ()


# What is known of a motion apart from its samples, in mappings and in tables of metadata.
ABOUT = ("robot", "unit", "payload_kg", "kp_setting", "condition")


@dataclass(frozen=True)
class CsvMapping:
    """A mapping file.

    Attributes:
        joints: names of the joints, in the order of the columns.
        series: `measured`, and optionally `command` and `simulated/LABEL`.
        episodes: regular expression, as RE2 has them, that the path of one file per episode, below the imported folder,
            matches in full; its named groups can be used as `{group}` in `id`, `file` and the constants below.
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
        delimiter: one character, or `whitespace`.
        header: names of the columns if the files have no header line.
        skip_lines: lines before the header.
        keep_origin: keep the stamps as they are instead of counting from the episode's first.
        bodies: names of the bodies of `body.` signals.
        name: how messages call the mapping.
    """

    joints: tuple[str, ...]
    series: Mapping[str, SeriesColumns]
    episodes: str = r".*\.csv"
    id: str = ""
    robot: str = ""
    unit: str = ""
    payload_kg: str = ""
    kp_setting: str = ""
    condition: str = ""
    licence: str = ""
    metadata: str = ""
    delimiter: str = ","
    header: tuple[str, ...] = ()
    skip_lines: int = 0
    keep_origin: bool = False
    bodies: tuple[str, ...] = ()
    name: str = "mapping"

    def __post_init__(self) -> None:
        """Refuse what cannot work for any file."""
        if "measured" not in self.series:
            raise ConfigError(f"{self.name} has no series `measured`", available=self.series)
        if (len(self.delimiter) != 1 and self.delimiter != "whitespace") or self.delimiter in '"\r\n':
            raise ConfigError(
                f"{self.name}: delimiter", got=repr(self.delimiter), expected="one character, or whitespace"
            )
        groups = group_names(self.episodes, where=f"{self.name}: episodes")
        templates = [self.id, *(getattr(self, key) for key in ABOUT)]
        for template in (*templates, *(series.file for series in self.series.values())):
            substitute(template, dict.fromkeys(groups, ""), where=self.name)
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
        for signal, item in spec.signals.items():
            if signal not in SI_UNIT:
                raise ConfigError(f"{where} has an unknown signal", got=signal, available=SI_UNIT)
            columns, slots = self.columns(series, signal), self.slots(series, signal)
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
        if item.dtype not in {"float64", "float32"}:
            raise ConfigError(f"{where}: dtype", got=item.dtype, available=["float64", "float32"])

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

    def columns(self, series: str, signal: str) -> tuple[str, ...]:
        """Names of the columns of a signal, joint by joint, or body by body and component by component."""
        columns = self.series[series].signals[signal].columns
        if not isinstance(columns, str):
            return columns
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
