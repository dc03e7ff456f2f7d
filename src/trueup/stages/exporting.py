"""Export: a dataset in, files of another format out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from trueup.align import common_grid, resample
from trueup.core.episode import Episode
from trueup.dataset import Dataset
from trueup.dataset.export_csv import export_csv
from trueup.dataset.export_lerobot import export_lerobot
from trueup.errors import ConfigError
from trueup.stages.progress import Track, silent


def export_dataset(
    path: Path | str,
    out: Path | str,
    *,
    format: Literal["csv", "lerobot"] = "csv",
    rate_hz: int | None = None,
    task: str = "",
    track: Track = silent,
) -> int:
    """Write a dataset in another format; returns the number of episodes.

    CSV keeps every sample and comes with a mapping file that imports it again. LeRobot has one clock for state and
    action, so measured signals are interpolated and commands held on a grid of `rate_hz`.

    Raises:
        OutputExists: `out` is there.
        ConfigError: `rate_hz` is not positive, or given for CSV.
    """
    dataset, out = Dataset(path), Path(out)
    episodes = track(dataset, "export", len(dataset))
    if format == "csv":
        if rate_hz is not None:
            raise ConfigError("a CSV export keeps the stamps as they are; rate_hz is for lerobot")
        export_csv(episodes, out)
        return len(dataset)
    if rate_hz is None:
        rate_hz = int(np.round(np.median([dataset[name].measured.rate_hz for name in dataset.ids[:20]])))
    if rate_hz <= 0:
        raise ConfigError("rate_hz must be positive", got=rate_hz)
    export_lerobot(_on_grid(episodes, rate_hz), out, fps=rate_hz, robot_type=dataset.info.robot, task=task)
    return len(dataset)


def _on_grid(episodes: Iterator[Episode], rate_hz: int) -> Iterator[Episode]:
    for episode in episodes:
        command = episode.commanded()
        grid = common_grid(episode.measured, rate_hz=float(rate_hz))
        grid = grid[grid >= command.time_s[0]]
        held = resample(command, grid, hold=True)
        yield replace(episode, measured=resample(episode.measured, grid), command=held)
