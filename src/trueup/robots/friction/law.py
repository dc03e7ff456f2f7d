"""What a friction law is made of: numbers, and a formula."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from trueup.core.parameters import SearchRange
from trueup.errors import ConfigError

# A float where a formula is compiled into the engine, an array where numpy evaluates it.
Value: TypeAlias = Any
# The numbers of one law, in its order: a sequence, or a place in MuJoCo's memory.
Numbers: TypeAlias = Any

# Motions that show a number; `{target}` is the joint.
SLOW = "let {target} creep, stop and reverse at low speed"
FAST = "let {target} pass through its whole range of speeds"
# How numbers of a kind are looked for.
TORQUE = SearchRange(low=0.0, high=100.0, scale=0.1, prior_std=3.0)
SPEED = SearchRange("log", low=1e-3, span=20.0, prior_std=1.0)


@dataclass(frozen=True)
class Number:
    """One number of a law: in a joint's user data, in `robot.yaml`, and in the catalogue of a fit.

    Attributes:
        name: unique among all laws.
        unit: for a hinge.
        label: what it is, for the docs and the report.
        excite: the kind of motion that shows it; empty for what is never fitted.
        search: how a fit looks for it.
        default: its value in a joint that does not mention it.
        domain: `size` (not negative), `positive`, `signed`, or `share` (between -1 and 1).
        brakes: whether more of it makes a joint slower, whatever else is the case.
    """

    name: str
    unit: str
    label: str
    excite: str = ""
    search: SearchRange = TORQUE
    default: float = 0.0
    domain: Literal["size", "positive", "signed", "share"] = "size"
    brakes: bool = False

    def check(self, value: float) -> None:
        """Refuse what makes no law.

        Raises:
            ConfigError: not finite, or outside the domain.
        """
        signed = self.domain in ("signed", "share")
        if not np.isfinite(value) or (value < 0 and not signed):
            expected = "a finite number" if signed else ">= 0 and finite"
            raise ConfigError(f"friction: {self.name}", got=value, expected=expected)
        if self.domain == "positive" and value == 0:
            raise ConfigError(f"friction: {self.name} must be positive", got=value)
        if self.domain == "share" and abs(value) >= 1:
            raise ConfigError(f"friction: {self.name} must lie between -1 and 1", got=value)


@dataclass(frozen=True)
class Law:
    """One law of joint friction.

    Attributes:
        numbers: in the order of the user data. A law with a formula is off where the first of them is zero.
        formula: in the names of the numbers and v, g, q, for the docs.
        source: where it comes from.
        brake: `brake(v, g, q, n)`, the torque [Nm or N] against the motion of a joint with velocity v [rad/s or m/s],
            transmitted torque g [Nm or N], position q [rad or m] and the numbers n[0], n[1], …. One expression of
            numpy's functions: numba compiles it for floats, numpy evaluates it on arrays. None for what the engines
            do by name.
        drive: the kind of drive that a joint needs for it; any if empty.
        tried: whether a default fit tries it on top of the others.
    """

    numbers: tuple[Number, ...]
    formula: str
    source: str
    brake: Callable[..., Value] | None = None
    drive: Literal["", "position servo", "motor"] = ""
    tried: bool = False
