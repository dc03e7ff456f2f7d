"""How far corrected outputs can be trusted, by what training measured on motions that the network had not seen."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float64

from trueup.core.model_card import ModelCard, Output

# A simulator that is more likely than this to be far off is said to be.
FAR_OFF_PROBABILITY = 0.5


class Confidence:
    """Intervals and warnings as functions of the corrections, for any number of samples at once.

    Args:
        card: whose outputs carry the numbers; an output without them has an infinite interval, and a probability
            that is NaN.
    """

    def __init__(self, card: ModelCard) -> None:
        self._outputs = card.outputs
        unknown = (np.inf, 0.0)
        numbers = np.array([unknown if output.interval is None else output.interval for output in card.outputs])
        self._constant, self._slope = numbers.T.copy()
        self._limit = np.array([_far_limit(output) for output in card.outputs])

    def half_width(self, correction: Float[np.ndarray, "*shape K"]) -> Float64[np.ndarray, "*shape K"]:
        """Half widths of the intervals around the corrected outputs, in their units.

        Args:
            correction: corrected minus simulated, K last.
        """
        width: Float64[np.ndarray, "*shape K"] = self._constant + self._slope * np.abs(correction)
        return width

    def far_off(self, correction: Float[np.ndarray, "*shape K"]) -> Float64[np.ndarray, "*shape K"]:
        """Probability that the simulator is further off than the output's `far`, by the size of the correction."""
        out = np.full(correction.shape, np.nan)
        for number, output in enumerate(self._outputs):
            if output.far_correction:
                size = np.abs(correction[..., number])
                out[..., number] = np.interp(size, output.far_correction, output.far_probability)
        return out

    def is_far_off(self, correction: Float[np.ndarray, "*shape K"]) -> Bool[np.ndarray, "*shape K"]:
        """Whether that probability exceeds one half; cheaper than the probability itself."""
        far: Bool[np.ndarray, "*shape K"] = np.abs(correction) > self._limit
        return far


def _far_limit(output: Output) -> float:
    """The size of correction beyond which the simulator is more likely far off than not."""
    size, probability = np.array(output.far_correction), np.array(output.far_probability)
    above = np.flatnonzero(probability > FAR_OFF_PROBABILITY)
    if above.size == 0:
        return np.inf
    first = int(above[0])
    if first == 0:
        return -1.0
    share = (FAR_OFF_PROBABILITY - probability[first - 1]) / (probability[first] - probability[first - 1])
    return float(size[first - 1] + share * (size[first] - size[first - 1]))
