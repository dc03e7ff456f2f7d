"""LeRobot datasets, versions 2 and 3: `observation.state` is measured, `action` is the command.

Joint names come from the features' `names`; endings such as `.pos` and `.vel` say the signal. Videos are not read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.timeseries import TimeSeries
from trueup.dataset.importers.base import EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.beside import licence_beside, model_beside
from trueup.dataset.importers.clock import usable_clock
from trueup.dataset.importers.files import episode_id, unique_ids
from trueup.dataset.importers.gain_setting import kp_setting_of
from trueup.dataset.importers.lerobot_columns import ACTION, STATE, Columns
from trueup.dataset.importers.lerobot_info import INFO, LeRobotInfo, read_info, read_splits
from trueup.dataset.importers.lerobot_rows import OWN, EpisodeRow, FrameReader, read_episodes, reading, vectors
from trueup.dataset.importers.stated import Stated, read_stated, with_units
from trueup.errors import MissingSignal, NameMismatch

NAME = "lerobot"
LOOKS_FOR = f"a folder with {INFO}"
EPISODE = "an episode"
ASSUMES = "SI unless stated: **check this**"

# LeRobot's own tolerance between a stamp and frame_index / fps [s].
TOLERANCE_S = 1e-4
# No joint turns further; larger values called rad are degrees or percent.
_LARGEST_RAD = 4.0 * math.pi


def detects(path: Path) -> bool:
    """Whether `path` is the folder of a LeRobot dataset."""
    try:
        return (path / INFO).is_file()
    except OSError:
        return False


def scan(path: Path, options: ImportOptions) -> ImportPlan:
    """List the episodes of the dataset in `path`.

    Raises:
        FormatError: the dataset is of another version than 2 and 3.
        DataError: the metadata are missing or damaged.
        ConfigError: an option that is not read, the mapping file is wrong, or joints have no names and none are stated.
        NameMismatch: state and action have no joint in common.
        MissingSignal: there is no `observation.state`.
    """
    options.refuse_others(NAME, "units", "mapping")
    stated = read_stated(options)
    info = read_info(path)
    columns = {series: Columns.of(info, series, stated) for series in ("measured", "command")}
    measured, command = columns["measured"], columns["command"]
    if not measured.joints:
        raise MissingSignal(f"{path}: {STATE} has no joints", available=info.features)
    if command.joints and not set(command.joints) & set(measured.joints):
        raise NameMismatch(
            f"{path}: {STATE} and {ACTION} have no joint in common",
            left=measured.joints,
            right=command.joints,
            left_name=STATE,
            right_name=ACTION,
        )
    rows = read_episodes(path, info)
    names = {row.number: episode_id(str(row.about.get(f"{OWN}id", f"episode_{row.number:06d}"))) for row in rows}
    unique_ids((name, f"episode {number}") for number, name in names.items())
    splits, split_notes = read_splits(info, list(names))
    reader = FrameReader([name for series in columns.values() for name in series.features])
    sources = tuple(
        EpisodeSource(
            names[row.number],
            partial(_load, path, info, row, names[row.number], columns, reader, stated),
            row.length * 4 * sum(feature.width for series in columns.values() for feature in series.features.values()),
            row.file.relative_to(path).as_posix(),
        )
        for row in rows
    )
    return ImportPlan(
        format=NAME,
        episodes=sources,
        robot=stated.robot or info.robot,
        licence=licence_beside(path),
        splits={names[number]: split for number, split in splits.items()},
        model_dir=model_beside(path),
        notes=(*measured.notes, *command.notes, *_videos(info), *split_notes),
    )


def _videos(info: LeRobotInfo) -> tuple[str, ...]:
    skipped = [name for name, feature in info.features.items() if feature.dtype in {"video", "image"}]
    return (f"images and videos are not imported: {', '.join(skipped)}",) if skipped else ()


def _load(
    root: Path,
    info: LeRobotInfo,
    row: EpisodeRow,
    name: str,
    columns: Mapping[str, Columns],
    reader: FrameReader,
    stated: Stated,
) -> Episode:
    """Read one episode."""
    table = reader.read(row)
    source = f"{row.file}, episode {row.number}"
    with reading(row.file):
        stamps = vectors(table, "timestamp", 1, source)[:, 0].astype(np.float64)
        grid = np.arange(row.length) / info.fps
        # Stamps are stored in float32, which is coarser than the tolerance after half an hour.
        on_grid = bool(np.all(np.abs(stamps - grid) <= TOLERANCE_S + np.spacing(grid.astype(np.float32))))
        time_s = grid if on_grid else stamps - stamps[0]
        rows, clock_flags = usable_clock(time_s, source=source)
        series = {kind: item.series(table, time_s, source).rows(rows) for kind, item in columns.items() if item.joints}
    joints = tuple(joint for item in series.values() for joint in item.joints)
    series = {kind: with_units(item, stated.units, joints) for kind, item in series.items()}
    return Episode(
        meta=EpisodeMeta(
            id=name,
            robot=stated.robot or info.robot,
            unit=stated.unit or str(row.about.get(f"{OWN}unit", "")),
            payload_kg=stated.payload_kg if stated.payload_kg is not None else _payload(row),
            kp_setting=stated.kp_setting
            or kp_setting_of(row.about.get(f"{OWN}kp_setting"), f"{row.file}: {OWN}kp_setting"),
            condition=stated.condition or str(row.about.get(f"{OWN}condition", "")),
            source=row.file.relative_to(root).as_posix(),
            source_hash=reader.hash_of(row.file),
            flags=(*clock_flags, *_flags(series, columns, row)),
        ),
        measured=series["measured"],
        command=series.get("command"),
    )


def _payload(row: EpisodeRow) -> float | None:
    value = row.about.get(f"{OWN}payload_kg")
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _flags(series: Mapping[str, TimeSeries], columns: Mapping[str, Columns], row: EpisodeRow) -> list[Flag]:
    """What this episode's values and task say."""
    flags = []
    for kind, item in series.items():
        if "position" in columns[kind].assumed:
            largest = float(np.nanmax(np.abs(item["position"]), initial=0.0))
            if largest > _LARGEST_RAD:
                detail = f"positions up to {largest:.4g} cannot be rad, which was assumed: state their unit"
                flags.append(Flag(kind="unit", series=kind, signal="position", detail=detail))
    tasks = row.about.get("tasks")
    said = "; ".join(str(task) for task in tasks if task) if isinstance(tasks, list) else ""
    if said:
        flags.append(Flag(kind="about", detail=f"task: {said}", severity="note"))
    return flags
