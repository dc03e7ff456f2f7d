"""Identification: what the simulator has wrong, and how sure that is."""

from trueup.identify.attribution import explain as explain
from trueup.identify.candidate import Candidate as Candidate
from trueup.identify.candidate import Nominal as Nominal
from trueup.identify.config import IdentifyConfig as IdentifyConfig
from trueup.identify.export import rehearse as rehearse
from trueup.identify.export import save_identification as save_identification
from trueup.identify.identification import Identification as Identification
from trueup.identify.identification import identify as identify
from trueup.identify.identification import refuse_one_start as refuse_one_start
from trueup.identify.inertial import Inertial as Inertial
from trueup.identify.information import PlannedInformation as PlannedInformation
from trueup.identify.knowledge import Knowledge as Knowledge
from trueup.identify.knowledge import deviations as deviations
from trueup.identify.problem import Problem as Problem
from trueup.identify.problem import Weights as Weights
from trueup.identify.quantities import QUANTITIES as QUANTITIES
from trueup.identify.scoring import judged as judged
from trueup.identify.segments import SegmentRule as SegmentRule
from trueup.identify.segments import make_segments as make_segments
from trueup.identify.solution import OnModel as OnModel
from trueup.identify.solution import Progress as Progress
from trueup.identify.solution import SolveSettings as SolveSettings
from trueup.identify.solve import solve as solve

__all__ = [
    "QUANTITIES",
    "Candidate",
    "Identification",
    "IdentifyConfig",
    "Inertial",
    "Knowledge",
    "Nominal",
    "OnModel",
    "PlannedInformation",
    "Problem",
    "Progress",
    "SegmentRule",
    "SolveSettings",
    "Weights",
    "deviations",
    "explain",
    "identify",
    "judged",
    "make_segments",
    "refuse_one_start",
    "rehearse",
    "save_identification",
    "solve",
]
