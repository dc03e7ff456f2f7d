"""The gap motion by motion, worst first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trueup.core.results import GapResult
from trueup.report.folder import RunFolder
from trueup.report.labels import MAIN_METRIC, SIGNALS, ordered, run_title, split_title
from trueup.report.numbers import in_degrees, pretty_unit, significant
from trueup.report.sections.base import Section
from trueup.report.verdict import find_headline

MAX_ROWS = 500


@dataclass(frozen=True)
class EpisodeRow:
    """One motion.

    Attributes:
        episode: its id.
        split: its split.
        errors: RMSE per run, mean of the scored joints; NaN where it was not computed.
        texts: the same as printed.
        worst_joint: the scored joint with the largest error under the judged run, or empty.
        flags: number of quality flags.
    """

    episode: str
    split: str
    errors: Sequence[float]
    texts: Sequence[str]
    worst_joint: str
    flags: int


def episodes_section(run: RunFolder) -> Section | None:
    """Only where errors per motion were stored."""
    headline = find_headline(run.gap, run.ladder)
    signals = ordered({s for items in run.gap.episodes.values() for item in items.values() for s in item}, SIGNALS)
    if not signals:
        return None
    signal = headline.signal if headline and headline.signal in signals else signals[0]
    runs = [label for label in run.runs if label in run.gap.episodes]
    judged = headline.run if headline and headline.run in runs else runs[-1]
    rows = episode_rows(run, runs, judged, signal)
    unit = headline.result.total.unit if headline else ""
    context = {
        "rows": rows[:MAX_ROWS],
        "total": len(rows),
        "runs": [run_title(label) for label in runs],
        "judged": runs.index(judged),
        "signal": signal,
        "unit": pretty_unit(unit),
        "degrees": [in_degrees(row.errors[runs.index(judged)], unit) for row in rows[:MAX_ROWS]],
        "flagged": run.quality is not None,
        "traced": set(run.traces.episodes) if run.traces else set(),
    }
    return Section("episodes", "Motion by motion", context) if rows else None


def episode_rows(run: RunFolder, runs: Sequence[str], judged: str, signal: str) -> list[EpisodeRow]:
    """All motions, the largest error of the judged run first."""
    ids = {episode for label in runs for episode in run.gap.episodes[label]}
    rows = []
    for episode in sorted(ids):
        per_run = [joint_errors(run.gap, label, episode, signal) for label in runs]
        errors = [scored_mean(values, run.gap.scored_joints) for values in per_run]
        values = finite(per_run[list(runs).index(judged)], run.gap.scored_joints)
        checked = run.quality.episodes.get(episode) if run.quality else None
        rows.append(
            EpisodeRow(
                episode=episode,
                split=split_title(run.gap.splits.get(episode, "")),
                errors=errors,
                texts=[significant(error) for error in errors],
                worst_joint=max(values, key=lambda joint: values[joint]) if values else "",
                flags=len(checked.flags) if checked else 0,
            )
        )
    position = list(runs).index(judged)
    return sorted(rows, key=lambda row: -row.errors[position] if math.isfinite(row.errors[position]) else math.inf)


def joint_errors(gap: GapResult, label: str, episode: str, signal: str) -> Mapping[str, float]:
    """RMSE per joint of one motion; empty where it was not computed."""
    return gap.episodes.get(label, {}).get(episode, {}).get(signal, {}).get(MAIN_METRIC, {})


def scored_mean(values: Mapping[str, float], scored: Sequence[str]) -> float:
    """Mean over the scored joints; NaN where there is none."""
    found = finite(values, scored)
    return sum(found.values()) / len(found) if found else math.nan


def finite(values: Mapping[str, float], joints: Sequence[str]) -> dict[str, float]:
    """The values of these joints that are numbers, in the order of the joints."""
    return {joint: values[joint] for joint in joints if joint in values and math.isfinite(values[joint])}
