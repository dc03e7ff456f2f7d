"""A recording's robot behind topics of ROS 2: one, which is there all the time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from trueup.core.protocols import Hardware
from trueup.errors import ConfigError

if TYPE_CHECKING:
    from trueup.ros2 import RobotTopics, Ros2Robot


@dataclass
class Ros2Rig:
    """A robot that publishes joint states and listens to commands.

    Attributes:
        joints: that are driven, in this order.
        topics: where.
        number: which individual it is; the recording's word for it.
    """

    joints: tuple[str, ...]
    topics: RobotTopics
    number: int = 1
    _robot: Ros2Robot | None = field(default=None, init=False, repr=False, compare=False)

    @property
    def unit(self) -> str:
        """Which individual it is."""
        return f"ros2-{self.number}"

    @property
    def condition(self) -> str:
        """Nothing is known of it."""
        return ""

    def describe(self) -> dict[str, Any]:
        """Where it was."""
        topics = self.topics
        named = {"states": topics.states, "commands": topics.commands, "form": topics.form}
        return {"hardware": "ros2", "unit": self.number, **named, "signals": list(topics.signals)}

    def connect(self) -> Ros2Robot:
        """The robot; it is looked for when it is asked for first.

        Raises:
            RobotStopped: it is not there.
            NameMismatch: it has other joints.
        """
        from trueup.ros2 import Ros2Robot

        if self._robot is None:
            self._robot = Ros2Robot(self.joints, self.topics)
        return self._robot

    def session(self, number: int, payload_kg: float) -> Hardware:  # noqa: ARG002 - it is where the motion before left it
        """The same robot, with what it carries."""
        return self.connect()

    def __getstate__(self) -> dict[str, Any]:
        """Not for other processes.

        Raises:
            ConfigError: always.
        """
        raise ConfigError("one robot cannot be driven by several processes", hint="Give --jobs 1.")
