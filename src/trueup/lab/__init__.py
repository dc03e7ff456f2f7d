"""Virtual hardware: robots with effects that the simulator does not know."""

from trueup.lab.demo_arm import DemoHardware as DemoHardware
from trueup.lab.demo_arm import record_demo as record_demo

__all__ = ["DemoHardware", "record_demo"]
