"""Torque block by block: the gray-box regression of a dataset's motions (GapONet 3.1, eq. 1)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.graybox_result import HELD_OUT, GrayboxResult
from trueup.dataset import Dataset
from trueup.errors import TrueupError
from trueup.measure import executed_of
from trueup.stages.comparing import Frame

# Rows that are held at once take some 800 bytes for ten joints; of a longer dataset every n-th motion is used.
_MOST_SAMPLES = 400_000
_NEEDED = "It needs measured torque and position, and the commanded position, of whole motions."


def blocks_of(dataset: Dataset, names: Sequence[str], frame: Frame) -> tuple[GrayboxResult | None, str]:
    """The regression over these episodes in the robot's names.

    The delay of the command is the one with which the servo alone explains the train motions best: friction would
    otherwise stand for a delay that nobody knew of.

    Args:
        dataset: with the episodes.
        names: those that are measured.
        frame: joint map, scored joints and torque limits.

    Returns:
        The result and an empty text, or None and a sentence that says why there is none and what it needs.
    """
    from trueup.identify.regression import GrayboxSettings, best_delay, fit_graybox, spread

    metas = {meta.id: meta for meta in dataset.metas}
    chosen = thinned(dataset, [metas[name] for name in names])
    refused: dict[str, str] = {}
    limits = frame.torque_limits or {}
    settings = GrayboxSettings(torque_limits=limits)
    try:
        few = list(_episodes(dataset, spread(chosen), frame, refused))
        if not few:
            return None, f"Torque was not taken apart: {next(iter(refused.values()), 'no motion is left')}. {_NEEDED}"
        settings = replace(settings, delay_s=best_delay(few, settings, joints=frame.scored))
        result = fit_graybox(_episodes(dataset, chosen, frame, refused), settings=settings, joints=frame.scored)
    except TrueupError as error:
        return None, f"Torque was not taken apart: {error.what}. {_NEEDED}"
    if not result.total:
        why = next((note for joint in result.joints.values() for note in reversed(joint.notes)), "no joint can be used")
        return None, f"Torque was not taken apart: {why}. {_NEEDED}"
    notes = [*result.notes, f"commands are taken to act {1e3 * settings.delay_s:g} ms late, which fits train best"]
    if len(chosen) < len(names):
        notes.append(f"{len(chosen)} of {len(names)} motions were used, spread over the dataset")
    if refused:
        notes.append(f"{len(refused)} motions were left out: {next(iter(refused.values()))}")
    if HELD_OUT not in result.total[0].splits:
        notes.append("fewer than three motions: nothing can be held out, and each block looks better than it is")
    return replace(result, notes=tuple(notes)), ""


def thinned(dataset: Dataset, metas: Sequence[EpisodeMeta]) -> list[str]:
    """Every n-th executed motion with all its repetitions, so that the samples can be held at once."""
    samples = dict(zip(dataset.ids, dataset.index.column("measured_samples").to_pylist(), strict=True))
    total = sum(samples[meta.id] for meta in metas)
    every = max(1, -(-total // _MOST_SAMPLES))
    return [meta.id for meta, motion in zip(metas, executed_of(metas), strict=True) if motion % every == 0]


def _episodes(dataset: Dataset, names: Sequence[str], frame: Frame, refused: dict[str, str]) -> Iterator[Episode]:
    """Episodes in the robot's names that have what the regression needs."""
    for name in names:
        try:
            episode = dataset.episode(name)
            episode = episode if frame.joint_map is None else frame.joint_map.of_episode(episode)
        except TrueupError as error:
            refused[name] = error.what
            continue
        if "torque" not in episode.measured:
            refused[name] = "no torque was measured"
        elif not np.isfinite(episode.measured["torque"]).any():
            refused[name] = "the measured torque has no finite sample"
        elif episode.command is None or "position" not in episode.command:
            refused[name] = "no position was commanded"
        else:
            yield episode
