"""What the evolution strategy has to be told: roles of the parameters, and how to search."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Int

from trueup.errors import ConfigError


@dataclass(frozen=True, eq=False)
class Roles:
    """What each of P parameters does, for smart adjustment.

    Attributes:
        group: the group (joint) whose error tells about the parameter, (P,), counted from 0; -1 for a parameter
            that all groups share.
        effect: +1 if raising the parameter raises the friction of its group, -1 if it lowers it, 0 if neither
            (an inertia), (P,).
    """

    group: Int[np.ndarray, "P"]
    effect: Int[np.ndarray, "P"]


@dataclass(frozen=True)
class EvolutionSettings:
    """How the evolution strategy searches; the defaults are the thesis's algorithm.

    Attributes:
        population: candidates per step, evaluated at once; 1 in the thesis.
        acceptance: `group` (each joint accepts its own parameters by its own error) or `total`.
        smart: move friction only in the direction that the sign of the group's error asks for.
        step: half width of the neighborhood, in typical scales.
        finer_decades: shrink each candidate's neighborhood by a random factor, log-uniform between
            10^-finer_decades and 1, so that the search also ends well; 0 in the thesis.
        ignore_after: smart adjustment is ignored when more steps in a row than this brought nothing better.
        widen_after: beyond so many, the neighborhood is wider.
        widen: by this factor.
        patience: stop after so many steps in a row without anything better.
        failed_limit: give up when every candidate failed in so many steps from the start.
    """

    population: int = 1
    acceptance: Literal["group", "total"] = "group"
    smart: bool = True
    step: float = 0.1
    finer_decades: float = 0.0
    ignore_after: int = 10
    widen_after: int = 30
    widen: float = 3.0
    patience: int = 300
    failed_limit: int = 50

    def __post_init__(self) -> None:
        for name, least in (("population", 1), ("patience", 1), ("failed_limit", 1)):
            if getattr(self, name) < least:
                raise ConfigError(f"{name} of the evolution strategy", got=getattr(self, name), expected="at least 1")
        if not (self.step > 0.0 and self.widen > 0.0 and self.finer_decades >= 0.0):
            raise ConfigError(
                "step, widen and finer_decades of the evolution strategy",
                got=f"{self.step}, {self.widen}, {self.finer_decades}",
                expected="above 0, above 0, at least 0",
            )
