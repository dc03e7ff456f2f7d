"""The gap between a robot and simulations of it: episodes in, `GapResult` out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from trueup.core.episode import EpisodeMeta
from trueup.core.results import GapResult, MetricResult, PairedDifference
from trueup.measure.columns import mean
from trueup.measure.comparison import COMMAND_RUN, Comparison
from trueup.measure.metrics.base import MAX_LAG_S, MetricOptions
from trueup.measure.reduction import REST, Column, Reduction, Table
from trueup.measure.uncertainty import LEVEL, bootstrap_interval, estimate, motion_numbers, paired_difference

ALL = "all"
EPISODE_METRICS = ("rmse", "max", "phase_lag", "position_norm", "rotation_distance")
_COMPARED = ("rmse", "position_norm", "position_norm_max", "rotation_distance", "rotation_distance_max")
_SPLIT_ORDER = ("train", "val", "test")
_INTERVAL = "expanded percentile bootstrap over {0}, at least Student's t below ten {0}"


def measure_gap(
    comparisons: Iterable[Comparison],
    *,
    runs: Sequence[str] | None = None,
    scored_joints: Sequence[str] | None = None,
    signals: Sequence[str] | None = None,
    metrics: Sequence[str] | None = None,
    torque_limits: Mapping[str, float] | None = None,
    tau_rad: float = 0.5,
    max_lag_s: float = MAX_LAG_S,
    window_s: float | None = None,
    episode_metrics: Sequence[str] = EPISODE_METRICS,
    draws: int = 2000,
    seed: int = 0,
    provenance: Mapping[str, Any] | None = None,
) -> GapResult:
    """Measure every run against the robot, with 95 % intervals over motions.

    Each episode is reduced to its metrics as it comes and then forgotten. A metric's `value` is the mean over
    episodes of the mean over scored joints; joints or episodes for which it is not defined are left out of the
    means. That is so for metrics that relate the error to the motion (NRMSE, correlations, R2, phase lag) where a
    joint moves by less than 0.01 rad or 1 mm in an episode. Runs are compared pairwise on the episodes that both
    have: each one with the first, and with the command.

    Args:
        comparisons: one item per episode, e.g. a generator.
        runs: labels, in order, the first is the baseline of the paired comparisons (and `RUN` that of `RUN+NETWORK`);
            `command` takes the command
            as the motion. None for all that occur.
        scored_joints: joints that enter `value`; None for all.
        signals: None for what measured and run both have.
        metrics: names from `METRICS`; None for each signal's default set.
        torque_limits: joint -> limit [Nm or N]; without them there is no saturation incidence.
        tau_rad: threshold of the large-gap ratio [rad].
        max_lag_s: search limit of the phase lag [s].
        window_s: length of the windows that the simulations were restarted in; only recorded here.
        episode_metrics: the metrics that are kept episode by episode; more of them make gap.json long.
        draws: bootstrap resamples; fewer make the ends of the intervals noisy.
        seed: seed of all draws.
        provenance: versions, hashes and configuration, stored as they are.

    Raises:
        DataError: no episodes, or one twice.
        MissingSignal: a run, signal or metric that was asked for is not there.
        NameMismatch: joints differ between episodes, or names in an argument are no joints of the robot.
        UnitError: units differ between episodes, or among the scored joints.
        ConfigError: saturation was asked for without torque limits.
    """
    reduction = Reduction(
        runs=runs,
        signals=signals,
        metrics=metrics,
        scored_joints=scored_joints,
        torque_limits=torque_limits,
        options=MetricOptions(tau_rad=tau_rad, max_lag_s=max_lag_s, seed=seed),
    )
    for comparison in comparisons:
        reduction.add(comparison)
    tables = reduction.tables()
    metas = reduction.metas
    splits, motions = _splits(metas), executed_of(metas)
    repeated = len(set(motions.tolist())) < len(metas)
    return GapResult(
        runs={
            table.label: {
                split: _summarize(table, rows, motions, draws, seed)
                for split, rows in splits.items()
                if (rows & table.covered).any()
            }
            for table in tables
        },
        joints=reduction.joints,
        scored_joints=reduction.scored_joints,
        paired=tuple(_compare(tables, splits, motions, draws, seed)),
        groups={
            name: {
                value: {
                    table.label: _summarize(table, rows, motions, draws, seed)
                    for table in tables
                    if (rows & table.covered).any()
                }
                for value, rows in values.items()
            }
            for name, values in _groups(metas).items()
        },
        episodes={table.label: _by_episode(table, metas, episode_metrics) for table in tables},
        splits={meta.id: meta.split for meta in metas},
        settings={
            "runs": [table.label for table in tables],
            "window_s": window_s,
            "tau_rad": tau_rad,
            "max_lag_s": max_lag_s,
            "rest": dict(REST),
            "torque_limits": None if torque_limits is None else dict(torque_limits),
            "bootstrap_draws": draws,
            "level": LEVEL,
            "interval": _INTERVAL.format("motions" if repeated else "episodes"),
            "seed": seed,
            "missing_episodes": {
                table.label: [meta.id for meta, there in zip(metas, table.covered, strict=True) if not there]
                for table in tables
                if not table.covered.all()
            },
        },
        provenance=provenance or {},
    )


def _splits(metas: Sequence[EpisodeMeta]) -> dict[str, Bool[np.ndarray, "E"]]:
    present = {meta.split for meta in metas} - {""}
    names = [name for name in _SPLIT_ORDER if name in present] + sorted(present.difference(_SPLIT_ORDER, {ALL}))
    rows = {name: np.array([meta.split == name for meta in metas]) for name in names}
    return {**rows, ALL: np.ones(len(metas), dtype=bool)}


def _groups(metas: Sequence[EpisodeMeta]) -> dict[str, dict[str, Bool[np.ndarray, "E"]]]:
    """Field -> value -> rows, for the fields of which more than one value was recorded."""
    groups = {}
    for name in ("payload_kg", "kp_setting", "unit", "condition"):
        values = [getattr(meta, name) for meta in metas]
        recorded = sorted({value for value in values if value not in (None, "")})
        if len(recorded) > 1:
            groups[name] = {
                f"{value:.12g}" if isinstance(value, float) else str(value): np.array(
                    [item == value for item in values]
                )
                for value in recorded
            }
    return groups


def executed_of(metas: Sequence[EpisodeMeta]) -> Int[np.ndarray, "E"]:
    """`motion_numbers` of episodes."""
    return motion_numbers(meta.executed for meta in metas)


def _summarize(
    table: Table, rows: Bool[np.ndarray, "E"], motions: Int[np.ndarray, "E"], draws: int, seed: int
) -> dict[str, dict[str, MetricResult]]:
    """Signal -> metric -> result over the episodes of this subset that the run has."""
    chosen = rows & table.covered
    stacked = np.concatenate(
        [np.column_stack([column.per_joint[chosen], column.total[chosen]]) for column in table.columns], axis=1
    )
    means = mean(stacked)
    lows, highs = bootstrap_interval(stacked, motions=motions[chosen], draws=draws, seed=seed)
    result: dict[str, dict[str, MetricResult]] = {}
    at = 0
    for column in table.columns:
        units = (*column.units, column.total_unit)
        estimates = [
            estimate(float(means[at + k]), unit, float(lows[at + k]), float(highs[at + k]), column.metric.bounds)
            for k, unit in enumerate(units)
        ]
        at += len(units)
        result.setdefault(column.signal, {})[column.metric.name] = MetricResult(
            total=estimates[-1],
            per_joint=dict(zip(column.names, estimates[:-1], strict=True)),
            episodes=int(np.isfinite(column.total[chosen]).sum()),
        )
    return result


def _compare(
    tables: Sequence[Table],
    splits: Mapping[str, Bool[np.ndarray, "E"]],
    motions: Int[np.ndarray, "E"],
    draws: int,
    seed: int,
) -> Iterable[PairedDifference]:
    """Every run with the first run, with the command, and with the run that it corrects, each pair once."""
    command = [table for table in tables if table.label == COMMAND_RUN]
    others = [table for table in tables if table.label != COMMAND_RUN]
    pairs = [(table, base) for table in others for base in command]
    pairs += [(table, others[0]) for table in others[1:]]
    by_label = {table.label: table for table in others[1:]}
    # The label of a corrected run is that of the other one with a plus and a name.
    corrected = {table.label: table.label.rpartition("+")[0] for table in others}
    pairs += [(table, by_label[base]) for table in others if (base := corrected[table.label]) in by_label]
    for run, baseline in pairs:
        both = run.covered & baseline.covered
        for split, rows in splits.items():
            chosen = rows & both
            if not chosen.any():
                continue
            for column, other in _compared_columns(run, baseline):
                yield paired_difference(
                    column.total[chosen],
                    other.total[chosen],
                    run=run.label,
                    baseline=baseline.label,
                    split=split,
                    signal=column.signal,
                    metric=column.metric.name,
                    unit=column.total_unit,
                    motions=motions[chosen],
                    draws=draws,
                    seed=seed,
                )


def _compared_columns(run: Table, baseline: Table) -> Iterable[tuple[Column, Column]]:
    known = {(column.signal, column.metric.name): column for column in baseline.columns}
    for column in run.columns:
        other = known.get((column.signal, column.metric.name))
        if other is not None and column.metric.name in _COMPARED:
            yield column, other


def _by_episode(
    table: Table, metas: Sequence[EpisodeMeta], names: Sequence[str]
) -> dict[str, dict[str, dict[str, dict[str, float]]]]:
    """Episode -> signal -> metric -> joint -> value."""
    episodes: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    kept = [column for column in table.columns if column.metric.name in names]
    for row in np.flatnonzero(table.covered).tolist():
        signals: dict[str, dict[str, dict[str, float]]] = {}
        for column in kept:
            values = dict(zip(column.names, column.per_joint[row].tolist(), strict=True))
            signals.setdefault(column.signal, {})[column.metric.name] = values
        episodes[metas[row].id] = signals
    return episodes
