"""What a metric is: what it is called, computes, is measured in, and where it comes from."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float, Float64, Int

MAX_LAG_S = 0.5
Kind = Literal["joint", "body.position", "body.rotation"]
UnitRule = Literal["signal", "signal^2", "signal/s^2", "1", "%", "s", "rad"]


@dataclass(frozen=True)
class MetricOptions:
    """What can be chosen about the metrics.

    Attributes:
        tau_rad: threshold of the large-gap ratio [rad].
        max_lag_s: search limit of the phase lag [s].
        seed: of the noise of robustness.
    """

    tau_rad: float = 0.5
    max_lag_s: float = MAX_LAG_S
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Samples:
    """One signal of one episode, measured and simulated on one clock.

    Attributes:
        measured: shape (T, J), or (T, B, 3) and (T, B, 3, 3) for bodies.
        simulated: the same shape.
        time_s: clock, shape (T,) [s].
        starts: first row of each segment, the first is 0.
        limit: torque limits, shape (J,), NaN for a joint without one; None when there are none at all.
        options: what was chosen.
    """

    measured: Float[np.ndarray, "T ..."]
    simulated: Float[np.ndarray, "T ..."]
    time_s: Float64[np.ndarray, "T"]
    starts: Int[np.ndarray, "S"]
    limit: Float64[np.ndarray, "J"] | None = None
    options: MetricOptions = field(default_factory=MetricOptions)


@dataclass(frozen=True)
class Metric:
    """A metric by name.

    Attributes:
        name: as in gap.json and on the command line.
        function: one value per joint (or body) of the samples.
        description: what it computes, of m measured, s simulated and e = m - s.
        source: paper and equation, or the usual definition.
        title: as the report calls it, with its meaning in brackets where that helps; the name if empty.
        unit: the rule that turns the unit of the signal into the unit of the metric.
        lower_is_better: True or False; None for a signed metric, of which nearer to zero is better.
        kind: what it applies to: joint signals, body positions or body orientations.
        signals: the signals for which it is computed by default; empty for every signal of its kind.
        bounds: the values that it can take; intervals are cut to them.
        angles_only: whether it says nothing of joints that are not measured in rad.
        needs_limit: whether it needs torque limits.
        needs_motion: whether it relates the error to the measured motion, and says nothing of a joint that rests.
    """

    name: str
    function: Callable[[Samples], Float64[np.ndarray, "J"]]
    description: str
    source: str = "usual"
    title: str = ""
    unit: UnitRule = "signal"
    lower_is_better: bool | None = True
    kind: Kind = "joint"
    signals: tuple[str, ...] = ()
    bounds: tuple[float, float] = (0.0, math.inf)
    angles_only: bool = False
    needs_limit: bool = False
    needs_motion: bool = False

    def is_default(self, signal: str) -> bool:
        """Whether the metric belongs to the default set of this signal."""
        return self.applies(signal) and (not self.signals or signal in self.signals)

    def applies(self, signal: str) -> bool:
        """Whether the metric can be computed for this signal."""
        if self.needs_limit and signal not in self.signals:
            return False
        return signal == self.kind if signal.startswith("body.") else self.kind == "joint"


Pair = Callable[[Float[np.ndarray, "T J"], Float[np.ndarray, "T J"]], Float64[np.ndarray, "J"]]
SHARE = (0.0, 1.0)
CORRELATION = (-1.0, 1.0)


def plain(function: Pair) -> Callable[[Samples], Float64[np.ndarray, "J"]]:
    """A function of measured and simulated alone, both (T, J), as one of samples."""
    return lambda s: function(s.measured, s.simulated)


def metric_unit(rule: UnitRule, signal_unit: str) -> str:
    """The unit of a metric of a signal in `signal_unit`, e.g. `signal/s^2` of `rad/s` is `rad/s^3`."""
    if rule == "signal":
        return signal_unit
    if rule == "signal^2":
        compound = len(signal_unit) > 1 and signal_unit != "rad"
        return "1" if signal_unit == "1" else f"({signal_unit})^2" if compound else f"{signal_unit}^2"
    if rule == "signal/s^2":
        base, _, per_time = signal_unit.partition("/s")
        order = 2 + (0 if "/s" not in signal_unit else int(per_time.removeprefix("^") or 1))
        return f"{base}/s^{order}"
    return rule
