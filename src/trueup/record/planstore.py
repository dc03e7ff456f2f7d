"""Plan sets on disk: JSON for what was planned, Parquet for the samples.

    plans.json             what was asked for: description, robot, hash of the model; how many were planned
    blocks/00000.json      rows of the first block of motions: ids, joints, splits, draws; which were skipped, and why
    blocks/00000.parquet   their samples, one row group a motion

A block is planned and written as a whole, its JSON last; so a block is there or not, wherever planning was stopped.
"""

from __future__ import annotations

import hashlib
import importlib
import shutil
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from trueup.core.atomic import as_read_back, make_folder, read_json, write_json
from trueup.core.config import build
from trueup.core.provenance import provenance
from trueup.core.workers import in_processes
from trueup.dataset.columns import from_table, layout_of, to_table
from trueup.dataset.lock import LOCK_NAME, FolderLock
from trueup.dataset.shards import ShardReader, shard_name, write_shard
from trueup.errors import ConfigError, DataError, FormatError, MissingSignal, NoPlan, OutputExists
from trueup.record.plan import Plan
from trueup.record.planset import PLANS_SCHEMA, PlanSetSpec
from trueup.record.scene import Scene
from trueup.robots import RobotSpec, find_model

PLANS_NAME = "plans.json"
BLOCKS = "blocks"
BLOCK_SCHEMA = "trueup.plan-block/1"
# Motions of one block: what is planned again after an interruption, and the unit of work of a process.
BLOCK = 16

_OPEN_BLOCKS = 8

Progress = Callable[[int, int, int], None]


@dataclass(frozen=True)
class Planned:
    """What planning a set came to.

    Attributes:
        planned: motions that were planned, those of earlier runs included.
        skipped: motions for which no attempt led to a plan.
    """

    planned: int
    skipped: int


