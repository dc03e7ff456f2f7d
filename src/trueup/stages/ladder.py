"""The ladder: one rung per way of predicting the robot, the best on val marked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from trueup.core.results import Ladder, Metrics, Rung
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
    runs = measurement.gap.runs
    # The command is there as it is: nothing is computed.
    made = [Rung("command", 0.0, runs[COMMAND_RUN])] if COMMAND_RUN in runs else []
    made += [Rung(name, seconds, runs[label]) for name, (label, seconds) in rungs.items()]
    return Ladder(choose(made), provenance=measurement.gap.provenance)


def choose(rungs: Sequence[Rung]) -> list[Rung]:
    """The same rungs with the best on val marked; none is where val has no number."""
    scores = [_score(rung.splits.get("val", {})) for rung in rungs]
    known = [score for score in scores if score is not None]
    best = scores.index(min(known)) if known else None
    return [replace(rung, chosen=index == best) for index, rung in enumerate(rungs)]


def _score(metrics: Metrics) -> float | None:
    signal, metric = CHOICE
    result = metrics.get(signal, {}).get(metric)
    return None if result is None or math.isnan(result.total.value) else result.total.value
