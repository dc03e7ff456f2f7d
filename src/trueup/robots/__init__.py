"""Robot descriptions and the project's own models."""

from trueup.robots.friction import JointFriction
from trueup.robots.spec import (
    CommandTiming,
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
    "find_model",
    "load_robot",
    "shipped_robots",
]
