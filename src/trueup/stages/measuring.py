"""Gap: a dataset and its runs in, numbers with intervals and everything that a report shows out."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from trueup.align import cut_rest, position_mse
from trueup.core.analysis import Analysis
from trueup.core.atomic import make_folder
from trueup.core.augment_result import AUGMENT_NAME
from trueup.core.engines import EngineComparison
from trueup.core.episode import Episode
from trueup.core.provenance import provenance
from trueup.core.quality import Quality
from trueup.core.results import GapResult
from trueup.core.traces import TraceSet
from trueup.dataset import Dataset
from trueup.errors import ConfigError, DataError, MissingSignal, TrueupError
from trueup.measure import COMMAND_RUN, AnalysisBuilder, Comparison, PlaneBuilder, lags_of, measure_gap, trends_of
from trueup.robots import RobotSpec
from trueup.stages.comparing import comparison_of, frame_of
from trueup.stages.progress import Track, silent
from trueup.stages.suspicions import Signs, far_motions, incomplete, outdated, quality_of, unapplied

# Motions whose curves are kept for the report, those with the largest errors; memory must not grow with the dataset.
_MOST_TRACED = 300


@dataclass(frozen=True)
class Measurement:
    """The gap of a dataset, and what explains it.

    Attributes:
        gap: the numbers.
        analysis: error against velocity, position and load, lags, error against horizon.
        traces: thinned curves for the report.
        quality: the flags of all episodes, in the robot's joint names.
        engines: trends with the payload, and the joint trajectories on their main axes; None where neither two engines
            nor two payloads are compared.
    """

    gap: GapResult
    analysis: Analysis
    traces: TraceSet
    quality: Quality
    engines: EngineComparison | None = None

    def save(self, folder: Path | str) -> None:
        """Write gap.json, analysis.json, quality.json, traces.json and traces.npz, and engines.json if there is one."""
        folder = Path(folder)
        make_folder(folder)
        self.traces.save(folder)
        self.analysis.save(folder / "analysis.json")
        self.quality.save(folder / "quality.json")
        if self.engines is not None:
            self.engines.save(folder / "engines.json")
        else:  # one of an earlier comparison in this folder
            (folder / "engines.json").unlink(missing_ok=True)
        (folder / AUGMENT_NAME).unlink(missing_ok=True)  # likewise, of corrections that are not among these runs
        self.gap.save(folder / "gap.json")


def gap(
    dataset: Dataset,
    *,
    runs: Sequence[str] | None = None,
    robot: RobotSpec | None = None,
    split: str | None = None,
    drop_flagged: bool = False,
    cut_resting: bool = False,
    align: bool = False,
    signals: Sequence[str] | None = None,
    metrics: Sequence[str] | None = None,
    tau_rad: float = 0.5,
    draws: int = 2000,
    seed: int = 0,
    track: Track = silent,
) -> Measurement:
    """Measure how far simulated runs are from the robot.

    Args:
        dataset: with the runs in it.
        runs: labels; all that the dataset has if None. The command taken as the motion (`command`) is added
            where the command names one.
        robot: for a dataset without runs, and to override which joints are scored.
        split: measure only this one.
        drop_flagged: leave out episodes with a quality flag of severity `warning`.
        cut_resting: leave out the resting ends of each motion, half a second of rest excepted.
        align: shift runs that came with the logs so that their motion starts with the measured one (mean shift,
            LSTM thesis, Algorithm 2); for robot and simulator that were recorded apart, each on its own clock.
        signals: those to compare; all that both sides have if None.
        metrics: names; a sensible set per signal if None.
        tau_rad: threshold of the large-gap ratio [rad].
        draws: bootstrap resamples.
        seed: of the bootstrap.
        track: shows progress.

    Raises:
        MissingSignal: a run or split is not there.
        ConfigError: runs with different joint maps or windows cannot share one table.
        DataError: no episode is left.
    """
    # The stock model is what the others are compared with, whatever their names.
    known = sorted(dataset.runs, key=lambda label: (not label.endswith("/stock"), label))
    if not 0 < tau_rad < np.inf:
        raise ConfigError("tau_rad must be positive", got=tau_rad)
    labels = tuple(known if runs is None else (label for label in runs if label != COMMAND_RUN))
    frame = frame_of(dataset, labels, robot)
    kept = dataset.select(split=split, drop_flagged=drop_flagged)
    if not kept:
        raise DataError(
            f"no episode of {dataset.path} is left to measure",
            got=f"split {split!r}, {'without' if drop_flagged else 'with'} flagged ones",
            available=sorted(set(dataset.splits.values())),
        )
    builder = AnalysisBuilder(window_s=frame.window_s)
    traces = TraceSet()
    plane = PlaneBuilder(frame.scored)
    several_engines = len({label.partition("/")[0] for label in labels}) > 1
    comparing = several_engines or _several({meta.id: meta.payload_kg for meta in dataset.metas}, kept)
    payload_kg: dict[str, float | None] = {}
    executed = {meta.id: meta.source for meta in dataset.metas}
    errors: dict[str, float] = {}
    left_out: dict[str, TrueupError] = {}
    signs = Signs()
    covered = {label: frozenset(dataset.run_ids(label)) for label in labels}
    for label in labels:
        if not covered[label] & set(kept):
            raise MissingSignal(
                f"the run {label!r} has none of the motions to measure",
                available=sorted(covered[label]),
                hint="Replay them: trueup replay DATASET --robot ROBOT --resume.",
            )

    def comparisons() -> Iterator[Comparison]:
        for name in track(kept, "gap", len(kept)):
            episode = dataset.episode(name, runs=[label for label in labels if name in covered[label]])
            try:
                comparison = comparison_of(cut_rest(episode) if cut_resting else episode, frame, align=align)
            except TrueupError as error:  # one bad motion must not hide the others; a damaged file is another matter
                left_out[name] = error
                continue
            traces.add(name, episode.meta.split, comparison.measured, comparison.command, dict(comparison.simulated))
            # A robot that is driven by torque may log a wish for its position, but that is not what it was told.
            scored = comparison if frame.follows_motion else replace(comparison, command=None)
            builder.add(scored)
            signs.add(comparison)
            if comparing:
                plane.add(comparison)
            payload_kg[name] = comparison.meta.payload_kg
            if len(traces.episodes) > _MOST_TRACED:
                traces.episodes.pop(min(traces.episodes, key=lambda key: errors.get(key, np.inf)))
            if labels and labels[0] in comparison.simulated and "position" in comparison.measured:
                motion = Episode(comparison.meta, comparison.measured, simulated=comparison.simulated)
                errors[name] = position_mse(motion, run=labels[0])
            yield scored

    config: dict[str, Any] = {
        "runs": {label: _made(dataset, label) for label in labels},
        "split": split,
        "drop_flagged": drop_flagged,
        "signals": None if signals is None else list(signals),
        "metrics": None if metrics is None else list(metrics),
        "cut_rest": cut_resting,
        "align_starts": align,
    }
    items = comparisons()
    first = next(items, None)
    if first is None:
        raise next(iter(left_out.values()))
    result = measure_gap(
        itertools.chain([first], items),
        scored_joints=frame.scored,
        signals=signals,
        metrics=metrics,
        torque_limits=frame.torque_limits,
        tau_rad=tau_rad,
        window_s=frame.window_s,
        draws=draws,
        seed=seed,
        provenance=provenance(config=config, seed=seed, data_hash=dataset.hash),
    )
    if not result.runs:
        raise MissingSignal(
            f"{dataset.path} has nothing to compare with the measurement",
            available=labels,
            hint="Make a run first: trueup replay DATASET --robot ROBOT.",
        )
    source = dataset.info.provenance.get("config", {}).get("source")
    names = {"robot": frame.robot or dataset.info.robot, "dataset": source or dataset.path.resolve().name}
    told = [f"{name} was left out: {error.what}" for name, error in left_out.items()]
    warnings = {
        "warnings": [
            *incomplete(dataset, covered, kept),
            *outdated(dataset, labels),
            *unapplied(frame.joint_map, dataset[kept[0]].measured.joints),
            *told,
            *(signs.warnings() if signals is None or "torque" in signals else ()),
        ]
    }
    result = replace(result, settings={**result.settings, **names, **warnings})
    origin = result.provenance
    traces.provenance = origin
    analysis = replace(builder.result(lags_of(result)), provenance=origin)
    quality = quality_of(dataset, set(kept), frame.joint_map, far_motions(errors), split=split)
    engines = None
    if several_engines or _several(payload_kg, payload_kg):
        engines = EngineComparison(trends_of(result, payload_kg, motions=executed), plane.result(), origin)
    return Measurement(result, analysis, traces, replace(quality, provenance=origin), engines)


def _several(payload_kg: Mapping[str, float | None], motions: Iterable[str]) -> bool:
    """Whether these motions carry two known payloads or more."""
    return len({payload_kg[name] for name in motions} - {None}) > 1


def _made(dataset: Dataset, label: str) -> dict[str, Any]:
    """How a run was made; how long that took is no configuration."""
    return {key: value for key, value in dataset.run_info(label).items() if key != "seconds"}
