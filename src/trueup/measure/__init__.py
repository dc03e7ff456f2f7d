"""How large the gap is, with intervals; it does not know who made the simulation."""

from trueup.measure.analysis import AnalysisBuilder as AnalysisBuilder
from trueup.measure.analysis import lags_of as lags_of
from trueup.measure.bars import Bar as Bar
from trueup.measure.bars import BarFailure as BarFailure
from trueup.measure.bars import check_bars as check_bars
from trueup.measure.bars import parse_bar as parse_bar
from trueup.measure.bins import BinnedError as BinnedError
from trueup.measure.bins import HorizonError as HorizonError
from trueup.measure.bins import binned_error as binned_error
from trueup.measure.bins import error_against_horizon as error_against_horizon
from trueup.measure.comparison import COMMAND_RUN as COMMAND_RUN
from trueup.measure.comparison import Comparison as Comparison
from trueup.measure.gap import measure_gap as measure_gap
from trueup.measure.lag import phase_lag as phase_lag
from trueup.measure.metrics import METRICS as METRICS
from trueup.measure.metrics import Metric as Metric
from trueup.measure.metrics import MetricOptions as MetricOptions
from trueup.measure.metrics import Samples as Samples
from trueup.measure.metrics import metric as metric
from trueup.measure.metrics import metric_unit as metric_unit
from trueup.measure.metrics_body import position_distance as position_distance
from trueup.measure.metrics_body import rotation_distance as rotation_distance
from trueup.measure.metrics_distribution import gap_iqr as gap_iqr
from trueup.measure.metrics_distribution import gap_range as gap_range
from trueup.measure.metrics_distribution import large_gap_ratio as large_gap_ratio
from trueup.measure.metrics_distribution import saturation_incidence as saturation_incidence
from trueup.measure.metrics_error import mae as mae
from trueup.measure.metrics_error import mape as mape
from trueup.measure.metrics_error import max_error as max_error
from trueup.measure.metrics_error import mse as mse
from trueup.measure.metrics_error import nrmse as nrmse
from trueup.measure.metrics_error import rmse as rmse
from trueup.measure.metrics_shape import robustness as robustness
from trueup.measure.metrics_shape import smoothness as smoothness
from trueup.measure.metrics_shape import trajectory_consistency as trajectory_consistency
from trueup.measure.metrics_similarity import ccc as ccc
from trueup.measure.metrics_similarity import cosine as cosine
from trueup.measure.metrics_similarity import pearson as pearson
from trueup.measure.metrics_similarity import r2 as r2
from trueup.measure.plane import PlaneBuilder as PlaneBuilder
from trueup.measure.trend import trend as trend
from trueup.measure.trend import trends_of as trends_of
from trueup.measure.uncertainty import bootstrap_interval as bootstrap_interval
from trueup.measure.uncertainty import paired_difference as paired_difference
from trueup.measure.uncertainty import ratio_interval as ratio_interval

__all__ = [
    "COMMAND_RUN",
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
    "Samples",
    "binned_error",
    "bootstrap_interval",
    "ccc",
    "check_bars",
    "cosine",
    "error_against_horizon",
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
    "mse",
    "nrmse",
    "paired_difference",
    "parse_bar",
    "pearson",
    "phase_lag",
    "position_distance",
    "r2",
    "ratio_interval",
    "rmse",
    "robustness",
    "rotation_distance",
    "saturation_incidence",
    "smoothness",
    "trajectory_consistency",
    "trend",
    "trends_of",
]
