"""Distances between measured and simulated rigid bodies: position and orientation."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Float64

from trueup.measure.columns import largest, mean
from trueup.measure.metrics.base import Metric


def position_distance(
    measured: Float[np.ndarray, "T B 3"], simulated: Float[np.ndarray, "T B 3"]
) -> Float64[np.ndarray, "T B"]:
    """Euclidean distance of body positions, sample by sample [m]; NaN where either is not finite."""
    first, second = _finite(measured), _finite(simulated)
    return np.asarray(np.sqrt(((first - second) ** 2).sum(axis=-1)))


def rotation_distance(
    measured: Float[np.ndarray, "*N 3 3"], simulated: Float[np.ndarray, "*N 3 3"]
) -> Float64[np.ndarray, "*N"]:
    """Geodesic distance of two orientations in [0, pi] rad (SAT, eq. 4).

    The angle of R = R1 R2^T. The paper takes the arccosine of (trace - 1) / 2, which loses half of the digits
    near 0 and near pi and leaves its domain by rounding; here the sine, from the part of R that is not
    symmetric, and the cosine go into one arctangent.

    Args:
        measured: rotation matrices, shape (..., 3, 3).
        simulated: likewise; a matrix with an entry that is not finite gives NaN.
    """
    turn = _finite(measured) @ np.swapaxes(_finite(simulated), -1, -2)
    cosine = 0.5 * (np.trace(turn, axis1=-2, axis2=-1) - 1.0)
    axis = np.stack(
        [
            turn[..., 2, 1] - turn[..., 1, 2],
            turn[..., 0, 2] - turn[..., 2, 0],
            turn[..., 1, 0] - turn[..., 0, 1],
        ],
        axis=-1,
    )
    sine = 0.5 * np.sqrt((axis**2).sum(axis=-1))
    return np.asarray(np.arctan2(sine, cosine))


def _finite(values: Float[np.ndarray, "*N"]) -> Float64[np.ndarray, "*N"]:
    return np.where(np.isfinite(values), values, np.nan).astype(np.float64, copy=False)


METRICS = (
    Metric(
        "position_norm",
        lambda s: mean(position_distance(s.measured, s.simulated)),
        "mean ‖p_m - p_s‖ of a body",
        "SAT, section VI",
        "mean distance of bodies",
        kind="body.position",
    ),
    Metric(
        "position_norm_max",
        lambda s: largest(position_distance(s.measured, s.simulated)),
        "max ‖p_m - p_s‖",
        "SAT, section VI",
        kind="body.position",
    ),
    Metric(
        "rotation_distance",
        lambda s: mean(rotation_distance(s.measured, s.simulated)),
        "mean angle of R_m R_sᵀ",
        "SAT, eq. 4",
        "mean rotation between bodies",
        unit="rad",
        kind="body.rotation",
        bounds=(0.0, math.pi),
    ),
    Metric(
        "rotation_distance_max",
        lambda s: largest(rotation_distance(s.measured, s.simulated)),
        "largest angle of R_m R_sᵀ",
        "SAT, eq. 4",
        unit="rad",
        kind="body.rotation",
        bounds=(0.0, math.pi),
    ),
)
