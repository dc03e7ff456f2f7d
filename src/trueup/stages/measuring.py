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
from trueup.core.atomic import make_folder, remove
from trueup.core.augment_result import AUGMENT_NAME
from trueup.core.engines import EngineComparison
from trueup.core.episode import Episode
from trueup.core.graybox_result import GrayboxResult
from trueup.core.provenance import provenance
from trueup.core.quality import Quality
from trueup.core.results import GapResult
from trueup.core.traces import TraceSet
from trueup.dataset import Dataset
from trueup.errors import ConfigError, DataError, MissingSignal, TrueupError
from trueup.measure import (
    COMMAND_RUN,
    EPISODE_METRICS,
    AnalysisBuilder,
    Comparison,
    PlaneBuilder,
    RepeatBuilder,
    conditions_repeat,
    lags_of,
    measure_gap,
    nearer_of,
    trends_of,
)
from trueup.robots import RobotSpec
from trueup.stages.blocks import blocks_of
from trueup.stages.comparing import Frame, comparison_of, frame_of
from trueup.stages.folder import provenance_of
from trueup.stages.lacking import lacking
from trueup.stages.progress import Track, silent
from trueup.stages.suspicions import Signs, far_motions, held, incomplete, outdated, quality_of, unapplied

# Motions whose curves are kept for the report, those with the largest errors; memory must not grow with the dataset.
_MOST_TRACED = 300
# Kept motion by motion, besides the usual ones, where payloads, conditions or engines are compared.
_COMPARED_METRICS = ("nrmse", "smoothness", "saturation_measured", "saturation_simulated")


