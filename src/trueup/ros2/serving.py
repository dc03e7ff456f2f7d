"""Virtual hardware, or a simulation, behind topics of ROS 2: for trying out what is meant for a robot."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trueup.core.protocols import Hardware
from trueup.errors import ConfigError, TrueupError
from trueup.ros2.joints import FIELDS, JointColumns
from trueup.ros2.messages import NS_PER_S, Float64MultiArray, Header, JointState, Time
from trueup.ros2.node import Node
from trueup.ros2.robot import FORMS, RobotTopics

_PROGRESS_S = 1.0


@dataclass
class Served:
    """What was served.

    Attributes:
        published: joint states.
        commands: that were followed.
        refused: commands of other joints, of other lengths or signals, or after a stop.
        late: joint states that were published more than one period too late.
        seconds: how long it went on [s].
    """

    published: int = 0
    commands: int = 0
    refused: int = 0
    late: int = 0
    seconds: float = 0.0


def serve(
    robot: Hardware,
    topics: RobotTopics,
    *,
    rate_hz: float = 1000.0,
    stop: threading.Event | None = None,
    seconds: float | None = None,
    on_progress: Callable[[Served], None] = lambda _: None,
) -> Served:
    """Publish a robot's joint states at a rate, and let it follow the commands that come, until it is stopped.

    The robot's clock goes with this computer's; stamps are the robot's time, from when it began. Where the computer
    is too slow for the robot, its time falls behind, and no reading is left out.

    Args:
        robot: that runs as fast as it can.
        topics: where.
        rate_hz: joint states per second [Hz].
        stop: ends it.
        seconds: ends it after so long [s].
        on_progress: told once per second.

    Raises:
        ConfigError: no rate, or a robot that does not follow what commands would carry.
    """
    if not 0 < rate_hz < np.inf:
        raise ConfigError("a rate of joint states", got=rate_hz, expected="a positive number")
    if missing := [name for name in topics.signals if name not in robot.command_signals]:
        raise ConfigError(f"the robot follows no {' and '.join(missing)}", available=robot.command_signals)
    served, stop = Served(), stop or threading.Event()
    with Node(topics.network) as node:
        follower = _Follower(robot, topics, node, served)
        states = node.publish(topics.states, JointState)
        robot.wait_until_s(robot.now_s() + 1.0 / rate_hz)  # what is compiled at its first step is compiled here
        began, began_ns, robot_s = time.monotonic(), time.time_ns(), robot.now_s()
        told = began
        while not stop.is_set() and (seconds is None or served.published < seconds * rate_hz):
            time_s = served.published / rate_hz
            follower.follow_until(began + time_s)
            robot.wait_until_s(robot_s + time_s)
            stamp = Time.of_ns(began_ns + round(time_s * NS_PER_S))
            fields = {FIELDS[name]: values.tolist() for name, values in robot.read().items() if name in FIELDS}
            states.send(JointState(header=Header(stamp), name=list(robot.joints), **fields))
            served.published += 1
            now = time.monotonic()
            served.late += int(now - began > time_s + 1.0 / rate_hz)
            if now - told >= _PROGRESS_S:
                told, served.seconds = now, now - began
                on_progress(served)
    served.seconds = time.monotonic() - began
    return served


class _Follower:
    """Commands that come, to the robot."""

    def __init__(self, robot: Hardware, topics: RobotTopics, node: Node, served: Served) -> None:
        self._robot, self._topics, self._node, self._served = robot, topics, node, served
        self._inbox = node.listen(topics.commands, FORMS[topics.form])
        self._columns = JointColumns(robot.joints)

    def follow_until(self, until: float) -> None:
        """All that comes until then, by the clock of this computer."""
        while True:
            left = until - time.monotonic()
            if self._node.wait(max(left, 0.0)):
                for message in self._inbox.coming():
                    self._follow(message)
            if left <= 0.0:
                return

    def _follow(self, message: JointState | Float64MultiArray) -> None:
        try:
            self._robot.write(self._command(message))
        except (TrueupError, ValueError):
            self._served.refused += 1
        else:
            self._served.commands += 1

    def _command(self, message: JointState | Float64MultiArray) -> dict[str, np.ndarray]:
        signals = self._topics.signals
        if isinstance(message, Float64MultiArray):
            values = np.array(message.data, np.float64)
            if values.shape != (len(self._robot.joints),):
                raise ValueError(values.shape)
            return {signals[0]: values}
        read = self._columns.read(message) or {}
        if not set(signals) <= read.keys():
            raise ValueError(message.name)
        return {name: read[name] for name in signals}
