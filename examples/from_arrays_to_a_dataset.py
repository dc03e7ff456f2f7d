"""How do I import a log of my own, from arrays?

A few lines turn your arrays into a dataset. For files of a known format, use `trueup import`.

    python examples/from_arrays_to_a_dataset.py OUT
"""

import sys
from pathlib import Path

import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.stages.importing import checked

out = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/example-data")
joints = ("shoulder", "elbow")
rng = np.random.default_rng(0)
with DatasetWriter.create(out, DatasetInfo(robot="my_arm")) as writer:
    for number, split in enumerate(("train", "train", "val", "test")):
        time_s = np.arange(400) / 100.0
        asked = np.stack([np.sin(time_s + number), np.cos(time_s)], axis=1)
        seen = np.roll(asked, 3, axis=0) + 1e-3 * rng.standard_normal(asked.shape)
        command = TimeSeries(time_s, joints, {"position": asked}, same_units({"position": "rad"}, joints))
        measured = TimeSeries(time_s, joints, {"position": seen}, same_units({"position": "rad"}, joints))
        meta = EpisodeMeta(f"motion/{number:05d}", robot="my_arm", unit="one", split=split)
        writer.append(checked(Episode(meta, measured, command)))  # with warnings of what looks wrong
for episode in Dataset(out):
    flags = ", ".join(flag.kind for flag in episode.meta.flags) or "nothing to say"
    print(f"{episode.meta.id}: {len(episode.measured)} samples at {episode.measured.rate_hz:.0f} Hz, {flags}")
