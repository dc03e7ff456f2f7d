"""How trainings went, as numbers: rounds over steps or minutes, groups of seeds on common ground, and their best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from trueup.core.trials import Trial, grouped

Over = Literal["steps", "minutes"]
Quantity = Literal["distance_m", "reward"]


@dataclass(frozen=True, eq=False)
class Curve:
    """A quantity over a training, of N points.

    Attributes:
        title: of the group.
        runs: how many trainings it is of.
        x: control steps, or minutes of processor time, (N,).
        mean: over the trainings, (N,).
        low: the least of them, (N,).
        high: the largest, (N,).
    """

    title: str
    runs: int
    x: Float64[np.ndarray, "N"]
    mean: Float64[np.ndarray, "N"]
    low: Float64[np.ndarray, "N"]
    high: Float64[np.ndarray, "N"]


@dataclass(frozen=True)
class Summary:
    """A group in one line.

    Attributes:
        title: of the group.
        runs: how many trainings there are.
        distance_m: median distance at the end of an episode in the best round, mean over trainings [m].
        distances_m: least and largest of them [m].
        reward: of a control step in the best round, mean over trainings.
        rewards: least and largest of them.
        minutes: of processor time, mean over trainings.
    """

    title: str
    runs: int
    distance_m: float
    distances_m: tuple[float, float]
    reward: float
    rewards: tuple[float, float]
    minutes: float


def curves_of(trials: Sequence[Trial], over: Over, quantity: Quantity, by: Sequence[str] = ()) -> list[Curve]:
    """One curve per group of trials; see `trials.grouped`.

    Raises:
        ConfigError: no configuration has a key of `by`.
    """
    return [
        band_of(group.title, [_points(trials[row], over, quantity) for row in group.members])
        for group in grouped(trials, by)
    ]


def band_of(title: str, runs: Sequence[Float64[np.ndarray, "2 _"]]) -> Curve:
    """Mean, least and largest of several curves, each at its own places, joined by straight lines.

    Args:
        title: of the curve.
        runs: x, which grows, and y of each; at least one.

    Returns:
        At all places of all curves that lie where all of them are. Where they have nothing in common, at the last place
        of the shortest.
    """
    first = max(run[0, 0] for run in runs)
    last = min(run[0, -1] for run in runs)
    x = np.unique(np.concatenate([run[0] for run in runs]))
    x = x[(x >= min(first, last)) & (x <= last)]
    rows = np.stack([np.interp(x, *run) for run in runs])
    return Curve(title, len(runs), x, rows.mean(axis=0), rows.min(axis=0), rows.max(axis=0))


def summaries(trials: Sequence[Trial], by: Sequence[str] = ()) -> list[Summary]:
    """One line per group of trials.

    Raises:
        ConfigError: no configuration has a key of `by`.
    """
    found = []
    for group in grouped(trials, by):
        own = [trials[row].history for row in group.members]
        near = [min(item["distance_m"] for item in history) for history in own]
        worth = [max(item["reward"] for item in history) for history in own]
        minutes = [history[-1]["cpu_seconds"] / 60.0 for history in own]
        found.append(
            Summary(
                group.title,
                len(own),
                float(np.mean(near)),
                (min(near), max(near)),
                float(np.mean(worth)),
                (min(worth), max(worth)),
                float(np.mean(minutes)),
            )
        )
    return found


def _points(trial: Trial, over: Over, quantity: Quantity) -> Float64[np.ndarray, "2 R"]:
    x = [item["steps"] if over == "steps" else item["cpu_seconds"] / 60.0 for item in trial.history]
    return np.array([x, [item[quantity] for item in trial.history]], np.float64)
