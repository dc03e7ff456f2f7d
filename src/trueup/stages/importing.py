"""Import: logs in, a dataset out."""

from __future__ import annotations

import contextlib
import hashlib
import re
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from trueup.align import JointMap, check_quality
from trueup.align.quality import KINDS
from trueup.core.atomic import as_read_back
from trueup.core.episode import Episode, Flag, warning_kinds
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.dataset import (
    Dataset,
    DatasetInfo,
    DatasetWriter,
    assign_splits,
    is_dataset,
    match_splits,
    read_split,
    refuse_occupied,
    refuse_results,
)
from trueup.dataset.importers.base import ASSUMED, EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.detect import find_importer
from trueup.dataset.importers.packed import opened
from trueup.errors import ConfigError, DataError, NameMismatch, OutputExists, TrueupError
from trueup.robots import RobotSpec
from trueup.stages.progress import Track, silent
from trueup.stages.robot_model import copy_model

# What is held out where nobody says it, and of how many motions at least.
HELD_OUT: Mapping[str, float] = {"train": 0.7, "val": 0.15, "test": 0.15}
FEWEST_HELD_OUT = 6
_LONGEST_S = 30 * 86400.0
_LONGEST_NAME = 200
# Control characters, which would command a terminal, overrides of the writing direction, and halves of characters.
_NOT_TEXT = re.compile("[\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_LARGEST = 1e15


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
        TrueupError: the format is unknown, nothing can be imported, or it is a folder of results.
    """
    refuse_results(source)
    options = options or ImportOptions()
    logs = opened(source)
    plan = find_importer(logs.path, format, options.mapping).scan(logs.path, options)
    if not plan.episodes:
        raise DataError(f"{source} holds no episodes", got=f"format {plan.format}", hint="; ".join(plan.notes) or None)
    return replace(plan, kept=logs.kept)


def _refuse_other_robot(plan: ImportPlan, robot: RobotSpec) -> None:
    """Look at the first, the middle and the last episode, before all are read: are they of another robot?"""
    joint_map = JointMap.from_dict(robot.joint_rules())
    first: NameMismatch | None = None
    for number in sorted({0, len(plan.episodes) // 2, len(plan.episodes) - 1}):
        try:
            joints = set((series := plan.episodes[number].load().measured).joints)
        except TrueupError:  # the import says so
            return
        if joints & {*joint_map.log_joints, *robot.joint_names}:
            return
        try:
            joint_map.for_series(series)
        except NameMismatch as error:
            first = first or error
    if first is not None:
        raise first


def dataset_of(
    source: Path,
    stack: contextlib.ExitStack,
    *,
    robot: RobotSpec,
    format: str | None = None,
    options: ImportOptions | None = None,
    track: Track = silent,
) -> tuple[Dataset, list[str]]:
    """The dataset; of logs, one that is gone with the stack. And what was left out.

    Raises:
        ConfigError: it is a dataset, and options of an import are given.
        TrueupError: what an import raises.
    """
    refuse_results(source)
    if is_dataset(source):
        if format is not None or (options or ImportOptions()) != ImportOptions():
            raise ConfigError(
                f"{source} is a dataset, so import options do not apply",
                hint="Leave them out, or give the logs that it was imported from.",
            )
        return Dataset(source), []
    out = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="trueup-"))) / "dataset"
    imported = import_logs(source, out, format=format, options=options, robot=robot, refuse_others=True, track=track)
    refused = [f"{name} was not imported: {error.summary}" for name, error in imported.refused.items()]
    return Dataset(out), refused


def import_logs(
    source: Path | str,
    out: Path | str,
    *,
    format: str | None = None,
    options: ImportOptions | None = None,
    robot: RobotSpec | None = None,
    refuse_others: bool = False,
    refuse_more: bool = False,
    splits: Path | Mapping[str, float] | None = None,
    hold_out: bool = False,
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
        refuse_others: refuse logs of which neither the first, the middle nor the last has a joint of this robot.
        refuse_more: refuse logs that would add motions to the dataset that is there.
        splits: a split.json, or fractions such as {"train": 0.8, "val": 0.1, "test": 0.1} drawn by whole motion;
            None takes what lies beside the data.
        hold_out: draw `HELD_OUT` where neither says anything, of `FEWEST_HELD_OUT` motions or more.
        seed: of the draw.
        overwrite: delete the dataset that is there first.
        resume: go on with the dataset that is there.
        track: shows progress.

    Raises:
        OutputExists: `out` is there, and neither `overwrite` nor `resume` is given; or it has fewer motions, and more
            are refused.
        NameMismatch: the logs are of another robot, and such are refused; both lists are printed.
        TrueupError: the format is unknown, or no episode could be read.
    """
    source, out = Path(source), Path(out)
    refuse_nesting(source, out)
    plan = plan_import(source, format=format, options=options)
    if refuse_others and robot is not None:
        _refuse_other_robot(plan, robot)
    if isinstance(splits, Path):
        # Read before anything is written: a dataset whose splits cannot be had would pass for one that has none.
        read_split(splits)
    units_known = robot is not None and all(joint.log_unit for joint in robot.joints)
    notes = [note for note in plan.notes if not (units_known and note.startswith(ASSUMED))]
    config = {"format": plan.format, "source": source.name, "options": _plain(options)}
    info = DatasetInfo(
        robot=robot.name if robot else plan.robot,
        licence=plan.licence,
        provenance={**provenance(config=config, seed=seed), "complete": False},
        notes=tuple(notes),
    )
    if not resume:
        refuse_occupied(out, overwrite=overwrite)
    refused: dict[str, TrueupError] = {}
    flagged: dict[str, tuple[str, ...]] = {}
    with contextlib.ExitStack() as stack:
        writer = None
        if resume and is_dataset(out):
            _refuse_other_options(DatasetInfo.load(out), info, out)
            writer = stack.enter_context(DatasetWriter.resume(out, info))
            if plan.model_dir is not None and not writer.info.model:
                writer.info = copy_model(plan.model_dir, out, writer.info)
        there = frozenset(writer.ids if writer else ())
        missing = [item for item in plan.episodes if item.id not in there]
        for item in track(missing, "import", len(missing)):
            # Splits of the user's own are assigned at the end, when all sources are known.
            split = plan.splits.get(item.id, "") if splits is None else ""
            episode = _load(item, split, robot, refused)
            if episode is None:
                continue
            if refuse_more and there:
                raise OutputExists(
                    f"{source} holds motions that {out} has not",
                    got=item.id,
                    hint="Resume with the logs of the first call, give --overwrite, or choose another --out.",
                )
            if writer is None:  # only now, so that an import of which nothing can be read leaves nothing behind
                writer = stack.enter_context(DatasetWriter.create(out, info, overwrite=overwrite))
                if plan.model_dir is not None:
                    writer.info = copy_model(plan.model_dir, out, writer.info)
            if episode.meta.warned:
                flagged[item.id] = warning_kinds(episode.meta.flags)
            writer.append(episode)
        if writer is not None:
            writer.info = replace(writer.info, provenance={**writer.info.provenance, "complete": True})
            writer.info.save(out)
    imported = len(missing) - len(refused)
    if refused and not imported and not there:
        first = next(iter(refused.values()))
        if len(refused) == 1:
            raise first
        what = f"none of the {len(refused)} episodes in {source} could be read; the first: {first.summary}"
        raise DataError(what, hint=first.hint)
    # A format that puts all motions into train says nothing of what to hold out.
    silent_on_it = {plan.splits.get(item.id, "train") or "train" for item in plan.episodes} == {"train"}
    if hold_out and splits is None and silent_on_it and len(Dataset(out)) >= FEWEST_HELD_OUT:
        splits = HELD_OUT
        notes.append("no splits given: 70 % of the motions are train, 15 % val, 15 % test (--splits)")
    if splits is not None:
        notes += split_anew(Dataset(out), splits, seed=seed)
    kept = len(plan.episodes) - len(missing)
    return ImportSummary(out, plan.format, imported, kept, refused, flagged, tuple(notes))


def is_whole(out: Path) -> bool:
    """Whether there is a dataset in a folder of which no import was interrupted."""
    return is_dataset(out) and bool(DatasetInfo.load(out).provenance.get("complete", True))


def _load(item: EpisodeSource, split: str, robot: RobotSpec | None, refused: dict[str, TrueupError]) -> Episode | None:
    try:
        episode = checked(item.load(), robot)
    except TrueupError as error:
        refused[item.id] = error
        return None
    return replace(episode, meta=replace(episode.meta, split=split))


def checked(episode: Episode, robot: RobotSpec | None = None) -> Episode:
    """The episode with what the quality checks find.

    With a robot, they see the motion in its units: thresholds are in radians, and degrees or encoder ticks of which the
    log says nothing would look like a robot that runs wild. The limits of its description count, too.
    """
    if episode.measured.duration_s > _LONGEST_S:
        raise DataError(
            f"episode {episode.id!r} lasts {episode.measured.duration_s:.3g} s",
            hint="Are its stamps really in seconds? A mapping file states their unit.",
        )
    _refuse_nonsense(episode)
    episode = _without_empty(episode)
    if robot is None:
        return episode.with_flags(check_quality(episode))
    if all(joint.log_unit for joint in robot.joints):  # what the importer assumed does not count
        episode = replace(
            episode,
            meta=replace(episode.meta, flags=tuple(flag for flag in episode.meta.flags if flag.kind != "unit")),
        )
    joint_map = JointMap.from_dict(robot.joint_rules())
    try:
        seen = joint_map.of_episode(episode)
    except TrueupError:  # of another robot, or without what it follows: a replay says so
        return episode.with_flags(check_quality(episode))
    flags = check_quality(
        seen,
        limits={joint.name: joint.position_limits for joint in robot.joints},
        torque_limits={joint.name: joint.torque_limit for joint in robot.joints if joint.torque_limit},
    )
    of_log = joint_map.for_series(episode.measured)
    names = dict(zip(of_log.joints, of_log.log_joints, strict=True))
    found = (replace(flag, joint=names.get(flag.joint, "")) if flag.kind in KINDS else flag for flag in flags)
    return episode.with_flags(tuple(found))


def _without_empty(episode: Episode) -> Episode:
    """Without signals that have a place in the log, and not a single value; positions stay, since a robot has them."""
    measured, flags = _with_values(episode.measured, "measured")
    command, more = (None, []) if episode.command is None else _with_values(episode.command, "command")
    if not flags and not more:
        return episode
    return replace(episode, measured=measured, command=command).with_flags((*episode.meta.flags, *flags, *more))


def _with_values(series: TimeSeries, name: str) -> tuple[TimeSeries, list[Flag]]:
    empty = [key for key, values in series.signals.items() if key != "position" and not np.isfinite(values).any()]
    if not empty or len(empty) == len(series.signals):
        return series, []
    signals = {key: values for key, values in series.signals.items() if key not in empty}
    units = {key: unit for key, unit in series.units.items() if key not in empty}
    detail = "no sample of any joint has a value: the signal is left out"
    flags = [Flag(kind="empty_signal", series=name, signal=key, detail=detail, severity="note") for key in empty]
    return replace(series, signals=signals, units=units), flags


def _refuse_nonsense(episode: Episode) -> None:
    """Names that no file or terminal can hold, and numbers whose squares no number can."""
    for one in filter(None, (episode.measured, episode.command, *episode.simulated.values())):
        for name in (*one.joints, *one.bodies):
            if _NOT_TEXT.search(name) or not 0 < len(name) <= _LONGEST_NAME:
                raise DataError(f"episode {episode.id!r}: this is no name of a joint or body", got=repr(name))
        for signal, values in one.signals.items():
            largest = np.abs(values).max(initial=0.0, where=~np.isnan(values))
            if largest > _LARGEST:
                raise DataError(f"episode {episode.id!r}: {signal} has values that no robot has", got=f"{largest:g}")


def split_anew(dataset: Dataset, splits: Path | Mapping[str, float], *, seed: int) -> tuple[str, ...]:
    """Give the episodes the splits of a file, and no others, or such as are drawn by whole motion; returns notes.

    Raises:
        ConfigError: the shares cannot be drawn.
        DataError, FormatError: the file is no split file.
    """
    if isinstance(splits, Mapping):
        dataset.set_splits(assign_splits(dataset.ids, splits, seed=seed))
        return ()
    sources = {meta.id: meta.source for meta in dataset.metas}
    match = match_splits(read_split(splits), dataset.ids, sources=sources)
    dataset.set_splits({name: match.splits.get(name, "") for name in dataset.ids})
    return match.notes


def _plain(options: ImportOptions | None) -> dict[str, Any]:
    """Options as JSON; a mapping file by its content, which decides, not its place."""
    options = options or ImportOptions()
    tree = asdict(options)
    for name in ("mapping", "spare_mapping"):
        mapping = tree.pop(name)
        if mapping is not None:
            tree[name] = hashlib.sha256(mapping.read_bytes()).hexdigest() if mapping.is_file() else str(mapping)
    return {"mapping": None, **tree}


def _refuse_other_options(stored: DatasetInfo, info: DatasetInfo, out: Path) -> None:
    before, now = (item.provenance.get("config", {}) for item in (stored, info))
    plain = as_read_back(now)
    changed = sorted(key for key in ("format", "options") if before.get(key) != plain.get(key))
    if changed:
        raise OutputExists(
            f"{out} was imported with other settings ({', '.join(changed)})",
            got=plain[changed[0]],
            expected=before.get(changed[0]),
            hint="Resume with the settings of the first call, or start again with --overwrite.",
        )


def refuse_nesting(source: Path, out: Path) -> None:
    """Logs are never changed: nothing is written over them, nor among them, where it would pass for one of them.

    Raises:
        ConfigError: that would be so.
    """
    logs, place = source.resolve(), out.resolve()
    if place == logs or place in logs.parents or logs in place.parents:
        raise ConfigError(
            f"the output folder must not contain the logs in {source}, or lie inside them",
            got=out,
            hint="Choose an --out beside the logs.",
        )
