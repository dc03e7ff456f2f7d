"""Virtual hardware: robots with effects that the simulator does not know."""

from trueup.lab.demo_arm import DemoHardware as DemoHardware
from trueup.lab.demo_arm import record_demo as record_demo
from trueup.lab.simulated_robot import Sensors as Sensors
from trueup.lab.simulated_robot import SimulatedRobot as SimulatedRobot

__all__ = ["DemoHardware", "Sensors", "SimulatedRobot", "record_demo"]
