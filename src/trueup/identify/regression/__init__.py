"""Regressions that are linear in what they look for: gray-box torque models and inverse dynamics."""

from trueup.core.graybox_result import BlockFit, Coefficient, GrayboxResult, JointFit, Score
from trueup.identify.regression.graybox import GrayboxSettings, fit_graybox, predict_graybox
from trueup.identify.regression.graybox_delay import best_delay, spread
from trueup.identify.regression.inverse_dynamics import (
    InverseDynamicsSettings,
    fit_inverse_dynamics,
    inverse_dynamics_from_episodes,
    predict_inverse_dynamics,
)
from trueup.identify.regression.inverse_dynamics_result import (
    BaseParameter,
    BodyEstimate,
    InverseDynamicsFit,
    JointTerms,
)
from trueup.identify.regression.servo_start import ServoStart, servo_start
from trueup.identify.regression.torque_start import TorqueStart, torque_start

__all__ = [
    "BaseParameter",
    "BlockFit",
    "BodyEstimate",
    "Coefficient",
    "GrayboxResult",
    "GrayboxSettings",
    "InverseDynamicsFit",
    "InverseDynamicsSettings",
    "JointFit",
    "JointTerms",
    "Score",
    "ServoStart",
    "TorqueStart",
    "best_delay",
    "fit_graybox",
    "fit_inverse_dynamics",
    "inverse_dynamics_from_episodes",
    "predict_graybox",
    "predict_inverse_dynamics",
    "servo_start",
    "spread",
    "torque_start",
]
