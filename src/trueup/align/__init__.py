"""Bring command, measurement and simulation onto the same joints and the same time, and flag what is suspicious."""

from trueup.align.delay import DelayEstimate as DelayEstimate
from trueup.align.delay import estimate_delay as estimate_delay
from trueup.align.execution import failed_execution as failed_execution
from trueup.align.execution import position_mse as position_mse
from trueup.align.execution import robust_threshold as robust_threshold
from trueup.align.joint_rule import JointRule as JointRule
from trueup.align.joints import JointMap as JointMap
from trueup.align.limits import limits_in_log as limits_in_log
from trueup.align.quality import check_quality as check_quality
from trueup.align.quality_config import QualityConfig as QualityConfig
from trueup.align.resample import common_grid as common_grid
from trueup.align.resample import resample as resample
from trueup.align.rest import cut_rest as cut_rest
from trueup.align.rest import moving_span as moving_span
from trueup.align.start import StartDetection as StartDetection
from trueup.align.start import align_starts as align_starts
from trueup.align.start import detect_motion_start as detect_motion_start
from trueup.align.start import detect_start as detect_start
from trueup.align.start import shift_by_cross_correlation as shift_by_cross_correlation

__all__ = [
    "DelayEstimate",
    "JointMap",
    "JointRule",
    "QualityConfig",
    "StartDetection",
    "align_starts",
    "check_quality",
    "common_grid",
    "cut_rest",
    "detect_motion_start",
    "detect_start",
    "estimate_delay",
    "failed_execution",
    "limits_in_log",
    "moving_span",
    "position_mse",
    "resample",
    "robust_threshold",
    "shift_by_cross_correlation",
]
