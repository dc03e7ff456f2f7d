"""Virtual hardware: robots with effects that the simulator does not know."""

from trueup.lab.demo_arm import DemoHardware as DemoHardware
from trueup.lab.demo_arm import record_demo as record_demo
from trueup.lab.faults import Fault as Fault
from trueup.lab.simulated_robot import Sensors as Sensors
from trueup.lab.simulated_robot import SimulatedRobot as SimulatedRobot
from trueup.lab.spec import LabSpec as LabSpec
from trueup.lab.spec import load_lab as load_lab
from trueup.lab.truth import Truth as Truth
from trueup.lab.truth import draw_truth as draw_truth
from trueup.lab.virtual_robot import Execution as Execution
from trueup.lab.virtual_robot import VirtualRobot as VirtualRobot

__all__ = [
    "DemoHardware",
    "Execution",
    "Fault",
    "LabSpec",
    "Sensors",
    "SimulatedRobot",
    "Truth",
    "VirtualRobot",
    "draw_truth",
    "load_lab",
    "record_demo",
]
