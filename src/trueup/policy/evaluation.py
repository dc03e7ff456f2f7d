"""What a policy does with many goals, on whatever arms: how near it comes, how it gets there, what it demands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float64

from trueup.core.results import Estimate, PairedDifference, Verdict
from trueup.errors import DataError
from trueup.measure import bootstrap_interval, paired_difference
from trueup.policy.reaching import Reaching

# From what is seen, (N, O), to torques, (N, J) [Nm].
Policy = Callable[[Float64[np.ndarray, "N O"]], Float[np.ndarray, "N J"]]
# Near enough to have reached the goal [m].
NEAR_M = 0.05
UNITS: Mapping[str, str] = {
    "success": "1",
    "distance": "m",
    "overshoot": "m",
    "smoothness": "1",
    "torque_at_limit": "1",
    "velocity_violation": "1",
    "reward": "1",
}
HIGHER_IS_BETTER = ("success", "reward")


@dataclass(frozen=True, eq=False)
class Episodes:
    """E episodes of T control steps.

    Attributes:
        goals: (E, 3) [m].
        distance_m: from the goal after each control step, (E, T) [m]; NaN from where an arm is lost.
        reward: of each control step, (E, T), likewise.
        values: metric -> of each episode, (E,): `success`, whether it ends within 5 cm of the goal; `distance` there
            [m]; `overshoot`, how far the end of the arm was beyond the goal, on the way from the start to it [m];
            `smoothness`, mean change of the torques from step to step, in shares of the largest; shares of the time in
            which a joint is given its largest torque, `torque_at_limit`, or is faster than it may be,
            `velocity_violation`; mean `reward` of a control step. A lost arm has not succeeded, and counts with where
            it was last seen.
        lost: whose engine or policy said what is no number, (E,).
    """

    goals: Float64[np.ndarray, "E 3"]
    distance_m: Float64[np.ndarray, "E T"]
    reward: Float64[np.ndarray, "E T"]
    values: Mapping[str, Float64[np.ndarray, "E"]]
    lost: Bool[np.ndarray, "E"]

    def estimates(self) -> dict[str, Estimate]:
        """Metric -> its mean over goals with a 95 % interval; of the distance, the median's is `distance_median`."""
        columns = np.stack([self.values[name] for name in UNITS], axis=1)
        means, ends = columns.mean(axis=0).tolist(), zip(*bootstrap_interval(columns), strict=True)
        found = {
            name: Estimate(mean, unit, *(None if np.isnan(end) else float(end) for end in own))
            for (name, unit), mean, own in zip(UNITS.items(), means, ends, strict=True)
        }
        return {**found, "distance_median": _median(self.values["distance"])}

    def against(self, other: Episodes, metric: str) -> PairedDifference:
        """This policy minus another, goal by goal.

        Raises:
            DataError: they had other goals.
        """
        if not np.array_equal(self.goals, other.goals):
            raise DataError("policies are compared on the same goals")
        found = paired_difference(
            self.values[metric],
            other.values[metric],
            run="this",
            baseline="other",
            split="goals",
            signal="reach",
            metric=metric,
            unit=UNITS[metric],
        )
        return replace(found, verdict=verdict_of(found.difference, metric))


def verdict_of(difference: Estimate, metric: str) -> Verdict:
    """`better` or `worse` where the interval of a difference excludes zero, whichever way is up for the metric."""
    if difference.low is None or difference.high is None or difference.low <= 0.0 <= difference.high:
        return "undecided"
    return "better" if (difference.low > 0.0) == (metric in HIGHER_IS_BETTER) else "worse"


