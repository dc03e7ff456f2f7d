"""A motion that is written to logs of many kinds, and what to expect of the import of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

START_S = 1_700_000_000


@dataclass(frozen=True)
class Recorded:
    """A motion as it was.

    Attributes:
        joints: of the model.
        time_s: stamps of all of it, from 0, (T,).
        done: measured positions [rad], (T, J).
        told: commanded positions [rad], (T, J).
    """

    joints: tuple[str, ...]
    time_s: np.ndarray
    done: np.ndarray
    told: np.ndarray

    @property
    def speed(self) -> np.ndarray:
        """Measured velocities [rad/s], (T, J)."""
        return np.gradient(self.done, self.time_s, axis=0)

    @property
    def time_ns(self) -> np.ndarray:
        """Stamps since 1970, (T,)."""
        return START_S * 10**9 + np.round(self.time_s * 1e9).astype(np.int64)


def _all(truth: Recorded, _: int) -> slice:
    return slice(0, len(truth.time_s))


@dataclass(frozen=True)
class Kind:
    """A kind of log.

    Attributes:
        write: writes the motion into a folder.
        second: what a second try is given, `ImportOptions` by name; the mapping as text.
        named: what the message of the first try has to say, so that a user would give these; else the options' values.
        precision: by which positions may differ [rad].
        precision_s: by which stamps may differ [s].
        told: whether the log has commands.
        told_every: a command for so many samples.
        lost: samples that the log itself lacks.
        motions: that the log has.
        rows: samples of each.
    """

    write: Callable[[Path, Recorded], Any]
    second: Mapping[str, Any] = field(default_factory=dict)
    named: tuple[str, ...] = ()
    precision: float = 1e-6
    precision_s: float = 1e-6
    told: bool = True
    told_every: int = 1
    lost: int = 0
    motions: int = 1
    rows: Callable[[Recorded, int], slice] = _all

    def named_in(self, message: str) -> bool:
        """Whether a message tells its reader what the second try needs."""
        return bool(self.named) and all(word in message for word in self.named)
