"""What can go wrong with a virtual robot, on demand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Int64

from trueup.errors import ConfigError


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong at a known time.

    Attributes:
        kind: `stop` is a protective stop: brakes close, and the robot takes no command until it recovers; `stall`
            blocks one joint; `drop` loses readings: the ones before them are read again.
        at_s: when, on the robot's clock [s].
        duration_s: of `stall` and `drop` [s].
        joint: of `stall`.
        share: of the readings that `drop` loses.

    Raises:
        ConfigError: a time or share that makes no sense, or a stall without a joint.
    """

    kind: Literal["stop", "stall", "drop"]
    at_s: float
    duration_s: float = float("inf")
    joint: str = ""
    share: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what cannot happen."""
        if not (self.at_s >= 0 and self.duration_s > 0 and 0 < self.share <= 1):
            raise ConfigError("a fault needs at_s >= 0, duration_s > 0 and a share in (0, 1]", got=self)
        if (self.kind == "stall") != bool(self.joint):
            raise ConfigError("a stall needs a joint, and no other fault has one", got=self)

    def ticks(self, control_step_s: float) -> tuple[int, int]:
        """First control step that it touches, and the first after it."""
        return _tick(self.at_s, control_step_s), _tick(self.at_s + self.duration_s, control_step_s)


# Later than any run; fits an int64.
FOREVER = 2**62


def _tick(time_s: float, control_step_s: float) -> int:
    return FOREVER if time_s / control_step_s > FOREVER else int(np.ceil(time_s / control_step_s - 1e-6))


def stalls(faults: Sequence[Fault], joints: tuple[str, ...], control_step_s: float) -> Int64[np.ndarray, "F 3"]:
    """Joint, first and last control step (exclusive) of every stall.

    Raises:
        ConfigError: there is no such joint.
    """
    rows = []
    for fault in faults:
        if fault.kind != "stall":
            continue
        if fault.joint not in joints:
            raise ConfigError(f"no joint {fault.joint!r} can stall", available=joints)
        rows.append((joints.index(fault.joint), *fault.ticks(control_step_s)))
    return np.array(rows, np.int64).reshape(-1, 3)
