"""Base parameters: the combinations of link parameters that joint torques depend on.

Torques of a chain cannot tell all ten parameters of each link; the regressor has dependent columns. Going from the
base to the tip, a column is kept if those before it do not span it, so that what cannot be told of a link is grouped
with the links before it (Khalil and Bennis 1995, "Symbolic calculation of the base inertial parameters"; numerically as
Gautier 1991, "Numerical calculation of the base inertial parameters of robots").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

_SHOWN = 1e-6  # coefficients below this share of one are rounding errors


@dataclass(frozen=True, eq=False)
class BaseStructure:
    """How P parameters combine into K base parameters.

    Attributes:
        names: names of the P parameters.
        kept: numbers of the parameters after which the base parameters are called, increasing.
        groups: base = groups @ parameters, (K, P), with the unit matrix in the kept columns.
    """

    names: tuple[str, ...]
    kept: tuple[int, ...]
    groups: Float64[np.ndarray, "K P"]

    @property
    def rank(self) -> int:
        """The number K of base parameters."""
        return len(self.kept)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Parameters that no torque depends on."""
        return tuple(name for name, column in zip(self.names, self.groups.T, strict=True) if not column.any())

    def expression(self, number: int) -> str:
        """A base parameter in words, e.g. `upper_arm.Iyy + 0.0625 forearm.m`."""
        text = self.names[self.kept[number]]
        for name, weight in zip(self.names, self.groups[number], strict=True):
            if name == self.names[self.kept[number]] or weight == 0.0:
                continue
            size = "" if abs(abs(weight) - 1.0) < _SHOWN else f"{abs(weight):.6g} "
            text += f" {'+' if weight > 0 else '-'} {size}{name}"
        return text


def find_base(regressor: Float64[np.ndarray, "N P"], names: Sequence[str], *, tolerance: float = 1e-8) -> BaseStructure:
    """Group the columns of a regressor.

    Args:
        regressor: rows of random states show what the mechanism can tell, rows of a motion what the motion can.
        names: one per column.
        tolerance: a column is dependent if what the others leave over of it is below this share of its length.
    """
    triangle = np.linalg.qr(regressor, mode="r")
    sizes = np.linalg.norm(triangle, axis=0)
    seen = sizes > tolerance * sizes.max()
    columns = triangle / np.where(seen, sizes, 1.0)
    kept: list[int] = []
    basis = np.zeros((len(triangle), 0))
    for number in np.flatnonzero(seen):
        left = columns[:, number]
        for _ in range(2):  # once more, or rounding errors of nearly dependent columns add up
            left = left - basis @ (basis.T @ left)
        size = float(np.linalg.norm(left))
        if size > tolerance:
            kept.append(int(number))
            basis = np.column_stack([basis, left / size])
    weights = np.linalg.lstsq(columns[:, kept], columns, rcond=None)[0]
    weights[np.abs(weights) < np.sqrt(tolerance)] = 0.0
    groups = np.where(seen, weights * sizes / sizes[kept][:, None], 0.0)
    groups[:, kept] = np.eye(len(kept))
    return BaseStructure(tuple(names), tuple(kept), groups)
