"""Samples at other times than their own."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64


def columns_at(
    time_s: Float64[np.ndarray, "N"], clock_s: Float64[np.ndarray, "T"], values: Float[np.ndarray, "T C"]
) -> Float64[np.ndarray, "N C"]:
    """Columns of `values`, whose rows are at `clock_s`, at other times: linear between rows, held beyond the ends."""
    return np.stack([np.interp(time_s, clock_s, column) for column in values.T], axis=1)
