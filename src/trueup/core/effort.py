"""What a computation takes: seconds, processor seconds, and an estimate of energy."""

from __future__ import annotations

import time
from dataclasses import dataclass

# What a busy core takes, with its share of the rest of the machine [W]: a laptop's at full load. Nothing measures it;
# it makes joules of processor seconds, by the same factor for everything that is compared.
WATTS_PER_CORE = 8.0


@dataclass(frozen=True)
class Effort:
    """Of one computation.

    Attributes:
        seconds: by the clock on the wall [s].
        cpu_seconds: of all threads of this process [s].
    """

    seconds: float
    cpu_seconds: float

    @property
    def joules(self) -> float:
        """Estimate: processor seconds times `WATTS_PER_CORE` [J]; what a GPU takes is not in it."""
        return self.cpu_seconds * WATTS_PER_CORE

    def __add__(self, other: Effort) -> Effort:
        """Of one after the other."""
        return Effort(self.seconds + other.seconds, self.cpu_seconds + other.cpu_seconds)


class Meter:
    """Runs from when it is made."""

    def __init__(self) -> None:
        self._began = time.perf_counter(), time.process_time()

    def read(self) -> Effort:
        """Since then."""
        return Effort(time.perf_counter() - self._began[0], time.process_time() - self._began[1])
