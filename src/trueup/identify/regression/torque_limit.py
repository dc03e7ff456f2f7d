"""Does a measured torque look cut off? A linear model fitted across a limit has gains that are too low."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

AT_LIMIT = 0.98  # from this share of the limit on, a torque counts as cut off
_NEAR_TOP = 0.95
_BELOW = 0.9
_FEWEST = 30  # samples to fit the model to
_UNEXPLAINED = 10.0  # times the median residual, about seven standard deviations
_LEAST_EXCESS = 0.05


def apparent_limit(torque: Float64[np.ndarray, "N"], terms: Float64[np.ndarray, "N K"]) -> float | None:
    """The torque at which the drive seems to end, or None.

    A limit shows at the largest torques: a linear model of the others asks for clearly more than was measured there,
    in most of these samples and in two at least. The model is fitted to the torques below 90 % of the largest and
    extrapolated.

    Args:
        torque: measured [Nm or N].
        terms: what the torque depends on linearly, a constant among it.
    """
    size = np.abs(torque)
    below = size <= _BELOW * size.max()
    if below.sum() < _FEWEST:
        return None
    model = terms @ np.linalg.lstsq(terms[below], torque[below], rcond=None)[0]
    usual = float(np.median(np.abs(torque - model)[below]))
    excess = np.sign(torque) * (model - torque)
    near = size >= _NEAR_TOP * size.max()
    cut = near & (excess > max(_UNEXPLAINED * usual, _LEAST_EXCESS * float(size.max())))
    if cut.sum() < max(2.0, 0.5 * near.sum()):
        return None
    return float(np.median(size[cut]))
