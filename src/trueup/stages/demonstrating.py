"""Demo: record the built-in arm's hardware and close on the recording."""

from __future__ import annotations

from pathlib import Path

from trueup.core.provenance import provenance
from trueup.dataset import DatasetInfo, DatasetWriter
from trueup.errors import OutputExists
from trueup.robots import load_robot
from trueup.stages.closing import Closed, close
from trueup.stages.importing import checked
from trueup.stages.progress import Track, silent


def demo_dataset(out: Path | str, *, seed: int = 0, overwrite: bool = False, track: Track = silent) -> Path:
    """Record twelve motions of the demo arm's hardware into a dataset (see `lab.record_demo`).

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
    out: Path | str, *, seed: int = 0, jobs: int | None = None, overwrite: bool = False, track: Track = silent
) -> Closed:
    """Record the demo arm's hardware into `out/dataset` and close on it.

    Raises:
        OutputExists: `out` is not empty, and `overwrite` is not given.
    """
    out = Path(out)
    if out.is_dir() and any(out.iterdir()) and not overwrite:
        raise OutputExists(f"{out} is not empty", hint="Give --overwrite, or choose another --out.")
    data = demo_dataset(out / "dataset", seed=seed, overwrite=overwrite, track=track)
    return close(data, load_robot("demo_arm"), out, seed=seed, jobs=jobs, overwrite=True, track=track)
