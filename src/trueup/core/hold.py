"""Commands are held between their stamps; this is the one place that says how."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int

# Stamps that mean the same instant may differ by a rounding error: k * (1 / rate) and k / rate, stamps rounded to a
# microsecond, and seconds since 1970 in double precision, which are 0.24 microseconds apart.
SAME_INSTANT_S = 1e-6


def held_rows(stamps_s: Float64[np.ndarray, "N"], time_s: Float64[np.ndarray, "*shape"]) -> Int[np.ndarray, "*shape"]:
    """The row of the latest stamp at or before each time; -1 before the first stamp.

    Args:
        stamps_s: increasing, (N,) [s].
        time_s: any shape [s].
    """
    return np.searchsorted(stamps_s, time_s + SAME_INSTANT_S, side="right") - 1
