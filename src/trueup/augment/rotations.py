"""Orientations as a network reads and writes them: the first two columns of the rotation matrix (SAT, V-A)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

# A direction shorter than this is none; two columns whose sine is below it span no plane.
_NONE = 1e-9


def six_of(rotation: Float[Tensor, "... 3 3"]) -> Float[Tensor, "... 6"]:
    """A rotation without its last column: the first column, then the second."""
    return torch.cat([rotation[..., 0], rotation[..., 1]], dim=-1)


def rotation_of(six: Float[Tensor, "... 6"]) -> Float[Tensor, "... 3 3"]:
    """The rotation whose first two columns are nearest in the order of Gram-Schmidt (SAT, V-A).

    Whatever the numbers: a first column of no length is taken for x, a second one along the first for the axis that is
    most across it. There a gradient means nothing, and is zero.
    """
    first, second = six[..., :3], six[..., 3:]
    axis_x = torch.zeros_like(first)
    axis_x[..., 0] = 1.0
    first = _unit(first, axis_x)
    across = torch.nn.functional.one_hot(first.abs().argmin(dim=-1), 3).to(six)
    second = _unit(_across(_unit(second, across), first), _unit(_across(across, first), across))
    # Once more: where both were nearly parallel, the first pass has lost most of its digits.
    second = _unit(_across(second, first), second)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def _across(vector: Tensor, axis: Tensor) -> Tensor:
    """What is left of a vector without its part along a unit vector."""
    return vector - (vector * axis).sum(dim=-1, keepdim=True) * axis


def _unit(vector: Tensor, otherwise: Tensor) -> Tensor:
    # Scaled by its largest number first: squares of very large or small ones are not.
    size = vector.detach().abs().amax(dim=-1, keepdim=True)
    scaled = vector / torch.where(size > 0, size, torch.ones_like(size))
    length = scaled.norm(dim=-1, keepdim=True)
    there = (size > _NONE) & torch.isfinite(size)
    return torch.where(there, scaled / torch.where(length > 0, length, torch.ones_like(length)), otherwise)
