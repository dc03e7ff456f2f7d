"""Dilated convolutions over the last samples."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from trueup.augment.config import AugmentConfig, Method, NetworkConfig
from trueup.augment.graph import Graph
from trueup.augment.networks.base import Windowed, draw_linear
from trueup.errors import ConfigError


@dataclass(frozen=True)
class TcnConfig(NetworkConfig):
    """The options of every network, and its own.

    Attributes:
        kernel: samples that one layer looks at.
    """

    kernel: int = 3


class Tcn(Windowed):
    """Layers of convolutions, each with twice the dilation of the one before, and a dense one."""

    Config = TcnConfig

    def __init__(self, config: TcnConfig, inputs: int, base: Sequence[int], rate_hz: float) -> None:
        super().__init__(config, inputs, base, rate_hz)
        widths = itertools.pairwise((inputs, *config.hidden))
        self.layers = nn.ModuleList(
            nn.Conv1d(a, b, config.kernel, dilation=2**level) for level, (a, b) in enumerate(widths)
        )
        self.dense = nn.Linear(config.hidden[-1], self.outputs)
        self.past = (config.kernel - 1) * (2 ** len(self.layers) - 1)

    @classmethod
    def check(cls, config: NetworkConfig) -> None:
        """See `Network.check`."""
        super().check(config)
        if not config.hidden or not isinstance(config, TcnConfig) or config.kernel < 2:
            raise ConfigError("network: tcn needs a hidden layer and a kernel of two samples")

    def inner(self, x: Tensor) -> Tensor:
        """See `Windowed.inner`."""
        x = x.permute(1, 2, 0)
        for layer in self.layers:
            x = torch.relu(layer(x))
        out: Tensor = self.dense(x.permute(2, 0, 1))
        return torch.tanh(out) if self.tanh else out

    def draw_inner(self, graph: Graph, x: str) -> str:
        """See `Windowed.draw_inner`."""
        x = graph.add("Transpose", x, perm=[1, 2, 0])
        for level, layer in enumerate(self.layers):
            weights = (graph.floats(part.detach().numpy()) for part in layer.parameters())
            x = graph.add("Relu", graph.add("Conv", x, *weights, dilations=[2**level]))
        out = draw_linear(graph, self.dense, graph.add("Transpose", x, perm=[2, 0, 1]))
        return graph.add("Tanh", out) if self.tanh else out


KINDS = {"tcn": Tcn}


def methods() -> tuple[Method, ...]:
    """What `--method` chooses here."""
    config = TcnConfig("tcn", hidden=(32, 32, 32, 32))
    return (Method(AugmentConfig("tcn", config), "convolutions over the last 31 samples"),)
