"""A robot behind topics of ROS 2, as a recorder drives it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from trueup.errors import ConfigError, NameMismatch, RobotStopped
from trueup.ros2.joints import FIELDS, JointColumns
from trueup.ros2.listeners import others_hint, refusal_hint
from trueup.ros2.messages import Float64MultiArray, Header, JointState, Time
from trueup.ros2.network import Network
from trueup.ros2.node import Node, Outbox

# Discovery of nodes and topics takes a second or two [s].
_DISCOVERY_S = 10.0
FORMS: dict[str, type[JointState] | type[Float64MultiArray]] = {"joint_state": JointState, "array": Float64MultiArray}


@dataclass(frozen=True)
class RobotTopics:
    """Where a robot speaks and listens.

    Attributes:
        states: `sensor_msgs/JointState` of what its sensors say.
        commands: what it follows.
        form: of the commands: `joint_state`, a `sensor_msgs/JointState` with positions (and velocities, where
            `signals` says so), or `array`, a `std_msgs/Float64MultiArray` of positions in the robot's order of joints,
            as the forward command controllers of ros2_control take it.
        signals: that it follows.
        silent_s: a robot that says nothing for so long does not answer [s].
        network: where it is.

    Raises:
        ConfigError: no such form, or signals that it cannot carry.
    """

    states: str = "/joint_states"
    commands: str = "/joint_commands"
    form: str = "joint_state"
    signals: tuple[str, ...] = ("position",)
    silent_s: float = 0.5
    network: Network = field(default_factory=Network)

    def __post_init__(self) -> None:
        """Refuse what cannot be sent."""
        if self.form not in FORMS:
            raise ConfigError(f"there is no form of commands {self.form!r}", available=FORMS)
        if not self.signals or not set(self.signals) <= FIELDS.keys():
            raise ConfigError("signals of a command", got=list(self.signals), expected=f"some of {list(FIELDS)}")
        if self.form == "array" and len(self.signals) != 1:
            raise ConfigError("an array carries one signal", got=list(self.signals))
        if not 0 < self.silent_s < np.inf:
            raise ConfigError("silent_s of a robot", got=self.silent_s, expected="a positive time")


class Ros2Robot:
    """`Hardware` over ROS 2: commands are published, readings are the latest joint states that came.

    It waits until robot and topics have found each other. A reading is as old as the last message, so a robot that
    publishes as often as it is read, or more often, is best.

    Args:
        joints: that are driven, in this order; the robot may have more.
        topics: where.
        patience_s: how long the robot may take until it is heard [s].

    Raises:
        RobotStopped: nobody publishes joint states, nobody listens to commands, or others publish commands, too.
        NameMismatch: what is published is of other joints; both lists are printed.
        ConfigError: a name of a topic, or a domain, that is none.
    """

    def __init__(
        self, joints: Sequence[str], topics: RobotTopics | None = None, *, patience_s: float = _DISCOVERY_S
    ) -> None:
        self.topics = topics or RobotTopics()
        self._joints, self._columns = tuple(joints), JointColumns(joints)
        self._node = Node(self.topics.network)
        self._states = self._node.listen(self.topics.states, JointState)
        self._commands: Outbox[Any] = self._node.publish(self.topics.commands, FORMS[self.topics.form], commands=True)
        self._started_s = self._heard_s = time.monotonic()
        self._reading: dict[str, np.ndarray] = {}
        self._broken = False
        try:
            self._find(patience_s)
        except BaseException:
            self.close()
            raise

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints."""
        return self._joints

    @property
    def command_signals(self) -> tuple[str, ...]:
        """Signals that its controller follows."""
        return self.topics.signals

    def read(self) -> dict[str, Float[np.ndarray, "J"]]:
        """What the robot said last.

        Raises:
            TimeoutError: that was too long ago.
        """
        self._listen()
        quiet_s = time.monotonic() - self._heard_s
        if quiet_s > self.topics.silent_s:
            raise TimeoutError(f"no joint states on {self.topics.states} for {quiet_s:.1f} s")
        return self._reading

    def write(self, command: dict[str, Float[np.ndarray, "J"]]) -> None:
        """Publish a command, stamped with this computer's time.

        Raises:
            ConfigError: a signal that the robot does not follow, or none.
        """
        values = {
            name: np.asarray(command[name], np.float64).tolist() for name in self.topics.signals if name in command
        }
        if not values or set(command) - set(self.topics.signals):
            raise ConfigError("a command", got=list(command), expected=list(self.topics.signals))
        message: JointState | Float64MultiArray
        if self.topics.form == "array":
            message = Float64MultiArray(data=next(iter(values.values())))
        else:
            fields = {FIELDS[name]: numbers for name, numbers in values.items()}
            message = JointState(header=Header(Time.of_ns(time.time_ns())), name=list(self._joints), **fields)
        self._commands.send(message)

    def now_s(self) -> float:
        """Seconds since it was found, on this computer's clock."""
        return time.monotonic() - self._started_s

    def wait_until_s(self, time_s: float) -> None:
        """Let time pass; the robot holds the command that was written last."""
        left = time_s - self.now_s()
        if left > 0:
            time.sleep(left)

    def recover(self) -> None:
        """Nothing: what a stopped robot needs is its driver's own affair; the next reading says whether it answers."""
        self._heard_s = time.monotonic()

    def close(self) -> None:
        """Leave the domain."""
        self._node.close()

    def _listen(self) -> None:
        for message in self._states.coming():
            read = self._columns.read(message)
            if read:
                self._reading, self._heard_s = read, time.monotonic()
            else:
                self._broken |= not message.name or self._columns.find(message) is not None

    def _find(self, patience_s: float) -> None:
        """Until robot and topics have found each other."""
        until = time.monotonic() + patience_s
        while time.monotonic() < until:
            self._node.wait()
            self._listen()
            if self._reading and self._commands.readers and not self._commands.others:
                self._started_s = time.monotonic()
                return
        if not self._reading and self._broken:
            raise RobotStopped(
                f"joint states on {self.topics.states} say nothing of their joints",
                expected="as many numbers as there are names in each array that is not empty, and one that is not",
                hint=f"`ros2 topic echo {self.topics.states}` shows what its driver publishes.",
            )
        if not self._reading and (published := self._columns.others):
            raise NameMismatch(
                f"joint states on {self.topics.states} are of other joints",
                left=self._joints,
                right=published,
                left_name="the robot needs",
                right_name="published are",
            )
        writers, readers = self._states.writers, self._commands.readers
        found = f"domain {self.topics.network.number}, {writers} publishers, {readers} listeners"
        if not self._reading:
            raise RobotStopped(
                f"no joint states on {self.topics.states} within {patience_s:g} s",
                got=found,
                hint="`ros2 topic list` shows what there is; --states names another topic, --domain another domain.",
            )
        if others := self._commands.others:
            raise RobotStopped(
                f"somebody else publishes to {self.topics.commands}, too: the robot would follow a mixture",
                got=f"{found}, {others} other publishers of commands",
                hint=others_hint(self.topics.commands),
            )
        if refused := self._commands.refused:
            raise RobotStopped(
                f"nobody listens to {self.topics.commands}",
                got=f"{found}; a listener asks for {refused}, which is not offered",
                hint=refusal_hint(self.topics.commands, refused),
            )
        raise RobotStopped(
            f"nobody listens to {self.topics.commands}",
            got=found,
            hint="Start the robot's controller, or name its topic by --commands and its type by --form.",
        )
