"""Robot descriptions and the project's own models."""

from trueup.robots.friction import JointFriction
from trueup.robots.spec import (
    ClockSpec,
    CommandSpec,
    ControllerSpec,
    JointGains,
    JointSpec,
    MotorSpec,
    PayloadSpec,
    ReplaySpec,
    RobotSpec,
    SimulationSpec,
    find_model,
    load_robot,
    shipped_robots,
)

__all__ = [
    "ClockSpec",
    "CommandSpec",
    "ControllerSpec",
    "JointFriction",
    "JointGains",
    "JointSpec",
    "MotorSpec",
    "PayloadSpec",
    "ReplaySpec",
    "RobotSpec",
    "SimulationSpec",
    "find_model",
    "load_robot",
    "shipped_robots",
]
