"""Gap: a dataset and its runs in, numbers with intervals and everything that a report shows out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from trueup.align import JointMap, align_starts, cut_rest, position_mse, resample, robust_threshold
from trueup.core.analysis import Analysis
from trueup.core.episode import Episode, Flag
from trueup.core.hold import SAME_INSTANT_S
from trueup.core.provenance import provenance
from trueup.core.quality import EpisodeQuality, Quality
from trueup.core.results import GapResult
from trueup.core.timeseries import TimeSeries
from trueup.core.traces import TraceSet
from trueup.core.windows import window_starts
from trueup.dataset import Dataset
from trueup.errors import ConfigError, DataError, MissingSignal
from trueup.measure import COMMAND_RUN, AnalysisBuilder, Comparison, lags_of, measure_gap
from trueup.robots import RobotSpec
from trueup.stages.progress import Track, silent
from trueup.stages.replaying import in_robot_names

_FEWEST_FOR_A_THRESHOLD = 5

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
    """

    gap: GapResult
    analysis: Analysis
    traces: TraceSet
    quality: Quality

    def save(self, folder: Path | str) -> None:
        """Write gap.json, analysis.json, quality.json, traces.json and traces.npz."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self.traces.save(folder)
        self.analysis.save(folder / "analysis.json")
        self.quality.save(folder / "quality.json")
        self.gap.save(folder / "gap.json")


@dataclass(frozen=True)
class _Frame:
    """What the runs that are compared have in common.

    `foreign` runs came with the logs: they speak the log's language and have clocks of their own.
    """

    joint_map: JointMap | None
    foreign: frozenset[str]
    scored: tuple[str, ...] | None
    torque_limits: dict[str, float] | None
    window_s: float | None
    follows_motion: bool
    robot: str


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
    labels = tuple(known if runs is None else (label for label in runs if label != COMMAND_RUN))
    frame = _frame(dataset, labels, robot)
    kept = dataset.select(split=split, drop_flagged=drop_flagged)
    if not kept:
        raise DataError(
            f"no episode of {dataset.path} is left to measure",
            got=f"split {split!r}, {'without' if drop_flagged else 'with'} flagged ones",
            available=sorted(set(dataset.splits.values())),
        )
    builder = AnalysisBuilder(window_s=frame.window_s)
    traces = TraceSet()
    errors: dict[str, float] = {}
    signs = _Signs()

    def comparisons() -> Iterator[Comparison]:
        for name in track(kept, "gap", len(kept)):
            episode = dataset.episode(name, runs=[label for label in labels if name in dataset.run_ids(label)])
            comparison = _comparison(cut_rest(episode) if cut_resting else episode, frame, align=align)
            traces.add(name, episode.meta.split, comparison.measured, comparison.command, dict(comparison.simulated))
            # A robot that is driven by torque may log a wish for its position, but that is not what it was told.
            scored = comparison if frame.follows_motion else replace(comparison, command=None)
            builder.add(scored)
            signs.add(comparison)
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
    result = measure_gap(
        comparisons(),
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
    names = {"robot": frame.robot or dataset.info.robot, "dataset": dataset.path.resolve().name}
    warnings = {"warnings": signs.warnings()}
    result = replace(result, settings={**result.settings, **names, **warnings})
    origin = result.provenance
    traces.provenance = origin
    analysis = replace(builder.result(lags_of(result)), provenance=origin)
    quality = _quality(dataset, set(kept), frame.joint_map, _failed(errors), split=split)
    return Measurement(result, analysis, traces, replace(quality, provenance=origin))


def _frame(dataset: Dataset, labels: Sequence[str], robot: RobotSpec | None) -> _Frame:
    infos = {label: dataset.run_info(label) for label in labels}
    maps = {label: info["joint_map"] for label, info in infos.items() if "joint_map" in info}
    settings = {label: info["settings"] for label, info in infos.items() if "settings" in info}
    windows = {label: item.get("window_s") for label, item in settings.items()}
    starts = {label: item.get("initial_velocity") for label, item in settings.items()}
    for what, values in (("joint maps", maps), ("windows", windows), ("initial velocities", starts)):
        first = next(iter(values.values()), None)
        other = [label for label, value in values.items() if value != first]
        if other:
            raise ConfigError(
                f"the runs have different {what}, so that their errors cannot share one table",
                got=f"{other} differ from {next(iter(values))!r}",
                hint="Name runs that belong together with --runs, or replay them anew.",
            )
    base = next(iter(infos.values()), {})
    rules = next(iter(maps.values()), robot.joint_rules() if robot else None)
    stated = next((tuple(info["scored_joints"]) for info in infos.values() if "scored_joints" in info), None)
    scored = robot.scored_joints if robot else stated
    limits = {joint.name: joint.torque_limit for joint in robot.joints if joint.torque_limit} if robot else {}
    return _Frame(
        joint_map=None if rules is None else JointMap.from_dict(rules),
        foreign=frozenset(labels) - set(maps),
        scored=scored,
        torque_limits={**base.get("torque_limits", {}), **limits} or None,
        window_s=next(iter(windows.values()), None),
        follows_motion=base.get("command_signal", "position") in ("position", "velocity"),
        robot=robot.name if robot else base.get("inputs", {}).get("robot", {}).get("name", ""),
    )


def _comparison(episode: Episode, frame: _Frame, *, align: bool) -> Comparison:
    """Everything on the measured stamps that have a command."""
    foreign = {label: series for label, series in episode.simulated.items() if label in frame.foreign}
    own = {label: series for label, series in episode.simulated.items() if label not in foreign}
    if frame.joint_map is not None:
        episode = in_robot_names(episode, frame.joint_map)
        foreign = {label: frame.joint_map.for_series(item).apply(item) for label, item in foreign.items()}
    command, measured = episode.command, episode.measured
    if align:
        foreign = {
            label: replace(item, time_s=item.time_s + align_starts(measured, item)) for label, item in foreign.items()
        }
    begin = [item.time_s[0] for item in (*own.values(), *foreign.values(), *([command] if command else []))]
    end = [item.time_s[-1] for item in (*own.values(), *foreign.values())]
    inside = (measured.time_s >= max(begin, default=-np.inf) - SAME_INSTANT_S) & (
        measured.time_s <= min(end, default=np.inf) + SAME_INSTANT_S
    )
    if not inside.any():
        raise DataError(f"episode {episode.id!r}: measurement, command and simulation have no time in common")
    measured = measured.rows(np.flatnonzero(inside))
    clock = measured.time_s
    simulated = {label: _at(series, clock) for label, series in own.items()}
    for label, series in foreign.items():
        # A hair before or after the run's own ends is its end.
        at = resample(series, np.clip(clock, series.time_s[0], series.time_s[-1]))
        simulated[label] = replace(at, time_s=clock)
    return Comparison(
        meta=episode.meta,
        measured=measured,
        simulated={label: simulated[label] for label in episode.simulated},
        command=None if command is None else resample(command, clock, hold=True),
        starts=window_starts(clock, frame.window_s),
    )


def _at(series: TimeSeries, time_s: np.ndarray) -> TimeSeries:
    """The samples at stamps that the series has."""
    rows = np.clip(np.searchsorted(series.time_s, time_s - 1e-9), 0, len(series) - 1)
    if not np.allclose(series.time_s[rows], time_s, rtol=0.0, atol=1e-9):
        raise DataError(
            "a run was made from other stamps than those measured now",
            hint="Replay it again: trueup replay DATASET --robot ROBOT --overwrite.",
        )
    return series.rows(rows)


def _made(dataset: Dataset, label: str) -> dict[str, Any]:
    """How a run was made; how long that took is no configuration."""
    return {key: value for key, value in dataset.run_info(label).items() if key != "seconds"}


class _Signs:
    """Finds torques that are measured without their sign: comparing them with signed ones says little."""

    def __init__(self) -> None:
        self._lowest: dict[str, float] = {}
        self._simulated: dict[str, float] = {}

    def add(self, comparison: Comparison) -> None:
        series = (
            comparison.measured,
            *(item.select(comparison.measured.joints) for item in comparison.simulated.values()),
        )
        if len(series) < 2 or not all("torque" in item for item in series):
            return
        for number, joint in enumerate(comparison.measured.joints):
            for lowest, item in zip((self._lowest, self._simulated), series, strict=False):
                lowest[joint] = min(lowest.get(joint, 0.0), float(np.nanmin(item["torque"][:, number], initial=0.0)))

    def warnings(self) -> list[str]:
        """One sentence, or none."""
        unsigned = [joint for joint, low in self._lowest.items() if low >= 0.0 > self._simulated[joint]]
        if not unsigned:
            return []
        joints = ", ".join(unsigned)
        return [f"The measured torque of {joints} has no sign, the simulated one has: errors of torque say little."]


def _failed(errors: Mapping[str, float]) -> dict[str, Flag]:
    """Motions that are much further from the simulation than the others are (LSTM thesis, 4.2)."""
    known = {name: value for name, value in errors.items() if np.isfinite(value)}
    if len(known) < _FEWEST_FOR_A_THRESHOLD:
        return {}
    threshold = robust_threshold(list(known.values()))
    return {
        name: Flag(
            kind="far_from_simulation",
            signal="position",
            severity="note",
            detail=f"position MSE against the simulation {value:.3g}, the other motions stay below {threshold:.3g}: "
            "executed wrongly, or something that the model does not know",
        )
        for name, value in known.items()
        if value > threshold
    }


def _quality(
    dataset: Dataset,
    kept: set[str],
    joint_map: JointMap | None,
    failed: Mapping[str, Flag],
    *,
    split: str | None,
) -> Quality:
    """The flags of the episodes that were asked for; those that are not in `kept` were dropped because of them."""
    names = {rule.log: rule.joint for rule in joint_map.rules} if joint_map else {}
    episodes = {}
    for name in dataset.select(split=split):
        meta = dataset.meta(name)
        flags = [replace(flag, joint=names.get(flag.joint, flag.joint)) for flag in meta.flags]
        flags += [failed[name]] if name in failed else []
        episodes[name] = EpisodeQuality(split=meta.split, flags=tuple(flags), dropped=name not in kept)
    return Quality(episodes)
