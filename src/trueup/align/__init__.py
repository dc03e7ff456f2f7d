"""Bring command, measurement and simulation onto the same joints and the same time, and flag what is suspicious."""

from trueup.align.delay import DelayEstimate, estimate_delay
from trueup.align.execution import failed_execution, position_mse, robust_threshold
from trueup.align.joint_rule import JointRule
from trueup.align.joints import JointMap
from trueup.align.quality import check_quality
from trueup.align.quality_config import QualityConfig
from trueup.align.resample import common_grid, resample
from trueup.align.rest import cut_rest, moving_span
from trueup.align.start import (
    StartDetection,
    align_starts,
    detect_motion_start,
    detect_start,
    shift_by_cross_correlation,
)

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
    "moving_span",
    "position_mse",
    "resample",
    "robust_threshold",
    "shift_by_cross_correlation",
]
