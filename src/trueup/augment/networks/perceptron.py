"""Dense layers over the last samples, or a single one: MLP and linear."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from trueup.augment.config import AugmentConfig, Method, NetworkConfig
from trueup.augment.graph import Graph
from trueup.augment.networks.base import Windowed, draw_linear
from trueup.errors import ConfigError


class Perceptron(Windowed):
    """A linear map of the window, and dense layers with tanh between if there are hidden ones."""

    def __init__(self, config: NetworkConfig, inputs: int, base: Sequence[int], rate_hz: float) -> None:
        super().__init__(config, inputs, base, rate_hz)
        widths = [*config.hidden, self.outputs]
        self.window = nn.Conv1d(inputs, widths[0], self.past + 1)
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(widths))

    @classmethod
    def check(cls, config: NetworkConfig) -> None:
        """See `Network.check`."""
        super().check(config)
        if config.kind == "linear" and config.hidden:
            raise ConfigError("network: linear has no hidden layer", got=f"hidden: {list(config.hidden)}")

    def inner(self, x: Tensor) -> Tensor:
        """See `Windowed.inner`."""
        x = self.window(x.permute(1, 2, 0)).permute(2, 0, 1)
        for layer in self.layers:
            x = layer(torch.tanh(x))
        return torch.tanh(x) if self.tanh else x

    def draw_inner(self, graph: Graph, x: str) -> str:
        """See `Windowed.draw_inner`."""
        turned = graph.add("Transpose", x, perm=[1, 2, 0])
        weights = (graph.floats(part.detach().numpy()) for part in self.window.parameters())
        x = graph.add("Transpose", graph.add("Conv", turned, *weights), perm=[2, 0, 1])
        for layer in self.layers:
            x = draw_linear(graph, layer, graph.add("Tanh", x))
        return graph.add("Tanh", x) if self.tanh else x


KINDS = {"mlp": Perceptron, "linear": Perceptron}


def methods() -> tuple[Method, ...]:
    """What `--method` chooses here."""
    return (
        Method(
            AugmentConfig("mlp", NetworkConfig("mlp", (128, 128), history=20)), "dense layers over the last 20 samples"
        ),
        Method(AugmentConfig("linear", NetworkConfig("linear", ())), "one layer over the last 50 samples"),
    )
