"""Plan sets on disk: JSON for what was planned, Parquet for the samples.

    plans.json             what was asked for: description (or ids and origin of plans that were made elsewhere), robot,
                           hash of the model; how many were planned
    blocks/00000.json      rows of the first block of motions: ids, joints, splits, draws; which were skipped, and why
    blocks/00000.parquet   their samples, one row group a motion

A block is planned and written as a whole, its JSON last; so a block is there or not, wherever planning was stopped.
Plans that are given one by one are written so, too: their block again with each of them.
"""

from __future__ import annotations

import hashlib
import importlib
import shutil
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
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
from trueup.errors import ConfigError, DataError, FormatError, MissingSignal, NameMismatch, NoPlan, OutputExists
from trueup.record.plan import Plan
from trueup.record.planset import PLANS_SCHEMA, PlanSetSpec
from trueup.record.scene import Scene
from trueup.record.workspace import Workspace
from trueup.robots import RobotSpec, find_model

PLANS_NAME = "plans.json"
BLOCKS = "blocks"
BLOCK_SCHEMA = "trueup.plan-block/1"
# Motions of one block: what is planned again after an interruption, and the unit of work of a process.
BLOCK = 16

_OPEN_BLOCKS = 8
# What plans.json says about what decided about the plans.
_ASKED = ("spec", "ids", "origin", "robot", "joints", "model")
_AGAIN = "Plan the set again into the same folder: what is there is kept."

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
    asked = _asked({"spec": spec.to_dict()}, robot, path)
    _refuse_other(folder, asked, overwrite=overwrite)
    with _planning(folder):
        record = {**asked, "complete": False, "provenance": provenance(config=asked, seed=spec.seed)}
        write_json(folder / PLANS_NAME, record)
        counts = _plan_blocks(spec, robot, path, folder, jobs, progress)
        found = {"complete": True, "planned": counts.planned, "skipped": counts.skipped}
        write_json(folder / PLANS_NAME, {**record, **found})
    return counts


@contextmanager
def _planning(folder: Path) -> Iterator[None]:
    """The folder, locked for one planner, without what a killed one has left."""
    make_folder(folder / BLOCKS)
    lock = FolderLock(folder)
    try:
        for left in [*_left_behind(folder), *(folder / BLOCKS).glob(".*.tmp")]:
            left.unlink(missing_ok=True)
        yield
    finally:
        lock.release()
        (folder / LOCK_NAME).unlink(missing_ok=True)


