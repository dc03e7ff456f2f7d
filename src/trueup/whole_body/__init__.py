"""The upper body on a base that has to balance: what an error of the arms does to the whole."""

from trueup.whole_body.balance import Balance as Balance
from trueup.whole_body.balance import BalanceSettings as BalanceSettings
from trueup.whole_body.balance import Lean as Lean
from trueup.whole_body.balance import design_balance as design_balance
from trueup.whole_body.bodies import SimulatedBody as SimulatedBody
from trueup.whole_body.bodies import WholeBody as WholeBody
from trueup.whole_body.driving import Compensator as Compensator
from trueup.whole_body.driving import DrivingSettings as DrivingSettings
from trueup.whole_body.driving import Trajectory as Trajectory
from trueup.whole_body.driving import drive as drive
from trueup.whole_body.feedforward import GravityFeedForward as GravityFeedForward
from trueup.whole_body.gap import UNITS as UNITS
from trueup.whole_body.gap import body_gap as body_gap
from trueup.whole_body.hardware import BaseSpec as BaseSpec
from trueup.whole_body.hardware import BaseTruth as BaseTruth
from trueup.whole_body.hardware import VirtualBody as VirtualBody
from trueup.whole_body.hardware import draw_base as draw_base
from trueup.whole_body.profile import BaseProfile as BaseProfile
from trueup.whole_body.trial import Trial as Trial

__all__ = [
    "UNITS",
    "Balance",
    "BalanceSettings",
    "BaseProfile",
    "BaseSpec",
    "BaseTruth",
    "Compensator",
    "DrivingSettings",
    "GravityFeedForward",
    "Lean",
    "SimulatedBody",
    "Trajectory",
    "Trial",
    "VirtualBody",
    "WholeBody",
    "body_gap",
    "design_balance",
    "draw_base",
    "drive",
]
