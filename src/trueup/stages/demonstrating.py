"""Demo: record virtual hardware and close on the recording."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

from trueup.core.provenance import provenance
from trueup.dataset import DatasetInfo, DatasetWriter
from trueup.errors import ConfigError, OutputExists
from trueup.robots import load_robot
from trueup.stages.closing import Closed, close
from trueup.stages.importing import checked
from trueup.stages.progress import Track, silent

DEMO_ROBOTS = ("panda", "demo_arm")

# A sixtieth of the papers' motions, each without and with a payload.
_MOTIONS = {"multi-joint": 12, "single-joint": 14, "cartesian": 4}
_PAYLOADS_KG = (0.0, 2.0)


def demo_dataset(out: Path | str, *, seed: int = 0, overwrite: bool = False, track: Track = silent) -> Path:
    """Record twelve motions of the three-joint demo arm's hardware into a dataset (see `lab.record_demo`).

    Raises:
        OutputExists: `out` is there, and `overwrite` is not given.
    """
    from trueup.lab import record_demo

    out = Path(out)
    info = DatasetInfo(robot="demo_arm", licence="Apache-2.0", provenance=provenance(config={}, seed=seed))
    with DatasetWriter.create(out, info, overwrite=overwrite) as writer:
        for episode in track(record_demo(seed=seed), "record", 12):
            writer.append(checked(episode))
    return out


def demo(
    out: Path | str,
    *,
    robot: Literal["panda", "demo_arm"] = "panda",
    seed: int = 0,
    jobs: int | None = None,
    overwrite: bool = False,
    track: Track = silent,
) -> Closed:
    """Record virtual hardware into `out/dataset` and close on it.

    Args:
        out: folder for the results.
        robot: `panda`: planned motions of a virtual Panda (extra `plan`); `demo_arm`: twelve motions of an arm of three
            joints, which is simulated and fitted in seconds.
        seed: of motions and noise.
        jobs: processes and threads; the number of cores if None.
        overwrite: replace what is in `out`.
        track: shows progress.

    Raises:
        OutputExists: `out` is not empty, and `overwrite` is not given.
        ConfigError: there is no demo of this robot.
        MissingDependency: the extra `plan` is not installed.
    """
    out = Path(out)
    if robot not in DEMO_ROBOTS:
        raise ConfigError(f"there is no demo of {robot!r}", available=DEMO_ROBOTS)
    if out.is_dir() and any(out.iterdir()) and not overwrite:
        raise OutputExists(f"{out} is not empty", hint="Give --overwrite, or choose another --out.")
    if robot == "demo_arm":
        data = demo_dataset(out / "dataset", seed=seed, overwrite=overwrite, track=track)
    else:
        data = _panda(out / "dataset", seed=seed, jobs=jobs or os.cpu_count() or 1, overwrite=overwrite, track=track)
    return close(data, load_robot(robot), out, seed=seed, jobs=jobs, overwrite=True, track=track)


def _panda(out: Path, *, seed: int, jobs: int, overwrite: bool, track: Track) -> Path:
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
        out, load_robot("panda"), rig, plans, payloads_kg=_PAYLOADS_KG, jobs=jobs, overwrite=overwrite, track=track
    )
    return done.path