def store_plans(
    make: Callable[[Sequence[Plan]], Plan],
    ids: Sequence[str],
    robot: RobotSpec,
    folder: Path,
    *,
    origin: Mapping[str, Any],
    seed: int | None = None,
    model: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> tuple[Plan, ...]:
    """Store plans that no description makes, e.g. designed ones, as a plan set.

    Each is stored as soon as it is made, and what is there from an interrupted run of the same ids and origin is kept.

    Args:
        make: makes the next plan from all those before it, stored ones included.
        ids: of the plans, in order.
        robot: the robot.
        folder: where to.
        origin: what decides about the plans, JSON types only.
        seed: of their draws, for the provenance.
        model: its MJCF or URDF; found as for replay if not given.
        overwrite: delete another set that is in the folder.
        progress: called with (plans done, of how many, 0) after each plan.

    Returns:
        All plans.

    Raises:
        ConfigError: no ids, or one of them twice.
        NameMismatch: a plan is for other joints.
        OutputExists: another set is in the folder.
        DataError: the disk is full or not writable, or another process is planning into the folder.
    """
    if not ids or len(set(ids)) != len(ids):
        raise ConfigError("a plan set needs motions with different ids", got=list(ids))
    asked = _asked({"ids": list(ids), "origin": dict(origin)}, robot, find_model(robot, given=model))
    _refuse_other(folder, asked, overwrite=overwrite)
    with _planning(folder):
        record = {**asked, "complete": False, "provenance": provenance(config=asked, seed=seed)}
        write_json(folder / PLANS_NAME, record)
        with closing(PlanSet(folder)) as stored:
            made = list(stored.there())
        while len(made) < len(ids):
            number = len(made)
            plan = replace(make(made), id=ids[number])
            if plan.joints != robot.joint_names:
                raise NameMismatch("a plan is for another robot", left=plan.joints, right=robot.joint_names)
            made.append(plan)
            _write_block(folder, number // BLOCK, made[number // BLOCK * BLOCK :], ())
            if progress is not None:
                progress(len(made), len(ids), 0)
        write_json(folder / PLANS_NAME, {**record, "complete": True, "planned": len(made), "skipped": 0})
    return tuple(made)


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
        plans: list[Plan] = []
        skipped: list[dict[str, str]] = []
        for number in range(block * BLOCK, min(len(self._spec), (block + 1) * BLOCK)):
            try:
                plan = self._spec.plan(self._scene, number)
            except NoPlan as error:
                skipped.append({"id": self._spec.id(number), "reason": error.summary})
                continue
            plans.append(plan)
        _write_block(self._folder, block, plans, skipped)
        return len(plans), len(skipped)


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


def _write_block(folder: Path, block: int, plans: Sequence[Plan], skipped: Sequence[Mapping[str, str]]) -> None:
    if plans:
        series = [plan.to_series() for plan in plans]
        layout = layout_of(series[0])
        write_shard(folder / BLOCKS / shard_name(block), layout, [to_table(item, layout) for item in series])
    rows = [plan.to_row() for plan in plans]
    write_json(_block_path(folder, block), {"schema": BLOCK_SCHEMA, "plans": rows, "skipped": list(skipped)})


def _block_path(folder: Path, number: int) -> Path:
    return folder / BLOCKS / f"{number:05d}.json"


def _read_block(folder: Path, number: int) -> dict[str, Any]:
    path = _block_path(folder, number)
    data = read_json(path)
    if not isinstance(data, dict) or data.get("schema") != BLOCK_SCHEMA:
        raise FormatError(f"{path} is no block of plans, or of another version", expected=BLOCK_SCHEMA)
    return data


def _asked(what: Mapping[str, Any], robot: RobotSpec, model: Path) -> dict[str, Any]:
    return {
        "schema": PLANS_SCHEMA,
        **what,
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
        spec: what was asked for; None for plans that were made elsewhere and stored.
        origin: what decided about those; empty where there is a spec.
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
            self.spec: PlanSetSpec | None = None
            self.origin: Mapping[str, Any] = record.get("origin", {})
            self._ids: tuple[str, ...] = tuple(record.get("ids", ()))
            if not self._ids:
                self.spec = build(PlanSetSpec, record["spec"], str(self.path / PLANS_NAME))
            self._asked = {name: record[name] for name in _ASKED if name in record}
            self.joints = tuple(record["joints"])
            self.robot = str(record["robot"])
            self.complete = bool(record["complete"])
        except (KeyError, TypeError) as error:
            raise DataError(f"{self.path / PLANS_NAME} is damaged", got=repr(error)) from error
        self._blocks: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self._shards = ShardReader(self.path / BLOCKS)

    def __len__(self) -> int:
        """The number of motions that were asked for, skipped ones included."""
        return len(self._ids) if self.spec is None else len(self.spec)

    def __getitem__(self, id: str) -> Plan:
        """One plan.

        Raises:
            ConfigError: the set has no such motion.
            MissingSignal: it was skipped, or is not planned yet.
            DataError: it is damaged.
        """
        number = self.number(id)
        rows = self._block(number // BLOCK)
        for group, row in enumerate(rows["plans"]):
            if row["id"] == id:
                return self._plan(number // BLOCK, group, row)
        reasons = {item["id"]: item["reason"] for item in rows["skipped"]}
        if id not in reasons:
            raise MissingSignal(f"{self.path} is not complete", got=f"no motion {id!r}", hint=_AGAIN)
        raise MissingSignal(f"motion {id!r} was skipped when the set was planned", got=reasons.get(id))

    def __iter__(self) -> Iterator[Plan]:
        """All plans in order, one at a time; skipped motions are left out."""
        for block in range(-(-len(self) // BLOCK)):
            for group, row in enumerate(self._block(block)["plans"]):
                yield self._plan(block, group, row)

    def ids(self) -> Iterator[str]:
        """Ids of the plans in order."""
        for block in range(-(-len(self) // BLOCK)):
            yield from (row["id"] for row in self._block(block)["plans"])

    def there(self) -> Iterator[Plan]:
        """The plans of a set that is perhaps not complete, up to the first block that is missing."""
        for block in range(-(-len(self) // BLOCK)):
            if not _block_path(self.path, block).exists():
                return
            for group, row in enumerate(self._block(block)["plans"]):
                yield self._plan(block, group, row)

    def scene(self, robot: RobotSpec, *, model: Path | None = None, clearance_share: float = 1.0) -> Scene:
        """The surroundings that the motions were planned in, for the ways between them; see `Scene` for errors.

        Args:
            robot: the robot.
            model: its MJCF or URDF; found as for replay if not given.
            clearance_share: of the clearance that the plans keep.
        """
        if self.spec is not None:
            spec = replace(self.spec, clearance_m=clearance_share * self.spec.clearance_m)
            return spec.scene(robot, model=model)
        limits = self.origin.get("limits", {})
        return Scene(
            robot,
            workspace=build(Workspace, self.origin.get("workspace", {}), str(self.path / PLANS_NAME)),
            model=model,
            clearance_m=clearance_share * PlanSetSpec.clearance_m,
            velocity=dict(zip(self.joints, limits.get("velocity", ()), strict=False)),
            acceleration=dict(zip(self.joints, limits.get("acceleration", ()), strict=False)),
        )

    def skipped(self) -> dict[str, str]:
        """Id -> why no plan was found."""
        found: dict[str, str] = {}
        for block in range(-(-len(self) // BLOCK)):
            found |= {item["id"]: item["reason"] for item in self._block(block)["skipped"]}
        return found

    @property
    def seed(self) -> int | None:
        """The seed of its draws, if a description made it."""
        return None if self.spec is None else self.spec.seed

    def to_dict(self) -> dict[str, Any]:
        """All that decides about the plans, JSON types only."""
        return dict(self._asked)

    def number(self, id: str) -> int:
        """The number of a motion, from its id, skipped ones included.

        Raises:
            ConfigError: there is no such motion.
        """
        if self.spec is not None:
            return self.spec.number(id)
        if id not in self._ids:
            raise ConfigError(f"there is no motion {id!r}", available=self._ids)
        return self._ids.index(id)

    def _block(self, number: int) -> dict[str, Any]:
        if number in self._blocks:
            self._blocks.move_to_end(number)
            return self._blocks[number]
        if not _block_path(self.path, number).exists():
            raise MissingSignal(
                f"{self.path} is not complete",
                got=f"no block {number}",
                hint=_AGAIN,
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
