"""HDF5 files as GapONet's appendix A.2 describes them: one file, one episode.

Variant 1, a legged humanoid: `command_time_list`, `command_val_list` and the group `robot` with
`joint_time_list`, `joint_angle_list`, `joint_velocity_list`, `joint_current_list`, `joint_temperature_list`.
Variant 2, two arms: groups `robot1` and `robot2` with a clock each, and one command for both, `robot1`'s joints
first. The second arm is interpolated linearly onto the clock of the first, where both have data.

The files carry no joint names: the user states them, or they stand in `joint_names` (a dataset or attribute of
the file or of a group). Likewise a file may say its `payload_kg`, `kp_setting` and
`condition`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.timeseries import TimeSeries, same_units
from trueup.core.units import SI_UNIT, conversion
from trueup.dataset.importers.base import EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.beside import plan_with
from trueup.dataset.importers.clock import common_origin, shifted, usable_clock
from trueup.dataset.importers.files import data_files, episode_id, files_hash
from trueup.dataset.importers.gain_setting import agreed_kp_setting, kp_setting_of
from trueup.dataset.importers.h5file import H5File, open_h5
from trueup.dataset.importers.h5names import ANGLES, LAYOUT, find_groups, joint_names
from trueup.dataset.importers.parts import on_one_clock
from trueup.dataset.importers.stated import Stated, read_stated, with_units
from trueup.errors import ConfigError, DataError, FormatError, TrueupError

NAME = "hdf5"
LOOKS_FOR = f"HDF5 files with {LAYOUT}"
EPISODE = "a file"
ASSUMES = "s; rad, rad/s, A, °C"

_SUFFIXES = (".h5", ".hdf5")
_SIGNALS = {
    "position": ANGLES,
    "velocity": "joint_velocity_list",
    "current": "joint_current_list",
    "temperature": "joint_temperature_list",
}
_IGNORED = ("imu_list", "ang_vel_list")
_ABOUT = ("motion_name", "slowdown_factor", "current_time")
# A float32 clock that counts from 1970 moves in steps of 128 s.
_COARSEST_S = 1e-4


def detects(path: Path) -> bool:
    """Whether `path` is an HDF5 file or holds some."""
    try:
        return bool(_files(path))
    except TrueupError:
        return False


def scan(path: Path, options: ImportOptions) -> ImportPlan:
    """List the HDF5 files at or below `path`; an episode's id is its path without the ending.

    Raises:
        FormatError: there is none.
        ConfigError: an option that is not read, the mapping file is wrong, or the first file needs joint names and none
            are stated.
        DataError: a link leads out of the folder; two files would get the same id.
    """
    options.refuse_others(NAME, "units", "mapping")
    stated = read_stated(options)
    files = _files(path)
    if not files:
        raise FormatError(f"{path} holds no HDF5 file", expected=LOOKS_FOR)
    root = path if path.is_dir() else path.parent
    episodes = []
    for file in files:
        source = file.relative_to(root).as_posix()
        name = episode_id(source.rpartition(".")[0])
        episodes.append(EpisodeSource(name, partial(_load, root, file, name, stated), file.stat().st_size, source))
    return plan_with(NAME, path, root, episodes, robot=stated.robot, notes=_first_names(files, stated))


def _files(path: Path) -> tuple[Path, ...]:
    return tuple(sorted(file for suffix in _SUFFIXES for file in data_files(path, suffix)))


def _first_names(files: Sequence[Path], stated: Stated) -> tuple[str, ...]:
    """What the first readable file holds, so that missing names are told before anything is imported."""
    for path in files:
        try:
            with open_h5(path) as file:
                groups = find_groups(file)
                joints = joint_names(file, groups, stated)
                ignored = [f"{group}/{name}" for group in groups for name in file.names(group) if name in _IGNORED]
        except DataError:
            continue  # its own episode says so when it is loaded
        return (
            f"units are rad, rad/s, A, degC; joints: {', '.join(name for part in joints for name in part)}",
            *((f"not imported: {', '.join(ignored)} (no joint signals)",) if ignored else ()),
            *(("robot2 is interpolated linearly onto robot1's clock",) if len(groups) > 1 else ()),
        )
    return ()


def _load(root: Path, path: Path, name: str, stated: Stated) -> Episode:
    """Read one file."""
    with open_h5(path) as file:
        groups = find_groups(file)
        names = joint_names(file, groups, stated)
        raw = [_read(file, group, joints, stated) for group, joints in zip(groups, names, strict=True)]
        command = _read_command(file, [joint for part in names for joint in part], stated)
        about = {key: file.scalar(key) for key in _ABOUT}
        said = kp_setting_of(file.number("kp_setting"), f"{file.source}: kp_setting")
        payload_kg, kp_setting = _payload(file, stated), agreed_kp_setting(said, stated.kp_setting, str(file.source))
        condition = stated.condition or file.scalar("condition")
    origin = common_origin(*(part.series.time_s for part in (*raw, command)))
    parts = [shifted(part.series, part.flags, origin=origin) for part in raw]
    commanded, command_flags = shifted(command.series, command.flags, origin=origin)
    measured = on_one_clock([series for series, _ in parts])
    if commanded.time_s[0] > measured.time_s[-1] or measured.time_s[0] > commanded.time_s[-1]:
        spans = [f"{series.time_s[0]:.6g} to {series.time_s[-1]:.6g} s" for series in (commanded, measured)]
        raise DataError(f"{path}: command and measurement do not overlap", got=f"command {spans[0]}, joints {spans[1]}")
    flags = [flag for _, part_flags in parts for flag in part_flags]
    flags += [*command_flags, *_notes(parts[0][0], measured, groups, about)]
    joints = (*measured.joints, *commanded.joints)
    return Episode(
        meta=EpisodeMeta(
            id=name,
            robot=stated.robot,
            unit=stated.unit,
            payload_kg=payload_kg,
            kp_setting=kp_setting,
            condition=condition,
            source=path.relative_to(root).as_posix(),
            source_hash=files_hash([path]),
            flags=tuple(flags),
        ),
        measured=with_units(measured, stated.units, joints),
        command=with_units(commanded, stated.units, joints),
    )


def _payload(file: H5File, stated: Stated) -> float | None:
    """What the file says, or else the mapping.

    Raises:
        DataError: it is no mass.
        ConfigError: they say different ones.
    """
    said = file.number("payload_kg")
    if said is None:
        return stated.payload_kg
    if not 0 <= said < np.inf:
        raise DataError(f"{file.source}: payload_kg is no mass", got=said, expected="kilograms, 0 or more")
    if stated.payload_kg not in (None, said):
        raise ConfigError(
            f"{file.source} says another payload than the mapping",
            got=f"{said:g} kg",
            expected=f"{stated.payload_kg:g} kg",
            hint="Leave `payload_kg` out of the mapping: each file then has its own.",
        )
    return said


def _notes(first: TimeSeries, merged: TimeSeries, groups: Sequence[str], about: dict[str, str]) -> list[Flag]:
    notes = []
    if len(groups) > 1:
        cut = len(first) - len(merged)
        detail = f"{groups[1]} is interpolated linearly onto {groups[0]}'s clock; {cut} of {len(first)} samples of "
        detail += f"{groups[0]} have no counterpart and were left out"
        severity = "warning" if cut > len(first) // 10 else "note"
        notes.append(Flag(kind="merged_clocks", detail=detail, severity=severity))
    said = ", ".join(f"{key}: {value}" for key, value in about.items() if value)
    if said:
        notes.append(Flag(kind="about", detail=said, severity="note"))
    return notes


@dataclass(frozen=True, eq=False)
class _Part:
    """A series on its raw clock, with what was noticed about it."""

    series: TimeSeries
    flags: tuple[Flag, ...]


def _read(file: H5File, group: str, joints: tuple[str, ...], stated: Stated) -> _Part:
    tables = {signal: _table(file, f"{group}/{name}", len(joints)) for signal, name in _SIGNALS.items()}
    present = {signal: values for signal, values in tables.items() if values is not None}
    return _part(file, f"{group}/joint_time_list", present, joints, "measured", stated)


def _read_command(file: H5File, joints: Sequence[str], stated: Stated) -> _Part:
    names = stated.command_joints or tuple(joints)
    values = file.numbers("command_val_list")
    if values is not None and values.ndim == 2 and values.shape[1] != len(names):
        raise ConfigError(
            f"{file.source}: the command has another number of columns than there are joints",
            got=f"{values.shape[1]} columns",
            expected=f"{len(names)} for {list(names)}",
            hint="Name the command's columns with `command_joints: [...]` in the file given with --mapping.",
        )
    table = _table(file, "command_val_list", len(names))
    if table is None:
        raise DataError(f"{file.source} has no command_val_list", available=file.names())
    return _part(file, "command_time_list", {stated.command_signal or "position": table}, names, "command", stated)


def _part(
    file: H5File,
    clock: str,
    signals: dict[str, Float64[np.ndarray, "T J"]],
    joints: tuple[str, ...],
    series: str,
    stated: Stated,
) -> _Part:
    time_s = _clock(file, clock, stated.time_unit)
    for signal, values in signals.items():
        if len(values) != time_s.size:
            raise DataError(
                f"{file.source}: {signal} and {clock} differ in length", got=f"{len(values)} rows", expected=time_s.size
            )
    rows, flags = usable_clock(time_s, source=f"{file.source}, {clock}", series=series)
    units = same_units({signal: SI_UNIT[signal] for signal in signals}, joints)
    kept = {signal: values[rows] for signal, values in signals.items()}
    return _Part(TimeSeries(time_s=time_s[rows], joints=joints, signals=kept, units=units), flags)


def _clock(file: H5File, name: str, unit: str) -> Float64[np.ndarray, "T"]:
    stamps = file.numbers(name)
    if stamps is None or stamps.size != max(stamps.shape, default=0):
        got = "nothing" if stamps is None else f"shape {stamps.shape}"
        raise DataError(f"{file.source}: {name} is no clock", got=got, expected="one stamp per sample")
    stamps = stamps.ravel()
    factor = conversion(unit, "s")
    if stamps.dtype.kind == "f" and stamps.size and np.isfinite(stamps).all():
        coarse = float(np.spacing(np.abs(stamps).max())) * factor
        if coarse > _COARSEST_S:
            raise DataError(
                f"{file.source}: {name} is stored as {stamps.dtype}, too coarse for its values",
                got=f"steps of {coarse:.3g} s at {float(stamps.max()):.6g}",
                hint="Subtract the first stamp before the clock is stored, or store it as float64.",
            )
    return np.asarray(stamps, dtype=np.float64) * factor


def _table(file: H5File, name: str, width: int) -> Float64[np.ndarray, "T J"] | None:
    values = file.numbers(name)
    if values is None:
        return None
    if values.ndim != 2 or values.shape[1] != width:
        raise DataError(
            f"{file.source}: {name} is no table of joints", got=values.shape, expected=f"(samples, {width})"
        )
    return np.asarray(values, dtype=np.float64)
