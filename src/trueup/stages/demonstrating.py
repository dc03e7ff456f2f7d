"""Demo: record virtual hardware and close on the recording."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from trueup.core.close_result import STEPS, StepName
from trueup.core.provenance import provenance
from trueup.core.sole_writer import writes_alone
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter, is_dataset
from trueup.errors import ConfigError, OutputExists
from trueup.robots import load_robot
from trueup.stages.close_folder import CloseFolder, may_begin
from trueup.stages.close_steps import Closed, Watch
from trueup.stages.closing import close
from trueup.stages.importing import checked
from trueup.stages.progress import Track, silent

DEMO_ROBOTS = ("panda", "demo_arm")
# On two cores; a quarter of it is recording.
BUDGET_S = 300.0

_DEMO_MOTIONS = 12
# A sixtieth of the papers' motions, each without and with a payload.
_MOTIONS = {"multi-joint": 12, "single-joint": 14, "cartesian": 4}
_PAYLOADS_KG = (0.0, 2.0)


def demo_dataset(
    out: Path | str, *, seed: int = 0, overwrite: bool = False, resume: bool = False, track: Track = silent
) -> Path:
    """Record twelve motions of the three-joint demo arm's hardware into a dataset (see `lab.record_demo`).

    Args:
        out: the dataset's folder.
        seed: of motions and noise.
        overwrite: replace what is there.
        resume: keep a recording that is whole, and begin again with one that was interrupted.
        track: shows progress.

    Raises:
        OutputExists: `out` is there, and neither `overwrite` nor `resume` is given; or it holds another recording.
    """
    from trueup.lab import record_demo

    out = Path(out)
    if resume and not overwrite and is_dataset(out):
        there = Dataset(out)
        if there.info.robot != "demo_arm" or there.info.provenance.get("seed") != seed:
            raise OutputExists(
                f"{out} holds another recording",
                got=f"demo_arm, seed {seed}",
                expected=f"{there.info.robot}, seed {there.info.provenance.get('seed')}",
                hint="Give --overwrite to begin anew, or choose another --out.",
            )
        if len(there) == _DEMO_MOTIONS:
            return out
        overwrite = True
    info = DatasetInfo(robot="demo_arm", licence="Apache-2.0", provenance=provenance(config={}, seed=seed))
    with DatasetWriter.create(out, info, overwrite=overwrite) as writer:
        for episode in track(record_demo(seed=seed), "record", _DEMO_MOTIONS):
            writer.append(checked(episode))
    return out


@writes_alone()
def demo(
    out: Path | str,
    *,
    robot: Literal["panda", "demo_arm"] = "panda",
    seed: int = 0,
    jobs: int | None = None,
    overwrite: bool = False,
    resume: bool = False,
    until: StepName = STEPS[-1],
    budget_s: float | None = BUDGET_S,
    on_begin: Callable[[], None] = lambda: None,
    track: Track = silent,
    watch: Watch | None = None,
) -> Closed:
    """Record virtual hardware into `out/dataset` and close on it.

    Args:
        out: folder for the results.
        robot: `panda`: planned motions of a virtual Panda (extra `plan`); `demo_arm`: twelve motions of an arm of three
            joints, which is simulated and fitted in seconds.
        seed: of motions and noise.
        jobs: processes and threads; the number of cores if None.
        overwrite: replace what is in `out`.
        resume: go on where an earlier call was interrupted: what was recorded and done is kept.
        until: the last step, see `close`.
        budget_s: time for all, the recording included [s]; None without a limit.
        on_begin: called before the first motion, when nothing speaks against it.
        track: shows progress.
        watch: who is told more.

    Raises:
        OutputExists: `out` is not empty, and neither `overwrite` nor `resume` is given; or it holds another demo.
        ConfigError: there is no demo of this robot, or nothing to import.
        MissingDependency: the extra `plan` is not installed.
    """
    out = Path(out)
    if robot not in DEMO_ROBOTS:
        raise ConfigError(f"there is no demo of {robot!r}", available=DEMO_ROBOTS)
    may_begin(out, overwrite=overwrite, resume=resume)
    if until == "import":
        raise ConfigError("a demo records its data: there is nothing to import", available=STEPS[1:])
    limit = None if budget_s is None else TimeLimit.after(budget_s)
    on_begin()
    with CloseFolder(
        out, until=until, budget_s=budget_s, overwrite=overwrite, provenance=provenance(config={}, seed=seed)
    ).replacing():
        if robot == "demo_arm":
            data = demo_dataset(out / "dataset", seed=seed, overwrite=overwrite, resume=resume, track=track)
        else:
            threads = jobs or os.cpu_count() or 1
            data = _panda(out / "dataset", seed=seed, jobs=threads, overwrite=overwrite, resume=resume, track=track)
    left_s = None if limit is None else max(1.0, limit.left_s)
    return close(
        data,
        load_robot(robot),
        out,
        until=until,
        budget_s=left_s,
        seed=seed,
        jobs=jobs,
        overwrite=not resume,
        resume=resume,
        track=track,
        watch=watch,
    )


def _panda(out: Path, *, seed: int, jobs: int, overwrite: bool, resume: bool, track: Track) -> Path:
    from dataclasses import replace

    from trueup.lab import LabSpec
    from trueup.record import load_plans
    from trueup.stages.recording import record
    from trueup.stages.rigs import LabRig

    paper = load_plans("paper")
    groups = tuple(replace(group, count=_MOTIONS[group.name]) for group in paper.groups)
    plans = replace(paper, name="demo", groups=groups, seed=seed)
    rig = LabRig(LabSpec(), seed=seed)
    done = record(
        out,
        load_robot("panda"),
        rig,
        plans,
        payloads_kg=_PAYLOADS_KG,
        jobs=jobs,
        overwrite=overwrite,
        resume=resume,
        track=track,
    )
    return done.path
