"""A trained network over whole motions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from trueup.core.model_card import ModelCard
from trueup.deploy.network import Network
from trueup.errors import DataError

# Samples that go through a network with states at a time: attention over a long motion at once would need memory with
# the square of its length.
_PIECE = 512


class Predictor:
    """Corrects motions from their first sample to their last; for networks of any kind.

    Args:
        network: an opened model folder.
    """

    def __init__(self, network: Network) -> None:
        self._network = network
        self._states = network.card.states
        self._outputs = ["y", *(f"{state.name}_out" for state in self._states)]

    @staticmethod
    def load(folder: Path | str) -> Predictor:
        """Open a model folder; the errors are those of `Network.load`."""
        return Predictor(Network.load(folder))

    def of_joints(self, joints: Sequence[str]) -> Predictor:
        """For a robot with these joints; see `ModelCard.of_joints`."""
        return Predictor(self._network.of_joints(joints))

    @property
    def card(self) -> ModelCard:
        """What the network says of itself."""
        return self._network.card

    def run(self, x: Float[np.ndarray, "T B I"]) -> Float32[np.ndarray, "T B K"]:
        """The corrected output channels.

        Every motion begins at a start: the first `card.warmup_steps` samples are less informed than those after them.

        Args:
            x: the input channels of B motions of equal length, in the card's order, SI, (T, B, I).

        Returns:
            The output channels in the card's order, SI, (T, B, K).

        Raises:
            DataError: another number of channels, nothing in it, or values that are not finite.
        """
        channels = self.card.inputs
        if x.ndim != 3 or x.shape[2] != len(channels) or 0 in x.shape:
            raise DataError(
                f"model {self.card.name!r} cannot read these motions",
                got=f"shape {x.shape}",
                expected=f"(T, B, {len(channels)}), T and B at least 1",
            )
        bad = ~np.isfinite(x)
        if bad.any():
            t, b, channel = (int(number) for number in np.argwhere(bad)[0])
            raise DataError(
                f"model {self.card.name!r} cannot read values that are not finite",
                got=f"{bad.sum()}, the first in {channels[channel].name}, sample {t} of motion {b}",
            )
        # The joints of a modular network stand side by side, like motions.
        split = (len(x), x.shape[1] * self.card.copies, -1)
        own = x.reshape(split)
        feed = {state.name: state.initial(own[0].astype(np.float64)) for state in self._states}
        piece = 1 if self._network.stepwise else _PIECE if self._states else len(x)
        parts = []
        for start in range(0, len(x), piece):
            feed["x"] = np.ascontiguousarray(own[start : start + piece], np.float32)
            y, *after = self._network.session.run(self._outputs, feed)
            feed |= {state.name: value for state, value in zip(self._states, after, strict=True)}
            parts.append(y)
        corrected: Float32[np.ndarray, "T B K"] = np.concatenate(parts).reshape(*x.shape[:2], -1)
        return corrected
