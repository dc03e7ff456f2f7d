"""Robot descriptions and the project's own models."""

from trueup.robots.friction import JointFriction
from trueup.robots.setup import AS_DESCRIBED, Setup, refuse_other_gains, refuse_unknown_gains, setup_of, with_kp_factor
from trueup.robots.spec import (
    BaseSpec,
    ClockSpec,
    CommandSpec,
    CommandTiming,
    ControllerSpec,
    JointGains,
    JointSpec,
    MotorSpec,
    PayloadSpec,
    ReplaySpec,
    RobotSpec,
    SimulationSpec,
    UnlistedSpec,
    find_model,
    load_robot,
    shipped_robots,
)

__all__ = [
    "AS_DESCRIBED",
    "BaseSpec",
    "ClockSpec",
    "CommandSpec",
    "CommandTiming",
    "ControllerSpec",
    "JointFriction",
    "JointGains",
    "JointSpec",
    "MotorSpec",
    "PayloadSpec",
    "ReplaySpec",
    "RobotSpec",
    "Setup",
    "SimulationSpec",
    "UnlistedSpec",
    "find_model",
    "load_robot",
    "refuse_other_gains",
    "refuse_unknown_gains",
    "setup_of",
    "shipped_robots",
    "with_kp_factor",
]