def evaluate(
    policy: Policy,
    reaching: Reaching,
    goals: Float[np.ndarray, "E 3"],
    *,
    velocity_limit: Float[np.ndarray, "J"] | None = None,
    seed: int = 0,
    on_episodes: Callable[[int, int], None] = lambda *_: None,
) -> Episodes:
    """Let a policy reach for goals, as many at a time as there are arms.

    Args:
        policy: what is judged.
        reaching: arms; of hardware, one after the other.
        goals: [m].
        velocity_limit: of the joints [rad/s]; no violation is counted if None.
        seed: of what the arms draw, and of noise: the same for every policy, so that they meet the same robots.
        on_episodes: told after each batch how many are done, and of how many.

    Raises:
        ConfigError: a goal is out of reach.
        RobotStopped: hardware has stopped.
    """
    count, steps, joints = reaching.arms.count, reaching.config.steps, len(reaching.most)
    total = len(goals)
    away, worth = np.full((2, total, steps), np.nan)
    torque = np.full((total, steps, joints), np.nan)
    speed, beyond = np.full((total, steps, joints), np.nan), np.full((total, steps), np.nan)
    lost = np.zeros(total, bool)
    start = reaching.workspace.start
    start_m = np.linalg.norm(goals - start, axis=1)
    for first in range(0, total, count):
        own = np.arange(first, min(first + count, total))
        rows = np.arange(len(own))
        rng = np.random.default_rng([seed, first])
        seen = reaching.begin(np.arange(count), rng, goals=np.resize(goals[own], (count, 3)))
        way, length = goals[own] - start, start_m[own]
        there = np.ones(len(own), bool)
        for step in range(steps):
            action = np.asarray(policy(seen), np.float64)
            done = reaching.step(action, rng)
            seen = done.observation
            there &= ~done.lost[rows]
            here = own[there]
            away[here, step], worth[here, step] = done.distance_m[rows][there], done.reward[rows][there]
            torque[here, step] = np.clip(action[rows][there], -reaching.most, reaching.most)
            speed[here, step] = np.abs(reaching.arms.velocity[rows][there])
            place = reaching.workspace.chain.place(np.ascontiguousarray(reaching.arms.position[rows][there]))
            beyond[here, step] = ((place - start) * way[there]).sum(axis=1) / length[there] - length[there]
        lost[own] = ~there
        on_episodes(int(own[-1]) + 1, total)
    return Episodes(
        np.asarray(goals, np.float64),
        away,
        worth,
        _values(start_m, away, worth, torque / reaching.most, speed, beyond, lost, velocity_limit),
        lost,
    )


def _values(
    start_m: Float64[np.ndarray, "E"],
    away: Float64[np.ndarray, "E T"],
    worth: Float64[np.ndarray, "E T"],
    share: Float64[np.ndarray, "E T J"],
    speed: Float64[np.ndarray, "E T J"],
    beyond: Float64[np.ndarray, "E T"],
    lost: Bool[np.ndarray, "E"],
    limit: Float[np.ndarray, "J"] | None,
) -> dict[str, Float64[np.ndarray, "E"]]:
    """Metrics of episodes; an arm that is lost at once has stayed where it began."""
    seen = np.isfinite(away)
    last = seen.shape[1] - 1 - np.argmax(seen[:, ::-1], axis=1)
    distance = np.where(seen.any(axis=1), away[np.arange(len(away)), last], start_m)
    counted = np.maximum(seen.sum(axis=1), 1)
    steps = np.nan_to_num(np.abs(np.diff(share, axis=1)).mean(axis=2))
    fast = (np.nan_to_num(speed) > (np.inf if limit is None else limit)).any(axis=2)
    return {
        "success": ((distance <= NEAR_M) & ~lost).astype(np.float64),
        "distance": distance,
        "overshoot": np.maximum(np.nan_to_num(beyond, nan=0.0).max(axis=1), 0.0),
        "smoothness": steps.sum(axis=1) / np.maximum(counted - 1, 1),
        "torque_at_limit": (np.nan_to_num(np.abs(share)) > 1 - 1e-6).any(axis=2).sum(axis=1) / counted,
        "velocity_violation": fast.sum(axis=1) / counted,
        "reward": np.nan_to_num(worth).sum(axis=1) / counted,
    }


def _median(values: Float64[np.ndarray, "E"], draws: int = 2000) -> Estimate:
    """The median with a 95 % percentile interval over goals drawn again."""
    rng = np.random.default_rng([len(values), 0])
    found = np.median(values[rng.integers(len(values), size=(draws, len(values)))], axis=1)
    low, high = np.quantile(found, (0.025, 0.975))
    return Estimate(float(np.median(values)), UNITS["distance"], float(low), float(high))
