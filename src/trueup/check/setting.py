"""What observations look at: logs alone, or logs that a model has something to say about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.check.evidence import Evidence
from trueup.check.reading import Reading
from trueup.core.episode import Episode
from trueup.robots import RobotSpec


def listed(names: Sequence[str]) -> str:
    """`a`, `a and b`, or `a, b and c`; empty for none."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


@dataclass(frozen=True, eq=False)
class Logs:
    """Logs and the description that they are read by.

    Attributes:
        robot: its description.
        episodes: in the robot's names and units.
    """

    robot: RobotSpec
    episodes: Sequence[Episode]

    def listed(self, joints: Sequence[int] | np.ndarray) -> str:
        """Names of joints by number, for a sentence."""
        return listed(self.names(joints))

    def names(self, joints: Sequence[int] | np.ndarray) -> tuple[str, ...]:
        """Names of joints by number."""
        return tuple(self.robot.joint_names[int(joint)] for joint in joints)


@dataclass(frozen=True, eq=False)
class Setting(Logs):
    """Logs, the model, and how the logs are read with everything that is certain.

    Attributes:
        evidence: the motions and the model.
        reading: of them.
    """

    evidence: Evidence
    reading: Reading

    @property
    def signal(self) -> str:
        """That is followed."""
        return self.evidence.followed(self.reading)

    @property
    def command(self) -> np.ndarray:
        """As it is read, at all rows, (N, J)."""
        values = self.evidence.commanded(self.evidence.signal, self.reading.lag_s)
        return self.reading.command.of(values, moved=self.signal == "position")


def where(mask: np.ndarray) -> list[int]:
    """Numbers of the joints for which something holds."""
    return [int(joint) for joint in np.flatnonzero(mask)]


def percent(share: float) -> str:
    """A share from 0 to 1, for people; what is worse than nothing explains nothing."""
    return f"{100.0 * float(share):.0f} %" if share >= 0.005 else "none"
