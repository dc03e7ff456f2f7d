"""Record: motions are planned, executed on a robot, and kept as a dataset."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import shutil
import tempfile
import time
import weakref
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from trueup.core.atomic import as_read_back
from trueup.core.episode import Episode, EpisodeMeta, warning_kinds
from trueup.core.provenance import provenance
from trueup.core.workers import in_processes
from trueup.dataset import DatasetInfo, DatasetWriter, is_dataset
from trueup.errors import ConfigError, DataError, NameMismatch, OutputExists, TrueupError
from trueup.robots import RobotSpec, find_model
from trueup.stages.importing import checked
from trueup.stages.progress import Track, silent
from trueup.stages.rigs import CompensatedRig, LabRig, Rig, ServoedRig
from trueup.stages.ros2_rig import Ros2Rig

if TYPE_CHECKING:
    from trueup.lab import Truth
    from trueup.record import PlanSet, PlanSetSpec, RecordSettings, Scene

PLANS = "plans"

# Motions that a worker does before it hands them over: few, since what is under way is lost in an interruption.
_AT_ONCE = 4


@dataclass(frozen=True)
class RecordSummary:
    """What a recording came to.

    Attributes:
        path: the dataset.
        recorded: motions recorded now.
        kept: motions that were there.
        skipped: motion -> why no plan was found.
        failed: motion -> why there is nothing of it.
        flagged: motion -> kinds of its warnings, of those recorded now.
        seconds: wall-clock time of this call [s].
    """

    path: Path
    recorded: int
    kept: int = 0
    skipped: Mapping[str, str] = field(default_factory=dict)
    failed: Mapping[str, TrueupError] = field(default_factory=dict)
    flagged: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    seconds: float = 0.0


@dataclass(frozen=True)
class _Task:
    """One motion with one payload."""

    id: str
    plan: str
    motion: int
    number: int
    payload_kg: float


def plans_named(
    name: str,
    *,
    scale: float = 1.0,
    seed: int | None = None,
    robot: RobotSpec | None = None,
    model: Path | None = None,
    rate_hz: float = 50.0,
) -> PlanSetSpec | PlanSet:
    """The motions to record: those of a stored plan set or of files as they are, or a description of motions to plan.

    Args:
        name: `paper`, a YAML file that describes motions, the folder of a plan set, or a file of joint angles (or a
            folder of such files) as SAGE has them.
        scale: share of the motions of each group.
        seed: of the planning; the description's own if None.
        robot: whose motions they are; files need it.
        model: its MJCF or URDF; found as for replay if None.
        rate_hz: rows per second of files [Hz].

    Raises:
        ConfigError: there is no such description, or what is recorded as it is is to be scaled.
        NameMismatch: a file names no joint of the robot.
        NoPlan: a motion of a file breaks a limit, or something is in its way.
    """
    from trueup.record import PLANS_NAME, PlanSet, load_plans
    from trueup.record.motion_files import motion_files

    stored, files = (Path(name) / PLANS_NAME).exists(), () if robot is None else motion_files(Path(name))
    if (stored or files) and scale != 1.0:
        raise ConfigError(
            "a stored plan set is recorded as it is" if stored else "motions of files are recorded as they are",
            got=f"--scale {scale:g}",
            hint="Leave --scale out, or describe a smaller set in a YAML file.",
        )
    if stored:
        return PlanSet(name)
    if robot is not None and files:
        return _of_files(files, robot, model, rate_hz)
    described = load_plans(name)
    return replace(described, seed=described.seed if seed is None else seed).scaled(scale)


def _of_files(files: Sequence[Path], robot: RobotSpec, model: Path | None, rate_hz: float) -> PlanSet:
    """A plan set of motion files, in a folder that goes with it."""
    from trueup.record.motion_files import plans_of_files

    folder = Path(tempfile.mkdtemp(prefix="trueup-"))
    try:
        plans = plans_of_files(files, robot, folder, model=model, rate_hz=rate_hz)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(plans, shutil.rmtree, folder, ignore_errors=True)
    return plans


def record(
    out: Path | str,
    robot: RobotSpec,
    rig: Rig | Sequence[Rig],
    plans: PlanSetSpec | PlanSet,
    *,
    payloads_kg: Sequence[float] = (0.0,),
    settings: RecordSettings | None = None,
    model: Path | None = None,
    jobs: int = 1,
    overwrite: bool = False,
    resume: bool = False,
    truth: Path | None = None,
    track: Track = silent,
) -> RecordSummary:
    """Execute a set of plans on a robot and keep commands and measurements as a dataset.

    Plans that are given as a description are made first; all are kept in the dataset's folder, under `plans`. A motion
    that goes wrong is kept with a warning, one of which nothing was recorded is listed in the summary; neither stops
    the others. What was interrupted is gone on with when the same is asked for again, and becomes the same files as
    without the interruption, apart from times in provenance.

    Args:
        out: the dataset's folder.
        robot: the robot; joints and limits count.
        rig: where its hardware comes from; several, such as other individuals or bases, take turns from motion to
            motion.
        plans: what to plan, or a plan set, which is copied.
        payloads_kg: every motion is recorded with each of these payloads [kg].
        settings: rates, speeds, tolerances.
        model: MJCF or URDF of the robot; found as for replay if None.
        jobs: processes; a robot behind ROS 2 is driven by one.
        overwrite: delete the dataset that is there first.
        resume: go on with a dataset that is there even if it is complete.
        truth: file for what is true of the lab's robot; apart from the data.
        track: shows progress.

    Raises:
        OutputExists: a complete dataset is there, or one of another recording, or something else.
        NameMismatch: the plans are of another robot.
        ConfigError: settings, payloads or plans that do not fit.
        DataError: the disk is full, or nothing could be recorded.
    """
    from trueup.record import PlanSet, RecordSettings

    started, out = time.perf_counter(), Path(out)
    settings = settings or RecordSettings()
    rigs = tuple(rig) if isinstance(rig, Sequence) else (rig,)
    if not rigs:
        raise ConfigError("a recording needs a rig")
    known = None if truth is None else _truth(truth, rigs, out, there=overwrite or resume)
    # They are part of ids, as they are written there.
    names = {_kilograms(load) for load in payloads_kg}
    if not payloads_kg or len(names) != len(payloads_kg) or not all(load >= 0 for load in payloads_kg):
        raise ConfigError("payloads must be different masses >= 0", got=list(payloads_kg))
    if jobs < 1:
        raise ConfigError("jobs must be at least 1", got=jobs)
    live = any(_is_live(one) for one in rigs)
    if live and (len(rigs) > 1 or len(payloads_kg) > 1):
        raise ConfigError(
            "one robot behind ROS 2 is recorded at a time, with what it carries",
            got=f"{len(rigs)} robots, {len(payloads_kg)} payloads",
            hint="Record into several datasets.",
        )
    path = find_model(robot, given=model)
    _refuse_unfit(robot, path, rigs, plans, payloads_kg, settings)
    config = {
        "robot": robot.to_dict(),
        "model": {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()},
        "rig": rigs[0].describe() if len(rigs) == 1 else [one.describe() for one in rigs],
        "plans": plans.to_dict(),
        "payloads_kg": list(payloads_kg),
        "settings": asdict(settings),
    }
    info = DatasetInfo(
        robot=robot.name,
        licence="Apache-2.0",
        provenance={**provenance(config=config, seed=plans.seed), "complete": False},
    )
    failed: dict[str, TrueupError] = {}
    flagged: dict[str, tuple[str, ...]] = {}
    recorded = 0
    with _writer(out, info, overwrite=overwrite, resume=resume) as writer:
        kept = len(writer.ids)
        if isinstance(plans, PlanSet):
            motions = _copied(plans, out / PLANS)
        else:
            motions = _planned(out / PLANS, plans, robot, path, jobs, overwrite=overwrite and not kept, track=track)
        tasks = [task for task in _tasks(motions, payloads_kg) if task.id not in writer.ids]
        worker = _Worker(robot, path, rigs, motions.path, settings)
        # An error here must not leave processes at work.
        with contextlib.closing(_results(worker, tasks, 1 if live else jobs)) as results:
            for name, result in track(results, "record", len(tasks)):
                if isinstance(result, TrueupError):
                    failed[name] = result
                    continue
                if result.meta.warned:
                    flagged[name] = warning_kinds(result.meta.flags)
                writer.append(result)
                recorded += 1
    # Complete is what is in its shards, all of it.
    skipped = motions.skipped()
    notes = tuple(f"{name} was not planned: {why}" for name, why in skipped.items())
    notes += tuple(f"{name} was not recorded: {error.summary}" for name, error in failed.items())
    replace(writer.info, provenance={**writer.info.provenance, "complete": True}, notes=notes).save(out)
    if not recorded and not kept:
        reasons = [*skipped.values(), *(error.summary for error in failed.values())]
        raise DataError("nothing was recorded, the first because", got=reasons[0] if reasons else "no motion")
    if truth is not None and known is not None:
        known.save(truth)
    return RecordSummary(out, recorded, kept, skipped, failed, flagged, time.perf_counter() - started)


def _is_live(rig: Rig) -> bool:
    """Whether there is one of it, whatever corrects its commands."""
    return isinstance(rig, Ros2Rig) or (isinstance(rig, CompensatedRig) and _is_live(rig.inner))


def _truth(path: Path, rigs: Sequence[Rig], out: Path, *, there: bool) -> Truth:
    """What is to be written to `path` at the end; refused before anything is recorded."""
    rig = rigs[0]
    if len({one.unit for one in rigs}) > 1:
        raise ConfigError(
            "a truth is that of one individual",
            got=list(dict.fromkeys(one.unit for one in rigs)),
            hint="Record one unit at a time, or leave --truth out.",
        )
    if not isinstance(rig, LabRig | ServoedRig):
        raise ConfigError("only the lab's robots have a truth to write down", got=rig.unit, hint="Leave --truth out.")
    if path.resolve().is_relative_to(out.resolve()):
        raise ConfigError("the truth is kept apart from the data", got=path, hint="Choose another folder for it.")
    if path.exists() and not there:
        raise OutputExists(f"{path} exists", hint="Give --overwrite, or choose another --truth.")
    return rig.truth()


def _refuse_unfit(
    robot: RobotSpec,
    model: Path,
    rigs: Sequence[Rig],
    plans: PlanSetSpec | PlanSet,
    payloads_kg: Sequence[float],
    settings: RecordSettings,
) -> None:
    """Refuse what no motion could be recorded with, before anything is written."""
    from trueup.record import PlanSet, Recorder, whole_ratio

    if isinstance(plans, PlanSet):
        if sorted(plans.joints) != sorted(robot.joint_names):
            raise NameMismatch(
                f"the plans in {plans.path} are of another robot", left=plans.joints, right=robot.joint_names
            )
        if not plans.complete:
            raise DataError(f"the plans in {plans.path} are not complete", hint="Plan them to the end first.")
        rate_hz = next((plan.rate_hz for plan in plans), settings.control_hz)
    else:
        rate_hz = plans.motion.clock.rate_hz
    whole_ratio(rate_hz, settings.control_hz, "the rate of the plans must be a multiple of control_hz")
    scene = plans.scene(robot, model=model)
    for rig, payload_kg in itertools.product(rigs, payloads_kg):
        Recorder(rig.session(0, payload_kg), scene, settings)


def _copied(plans: PlanSet, folder: Path) -> PlanSet:
    """The plans in the dataset's own folder, so that it is whole when it is moved."""
    from trueup.record import PlanSet

    if folder.resolve() == plans.path.resolve():
        return plans
    with contextlib.suppress(TrueupError):
        there = PlanSet(folder)
        if there.complete and there.to_dict() == plans.to_dict():
            return there
    copy = folder.with_name(f".{folder.name}.tmp")
    try:
        for left in (copy, folder):
            shutil.rmtree(left, ignore_errors=True)
        shutil.copytree(plans.path, copy)
        copy.replace(folder)
    except OSError as error:
        raise DataError(f"cannot copy the plans to {folder}", got=error.strerror or error) from error
    return PlanSet(folder)


