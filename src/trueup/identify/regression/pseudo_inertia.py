"""Inertial parameters as 4x4 pseudo-inertias, and a coordinate in which every value is a possible body.

A body is physically possible if and only if its pseudo-inertia is positive definite (Wensing, Kim, Slotine 2018,
"Linear matrix inequalities for physically-consistent inertial parameter identification", eq. 17).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from trueup.identify.inertial import Inertial

# The order of Pinocchio; first moments and inertia about the origin of the frame.
PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
PARAMETER_UNITS = ("kg", "kg m", "kg m", "kg m", *("kg m^2",) * 6)
_LEAST_RADIUS_M = 1e-3  # thickness that a rod, a plate or a point mass gets, so that its logarithm exists


class Pose(NamedTuple):
    """Where a frame is in another one.

    Attributes:
        rotation: (3, 3).
        translation: (3,) [m].
    """

    rotation: Float64[np.ndarray, "3 3"]
    translation: Float64[np.ndarray, "3"]

    @property
    def matrix(self) -> Float64[np.ndarray, "4 4"]:
        """The homogeneous transformation."""
        return np.block([[self.rotation, self.translation[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])

    def carried(self, pseudo: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"]:
        """A pseudo-inertia of the frame, seen from the other one."""
        return np.asarray(self.matrix @ pseudo @ self.matrix.T)


def parameters_of(pseudo: Float64[np.ndarray, "*B 4 4"]) -> Float64[np.ndarray, "*B 10"]:
    """The ten parameters of pseudo-inertias, in the order of `PARAMETERS`; linear."""
    second, first, mass = pseudo[..., :3, :3], pseudo[..., :3, 3], pseudo[..., 3:, 3]
    trace = np.trace(second, axis1=-2, axis2=-1)[..., None, None]
    inertia = trace * np.eye(3) - second
    order = ([0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2])
    return np.concatenate([mass, first, inertia[..., order[0], order[1]]], axis=-1)


def inertial_from(pseudo: Float64[np.ndarray, "4 4"]) -> Inertial:
    """Mass, center of mass and inertia about it."""
    mass = float(pseudo[3, 3])
    com = pseudo[:3, 3] / mass
    moment = pseudo[:3, :3] - mass * np.outer(com, com)
    moment = 0.5 * (moment + moment.T)
    return Inertial(mass, com, np.trace(moment) * np.eye(3) - moment)


def square_root(body: Inertial) -> Float64[np.ndarray, "4 4"]:
    """A factor L with L L' the pseudo-inertia, of a body that is given at least a millimeter of thickness."""
    values, vectors = np.linalg.eigh(body.second_moment)
    moment = (vectors * np.maximum(values, body.mass * _LEAST_RADIUS_M**2)) @ vectors.T
    com = body.com
    factor = np.zeros((4, 4))
    factor[:3, :3] = np.linalg.cholesky(moment)
    factor[:3, 3] = com * np.sqrt(body.mass)
    factor[3, 3] = np.sqrt(body.mass)
    return factor


def deformed(root: Float64[np.ndarray, "4 4"], theta: Float64[np.ndarray, "10"]) -> Float64[np.ndarray, "4 4"]:
    """The pseudo-inertia L U U' L' of log-Cholesky coordinates theta relative to a nominal body L L'.

    U is upper triangular with exp(theta[0] + theta[1..3]) and exp(theta[0]) on its diagonal, exp(theta[0]) times
    theta[4..6] above it and times theta[7..9] in its last column (Rucker and Wensing 2022, "Smooth parameterization
    of rigid-body inertia", eq. 19, here relative to L). Every theta is a possible body, zero the nominal one, and near
    it the Euclidean length of theta approximates the distance of the bodies that does not depend on units or frames.
    """
    inner = root @ _upper(theta)
    return np.asarray(inner @ inner.T)


def deformed_slopes(
    root: Float64[np.ndarray, "4 4"], theta: Float64[np.ndarray, "10"]
) -> Float64[np.ndarray, "10 4 4"]:
    """Derivatives of `deformed` by each coordinate."""
    upper = _upper(theta)
    slopes = np.zeros((10, 4, 4))
    slopes[0] = upper
    for axis in range(3):
        slopes[1 + axis, axis, axis] = upper[axis, axis]
        slopes[7 + axis, axis, 3] = upper[3, 3]
    for number, place in enumerate(_SHEARS):
        slopes[(4 + number, *place)] = upper[3, 3]
    half = root @ slopes @ upper.T @ root.T
    return np.asarray(half + half.transpose(0, 2, 1))


_SHEARS = ((0, 1), (0, 2), (1, 2))


def _upper(theta: Float64[np.ndarray, "10"]) -> Float64[np.ndarray, "4 4"]:
    upper = np.diag(np.exp(np.append(theta[1:4], 0.0)))
    for number, place in enumerate(_SHEARS):
        upper[place] = theta[4 + number]
    upper[:3, 3] = theta[7:]
    return np.asarray(np.exp(theta[0]) * upper)
