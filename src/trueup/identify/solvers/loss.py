"""How much a residual counts: with its square, or less the further out it lies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

LossName = Literal["linear", "soft_l1"]

# Median of the absolute values of a normal variable of standard deviation 1, inverted.
_NORMAL = 1.4826
_LEAST = 1e-3


@dataclass(frozen=True)
class Loss:
    """2 c^2 (sqrt(1 + (r / c)^2) - 1) for each residual r: its square near zero, 2 c |r| far out.

    Attributes:
        outlier: c; infinite for the squares themselves.
    """

    outlier: float = np.inf

    @staticmethod
    def of(residual: Float64[np.ndarray, "N"], name: LossName, scale: float) -> Loss:
        """The loss near a residual, with c at `scale` of its robust standard deviations."""
        if name == "linear":
            return Loss()
        size = np.abs(residual)
        # Where most residuals are exactly zero, as in a simulated log at rest, the others would not count at all.
        return Loss(max(scale * _NORMAL * float(np.median(size)), _LEAST * float(size.max()), 1e-150))

    def cost(self, residual: Float64[np.ndarray, "N"]) -> float:
        """The sum over all residuals."""
        if np.isinf(self.outlier):
            return float(residual @ residual)
        return float(2 * self.outlier**2 * np.sum(np.sqrt(1 + (residual / self.outlier) ** 2) - 1))

    def weights(self, residual: Float64[np.ndarray, "N"]) -> Float64[np.ndarray, "N"]:
        """Derivative of the loss by the square of the residual: 1 where that counts in full."""
        return np.asarray(1 / np.sqrt(1 + (residual / self.outlier) ** 2))
