"""What a compensator may do to commands, and what a robot may be commanded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from trueup.core.model_card import ModelCard
from trueup.errors import ConfigError

# A compensation shall be able to follow where friction turns, and need not jump: its whole size in five steps of 50 Hz.
_SIZES_PER_S = 10.0
# Where the range of a network's commands is all that is known.
_SHARE = 0.1

Outside = Literal["clamp", "keep", "off"]


@dataclass(frozen=True)
class Limits:
    """What may be commanded to the J joints of a robot.

    Attributes:
        low: smallest positions, (J,) [rad or m].
        high: largest positions, (J,).
        rate: largest change of commands per second, (J,) [rad/s or m/s]; None where the robot has no such limit.

    Raises:
        ConfigError: no numbers, not as many of each, or a range with nothing inside.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    rate: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        """Refuse ranges that hold nothing."""
        if len(self.low) != len(self.high) or not all(a < b for a, b in zip(self.low, self.high, strict=False)):
            raise ConfigError("limits of a robot", got=(self.low, self.high), expected="low below high of each joint")
        if self.rate is not None and (len(self.rate) != len(self.low) or not all(rate > 0 for rate in self.rate)):
            raise ConfigError("limits of a robot: rate", got=self.rate, expected="a positive number for each joint")


@dataclass(frozen=True)
class CompensatorSettings:
    """How far a compensator is trusted.

    Attributes:
        largest: largest correction, of all joints or of each [rad or m]; None for how far commands were from positions
            in training, or a tenth of their range where the network does not read that distance. Larger: corrections
            that training gave no reason for.
        rate: largest change of a correction per second, likewise [rad/s or m/s]; None for ten times the largest
            correction. Smaller: smoother, and late where friction turns.
        outside: what to do with a payload that training did not cover: `clamp` takes the nearest that it did, `keep`
            takes it as it is as far as the network's margin goes, and `off` corrects nothing.
    """

    largest: float | tuple[float, ...] | None = None
    rate: float | tuple[float, ...] | None = None
    outside: Outside = "clamp"

    def __post_init__(self) -> None:
        """Refuse what is no size."""
        for name in ("largest", "rate"):
            given = getattr(self, name)
            values = given if isinstance(given, tuple) else (given,) if given is not None else ()
            if not all(isinstance(value, int | float) and 0 < value < math.inf for value in values):
                raise ConfigError(f"{name} of a compensator", got=repr(given), expected="positive numbers")
        if self.outside not in ("clamp", "keep", "off"):
            raise ConfigError("outside of a compensator", got=self.outside, available=("clamp", "keep", "off"))

    def sizes(self, card: ModelCard) -> tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "J"]]:
        """Largest correction and its largest change per second of each joint.

        Raises:
            ConfigError: not as many numbers as joints, or none at all: neither here nor in the card.
        """
        count = len(card.joints)
        largest = _of_each("largest", _reach(card) if self.largest is None else self.largest, count)
        rate = _of_each("rate", tuple(_SIZES_PER_S * largest) if self.rate is None else self.rate, count)
        if not np.isfinite(largest).all():
            raise ConfigError(
                f"model {card.name!r} does not say how far its commands went",
                hint="Say how large a correction may be: CompensatorSettings(largest=...).",
            )
        return largest, rate


def _reach(card: ModelCard) -> tuple[float, ...]:
    """How far a correction may go by the ranges of training."""
    ends = [card.inputs[output.base] for output in card.outputs]
    return tuple(max(abs(end.low), abs(end.high)) if end.relative else _SHARE * (end.high - end.low) for end in ends)


def _of_each(name: str, given: float | Sequence[float], count: int) -> Float64[np.ndarray, "J"]:
    values = np.atleast_1d(np.asarray(given, np.float64))
    if values.size not in (1, count):
        raise ConfigError(f"{name} of a compensator", got=f"{values.size} numbers", expected=f"one, or {count}")
    return np.broadcast_to(values, (count,)).copy()
