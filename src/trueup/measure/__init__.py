"""How large the gap is, with intervals; it does not know who made the simulation."""

from trueup.measure.analysis import AnalysisBuilder, lags_of
from trueup.measure.bars import Bar, BarFailure, check_bars, parse_bar, refuse_unknown
from trueup.measure.bins import BinnedError, HorizonError, binned_error, error_against_horizon
from trueup.measure.comparison import COMMAND_RUN, Comparison
from trueup.measure.gap import EPISODE_METRICS, executed_of, measure_gap
from trueup.measure.metrics import METRICS, metric
from trueup.measure.metrics.base import Metric, MetricOptions, Samples, metric_unit
from trueup.measure.metrics.body import position_distance, rotation_distance
from trueup.measure.metrics.distribution import gap_iqr, gap_range, large_gap_ratio, saturation_incidence
from trueup.measure.metrics.error import mae, mape, max_error, mse, nrmse, rmse
from trueup.measure.metrics.lag import phase_lag
from trueup.measure.metrics.shape import robustness, smoothness, trajectory_consistency
from trueup.measure.metrics.similarity import ccc, cosine, pearson, r2
from trueup.measure.nearer import nearer_of
from trueup.measure.plane import PlaneBuilder
from trueup.measure.repeats import RepeatBuilder, conditions_repeat
from trueup.measure.trend import trend, trends_of
from trueup.measure.uncertainty import bootstrap_interval, by_motion, motion_numbers, paired_difference, ratio_interval

__all__ = [
    "COMMAND_RUN",
    "EPISODE_METRICS",
    "METRICS",
    "AnalysisBuilder",
    "Bar",
    "BarFailure",
    "BinnedError",
    "Comparison",
    "HorizonError",
    "Metric",
    "MetricOptions",
    "PlaneBuilder",
    "RepeatBuilder",
    "Samples",
    "binned_error",
    "bootstrap_interval",
    "by_motion",
    "ccc",
    "check_bars",
    "conditions_repeat",
    "cosine",
    "error_against_horizon",
    "executed_of",
    "gap_iqr",
    "gap_range",
    "lags_of",
    "large_gap_ratio",
    "mae",
    "mape",
    "max_error",
    "measure_gap",
    "metric",
    "metric_unit",
    "motion_numbers",
    "mse",
    "nearer_of",
    "nrmse",
    "paired_difference",
    "parse_bar",
    "pearson",
    "phase_lag",
    "position_distance",
    "r2",
    "ratio_interval",
    "refuse_unknown",
    "rmse",
    "robustness",
    "rotation_distance",
    "saturation_incidence",
    "smoothness",
    "trajectory_consistency",
    "trend",
    "trends_of",
]
