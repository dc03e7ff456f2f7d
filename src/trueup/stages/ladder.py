"""The ladder: one rung per way of predicting the robot, the best on val marked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import fmean

from trueup.core.results import GapResult, Ladder, Rung
from trueup.measure import COMMAND_RUN
from trueup.stages.measuring import Measurement

# The signal and metric by which the best rung is chosen on val.
CHOICE = ("position", "rmse")


def ladder_of(measurement: Measurement, rungs: Mapping[str, tuple[str, float]]) -> Ladder:
    """The ladder of a measurement.

    Args:
        measurement: with all the runs in it.
        rungs: rung name -> run label and the seconds that it took, from the bottom up. The command taken as the
            motion comes first where it was measured.
    """
    gap = measurement.gap
    # The command is there as it is: nothing is computed.
    first = {"command": (COMMAND_RUN, 0.0)} if COMMAND_RUN in gap.runs else {}
    made = {**first, **rungs}
    scores = val_scores(gap, [label for label, _ in made.values()])
    ladder = [Rung(name, seconds, gap.runs[label]) for name, (label, seconds) in made.items()]
    return Ladder(choose(ladder, scores), provenance=gap.provenance)


def choose(rungs: Sequence[Rung], scores: Sequence[float | None]) -> list[Rung]:
    """The same rungs with that of the lowest score marked; none where there is no score."""
    known = [score for score in scores if score is not None]
    best = scores.index(min(known)) if known else None
    return [replace(rung, chosen=index == best) for index, rung in enumerate(rungs)]


def val_scores(gap: GapResult, labels: Sequence[str]) -> list[float | None]:
    """The error of each run on those val motions that all of them have; None for a run without any.

    A run that lacks a motion may have failed on it, which must not make it the better one.
    """
    errors = [_val_errors(gap, label) for label in labels]
    there = [set(own) for own in errors if own]
    common = sorted(set.intersection(*there)) if there else []
    return [fmean(own[name] for name in common) if own and common else None for own in errors]


def _val_errors(gap: GapResult, label: str) -> dict[str, float]:
    """Val motion -> mean over the scored joints."""
    signal, metric = CHOICE
    found = {}
    for name, signals in gap.episodes.get(label, {}).items():
        joints = signals.get(signal, {}).get(metric, {})
        values = [joints[joint] for joint in gap.scored_joints if not math.isnan(joints.get(joint, math.nan))]
        if values and gap.splits.get(name) == "val":
            found[name] = fmean(values)
    return found
