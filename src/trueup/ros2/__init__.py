"""ROS 2 without an installation of it: networks between topics, and robots behind them (extra `ros2`)."""

from trueup.errors import needing

with needing("ROS 2", "ros2"):
    import cyclonedds as _  # noqa: F401

from trueup.ros2.answers import Augmented as Augmented
from trueup.ros2.answers import Compensated as Compensated
from trueup.ros2.bridge import BridgeReport as BridgeReport
from trueup.ros2.bridge import run_bridge as run_bridge
from trueup.ros2.messages import Float64MultiArray as Float64MultiArray
from trueup.ros2.messages import JointState as JointState
from trueup.ros2.network import Network as Network
from trueup.ros2.node import Node as Node
from trueup.ros2.robot import RobotTopics as RobotTopics
from trueup.ros2.robot import Ros2Robot as Ros2Robot
from trueup.ros2.serving import serve as serve
