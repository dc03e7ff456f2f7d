"""Robot descriptions and the project's own models."""

from trueup.robots.friction import JointFriction as JointFriction
from trueup.robots.spec import ControllerSpec as ControllerSpec
from trueup.robots.spec import JointGains as JointGains
from trueup.robots.spec import JointSpec as JointSpec
from trueup.robots.spec import ReplaySpec as ReplaySpec
from trueup.robots.spec import RobotSpec as RobotSpec
from trueup.robots.spec import SimulationSpec as SimulationSpec
from trueup.robots.spec import find_model as find_model
from trueup.robots.spec import load_robot as load_robot
from trueup.robots.spec import shipped_robots as shipped_robots

__all__ = [
    "ControllerSpec",
    "JointFriction",
    "JointGains",
    "JointSpec",
    "ReplaySpec",
    "RobotSpec",
    "SimulationSpec",
    "find_model",
    "load_robot",
    "shipped_robots",
]
