"""The precise network in a control loop: everything that was simulated so far, corrected again at each call."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32

from trueup.deploy.predictor import Predictor
from trueup.errors import ConfigError, DataError


class History:
    """Realeasy's Algorithm 1: a network that looks both ways, over the samples so far.

    Each new sample changes the correction of those before it, so that a controller can decide on the whole series. A
    call costs as much as a whole motion of that length: for a cycle of a few hundred hertz, take a causal network and
    `Stream`.

    Args:
        predictor: the network.
        capacity: the most samples that are kept; memory for them is taken at once.
    """

    def __init__(self, predictor: Predictor, *, capacity: int) -> None:
        if capacity < 1:
            raise ConfigError("capacity of a history", got=capacity, expected="1 or more samples")
        self._predictor = predictor
        self._samples = np.zeros((capacity, 1, len(predictor.card.inputs)), np.float32)
        self._count = 0

    def __len__(self) -> int:
        """The number of samples so far."""
        return self._count

    def append(self, x: Float[np.ndarray, "I"]) -> None:
        """Add the input channels of the next sample, in the card's order, SI, (I,).

        Raises:
            DataError: the history is full, or the number of channels is another.
        """
        if self._count == len(self._samples):
            raise DataError("the history is full", got=f"{self._count} samples", hint="Make it with more capacity.")
        if x.shape != self._samples.shape[2:]:
            raise DataError("a sample of a history", got=f"shape {x.shape}", expected=self._samples.shape[2:])
        self._samples[self._count, 0] = x
        self._count += 1

    def corrected(self) -> Float32[np.ndarray, "T K"]:
        """The output channels of all samples so far; row -1 is the newest.

        Raises:
            DataError: nothing was added, or values are not finite.
        """
        return self._predictor.run(self._samples[: self._count])[:, 0]

    def clear(self) -> None:
        """Begin a new motion."""
        self._count = 0
