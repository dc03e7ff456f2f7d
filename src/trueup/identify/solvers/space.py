"""Where a solver may look: bounds, start and typical step of the free parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from trueup.errors import ConfigError


@dataclass(frozen=True, eq=False)
class Space:
    """P free parameters in the coordinates in which they are searched (log for positive ones, say).

    Attributes:
        low: lower bounds, (P,), finite.
        high: upper bounds, (P,), finite, above `low`.
        start: where the search begins, (P,), within the bounds.
        scale: typical change of each parameter, (P,), above 0: what a solver takes as a step of size one.
        names: one name per parameter, for messages; `z0`, `z1`, ... when empty.

    Raises:
        ConfigError: bounds that contradict each other or are not finite, a start outside them, or a scale that is
            not above 0.
    """

    low: Float[np.ndarray, "P"]
    high: Float[np.ndarray, "P"]
    start: Float[np.ndarray, "P"]
    scale: Float[np.ndarray, "P"]
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        shapes = {name: getattr(self, name).shape for name in ("low", "high", "start", "scale")}
        if len(set(shapes.values())) != 1 or self.start.ndim != 1 or self.start.size == 0:
            raise ConfigError("bounds, start and scale of a search must be vectors of one length", got=shapes)
        if self.names and len(self.names) != self.start.size:
            raise ConfigError("names of a search", got=len(self.names), expected=f"{self.start.size}")
        self._refuse(~(np.isfinite(self.low) & np.isfinite(self.high)), "bounds must be finite")
        self._refuse(
            self.low >= self.high,
            "bounds contradict each other: low must be below high",
            hint="Freeze a parameter that has only one possible value.",
        )
        inside = (self.low <= self.start) & (self.start <= self.high)  # false for a nan
        self._refuse(~inside, "the start lies outside the bounds")
        self._refuse(~(np.isfinite(self.scale) & (self.scale > 0.0)), "the typical scale must be above 0")

    def _refuse(self, wrong: Bool[np.ndarray, "P"], what: str, hint: str | None = None) -> None:
        if wrong.any():
            raise ConfigError(
                what,
                got=", ".join(
                    f"{self.labels[i]}: low {self.low[i]:g}, high {self.high[i]:g}, start {self.start[i]:g}, "
                    f"scale {self.scale[i]:g}"
                    for i in np.flatnonzero(wrong)[:6]
                ),
                hint=hint,
            )

    @property
    def labels(self) -> tuple[str, ...]:
        """What the parameters are called in messages."""
        return self.names or tuple(f"z{index}" for index in range(self.start.size))

    @property
    def size(self) -> int:
        """P, the number of parameters."""
        return self.start.size

    def clip(self, z: Float[np.ndarray, "*C P"]) -> Float[np.ndarray, "*C P"]:
        """The nearest points within the bounds."""
        inside: Float[np.ndarray, "*C P"] = np.clip(z, self.low, self.high)
        return inside

    def to_json(self) -> dict[str, Any]:
        """JSON object; a checkpoint carries it, so that it is not continued in another space."""
        return {
            "names": list(self.labels),
            **{name: getattr(self, name).tolist() for name in ("low", "high", "start", "scale")},
        }
