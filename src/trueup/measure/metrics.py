"""The registry of metrics: what each is called, computes, is measured in, and where it comes from."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.errors import MissingSignal
from trueup.measure.columns import largest, mean
from trueup.measure.lag import MAX_LAG_S, phase_lag
from trueup.measure.metrics_body import position_distance, rotation_distance
from trueup.measure.metrics_distribution import gap_iqr, gap_range, large_gap_ratio, saturation_incidence
from trueup.measure.metrics_error import mae, mape, max_error, mse, nrmse, rmse
from trueup.measure.metrics_shape import ROBUSTNESS_SIGMAS, robustness, smoothness, trajectory_consistency
from trueup.measure.metrics_similarity import ccc, cosine, pearson, r2

Kind = Literal["joint", "body.position", "body.rotation"]
UnitRule = Literal["signal", "signal^2", "signal/s^2", "1", "%", "s", "rad"]


@dataclass(frozen=True)
class MetricOptions:
    """What can be chosen about the metrics.

    Attributes:
        tau_rad: threshold of the large-gap ratio [rad].
        mape_floor: share of the largest |measured| below which a sample does not enter MAPE.
        max_lag_s: search limit of the phase lag [s].
        sigmas: noise levels of robustness, in the unit of the signal.
        seed: seed of that noise.
    """

    tau_rad: float = 0.5
    mape_floor: float = 0.05
    max_lag_s: float = MAX_LAG_S
    sigmas: tuple[float, ...] = ROBUSTNESS_SIGMAS
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Samples:
    """One signal of one episode, measured and simulated on one clock.

    Attributes:
        measured: shape (T, J), or (T, B, 3) and (T, B, 3, 3) for bodies.
        simulated: the same shape.
        time_s: clock, shape (T,) [s].
        starts: first row of each segment, the first is 0.
        limit: torque limits, shape (J,), NaN for a joint without one; None when there are none at all.
        options: what was chosen.
    """

    measured: Float[np.ndarray, "T ..."]
    simulated: Float[np.ndarray, "T ..."]
    time_s: Float64[np.ndarray, "T"]
    starts: Int[np.ndarray, "S"]
    limit: Float64[np.ndarray, "J"] | None = None
    options: MetricOptions = field(default_factory=MetricOptions)


@dataclass(frozen=True)
class Metric:
    """A metric by name.

    Attributes:
        name: as in gap.json and on the command line.
        function: one value per joint (or body) of the samples.
        unit: the rule that turns the unit of the signal into the unit of the metric.
        lower_is_better: True or False; None for a signed metric, of which nearer to zero is better.
        description: one line for people.
        source: paper and equation, or the usual definition.
        kind: what it applies to: joint signals, body positions or body orientations.
        signals: the signals for which it is computed by default; empty for every signal of its kind.
        bounds: the values that it can take; intervals are cut to them.
        needs_limit: whether it needs torque limits.
        needs_motion: whether it relates the error to the measured motion, and says nothing of a joint that rests.
    """

    name: str
    function: Callable[[Samples], Float64[np.ndarray, "J"]]
    unit: UnitRule
    lower_is_better: bool | None
    description: str
    source: str
    kind: Kind = "joint"
    signals: tuple[str, ...] = ()
    bounds: tuple[float, float] = (0.0, math.inf)
    needs_limit: bool = False
    needs_motion: bool = False

    def is_default(self, signal: str) -> bool:
        """Whether the metric belongs to the default set of this signal."""
        return self.applies(signal) and (not self.signals or signal in self.signals)

    def applies(self, signal: str) -> bool:
        """Whether the metric can be computed for this signal."""
        if self.needs_limit and signal not in self.signals:
            return False
        return signal == self.kind if signal.startswith("body.") else self.kind == "joint"


_LOWER, _HIGHER, _SIGNED = True, False, None
_ANY = (-math.inf, math.inf)
_SHARE = (0.0, 1.0)
_CORRELATION = (-1.0, 1.0)


def _plain(
    function: Callable[[Float[np.ndarray, "T J"], Float[np.ndarray, "T J"]], Float64[np.ndarray, "J"]],
) -> Callable[[Samples], Float64[np.ndarray, "J"]]:
    return lambda s: function(s.measured, s.simulated)


def _saturation(torque: Float[np.ndarray, "T J"], limit: Float64[np.ndarray, "J"] | None) -> Float64[np.ndarray, "J"]:
    return saturation_incidence(torque, np.full(torque.shape[1], np.nan) if limit is None else limit)


_ALL = (
    Metric("rmse", _plain(rmse), "signal", _LOWER, "root mean squared error", "LSTM thesis, eq. 18"),
    Metric("mse", _plain(mse), "signal^2", _LOWER, "mean squared error", "LSTM thesis, eq. 18"),
    Metric(
        "nrmse", _plain(nrmse), "1", _LOWER, "RMSE over the measured range", "GapONet, section 3.2", needs_motion=True
    ),
    Metric("mae", _plain(mae), "signal", _LOWER, "mean absolute error", "usual"),
    Metric("max", _plain(max_error), "signal", _LOWER, "largest absolute error", "usual"),
    Metric(
        "mape",
        lambda s: mape(s.measured, s.simulated, floor=s.options.mape_floor),
        "%",
        _LOWER,
        "mean absolute percentage error, without samples near zero",
        "usual",
    ),
    Metric("pearson", _plain(pearson), "1", _HIGHER, "correlation", "usual", bounds=_CORRELATION, needs_motion=True),
    Metric("cosine", _plain(cosine), "1", _HIGHER, "cosine similarity", "usual", bounds=_CORRELATION),
    Metric(
        "ccc",
        _plain(ccc),
        "1",
        _HIGHER,
        "Lin's concordance correlation",
        "Lin 1989",
        bounds=_CORRELATION,
        needs_motion=True,
    ),
    Metric(
        "r2",
        _plain(r2),
        "1",
        _HIGHER,
        "coefficient of determination",
        "usual",
        bounds=(-math.inf, 1.0),
        needs_motion=True,
    ),
    Metric(
        "large_gap_ratio",
        lambda s: large_gap_ratio(s.measured, s.simulated, tau=s.options.tau_rad),
        "1",
        _LOWER,
        "share of samples with an error of at least tau",
        "GapONet, eq. 12",
        signals=("position",),
        bounds=_SHARE,
    ),
    Metric("iqr", _plain(gap_iqr), "signal", _LOWER, "interquartile range of the absolute error", "GapONet, eq. 13"),
    Metric("range", _plain(gap_range), "signal", _LOWER, "range of the absolute error", "GapONet, eq. 14"),
    Metric(
        "trajectory_consistency",
        lambda s: trajectory_consistency(s.measured, s.simulated, s.time_s, starts=s.starts),
        "signal/s^2",
        _LOWER,
        "mean difference of the gradient's gradient",
        "GapONet, eq. 15, 16",
        signals=("position",),
    ),
    Metric(
        "smoothness",
        lambda s: smoothness(s.measured, s.simulated, s.time_s, starts=s.starts),
        "signal/s^2",
        _LOWER,
        "mean difference of second differences",
        "GapONet, eq. 17",
        signals=("position",),
    ),
    Metric(
        "robustness",
        lambda s: robustness(s.measured, s.simulated, sigmas=s.options.sigmas, seed=s.options.seed),
        "signal",
        _LOWER,
        "change of the gap under measurement noise (as written, the data cancel)",
        "GapONet, eq. 18, 19",
        signals=("position",),
    ),
    Metric(
        "phase_lag",
        lambda s: phase_lag(s.measured, s.simulated, s.time_s, starts=s.starts, max_lag_s=s.options.max_lag_s),
        "s",
        _SIGNED,
        "lag of the measured motion behind the simulated one (or behind the command)",
        "GapONet, section 3.2",
        signals=("position",),
        bounds=_ANY,
        needs_motion=True,
    ),
    Metric(
        "saturation_measured",
        lambda s: _saturation(s.measured, s.limit),
        "1",
        _LOWER,
        "share of measured samples at or above the torque limit",
        "GapONet, section 3.2",
        signals=("torque",),
        bounds=_SHARE,
        needs_limit=True,
    ),
    Metric(
        "saturation_simulated",
        lambda s: _saturation(s.simulated, s.limit),
        "1",
        _LOWER,
        "share of simulated samples at or above the torque limit",
        "GapONet, section 3.2",
        signals=("torque",),
        bounds=_SHARE,
        needs_limit=True,
    ),
    Metric(
        "position_norm",
        lambda s: mean(position_distance(s.measured, s.simulated)),
        "signal",
        _LOWER,
        "mean Euclidean distance of body positions",
        "SAT, section VI",
        kind="body.position",
    ),
    Metric(
        "position_norm_max",
        lambda s: largest(position_distance(s.measured, s.simulated)),
        "signal",
        _LOWER,
        "largest Euclidean distance of body positions",
        "SAT, section VI",
        kind="body.position",
    ),
    Metric(
        "rotation_distance",
        lambda s: mean(rotation_distance(s.measured, s.simulated)),
        "rad",
        _LOWER,
        "mean geodesic distance of body orientations",
        "SAT, eq. 4",
        kind="body.rotation",
        bounds=(0.0, math.pi),
    ),
    Metric(
        "rotation_distance_max",
        lambda s: largest(rotation_distance(s.measured, s.simulated)),
        "rad",
        _LOWER,
        "largest geodesic distance of body orientations",
        "SAT, eq. 4",
        kind="body.rotation",
        bounds=(0.0, math.pi),
    ),
)

METRICS = MappingProxyType({entry.name: entry for entry in _ALL})


def metric(name: str) -> Metric:
    """The metric of this name.

    Raises:
        MissingSignal: there is no such metric; the message lists those that there are.
    """
    try:
        return METRICS[name]
    except KeyError:
        raise MissingSignal(f"there is no metric {name!r}", available=METRICS) from None


def metric_unit(rule: UnitRule, signal_unit: str) -> str:
    """The unit of a metric of a signal in `signal_unit`, e.g. `signal/s^2` of `rad/s` is `rad/s^3`."""
    if rule == "signal":
        return signal_unit
    if rule == "signal^2":
        compound = len(signal_unit) > 1 and signal_unit != "rad"
        return "1" if signal_unit == "1" else f"({signal_unit})^2" if compound else f"{signal_unit}^2"
    if rule == "signal/s^2":
        base, _, per_time = signal_unit.partition("/s")
        order = 2 + (0 if "/s" not in signal_unit else int(per_time.removeprefix("^") or 1))
        return f"{base}/s^{order}"
    return rule
