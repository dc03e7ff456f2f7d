"""A line under a network: what grows with an input goes on growing beyond the inputs that the network has seen.

A network says little of use outside of its training range, and less the farther away. A joint that carries a robot
gives way under loads that the same joint never carried in training, and mostly in proportion. So a line is fitted
first, by least squares; the network learns what it leaves, and is told the nearest input that it knows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int

from trueup.augment.pairs import Pairs
from trueup.augment.scaling import Scaling, Summary, counterparts

# Ridge, as a share of what a normalized input weighs: inputs that hardly differ share what they explain.
_RIDGE = 1e-3
# The network is told no input farther than this from the mean, in standard deviations: beyond, it has seen hardly any.
_FAR = 4.0


@dataclass(frozen=True, eq=False)
class Line:
    """Of normalized inputs and outputs.

    Attributes:
        weight: (K, I).
        bias: (K,).
        low: smallest normalized inputs that the network is told, (I,).
        high: largest, (I,).
    """

    weight: Float64[np.ndarray, "K I"]
    bias: Float64[np.ndarray, "K"]
    low: Float64[np.ndarray, "I"]
    high: Float64[np.ndarray, "I"]

    @staticmethod
    def blank(outputs: int, inputs: int) -> Line:
        """One that is to be filled in."""
        return Line(np.zeros((outputs, inputs)), np.zeros(outputs), np.zeros(inputs), np.zeros(inputs))

    @staticmethod
    def fitted(pairs: Pairs, summary: Summary, scaling: Scaling, base: Int[np.ndarray, "K"]) -> Line:
        """The line that explains most of what must be added, by least squares over all samples.

        Args:
            pairs: the train split.
            summary: of it.
            scaling: what "normalized" means.
            base: for each output the input that it corrects, (K,).
        """
        relative, width = counterparts(pairs.inputs), len(pairs.inputs)
        squares, products = np.zeros((width + 1, width + 1)), np.zeros((width + 1, base.size))
        low, high = np.full(width, np.inf), np.full(width, -np.inf)
        for _, x, y in pairs:
            read = (x - np.where(relative >= 0, x[:, relative], 0) - scaling.center) / scaling.scale
            low, high = np.minimum(low, read.min(axis=0)), np.maximum(high, read.max(axis=0))
            wanted = (y.astype(float) - x[:, base]) / scaling.out_scale
            with_one = np.column_stack([read, np.ones(len(read))])
            squares += with_one.T @ with_one
            products += with_one.T @ wanted
        ridge = np.diag([_RIDGE * squares[-1, -1]] * width + [0.0])
        found = np.linalg.solve(squares + ridge, products).T
        mean, deviation = (summary.mean - scaling.center) / scaling.scale, summary.deviation / scaling.scale
        return Line(
            weight=found[:, :-1],
            bias=found[:, -1],
            low=np.maximum(low, mean - _FAR * deviation),
            high=np.minimum(high, mean + _FAR * deviation),
        )
