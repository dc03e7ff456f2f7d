"""Motions planned within limits and around obstacles, stored as plan sets, and the recorder that executes them.

Importing this loads neither MuJoCo nor a planner; both are loaded when a `Scene` is made or something is planned. What
executes stored plans needs neither.
"""

from trueup.record.check import Violation as Violation
from trueup.record.check import check_plan as check_plan
from trueup.record.check import require_valid as require_valid
from trueup.record.excitation import Design as Design
from trueup.record.excitation import DesignSettings as DesignSettings
from trueup.record.excitation import Information as Information
from trueup.record.excitation import design_excitation as design_excitation
from trueup.record.limits import JointLimits as JointLimits
from trueup.record.lines import cartesian_line as cartesian_line
from trueup.record.lines import random_line as random_line
from trueup.record.lines import straightness_m as straightness_m
from trueup.record.motion import MotionSettings as MotionSettings
from trueup.record.motion import joint_motion as joint_motion
from trueup.record.motion import random_joint_motion as random_joint_motion
from trueup.record.motion import random_pose as random_pose
from trueup.record.paths import PathSettings as PathSettings
from trueup.record.paths import plan_path as plan_path
from trueup.record.plan import Plan as Plan
from trueup.record.planreader import PLANS_NAME as PLANS_NAME
from trueup.record.planreader import PlanSet as PlanSet
from trueup.record.planset import MotionGroup as MotionGroup
from trueup.record.planset import PlanSetSpec as PlanSetSpec
from trueup.record.planset import load_plans as load_plans
from trueup.record.planset import paper_plans as paper_plans
from trueup.record.planstore import Planned as Planned
from trueup.record.planstore import plan_all as plan_all
from trueup.record.planstore import store_plans as store_plans
from trueup.record.profile import ClockSettings as ClockSettings
from trueup.record.recorder import Recorder as Recorder
from trueup.record.recorder import Recording as Recording
from trueup.record.recorder import RecordSettings as RecordSettings
from trueup.record.recorder import whole_ratio as whole_ratio
from trueup.record.references import ReferenceSettings as ReferenceSettings
from trueup.record.references import function_reference as function_reference
from trueup.record.references import random_reference as random_reference
from trueup.record.scene import Scene as Scene
from trueup.record.splines import random_spline as random_spline
from trueup.record.splines import spline_reference as spline_reference
from trueup.record.workspace import Box as Box
from trueup.record.workspace import Workspace as Workspace
from trueup.record.workspace import load_workspace as load_workspace

__all__ = [
    "PLANS_NAME",
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
