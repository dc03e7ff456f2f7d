"""What networks that see the last samples share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

from torch import Tensor

from trueup.augment.config import NetworkConfig
from trueup.augment.graph import Graph
from trueup.augment.networks.base import Network, SkipSamples, States
from trueup.core.model_card import State


class Windowed(Network):
    """A network over the current sample and `past` earlier ones; by default those of the configured history."""

    def __init__(self, config: NetworkConfig, inputs: int, base: Sequence[int], rate_hz: float) -> None:
        super().__init__(config, inputs, base, rate_hz)
        self.past = config.samples(rate_hz) - 1
        self.skip = SkipSamples(config.input_dropout)

    @property
    def states(self) -> tuple[State, ...]:
        """None."""
        return ()

    @abstractmethod
    def inner(self, x: Tensor) -> Tensor:
        """Outputs (T, B, K) for (past + T, B, I)."""

    @abstractmethod
    def draw_inner(self, graph: Graph, x: str) -> str:
        """The same as nodes."""

    def run(self, x: Tensor, states: States, lengths: Tensor | None) -> tuple[Tensor, States]:
        """See `Network.run`."""
        del states, lengths  # the future, padding or not, is not seen
        return self.inner(self.skip(x)), ()

    def draw(self, graph: Graph, x: str, states: Sequence[str]) -> tuple[str, tuple[str, ...]]:
        """See `Network.draw`."""
        del states
        return self.draw_inner(graph, x), ()
