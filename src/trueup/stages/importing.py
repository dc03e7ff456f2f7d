"""Import: logs in, a dataset out."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from trueup.align import JointMap, check_quality
from trueup.core.episode import Episode
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.dataset import DatasetInfo, DatasetWriter, assign_splits, match_splits, read_split
from trueup.dataset.importers.base import EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.detect import find_importer
from trueup.errors import ConfigError, DataError, TrueupError
from trueup.robots import RobotSpec
from trueup.stages.progress import Track, silent

# A model folder with meshes is copied whole; beyond this size it is somebody's asset library.
_MAX_MODEL_BYTES = 200 * 2**20


@dataclass(frozen=True)
class ImportSummary:
    """What an import did.

    Attributes:
        path: the dataset.
        format: the log format.
        imported: number of episodes written now.
        kept: number of episodes that were there from an interrupted import.
        refused: episode id -> why it could not be read; the others were imported all the same.
        flagged: episode id -> kinds of warnings that the quality checks raised.
        notes: what a person should know.
    """

    path: Path
    format: str
    imported: int
    kept: int = 0
    refused: Mapping[str, TrueupError] = field(default_factory=dict)
    flagged: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def plan_import(source: Path, *, format: str | None = None, options: ImportOptions | None = None) -> ImportPlan:
    """What an import of `source` would read, without reading it.

    Raises:
        TrueupError: the format is unknown, or nothing can be imported.
    """
    plan = find_importer(source, format).scan(source, options or ImportOptions())
    if not plan.episodes:
        raise DataError(f"{source} holds no episodes", got=f"format {plan.format}", hint="; ".join(plan.notes) or None)
    return plan


def import_logs(
    source: Path | str,
    out: Path | str,
    *,
    format: str | None = None,
    options: ImportOptions | None = None,
    robot: RobotSpec | None = None,
    split: Path | Mapping[str, float] | None = None,
    seed: int = 0,
    overwrite: bool = False,
    resume: bool = False,
    track: Track = silent,
) -> ImportSummary:
    """Read logs of any known format into a dataset.

    Each episode is checked (see `align.check_quality`) and written on its own: after an interruption what was
    finished stays readable, and `resume` reads only the rest. An episode that cannot be read is listed in the
    summary and does not stop the others.

    Args:
        source: file or folder.
        out: the dataset's folder.
        format: name of the format; detected if None.
        options: mapping file, units, topics.
        robot: whose logs they are; its limits enter the quality checks.
        split: a split.json, or fractions such as {"train": 0.8, "val": 0.1, "test": 0.1} drawn by whole motion;
            None takes what lies beside the data.
        seed: of that draw.
        overwrite: delete the dataset that is there first.
        resume: go on with the dataset that is there.
        track: shows progress.

    Raises:
        OutputExists: `out` is there, and neither `overwrite` nor `resume` is given.
        TrueupError: the format is unknown, or no episode could be read.
    """
    source, out = Path(source), Path(out)
    _refuse_nesting(source, out)
    plan = plan_import(source, format=format, options=options)
    splits = dict(plan.splits)
    notes = list(plan.notes)
    if split is not None:
        splits, unmatched = _splits(split, [item.id for item in plan.episodes], seed)
        notes += unmatched
    info = DatasetInfo(
        robot=robot.name if robot else plan.robot,
        licence=plan.licence,
        provenance=provenance(config={"format": plan.format, "source": source.name, **plan.details}, seed=seed),
        notes=tuple(notes),
    )
    refused: dict[str, TrueupError] = {}
    flagged: dict[str, tuple[str, ...]] = {}
    writer = DatasetWriter.resume(out, info) if resume else DatasetWriter.create(out, info, overwrite=overwrite)
    with writer:
        there = writer.ids
        if plan.model_dir is not None and not writer.info.model:
            writer.info = _copy_model(plan.model_dir, out, writer.info)
        missing = [item for item in plan.episodes if item.id not in there]
        for item in track(missing, "import", len(missing)):
            episode = _load(item, splits.get(item.id, ""), robot, refused)
            if episode is None:
                continue
            if episode.meta.warned:
                flagged[item.id] = tuple(
                    dict.fromkeys(flag.kind for flag in episode.meta.flags if flag.severity == "warning")
                )
            writer.append(episode)
    imported = len(missing) - len(refused)
    if refused and not imported and not there:
        first = next(iter(refused.values()))
        if len(refused) == 1:
            raise first
        raise DataError(f"none of the {len(refused)} episodes in {source} could be read, the first because", got=first)
    kept = len(plan.episodes) - len(missing)
    return ImportSummary(out, plan.format, imported, kept, refused, flagged, tuple(notes))


def _load(item: EpisodeSource, split: str, robot: RobotSpec | None, refused: dict[str, TrueupError]) -> Episode | None:
    try:
        episode = checked(item.load(), robot)
    except TrueupError as error:
        refused[item.id] = error
        return None
    return replace(episode, meta=replace(episode.meta, split=split or episode.meta.split))


def checked(episode: Episode, robot: RobotSpec | None = None) -> Episode:
    """The episode with what the quality checks find; the limits that the robot's description states count, too."""
    positions, torques = _limits_of_log(robot, episode.measured.joints) if robot else ({}, {})
    return episode.with_flags(check_quality(episode, limits=positions, torque_limits=torques))


def _limits_of_log(
    robot: RobotSpec, log_joints: Sequence[str]
) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """Position and torque limits, in the names and units of a log that may speak of the joints in other words."""
    joint_map = JointMap.from_dict(robot.joint_rules())
    if not set(joint_map.log_joints) <= set(log_joints):
        joint_map = JointMap.identity(robot.joint_names)  # in the robot's own words, or of another robot
    nan = float("nan")
    ends = np.array([joint.position_limits or (nan, nan) for joint in robot.joints], dtype=np.float64).T
    torque = np.array([joint.torque_limit or nan for joint in robot.joints], dtype=np.float64)
    limits = TimeSeries(
        time_s=np.array([0.0, 1.0]),
        joints=robot.joint_names,
        signals={"position": ends, "torque": np.stack([torque, torque])},
        units={"position": ("rad",) * len(torque), "torque": ("Nm",) * len(torque)},
    )
    told = joint_map.invert().apply(limits)
    columns = [(name, column) for column, name in enumerate(told.joints) if name in log_joints]
    positions = {name: np.sort(told["position"][:, column]) for name, column in columns}
    torques = {name: abs(float(told["torque"][0, column])) for name, column in columns}
    return (
        {name: (float(low), float(high)) for name, (low, high) in positions.items() if np.isfinite(low + high)},
        {name: value for name, value in torques.items() if np.isfinite(value)},
    )


def _splits(split: Path | Mapping[str, float], ids: Iterable[str], seed: int) -> tuple[dict[str, str], list[str]]:
    names = list(ids)
    if isinstance(split, Mapping):
        return assign_splits(names, split, seed=seed), []
    match = match_splits(read_split(split), names)
    return dict(match.splits), list(match.notes)


def _refuse_nesting(source: Path, out: Path) -> None:
    inside = out.resolve()
    if inside == source.resolve() or inside in source.resolve().parents:
        raise ConfigError(f"the dataset cannot be written over its source {source}", got=out)


def _copy_model(folder: Path, out: Path, info: DatasetInfo) -> DatasetInfo:
    """The robot's model goes with the data, so that a replay needs nothing else."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.is_symlink()]
    if sum(path.stat().st_size for path in files) > _MAX_MODEL_BYTES:
        return info
    for path in files:
        target = out / "model" / path.relative_to(folder)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    info = replace(info, model="model")
    info.save(out)
    return info