@dataclass(frozen=True)
class Measurement:
    """The gap of a dataset, and what explains it.

    Attributes:
        gap: the numbers.
        analysis: error against velocity, position and load, lags, error against horizon.
        traces: thinned curves for the report.
        quality: the flags of all episodes, in the robot's joint names.
        engines: payloads, conditions and engines side by side; None where there are not two of any of them.
        graybox: torque block by block, likewise; None if it was not asked for or cannot be.
        blocks: whether the torque was to be taken apart.
    """

    gap: GapResult
    analysis: Analysis
    traces: TraceSet
    quality: Quality
    engines: EngineComparison | None = None
    graybox: GrayboxResult | None = None
    blocks: bool = True

    def save(self, folder: Path | str) -> None:
        """Write gap.json, analysis.json, quality.json, traces.json and traces.npz; engines.json, graybox.json if any.

        A graybox.json of an identification stays if there is none to replace it; so does that of an earlier measurement
        of the same motions if none was asked for.
        """
        folder = Path(folder)
        make_folder(folder)
        self.traces.save(folder)
        self.analysis.save(folder / "analysis.json")
        self.quality.save(folder / "quality.json")
        if self.engines is not None:
            self.engines.save(folder / "engines.json")
        else:  # one of an earlier comparison in this folder
            remove(folder / "engines.json")
        if self.graybox is not None:
            self.graybox.save(folder / "graybox.json")
        elif not ((folder / "fit.json").is_file() or self._kept(folder / "graybox.json")):
            remove(folder / "graybox.json")
        remove(folder / AUGMENT_NAME)  # likewise, of corrections that are not among these runs
        self.gap.save(folder / "gap.json")

    def _kept(self, path: Path) -> bool:
        """Whether a result that is there is of the same motions, and nobody has asked for another."""
        if self.blocks or not path.is_file():
            return False
        return _motions_in(provenance_of(path)) == _motions_in(self.gap.provenance)


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
    blocks: bool = True,
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
        blocks: take the measured torque apart block by block, where payloads, conditions or engines are compared.
        track: shows progress.

    Raises:
        MissingSignal: a run or split is not there.
        ConfigError: runs with different joint maps or windows cannot share one table.
        DataError: no episode is left.
    """
    if not 0 < tau_rad < np.inf:
        raise ConfigError("tau_rad must be positive", got=tau_rad)
    # The stock model is what the others are compared with, whatever their names.
    known = sorted(dataset.runs, key=lambda label: (not label.endswith("/stock"), label))
    labels = tuple(known if runs is None else (label for label in runs if label != COMMAND_RUN))
    kept = dataset.select(split=split, drop_flagged=drop_flagged)
    # A replay that was interrupted before its first motion is no reason to measure nothing.
    empty = [label for label in labels if runs is None and not {*dataset.run_ids(label)} & {*kept}]
    if len(empty) < len(labels):
        labels = tuple(label for label in labels if label not in empty)
    frame = frame_of(dataset, labels, robot)
    if not kept:
        raise DataError(
            f"no episode of {dataset.path} is left to measure",
            got=f"split {split!r}, {'without' if drop_flagged else 'with'} flagged ones",
            available=sorted(set(dataset.splits.values())),
        )
    motions = _Motions(dataset, labels, kept, frame)
    config: dict[str, Any] = {
        "runs": {label: _made(dataset, label) for label in labels},
        "split": split,
        "drop_flagged": drop_flagged,
        "signals": None if signals is None else list(signals),
        "metrics": None if metrics is None else list(metrics),
        "cut_rest": cut_resting,
        "align_starts": align,
    }
    items = motions.compared(track, cut_resting=cut_resting, align=align)
    first = next(items, None)
    if first is None:
        raise next(iter(motions.left_out.values()))
    result = measure_gap(
        itertools.chain([first], items),
        scored_joints=frame.scored,
        signals=signals,
        metrics=metrics,
        torque_limits=frame.torque_limits,
        tau_rad=tau_rad,
        window_s=frame.window_s,
        episode_metrics=(*EPISODE_METRICS, *(_COMPARED_METRICS if motions.comparing else ())),
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
    warnings = [f"the run {label} has none of these motions and is left out" for label in empty]
    warnings += motions.warnings(signals)
    result = replace(result, settings={**result.settings, **names, "warnings": warnings})
    return motions.measurement(result, split, blocks=blocks and (signals is None or "torque" in signals))


class _Motions:
    """The motions that are measured: what is kept of each besides its metrics, while they go by one by one."""

    def __init__(self, dataset: Dataset, labels: Sequence[str], kept: Sequence[str], frame: Frame) -> None:
        self.left_out: dict[str, TrueupError] = {}
        self._dataset, self._labels, self._kept, self._frame = dataset, labels, kept, frame
        self._covered = {label: frozenset(dataset.run_ids(label)) for label in labels}
        for label, ids in self._covered.items():
            if not ids & set(kept):
                raise MissingSignal(
                    f"the run {label!r} has none of the motions to measure",
                    available=sorted(ids),
                    hint="Replay them: trueup replay DATASET --robot ROBOT --resume.",
                )
        self._several_engines = len({label.partition("/")[0] for label in labels}) > 1
        metas = {meta.id: meta for meta in dataset.metas}
        loads = {name: meta.payload_kg for name, meta in metas.items()}
        self._repeating = conditions_repeat(metas[name] for name in kept)
        self.comparing = self._several_engines or self._repeating or _several(loads, kept)
        self._analysis, self._plane = AnalysisBuilder(window_s=frame.window_s), PlaneBuilder(frame.scored)
        self._repeats = RepeatBuilder(frame.scored)
        self._traces, self._signs = TraceSet(), Signs()
        self._errors: dict[str, float] = {}
        self._payload_kg: dict[str, float | None] = {}

    def compared(self, track: Track, *, cut_resting: bool, align: bool) -> Iterator[Comparison]:
        """The motions one by one, on one clock; one that cannot be compared is left out."""
        for name in track(self._kept, "gap", len(self._kept)):
            episode = self._dataset.episode(
                name, runs=[label for label in self._labels if name in self._covered[label]]
            )
            try:
                comparison = comparison_of(cut_rest(episode) if cut_resting else episode, self._frame, align=align)
            except TrueupError as error:  # one bad motion must not hide the others; a damaged file is another matter
                self.left_out[name] = error
                continue
            # A robot that is driven by torque may log a wish for its position, but that is not what it was told.
            scored = comparison if self._frame.follows_motion else replace(comparison, command=None)
            self._analysis.add(scored)
            self._keep(comparison)
            yield scored

    def _keep(self, comparison: Comparison) -> None:
        name, meta = comparison.meta.id, comparison.meta
        self._traces.add(name, meta.split, comparison.measured, comparison.command, dict(comparison.simulated))
        self._signs.add(comparison)
        self._payload_kg[name] = meta.payload_kg
        if self.comparing:
            self._plane.add(comparison)
            self._repeats.add(comparison)
        if len(self._traces.episodes) > _MOST_TRACED:
            self._traces.episodes.pop(min(self._traces.episodes, key=lambda key: self._errors.get(key, np.inf)))
        if self._labels and self._labels[0] in comparison.simulated and "position" in comparison.measured:
            motion = Episode(meta, comparison.measured, simulated=comparison.simulated)
            self._errors[name] = position_mse(motion, run=self._labels[0])

    def warnings(self, signals: Sequence[str] | None) -> list[str]:
        """What a reader of the numbers of these signals, or of all, should know."""
        logged = self._dataset[self._kept[0]].measured.joints
        return [
            *incomplete(self._dataset, self._covered, self._kept),
            *outdated(self._dataset, self._labels),
            *held(self._dataset, self._labels),
            *unapplied(self._frame.joint_map, logged),
            *(f"{name} was left out: {error.what}" for name, error in self.left_out.items()),
            *(self._signs.warnings() if signals is None or "torque" in signals else ()),
        ]

    def measurement(self, result: GapResult, split: str | None, *, blocks: bool) -> Measurement:
        """The numbers with all that was kept beside them."""
        origin = result.provenance
        self._traces.provenance = origin
        analysis = replace(self._analysis.result(lags_of(result)), provenance=origin)
        far = far_motions(self._errors)
        quality = quality_of(self._dataset, set(self._kept), self._frame.joint_map, far, split=split)
        quality = replace(quality, provenance=origin)
        if not (self._several_engines or self._repeating or _several(self._payload_kg, self._payload_kg)):
            return Measurement(result, analysis, self._traces, quality, blocks=blocks)
        graybox, why = blocks_of(self._dataset, list(self._payload_kg), self._frame) if blocks else (None, "")
        engines = self._compared(result, why)
        if graybox is not None:
            graybox = replace(graybox, provenance=origin)
        return Measurement(result, analysis, self._traces, quality, engines, graybox, blocks)

    def _compared(self, result: GapResult, without_blocks: str) -> EngineComparison:
        executed = {meta.id: meta.executed for meta in self._dataset.metas}
        plane = self._plane.result()
        found = EngineComparison(
            trends=trends_of(result, self._payload_kg, motions=executed),
            plane=plane,
            shifts=self._repeats.shifts(result),
            inside={} if plane is None else self._repeats.inside(plane),
            nearer=nearer_of(result, self._payload_kg, motions=executed),
            provenance=result.provenance,
        )
        missing = lacking(found, result, self._payload_kg)
        return replace(found, missing={**missing, **({"blocks": without_blocks} if without_blocks else {})})


def _motions_in(origin: Mapping[str, Any]) -> tuple[Any, ...]:
    """What says of a measurement which motions are in it."""
    config = origin.get("config", {})
    return origin.get("data_hash"), config.get("split"), config.get("drop_flagged")


def _several(payload_kg: Mapping[str, float | None], motions: Iterable[str]) -> bool:
    """Whether these motions carry two known payloads or more."""
    return len({payload_kg[name] for name in motions} - {None}) > 1


def _made(dataset: Dataset, label: str) -> dict[str, Any]:
    """How a run was made; how long that took is no configuration."""
    return {key: value for key, value in dataset.run_info(label).items() if key != "seconds"}
