"""What many uncertain numbers say of those that they were drawn from: mean and spread of a population."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from trueup.errors import DataError

_Z95 = 1.959963984540054
# An individual that far from where the others are is another kind of individual, in standard deviations.
_APART = 3.5


@dataclass(frozen=True, eq=False)
class Population:
    """A random-effects summary of K individuals.

    Attributes:
        mean: of the population.
        half_width: of the 95 % interval of the mean.
        spread: standard deviation between individuals, what their own uncertainty explains taken away; 0 where that
            explains all of it.
        apart: which individuals are not like the others, (K,).
    """

    mean: float
    half_width: float
    spread: float
    apart: Bool[np.ndarray, "K"]


def population(values: Float[np.ndarray, "K"], deviations: Float[np.ndarray, "K"]) -> Population:
    """Mean and spread by the method of moments (DerSimonian and Laird 1986, Controlled Clinical Trials 7).

    The spread is what remains of the scatter of the values when the uncertainty of each is taken away. An individual is
    apart when it is 3.5 robust standard deviations (1.4826 times the median absolute deviation) from the median, its
    own uncertainty counted.

    Args:
        values: one per individual.
        deviations: standard deviation of each, its own uncertainty.

    Raises:
        DataError: no individuals, or numbers that are not finite, or a deviation that is not positive.
    """
    values, deviations = np.asarray(values, float), np.asarray(deviations, float)
    if values.ndim != 1 or not values.size or values.shape != deviations.shape:
        raise DataError("a population", got=f"{values.shape} values, {deviations.shape} deviations", expected="as many")
    if not (np.isfinite(values).all() and np.isfinite(deviations).all() and (deviations > 0).all()):
        raise DataError("a population of numbers that are not finite, or have no uncertainty", got=values.tolist())
    # In units of the largest, so that no square is too small or too large to be one.
    scale = float(max(np.abs(values).max(), deviations.max()))
    x, variance = values / scale, np.maximum((deviations / scale) ** 2, 1e-30)
    weight = 1.0 / variance
    fixed = weight @ x / weight.sum()
    excess = weight @ (x - fixed) ** 2 - (x.size - 1)
    room = weight.sum() - weight @ weight / weight.sum()
    between = max(0.0, float(excess / room)) if x.size > 1 and room > 0 else 0.0
    weight = 1.0 / (variance + between)
    mean = float(weight @ x / weight.sum())
    middle = np.median(x)
    robust = 1.4826 * np.median(np.abs(x - middle))
    apart = np.abs(x - middle) > _APART * np.sqrt(robust**2 + variance)
    return Population(
        mean * scale,
        _Z95 * scale / float(np.sqrt(weight.sum())),
        float(np.sqrt(between)) * scale,
        apart if x.size > 2 else np.zeros(x.size, bool),
    )
