"""Motions planned within limits and around obstacles, stored as plan sets, and the recorder that executes them.

Importing this loads neither MuJoCo nor a planner; both are loaded when a `Scene` is made or something is planned. What
executes stored plans needs neither.
"""

from trueup.record.check import Violation, check_plan, require_valid
from trueup.record.excitation import Design, DesignSettings, Information, design_excitation
from trueup.record.limits import JointLimits
from trueup.record.lines import cartesian_line, random_line, straightness_m
from trueup.record.motion import MotionSettings, joint_motion, random_joint_motion, random_pose
from trueup.record.paths import PathSettings, plan_path
from trueup.record.plan import Plan
from trueup.record.planreader import PLANS_NAME, PlanSet
from trueup.record.planset import MotionGroup, PlanSetSpec, load_plans, paper_plans
from trueup.record.planstore import Planned, plan_all, store_plans
from trueup.record.profile import ClockSettings
from trueup.record.recorder import Recorder, Recording, RecordSettings, whole_ratio
from trueup.record.references import ReferenceSettings, function_reference, random_reference
from trueup.record.scene import Scene
from trueup.record.servoing import SERVO_HZ, Springs, TorqueServo
from trueup.record.splines import random_spline, spline_reference
from trueup.record.workspace import Box, Workspace, load_workspace

__all__ = [
    "PLANS_NAME",
    "SERVO_HZ",
    "Box",
    "ClockSettings",
    "Design",
    "DesignSettings",
    "Information",
    "JointLimits",
    "MotionGroup",
    "MotionSettings",
    "PathSettings",
    "Plan",
    "PlanSet",
    "PlanSetSpec",
    "Planned",
    "RecordSettings",
    "Recorder",
    "Recording",
    "ReferenceSettings",
    "Scene",
    "Springs",
    "TorqueServo",
    "Violation",
    "Workspace",
    "cartesian_line",
    "check_plan",
    "design_excitation",
    "function_reference",
    "joint_motion",
    "load_plans",
    "load_workspace",
    "paper_plans",
    "plan_all",
    "plan_path",
    "random_joint_motion",
    "random_line",
    "random_pose",
    "random_reference",
    "random_spline",
    "require_valid",
    "spline_reference",
    "store_plans",
    "straightness_m",
    "whole_ratio",
]
