"""Bring one episode and its runs into the robot's words and onto one clock, ready to be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.align import JointMap, align_starts, resample
from trueup.core.episode import Episode
from trueup.core.hold import SAME_INSTANT_S
from trueup.core.timeseries import TimeSeries
from trueup.core.windows import window_starts
from trueup.dataset import Dataset
from trueup.errors import ConfigError, DataError
from trueup.measure import Comparison
from trueup.robots import RobotSpec

# A motion of fewer samples starts where it was measured and ends before it can differ: it would count as perfect.
_FEWEST_SAMPLES = 10


@dataclass(frozen=True)
class Frame:
    """What the runs that are compared have in common.

    `follows_motion`: whether the command may be scored as a motion; not beside a simulation that is restarted from
    the measured state again and again. `foreign` runs came with the logs: they speak the log's language and have
    clocks of their own.
    """

    joint_map: JointMap | None
    foreign: frozenset[str]
    scored: tuple[str, ...] | None
    torque_limits: dict[str, float] | None
    window_s: float | None
    follows_motion: bool
    robot: str


def frame_of(dataset: Dataset, labels: Sequence[str], robot: RobotSpec | None) -> Frame:
    """What the runs of these labels have in common; `robot` decides where they say nothing, and what is scored.

    Raises:
        ConfigError: they have different joint maps, windows or kinds of start.
        MissingSignal: there is no such run.
    """
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
    base = next((info for info in infos.values() if "inputs" in info), {})  # a foreign run says nothing of the robot
    window_s = next(iter(windows.values()), None)
    rules = next(iter(maps.values()), robot.joint_rules() if robot else None)
    stated = next((tuple(info["scored_joints"]) for info in infos.values() if "scored_joints" in info), None)
    scored = robot.scored_joints if robot else stated
    limits = {joint.name: joint.torque_limit for joint in robot.joints if joint.torque_limit} if robot else {}
    return Frame(
        joint_map=None if rules is None else JointMap.from_dict(rules),
        foreign=frozenset(labels) - set(maps),
        scored=scored,
        torque_limits={**base.get("torque_limits", {}), **limits} or None,
        window_s=window_s,
        follows_motion=window_s is None and base.get("command_signal", "position") in ("position", "velocity"),
        robot=robot.name if robot else base.get("inputs", {}).get("robot", {}).get("name", ""),
    )


def comparison_of(episode: Episode, frame: Frame, *, align: bool) -> Comparison:
    """Everything on the measured stamps that have a command."""
    foreign = {label: series for label, series in episode.simulated.items() if label in frame.foreign}
    own = {label: series for label, series in episode.simulated.items() if label not in foreign}
    if frame.joint_map is not None:
        episode = frame.joint_map.of_episode(episode)
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
    if inside.sum() < _FEWEST_SAMPLES:
        raise DataError(
            f"episode {episode.id!r}: measurement, command and simulation have too little time in common",
            got=f"{int(inside.sum())} samples",
            expected=f"at least {_FEWEST_SAMPLES}",
        )
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
        simulated={label: _measured_bodies(simulated[label], measured) for label in episode.simulated},
        command=None if command is None else resample(command, clock, hold=True),
        starts=window_starts(clock, frame.window_s),
    )


def _measured_bodies(series: TimeSeries, measured: TimeSeries) -> TimeSeries:
    """The run with the bodies that were measured; a simulator may say what others do."""
    there = bool(measured.bodies) and set(measured.bodies) <= set(series.bodies)
    return series.select_bodies(measured.bodies) if there else series


def _at(series: TimeSeries, time_s: np.ndarray) -> TimeSeries:
    """The samples at stamps that the series has."""
    rows = np.clip(np.searchsorted(series.time_s, time_s - SAME_INSTANT_S), 0, len(series) - 1)
    if not np.allclose(series.time_s[rows], time_s, rtol=0.0, atol=SAME_INSTANT_S):
        raise DataError(
            "a run was made from other stamps than those measured now",
            hint="Replay it again: trueup replay DATASET --robot ROBOT --overwrite.",
        )
    return series.rows(rows)
