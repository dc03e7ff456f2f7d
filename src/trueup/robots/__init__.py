"""Robot descriptions and the project's own models."""

from trueup.robots.friction import JointFriction
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
    "SimulationSpec",
    "UnlistedSpec",
    "find_model",
    "load_robot",
    "shipped_robots",
]
