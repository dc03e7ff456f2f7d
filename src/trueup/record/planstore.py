"""Plan sets on disk, written; `planreader.py` has the layout.

A block is planned and written as a whole, its JSON last; so a block is there or not, wherever planning was stopped.
Plans that are given one by one are written so, too: their block again with each of them.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from trueup.core.atomic import as_read_back, left_behind, make_folder, read_json, write_json
from trueup.core.provenance import provenance
from trueup.core.workers import in_processes
from trueup.dataset.columns import layout_of, to_table
from trueup.dataset.lock import LOCK_NAME, FolderLock
from trueup.dataset.shards import shard_name, write_shard
from trueup.errors import ConfigError, NameMismatch, NoPlan, OutputExists
from trueup.record.plan import Plan
from trueup.record.planreader import BLOCK, BLOCK_SCHEMA, BLOCKS, PLANS_NAME, PlanSet, block_path, read_block
from trueup.record.planset import PLANS_SCHEMA, PlanSetSpec
from trueup.record.scene import Scene
from trueup.robots import RobotSpec, find_model

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
        for left in [*left_behind(folder / PLANS_NAME), *(folder / BLOCKS).glob(".*.tmp")]:
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
        if block_path(folder, number).exists():
            rows = read_block(folder, number)
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


def _plan_block(number: int) -> tuple[int, int]:
    assert _worker is not None
    return _worker.plan(number)


def _write_block(folder: Path, block: int, plans: Sequence[Plan], skipped: Sequence[Mapping[str, str]]) -> None:
    if plans:
        series = [plan.to_series() for plan in plans]
        layout = layout_of(series[0])
        write_shard(folder / BLOCKS / shard_name(block), layout, [to_table(item, layout) for item in series])
    rows = [plan.to_row() for plan in plans]
    write_json(block_path(folder, block), {"schema": BLOCK_SCHEMA, "plans": rows, "skipped": list(skipped)})


def _asked(what: Mapping[str, Any], robot: RobotSpec, model: Path) -> dict[str, Any]:
    return {
        "schema": PLANS_SCHEMA,
        **what,
        "robot": robot.name,
        "joints": list(robot.joint_names),
        "model": {"name": model.name, "sha256": hashlib.sha256(model.read_bytes()).hexdigest()},
    }


def _refuse_other(folder: Path, asked: Mapping[str, Any], *, overwrite: bool) -> None:
    """Keep what is there of the same set; delete it or refuse if it is of another."""
    if not folder.exists() or not any(folder.iterdir()):
        return
    if not (folder / PLANS_NAME).exists():
        names = {entry.name for entry in folder.iterdir()} - {path.name for path in left_behind(folder / PLANS_NAME)}
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