def _writer(out: Path, info: DatasetInfo, *, overwrite: bool, resume: bool) -> DatasetWriter:
    """A new dataset, or the one that an earlier call of the same recording began."""
    if not is_dataset(out) or overwrite:
        return DatasetWriter.create(out, info, overwrite=overwrite)
    stored = DatasetInfo.load(out)
    before, now = stored.provenance.get("config"), as_read_back(info.provenance["config"])
    changed = sorted(key for key in now if not isinstance(before, dict) or before.get(key) != now[key])
    if changed:
        raise OutputExists(
            f"{out} was recorded with other settings ({', '.join(changed)})",
            hint="Choose another --out, or give --overwrite to delete it first.",
        )
    if stored.provenance.get("complete") and not resume:
        raise OutputExists(
            f"{out} exists and is complete", hint="--resume tries again what failed, --overwrite deletes it first."
        )
    return DatasetWriter.resume(out, info)


def _planned(
    folder: Path, spec: PlanSetSpec, robot: RobotSpec, model: Path, jobs: int, *, overwrite: bool, track: Track
) -> PlanSet:
    from trueup.record import PlanSet, plan_all

    # Planning calls back, and a track is asked for the next item: one item is taken for each motion that is done.
    bar = track(itertools.count(), "plan", len(spec))
    shown = 0

    def show(done: int, _total: int, _skipped: int) -> None:
        nonlocal shown
        for _ in range(done - shown):
            next(bar)
        shown = done

    with contextlib.closing(bar):
        plan_all(spec, robot, folder, model=model, jobs=jobs, overwrite=overwrite, progress=show)
    return PlanSet(folder)


