"""Demo: record virtual hardware and close on the recording."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from trueup.core.close_result import STEPS, StepName
from trueup.core.interpolation import columns_at
from trueup.core.provenance import provenance
from trueup.core.sole_writer import writes_alone
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter, is_dataset
from trueup.errors import ConfigError, OutputExists
from trueup.robots import RobotSpec, find_model, load_robot
from trueup.stages.close_folder import CloseFolder, may_begin
from trueup.stages.close_steps import Closed, Watch
from trueup.stages.close_words import shares
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
    out: Path | str,
    *,
    seed: int = 0,
    loads: bool = True,
    overwrite: bool = False,
    resume: bool = False,
    track: Track = silent,
) -> Path:
    """Record twelve motions of the three-joint demo arm's hardware into a dataset (see `lab.record_demo`).

    Args:
        out: the dataset's folder.
        seed: of motions and noise.
        loads: whether some motions carry something that the model does not know.
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
        for episode in track(record_demo(seed=seed, loads=loads), "record", _DEMO_MOTIONS):
            writer.append(checked(episode))
    return out


@writes_alone()
def demo(
    out: Path | str,
    *,
    robot: Literal["panda", "demo_arm"] = "panda",
    loads: bool = True,
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
        loads: whether some motions carry something; of the arm, its model does not know it.
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
            data = demo_dataset(
                out / "dataset", seed=seed, loads=loads, overwrite=overwrite, resume=resume, track=track
            )
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


def told(closed: Closed, robot: RobotSpec) -> tuple[str, ...]:
    """What came of a demo in plain sentences: how far off before and after, on motions that were not fitted, and why.

    Distances of the tool are root mean squares over all samples of these motions, by forward kinematics of measured and
    simulated positions; the last body of the model is the tool.
    """
    rungs = {rung.name: rung.splits.get("test", {}).get("position", {}).get("rmse") for rung in closed.ladder.rungs}
    before, after = rungs.get("stock"), rungs.get("fitted")
    if before is None or after is None:
        return ()
    tests = [id for id, split in closed.dataset.splits.items() if split == "test"]
    offs = [_tool_mm(closed.dataset, robot, tests, label) for label in ("mujoco/stock", "mujoco/fitted")]
    turns = [math.degrees(own.total.value) for own in (before, after)]
    less = 100.0 * (1.0 - after.total.value / before.total.value)
    how = f"{less:.0f} % less" if less > 0 else f"{-less:.0f} % more"
    was, now = (f"{turn:.2g}° per joint and {off:.2g} mm at the tool" for turn, off in zip(turns, offs, strict=True))
    lines = [
        f"On {len(tests)} motions that the fit has not seen, the simulator was off by {was}; fitted, by {now}: {how}."
    ]
    if closed.attribution is not None:
        lines.append(f"Where the error came from: {shares(closed.attribution)}.")
    return tuple(lines)


def _tool_mm(dataset: Dataset, robot: RobotSpec, ids: Sequence[str], label: str) -> float:
    import mujoco

    from trueup.robots.model import load_spec

    model = load_spec(find_model(robot)).compile()
    data, tool = mujoco.MjData(model), model.nbody - 1
    columns = [int(model.joint(name).qposadr[0]) for name in robot.joint_names]

    def track(positions: np.ndarray) -> np.ndarray:
        found = np.empty((len(positions), 3))
        for row, pose in enumerate(positions):
            data.qpos[columns] = pose
            mujoco.mj_kinematics(model, data)
            found[row] = data.xpos[tool]
        return found

    squares = []
    for id in ids:
        episode = dataset.episode(id, runs=[label])
        done, simulated = episode.measured.select(robot.joint_names), episode.simulated[label]
        at = columns_at(done.time_s, simulated.time_s, simulated.select(robot.joint_names)["position"])
        squares.append(np.sum((track(done["position"]) - track(at)) ** 2, axis=1))
    return 1000.0 * float(np.sqrt(np.mean(np.concatenate(squares))))


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