def plan_all(
    spec: PlanSetSpec,
    robot: RobotSpec,
    folder: Path,
    *,
    model: Path | None = None,
    jobs: int = 1,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Planned:
    """Plan all motions of a set into a folder.

    What is there from an interrupted run of the same set is kept; the result is the same, byte for byte apart from
    provenance, as that of a run without interruption, whatever the number of jobs.

    Args:
        spec: what to plan.
        robot: the robot.
        folder: where to.
        model: its MJCF or URDF; found as for replay if not given.
        jobs: processes.
        overwrite: delete another set that is in the folder.
        progress: called with (motions done, of how many, skipped so far) after each block.

    Raises:
        ConfigError: a robot, model or joint that does not fit; no job.
        OutputExists: another set is in the folder.
        DataError: the disk is full or not writable, or another process is planning into the folder.
    """
    if jobs < 1:
        raise ConfigError("jobs must be at least 1", got=jobs)
    path = find_model(robot, given=model)
    spec.scene(robot, model=path)  # refuses what cannot be planned at all, before anything is written
    asked = _asked(spec, robot, path)
    _refuse_other(folder, asked, overwrite=overwrite)
    make_folder(folder / BLOCKS)
    lock = FolderLock(folder)
    try:
        for left in [*_left_behind(folder), *(folder / BLOCKS).glob(".*.tmp")]:
            left.unlink(missing_ok=True)
        record = {**asked, "complete": False, "provenance": provenance(config=asked, seed=spec.seed)}
        write_json(folder / PLANS_NAME, record)
        counts = _plan_blocks(spec, robot, path, folder, jobs, progress)
        found = {"complete": True, "planned": counts.planned, "skipped": counts.skipped}
        write_json(folder / PLANS_NAME, {**record, **found})
    finally:
        lock.release()
        (folder / LOCK_NAME).unlink(missing_ok=True)
    return counts


def _plan_blocks(
    spec: PlanSetSpec, robot: RobotSpec, model: Path, folder: Path, jobs: int, progress: Progress | None
) -> Planned:
    total, blocks = len(spec), range(-(-len(spec) // BLOCK))
    planned = skipped = 0

    def count(done: tuple[int, int]) -> None:
        nonlocal planned, skipped
        planned, skipped = planned + done[0], skipped + done[1]
        if progress is not None:
            progress(planned + skipped, total, skipped)

    missing = []
    for number in blocks:
        if _block_path(folder, number).exists():
            rows = _read_block(folder, number)
            count((len(rows["plans"]), len(rows["skipped"])))
        else:
            missing.append(number)
    if jobs == 1 or len(missing) < 2:
        planner = _BlockPlanner(spec, robot, model, folder)
        for number in missing:
            count(planner.plan(number))
        return Planned(planned, skipped)
    jobs = min(jobs, len(missing))
    for done in in_processes(_plan_block, missing, jobs=jobs, begin=_begin, with_args=(spec, robot, model, folder)):
        count(done)
    return Planned(planned, skipped)


class _BlockPlanner:
    def __init__(self, spec: PlanSetSpec, robot: RobotSpec, model: Path, folder: Path) -> None:
        self._spec, self._folder = spec, folder
        self._scene: Scene = spec.scene(robot, model=model)

    def plan(self, block: int) -> tuple[int, int]:
        """Plan and write one block; how many motions were planned and skipped."""
        rows: list[dict[str, Any]] = []
        skipped: list[dict[str, str]] = []
        tables = []
        layout = None
        for number in range(block * BLOCK, min(len(self._spec), (block + 1) * BLOCK)):
            try:
                plan = self._spec.plan(self._scene, number)
            except NoPlan as error:
                skipped.append({"id": self._spec.id(number), "reason": error.summary})
                continue
            series = plan.to_series()
            layout = layout_of(series)
            tables.append(to_table(series, layout))
            rows.append(plan.to_row())
        if layout is not None:
            write_shard(self._folder / BLOCKS / shard_name(block), layout, tables)
        write_json(
            _block_path(self._folder, block),
            {"schema": BLOCK_SCHEMA, "plans": rows, "skipped": skipped},
        )
        return len(rows), len(skipped)


_worker: _BlockPlanner | None = None


def _begin(spec: PlanSetSpec, robot: RobotSpec, model: Path, folder: Path) -> None:
    global _worker  # what a process of the pool keeps between blocks
    _worker = _BlockPlanner(spec, robot, model, folder)
    # The matrices are small, and the other processes want their cores. What is not loaded yet cannot be told so.
    importlib.import_module("scipy.interpolate")
    threadpool_limits(1)


def _plan_block(number: int) -> tuple[int, int]:
    assert _worker is not None
    return _worker.plan(number)


def _block_path(folder: Path, number: int) -> Path:
    return folder / BLOCKS / f"{number:05d}.json"


def _read_block(folder: Path, number: int) -> dict[str, Any]:
    path = _block_path(folder, number)
    data = read_json(path)
    if not isinstance(data, dict) or data.get("schema") != BLOCK_SCHEMA:
        raise FormatError(f"{path} is no block of plans, or of another version", expected=BLOCK_SCHEMA)
    return data


def _asked(spec: PlanSetSpec, robot: RobotSpec, model: Path) -> dict[str, Any]:
    return {
        "schema": PLANS_SCHEMA,
        "spec": spec.to_dict(),
        "robot": robot.name,
        "joints": list(robot.joint_names),
        "model": {"name": model.name, "sha256": hashlib.sha256(model.read_bytes()).hexdigest()},
    }


def _left_behind(folder: Path) -> list[Path]:
    """Half a description that a process left which was killed."""
    return list(folder.glob(f".{PLANS_NAME}.*.tmp"))


def _refuse_other(folder: Path, asked: Mapping[str, Any], *, overwrite: bool) -> None:
    """Keep what is there of the same set; delete it or refuse if it is of another."""
    if not folder.exists() or not any(folder.iterdir()):
        return
    if not (folder / PLANS_NAME).exists():
        names = {entry.name for entry in folder.iterdir()} - {path.name for path in _left_behind(folder)}
        if names <= {BLOCKS, LOCK_NAME} and not any((folder / BLOCKS).glob("*")):
            return  # of a process that was killed before it had written the description
        if overwrite and names <= {BLOCKS, LOCK_NAME}:
            shutil.rmtree(folder / BLOCKS, ignore_errors=True)
            return
        raise OutputExists(f"{folder} is not empty and holds no plan set", hint="Choose another folder.")
    found = read_json(folder / PLANS_NAME)
    same = isinstance(found, dict) and all(found.get(key) == value for key, value in as_read_back(asked).items())
    if overwrite:
        # The description goes last, so that a deletion that was interrupted can be repeated.
        shutil.rmtree(folder / BLOCKS, ignore_errors=True)
        (folder / PLANS_NAME).unlink()
    elif not same:
        raise OutputExists(
            f"{folder} holds another plan set",
            hint="Choose another folder, repeat with the same description and robot, or give --overwrite.",
        )


class PlanSet:
    """A plan set on disk, read one motion at a time; neither the planner nor an engine is needed.

    Attributes:
        path: its folder.
        spec: what was asked for.
        joints: the robot's joints.
        robot: the robot's name.
        complete: whether planning went through.

    Raises:
        FormatError: the folder holds no plan set, or one of another version.
        DataError: it is damaged.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        record = read_json(self.path / PLANS_NAME)
        if not isinstance(record, dict) or record.get("schema") != PLANS_SCHEMA:
            raise FormatError(f"{self.path} holds no plan set, or one of another version", expected=PLANS_SCHEMA)
        try:
            self.spec = build(PlanSetSpec, record["spec"], str(self.path / PLANS_NAME))
            self.joints = tuple(record["joints"])
            self.robot = str(record["robot"])
            self.complete = bool(record["complete"])
        except (KeyError, TypeError) as error:
            raise DataError(f"{self.path / PLANS_NAME} is damaged", got=repr(error)) from error
        self._blocks: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self._shards = ShardReader(self.path / BLOCKS)

    def __len__(self) -> int:
        """The number of motions that were asked for, skipped ones included."""
        return len(self.spec)

    def __getitem__(self, id: str) -> Plan:
        """One plan.

        Raises:
            ConfigError: the set has no such motion.
            MissingSignal: it was skipped, or is not planned yet.
            DataError: it is damaged.
        """
        number = self.spec.number(id)
        rows = self._block(number // BLOCK)
        for group, row in enumerate(rows["plans"]):
            if row["id"] == id:
                return self._plan(number // BLOCK, group, row)
        reasons = {item["id"]: item["reason"] for item in rows["skipped"]}
        raise MissingSignal(f"motion {id!r} was skipped when the set was planned", got=reasons.get(id))

    def __iter__(self) -> Iterator[Plan]:
        """All plans in order, one at a time; skipped motions are left out."""
        for block in range(-(-len(self.spec) // BLOCK)):
            for group, row in enumerate(self._block(block)["plans"]):
                yield self._plan(block, group, row)

    def ids(self) -> Iterator[str]:
        """Ids of the plans in order."""
        for block in range(-(-len(self.spec) // BLOCK)):
            yield from (row["id"] for row in self._block(block)["plans"])

    def skipped(self) -> dict[str, str]:
        """Id -> why no plan was found."""
        found: dict[str, str] = {}
        for block in range(-(-len(self.spec) // BLOCK)):
            found |= {item["id"]: item["reason"] for item in self._block(block)["skipped"]}
        return found

    def _block(self, number: int) -> dict[str, Any]:
        if number in self._blocks:
            self._blocks.move_to_end(number)
            return self._blocks[number]
        if not _block_path(self.path, number).exists():
            raise MissingSignal(
                f"{self.path} is not complete",
                got=f"no block {number}",
                hint="Plan the set again into the same folder: what is there is kept.",
            )
        self._blocks[number] = _read_block(self.path, number)
        if len(self._blocks) > _OPEN_BLOCKS:
            self._blocks.popitem(last=False)
        return self._blocks[number]

    def _plan(self, block: int, group: int, row: Mapping[str, Any]) -> Plan:
        table, layout = self._shards.read(block, group, int(row["samples"]))
        return Plan.from_row(row, from_table(table, layout))

    def close(self) -> None:
        """Close the open files; reading opens them again."""
        self._shards.close()


def describe(spec: PlanSetSpec) -> Mapping[str, Any]:
    """Numbers of motions: group -> split -> count; for people."""
    table: dict[str, dict[str, int]] = {}
    for number in range(len(spec)):
        counts = table.setdefault(spec.place(number)[0].name, {})
        split = spec.split(number)
        counts[split] = counts.get(split, 0) + 1
    return table
