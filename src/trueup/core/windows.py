"""Short windows: where a simulation is restarted from the measured state."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int

from trueup.core.hold import SAME_INSTANT_S


def window_starts(time_s: Float64[np.ndarray, "T"], window_s: float | None) -> Int[np.ndarray, "W"]:
    """Rows at which a new window begins: the first sample at or after `time_s[0] + k * window_s`.

    Args:
        time_s: clock, shape (T,) [s].
        window_s: length of a window [s]; None for one window over everything.

    Returns:
        Increasing row numbers, the first is 0. Windows without a sample are left out.
    """
    if window_s is None:
        return np.zeros(1, dtype=np.int64)
    # Stamps that should fall on a boundary may lie a rounding error before it.
    window = np.floor((time_s - time_s[0] + SAME_INSTANT_S) / window_s)
    return np.flatnonzero(np.diff(window, prepend=-1.0))
