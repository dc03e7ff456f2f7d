"""Episodes in, one table of numbers per run out: memory holds numbers, never series."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float64

from trueup.core.episode import EpisodeMeta
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, UnitError
from trueup.measure.columns import mean, spread
from trueup.measure.comparison import COMMAND_RUN, Comparison
from trueup.measure.metrics import METRICS, metric
from trueup.measure.metrics.base import Metric, MetricOptions, Samples, metric_unit

# A joint whose measured position spans less than this in an episode rests: relating its error to its motion would
# divide by the noise of the encoder.
REST = MappingProxyType({"rad": 0.01, "m": 0.001})
_MOTION_SIGNALS = ("position", "velocity", "acceleration")


@dataclass(frozen=True, eq=False)
class Column:
    """One metric of one signal of one run, for all episodes.

    Attributes:
        signal: signal name.
        metric: the metric.
        names: joints, or bodies of a body signal.
        units: unit of the metric for each name.
        per_joint: shape (E, J); NaN where the run lacks the episode or the metric is not defined.
        total: mean over the scored names for which it is defined, shape (E,).
        total_unit: unit of the total.
    """

    signal: str
    metric: Metric
    names: tuple[str, ...]
    units: tuple[str, ...]
    per_joint: Float64[np.ndarray, "E J"]
    total: Float64[np.ndarray, "E"]
    total_unit: str


@dataclass(frozen=True, eq=False)
class Table:
    """All numbers of one run.

    Attributes:
        label: run label.
        covered: which episodes the run has, shape (E,).
        columns: its metrics, signal by signal.
    """

    label: str
    covered: Bool[np.ndarray, "E"]
    columns: tuple[Column, ...]


class Reduction:
    """Takes comparisons one by one, keeps their metrics and forgets their samples.

    Args:
        runs: labels to measure, in order; None for all that occur, in order of appearance.
        signals: signals to measure; None for those that measured and run both have.
        metrics: metric names; None for each signal's default set.
        scored_joints: joints that enter the total; None for all.
        torque_limits: joint -> limit [Nm or N].
        options: what can be chosen about the metrics.

    Raises:
        MissingSignal: a metric is unknown.
        ConfigError: saturation was asked for without torque limits, or a limit is not positive.
    """

    def __init__(
        self,
        *,
        runs: Sequence[str] | None,
        signals: Sequence[str] | None,
        metrics: Sequence[str] | None,
        scored_joints: Sequence[str] | None,
        torque_limits: Mapping[str, float] | None,
        options: MetricOptions,
    ) -> None:
        self.metas: list[EpisodeMeta] = []
        self.joints: tuple[str, ...] = ()
        self._scored = None if scored_joints is None else tuple(scored_joints)
        self._runs = None if runs is None else tuple(runs)
        self._signals = None if signals is None else tuple(signals)
        self._metrics = None if metrics is None else tuple(metric(name) for name in metrics)
        self._limits = torque_limits
        self._options = options
        self._names: dict[str, tuple[str, ...]] = {}
        self._units: dict[str, tuple[str, ...]] = {}
        self._values: dict[str, dict[str, dict[int, Float64[np.ndarray, "M J"]]]] = {}
        self._ids: set[str] = set()
        limited = [item.name for item in self._metrics or () if item.needs_limit]
        if limited and not torque_limits:
            raise ConfigError(f"{', '.join(limited)} needs torque limits", hint="give torque_limits, or leave it out")
        if any(not limit > 0.0 for limit in (torque_limits or {}).values()):
            raise ConfigError("torque limits must be positive", got=dict(torque_limits or {}))

    @property
    def scored_joints(self) -> tuple[str, ...]:
        """The joints that enter the total."""
        return self.joints if self._scored is None else self._scored

    def add(self, comparison: Comparison) -> None:
        """Reduce one episode.

        Raises:
            DataError: the episode was added before.
            NameMismatch: its joints or bodies are not those of the episodes before.
            MissingSignal: a requested signal is not there.
            UnitError: a signal has another unit than in the episodes before.
        """
        if comparison.meta.id in self._ids:
            raise DataError(f"episode {comparison.meta.id!r} occurs twice")
        if not self.metas:
            self._set_joints(comparison)
        elif set(comparison.measured.joints) != set(self.joints):
            raise NameMismatch(
                f"episode {comparison.meta.id!r} has other joints than the episodes before it",
                left=comparison.measured.joints,
                right=self.joints,
            )
        self._ids.add(comparison.meta.id)
        self.metas.append(comparison.meta)
        for label in comparison.labels:
            if self._runs is None or label in self._runs:
                of_run = self._values.setdefault(label, {})
                for signal in self._chosen_signals(comparison, label):
                    values = self._reduce(comparison, label, signal)
                    if values is not None:
                        of_run.setdefault(signal, {})[len(self.metas) - 1] = values

    def tables(self) -> list[Table]:
        """One table per run, in the order of `runs`, or of appearance with `command` last.

        Raises:
            DataError: there was no episode at all.
            MissingSignal: a run has no episode, or no signal in common with what was measured.
        """
        if not self.metas:
            raise DataError("there are no episodes to compare")
        order = sorted(self._values, key=lambda label: label == COMMAND_RUN) if self._runs is None else self._runs
        if not order:
            raise MissingSignal("no episode has a run or a commanded motion to compare", available=[])
        for label in order:
            if label not in self._values:
                raise MissingSignal(f"no episode has the run {label!r}", available=self._values)
            if not self._values[label]:
                raise MissingSignal(f"run {label!r} has no signal in common with what was measured")
        return [self._table(label) for label in order]

    def _set_joints(self, comparison: Comparison) -> None:
        self.joints = comparison.measured.joints
        for what, names in (("scored joints", self._scored or ()), ("torque limits", self._limits or {})):
            if not set(names) <= set(self.joints):
                raise NameMismatch(f"the {what} name joints that were not measured", left=names, right=self.joints)

    def _chosen_signals(self, comparison: Comparison, label: str) -> tuple[str, ...]:
        common = comparison.common_signals(label)
        if self._signals is None:
            return common
        if label != COMMAND_RUN:
            for signal in self._signals:
                if signal not in common:
                    side = label if signal in comparison.measured else "measured"
                    raise MissingSignal(
                        f"episode {comparison.meta.id!r} has no signal {signal!r} in {side}", available=common
                    )
        return tuple(signal for signal in self._signals if signal in common)

    def _chosen_metrics(self, signal: str) -> tuple[Metric, ...]:
        if self._metrics is not None:
            return tuple(item for item in self._metrics if item.applies(signal))
        chosen = (item for item in METRICS.values() if item.is_default(signal))
        return tuple(item for item in chosen if self._limits or not item.needs_limit)

    def _reduce(self, comparison: Comparison, label: str, signal: str) -> Float64[np.ndarray, "M J"] | None:
        chosen = self._chosen_metrics(signal)
        if not chosen:
            return None
        names, units = comparison.columns(signal), comparison.measured.units[signal]
        order = self._agree(comparison, signal, names, units)
        limits = self._limits or {}
        samples = Samples(
            # Column by column in memory: every metric reduces over time, several times faster this way.
            measured=np.asarray(comparison.measured[signal], dtype=np.float64, order="F"),
            simulated=np.asarray(comparison.run(label)[signal], dtype=np.float64, order="F"),
            time_s=comparison.measured.time_s,
            starts=comparison.starts,
            limit=np.array([limits.get(name, math.nan) for name in names]) if limits else None,
            options=self._options,
        )
        values = np.stack([item.function(samples) for item in chosen])
        angles = np.array([unit == "rad" for unit in units])
        rests = _rests(comparison) if signal in _MOTION_SIGNALS else np.zeros(len(names), dtype=bool)
        for row, item in enumerate(chosen):
            if item.angles_only:
                values[row, ~angles] = np.nan
            if item.needs_motion:
                values[row, rests] = np.nan
        return values[:, order]

    def _agree(self, comparison: Comparison, signal: str, names: tuple[str, ...], units: tuple[str, ...]) -> list[int]:
        """The order that puts the columns of this episode into the order of the first one."""
        known = self.joints if not signal.startswith("body.") else self._names.get(signal, names)
        if set(names) != set(known):
            raise NameMismatch(
                f"episode {comparison.meta.id!r}: {signal} is of other bodies than before", left=names, right=known
            )
        order = [names.index(name) for name in known]
        ordered = tuple(units[index] for index in order)
        self._names[signal] = known
        if self._units.setdefault(signal, ordered) != ordered:
            raise UnitError(
                f"episode {comparison.meta.id!r}: {signal} has another unit than in the episodes before",
                got=ordered,
                expected=self._units[signal],
            )
        return order

    def _table(self, label: str) -> Table:
        episodes = len(self.metas)
        covered = np.zeros(episodes, dtype=bool)
        columns: list[Column] = []
        for signal, rows in self._values[label].items():
            covered[list(rows)] = True
            names = self._names[signal]
            chosen = self._chosen_metrics(signal)
            values = np.full((episodes, len(chosen), len(names)), np.nan)
            values[list(rows)] = np.stack(list(rows.values()))
            scored = [
                index for index, name in enumerate(names) if signal.startswith("body.") or name in self.scored_joints
            ]
            for position, item in enumerate(chosen):
                units = tuple(metric_unit(item.unit, unit) for unit in self._units[signal])
                per_joint = values[:, position]
                columns.append(
                    Column(
                        signal=signal,
                        metric=item,
                        names=names,
                        units=units,
                        per_joint=per_joint,
                        total=mean(per_joint[:, scored].T),
                        total_unit=_one_unit(signal, {units[index] for index in scored}),
                    )
                )
        return Table(label, covered, tuple(columns))


def _rests(comparison: Comparison) -> Bool[np.ndarray, "J"]:
    measured = comparison.measured
    if "position" not in measured:
        return np.zeros(len(measured.joints), dtype=bool)
    least = np.array([REST.get(unit, 0.0) for unit in measured.units["position"]])
    position = measured["position"].astype(np.float64)
    return np.asarray(spread(np.where(np.isfinite(position), position, np.nan)) < least)


def _one_unit(signal: str, units: set[str]) -> str:
    if len(units) > 1:
        raise UnitError(
            f"the scored joints have different units for {signal}, which have no mean",
            got=", ".join(sorted(units)),
            hint="score joints of one unit; the others are still reported joint by joint",
        )
    return next(iter(units), "1")