def _kilograms(payload_kg: float) -> str:
    return f"{payload_kg:g}kg"


def _tasks(plans: PlanSet, payloads_kg: Sequence[float]) -> Iterator[_Task]:
    """All motions with the first payload, then all with the next: a payload is not changed more often than it must."""
    for place, payload_kg in enumerate(payloads_kg):
        for id in plans.ids():
            name = id if len(payloads_kg) == 1 else f"{id}/{_kilograms(payload_kg)}"
            motion = plans.number(id)
            yield _Task(name, id, motion, place * len(plans) + motion, payload_kg)


class _Worker:
    """Records motions; one per process."""

    def __init__(
        self, robot: RobotSpec, model: Path, rigs: Sequence[Rig], plans: Path, settings: RecordSettings
    ) -> None:
        self.arguments = (robot, model, rigs, plans, settings)
        self._robot, self._model, self._rigs, self._settings = robot, model, rigs, settings
        self._folder = plans
        self._plans: PlanSet | None = None
        self._scene: Scene | None = None

    def record(self, tasks: Sequence[_Task]) -> list[tuple[str, Episode | TrueupError]]:
        """What became of each of these motions."""
        results: list[tuple[str, Episode | TrueupError]] = []
        for task in tasks:
            try:
                results.append((task.id, self._episode(task)))
            except TrueupError as error:
                results.append((task.id, error))
        return results

    def _episode(self, task: _Task) -> Episode:
        from trueup.record import PlanSet, Recorder

        if self._scene is None or self._plans is None:
            self._plans = PlanSet(self._folder)
            # A robot that stopped a little beside its path still finds its way.
            self._scene = self._plans.scene(self._robot, model=self._model, clearance_share=0.5)
        plan = self._plans[task.plan]
        rig = self._rigs[task.motion % len(self._rigs)]
        hardware = rig.session(task.number, task.payload_kg)
        done = Recorder(hardware, self._scene, self._settings).record(plan)
        meta = EpisodeMeta(
            id=task.id,
            robot=self._robot.name,
            unit=rig.unit,
            payload_kg=task.payload_kg,
            condition=" ".join(filter(None, (plan.condition, rig.condition))),
            split=plan.split,
            source=f"{PLANS}/{task.plan}",
        )
        episode = checked(Episode(meta, done.measured, done.command), self._robot)
        return episode.with_flags((*done.flags, *episode.meta.flags))


def _results(worker: _Worker, tasks: Sequence[_Task], jobs: int) -> Generator[tuple[str, Episode | TrueupError]]:
    if jobs == 1 or len(tasks) <= _AT_ONCE:
        for task in tasks:
            yield from worker.record([task])
        return
    batches = [tasks[first : first + _AT_ONCE] for first in range(0, len(tasks), _AT_ONCE)]
    jobs = min(jobs, len(batches))
    for results in in_processes(_record, batches, jobs=jobs, begin=_begin, with_args=worker.arguments):
        yield from results


_worker: _Worker | None = None


def _begin(robot: RobotSpec, model: Path, rigs: Sequence[Rig], plans: Path, settings: RecordSettings) -> None:
    global _worker  # what a process keeps between motions
    _worker = _Worker(robot, model, rigs, plans, settings)


def _record(tasks: Sequence[_Task]) -> list[tuple[str, Episode | TrueupError]]:
    assert _worker is not None
    return _worker.record(tasks)
