"""Regressions that are linear in what they look for: gray-box torque models and inverse dynamics."""

from trueup.core.graybox_result import BlockFit as BlockFit
from trueup.core.graybox_result import Coefficient as Coefficient
from trueup.core.graybox_result import GrayboxResult as GrayboxResult
from trueup.core.graybox_result import JointFit as JointFit
from trueup.core.graybox_result import Score as Score
from trueup.identify.regression.base_parameters import BaseStructure as BaseStructure
from trueup.identify.regression.graybox import GrayboxSettings as GrayboxSettings
from trueup.identify.regression.graybox import fit_graybox as fit_graybox
from trueup.identify.regression.inverse_dynamics import InverseDynamicsSettings as InverseDynamicsSettings
from trueup.identify.regression.inverse_dynamics import fit_inverse_dynamics as fit_inverse_dynamics
from trueup.identify.regression.inverse_dynamics import inverse_dynamics_from_episodes as inverse_dynamics_from_episodes
from trueup.identify.regression.inverse_dynamics_result import BaseParameter as BaseParameter
from trueup.identify.regression.inverse_dynamics_result import BodyEstimate as BodyEstimate
from trueup.identify.regression.inverse_dynamics_result import InverseDynamicsFit as InverseDynamicsFit
from trueup.identify.regression.inverse_dynamics_result import JointTerms as JointTerms
from trueup.identify.regression.torque_start import TorqueStart as TorqueStart
from trueup.identify.regression.torque_start import torque_start as torque_start

__all__ = [
    "BaseParameter",
    "BaseStructure",
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
    "TorqueStart",
    "fit_graybox",
    "fit_inverse_dynamics",
    "inverse_dynamics_from_episodes",
    "torque_start",
]
