"""Experiments that isolate one thing: breakaway, constant torques of both signs, excite and coast.

Each has a `run_*` that drives anything that implements `RobotIO` and yields episodes, and an `estimate_*` that needs
nothing but episodes, recorded here or imported from a log.
"""

from trueup.identify.experiments.breakaway import estimate_breakaway as estimate_breakaway
from trueup.identify.experiments.clock import WallClock as WallClock
from trueup.identify.experiments.coast import estimate_coast as estimate_coast
from trueup.identify.experiments.constant_torque import estimate_constant_torque as estimate_constant_torque
from trueup.identify.experiments.findings import ExperimentResult as ExperimentResult
from trueup.identify.experiments.findings import Finding as Finding
from trueup.identify.experiments.findings import Rejection as Rejection
from trueup.identify.experiments.limits import Limits as Limits
from trueup.identify.experiments.limits import PoseHold as PoseHold
from trueup.identify.experiments.limits import RunSettings as RunSettings
from trueup.identify.experiments.pulses import PANDA_TORQUES_NM as PANDA_TORQUES_NM
from trueup.identify.experiments.pulses import PulsePlan as PulsePlan
from trueup.identify.experiments.pulses import run_coast as run_coast
from trueup.identify.experiments.pulses import run_constant_torque as run_constant_torque
from trueup.identify.experiments.ramp import RampPlan as RampPlan
from trueup.identify.experiments.ramp import run_breakaway as run_breakaway
from trueup.identify.experiments.slides import SlideSettings as SlideSettings

__all__ = [
    "PANDA_TORQUES_NM",
    "ExperimentResult",
    "Finding",
    "Limits",
    "PoseHold",
    "PulsePlan",
    "RampPlan",
    "Rejection",
    "RunSettings",
    "SlideSettings",
    "WallClock",
    "estimate_breakaway",
    "estimate_coast",
    "estimate_constant_torque",
    "run_breakaway",
    "run_coast",
    "run_constant_torque",
]
