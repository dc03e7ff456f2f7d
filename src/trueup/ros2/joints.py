"""From joint states to arrays in a robot's order of joints, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from trueup.ros2.messages import JointState

# Signal of trueup -> field of a message.
FIELDS = {"position": "position", "velocity": "velocity", "torque": "effort"}


class JointColumns:
    """Where the joints of a robot are in messages, whose joints may be more, and in any order.

    Args:
        joints: of the robot, in its order.

    Attributes:
        others: joints of the last message in which one of these was missing, or there twice; empty if there was none.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self.joints = tuple(joints)
        self.others: tuple[str, ...] = ()
        self._names: list[str] = []
        self._columns: list[int] | None = None

    def find(self, message: JointState) -> list[int] | None:
        """The robot's joints in this message; None if one is missing, or there twice."""
        names = list(message.name)
        if names != self._names or self._columns is None:  # publishers rarely change their mind
            place = {name: column for column, name in enumerate(names)}
            known = len(place) == len(names) and all(joint in place for joint in self.joints)
            self._names, self._columns = names, [place[joint] for joint in self.joints] if known else None
            self.others = self.others if known else tuple(names)
        return self._columns

    def read(self, message: JointState) -> dict[str, Float[np.ndarray, "J"]] | None:
        """Signal -> values, of those that the message has; None where it is not of these joints, or broken."""
        columns = self.find(message)
        if columns is None:
            return None
        read = {}
        for signal, name in FIELDS.items():
            values = getattr(message, name)
            if not values:
                continue
            if len(values) != len(message.name):
                return None
            read[signal] = np.array([values[column] for column in columns], np.float64)
        return read

    def written(self, message: JointState, values: Mapping[str, Float[np.ndarray, "J"]]) -> JointState:
        """The message with other values for these joints; a field that it did not have is NaN for its other joints."""
        columns = self.find(message)
        assert columns is not None, "whoever writes has read"
        changed: dict[str, Any] = {}
        for signal, array in values.items():
            name = FIELDS[signal]
            numbers = list(getattr(message, name)) or [float("nan")] * len(message.name)
            for column, value in zip(columns, array.tolist(), strict=True):
                numbers[column] = value
            changed[name] = numbers
        return replace(message, **changed)
