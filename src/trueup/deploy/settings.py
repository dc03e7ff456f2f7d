"""The rules by which a stream holds, falls back and starts anew."""

from __future__ import annotations

import math
from dataclasses import dataclass

from trueup.core.model_card import LARGEST_MARGIN
from trueup.errors import ConfigError

_HUGE = 1e300
# What the card says, if nobody else does.
_CARD = ((None, "warmup_steps"), (None, "margin"))


@dataclass(frozen=True)
class StreamSettings:
    """When a stream trusts its network.

    Attributes:
        warmup_steps: samples after a start, or after leaving the training range, before corrections are used; None for
            what the model's card says. Fewer: corrections sooner, from a state that knows little.
        correct_while_warming: give the network's output while it warms up, instead of the simulator's value.
        missed_periods: a time between two samples of more periods than this counts as a missed sample.
        gap_periods: when no sample could be used for longer than this many periods, the state is started anew: what it
            remembers is no longer what came just before.
        stalled_steps: a simulator that repeats itself more often than this although it must be moving has stalled: its
            velocities say so, or, where the network reads none, a command that has changed meanwhile. A network that
            reads neither cannot tell. Larger: for a dead time between command and motion.
        moving_speed: speed from which on a joint moves [rad/s or m/s]; above the noise of the simulator at rest.
        rate_tolerance: share by which the rate at which samples really come may be wrong, averaged over a hundred of
            them; needs `time_s`.
        margin: share of a channel's training range by which an input may leave it; None for what the card says. Larger:
            corrections from inputs that training never saw.
        measure: keep a histogram of how long steps take.
        compiled: take steps as machine code where the network has such, a `sat`; else, and False, by onnxruntime.
    """

    warmup_steps: int | None = None
    correct_while_warming: bool = False
    missed_periods: float = 1.5
    gap_periods: float = 5.0
    stalled_steps: int = 3
    moving_speed: float = 0.01
    rate_tolerance: float = 0.1
    margin: float | None = None
    measure: bool = True
    compiled: bool = True

    def __post_init__(self) -> None:
        """Refuse rules that make no sense."""
        for name, value in vars(self).items():
            known = isinstance(value, int | float) and not abs(value) > _HUGE
            if not known and (value, name) not in _CARD:
                raise ConfigError(f"{name} of a stream", got=repr(value), expected="a number")
        self._require("warmup_steps", self.warmup_steps is None or self.warmup_steps >= 0, "0 or more samples")
        self._require("missed_periods", 1 < self.missed_periods < math.inf, "more than 1")
        self._require("gap_periods", self.missed_periods <= self.gap_periods < math.inf, "at least missed_periods")
        self._require("stalled_steps", self.stalled_steps >= 1, "1 or more samples")
        self._require("moving_speed", 0 < self.moving_speed < math.inf, "a positive speed")
        self._require("rate_tolerance", 0 < self.rate_tolerance < 1, "between 0 and 1")
        self._require("margin", self.margin is None or 0 <= self.margin <= LARGEST_MARGIN, f"0 to {LARGEST_MARGIN:g}")

    def _require(self, name: str, good: bool, expected: str) -> None:  # noqa: FBT001
        if not good:
            raise ConfigError(f"{name} of a stream", got=getattr(self, name), expected=expected)
