"""Orientations as a network reads and writes them: the first two columns of the rotation matrix (SAT, V-A)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from trueup.errors import DataError

# A direction shorter than this is none; two columns whose sine is below it span no plane.
_NONE = 1e-9
# Rotations come from files with few digits, and from float32.
_ORTHONORMAL = 1e-3


def six_of(rotation: Float[np.ndarray, "*N 3 3"]) -> Float[np.ndarray, "*N 6"]:
    """A rotation without its last column: the first column, then the second."""
    return np.concatenate([rotation[..., 0], rotation[..., 1]], axis=-1)


def rotation_of(six: Float[np.ndarray, "*N 6"]) -> Float64[np.ndarray, "*N 3 3"]:
    """The rotation whose first two columns are nearest in the order of Gram-Schmidt (SAT, V-A).

    Whatever the numbers: a first column of no length is taken for x, a second one along the first for the axis that is
    most across it.
    """
    first, second = np.split(six.astype(np.float64), 2, axis=-1)
    first = _unit(first, np.broadcast_to([1.0, 0.0, 0.0], first.shape))
    across = np.eye(3)[np.abs(first).argmin(axis=-1)]
    second = _unit(_across(_unit(second, across), first), _unit(_across(across, first), across))
    # Once more: where both were nearly parallel, the first pass has lost most of its digits.
    second = _unit(_across(second, first), second)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def refuse_no_rotation(matrices: Float[np.ndarray, "*N 3 3"], where: str) -> None:
    """Raise DataError for a matrix that is no rotation; one that is not finite is a missing sample, and none of these.

    Args:
        matrices: that should be rotations.
        where: whose they are, for messages.
    """
    known = matrices[np.isfinite(matrices).all(axis=(-2, -1))].astype(np.float64)
    away = np.abs(known @ np.swapaxes(known, -1, -2) - np.eye(3)).max(axis=(-2, -1), initial=0.0)
    determinant = np.linalg.det(known)
    bad = (away > _ORTHONORMAL) | (determinant < 0)
    if bad.any():
        row = int(bad.argmax())
        raise DataError(
            f"{where}: a rotation is none",
            got=f"columns that miss being orthonormal by {away[row]:.2g}, determinant {determinant[row]:.3g}",
            expected="a rotation matrix, from the body's axes to the world's",
        )


def _across(vector: Float64[np.ndarray, "*N 3"], axis: Float64[np.ndarray, "*N 3"]) -> Float64[np.ndarray, "*N 3"]:
    """What is left of a vector without its part along a unit vector."""
    return np.asarray(vector - (vector * axis).sum(axis=-1, keepdims=True) * axis)


def _unit(vector: Float64[np.ndarray, "*N 3"], otherwise: Float64[np.ndarray, "*N 3"]) -> Float64[np.ndarray, "*N 3"]:
    # Scaled by its largest number first: squares of very large or small ones are not.
    size = np.abs(vector).max(axis=-1, keepdims=True)
    scaled = vector / np.where(size > 0, size, 1.0)
    length = np.sqrt((scaled**2).sum(axis=-1, keepdims=True))
    there = (size > _NONE) & np.isfinite(size)
    return np.where(there, scaled / np.where(length > 0, length, 1.0), otherwise)
