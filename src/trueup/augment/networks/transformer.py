"""Attention over the last samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from trueup.augment.config import AugmentConfig, Method, NetworkConfig
from trueup.augment.graph import Graph
from trueup.augment.networks.base import Windowed, draw_linear, draw_norm
from trueup.errors import ConfigError

_HIDDEN = -1e9  # of a sample that attention must not see


class Transformer(Windowed):
    """Pre-norm encoder whose attention sees the last `history` samples of the layer below, with a bias per lag."""

    def __init__(self, config: NetworkConfig, inputs: int, base: Sequence[int], rate_hz: float) -> None:
        super().__init__(config, inputs, base, rate_hz)
        width, history = config.hidden[0], config.samples(rate_hz)
        self.past = len(config.hidden) * (history - 1)
        self.embed = nn.Linear(inputs, width)
        self.blocks = nn.ModuleList(_Block(width, config.heads, history) for _ in config.hidden)
        self.norm = nn.LayerNorm(width)
        self.dense = nn.Linear(width, self.outputs)

    @classmethod
    def check(cls, config: NetworkConfig) -> None:
        """See `Network.check`."""
        super().check(config)
        if not config.hidden:
            raise ConfigError("network: transformer needs a hidden layer")
        if config.heads < 1 or any(size % config.heads for size in config.hidden):
            raise ConfigError(
                "network: hidden of a transformer", got=config.hidden, expected=f"multiples of {config.heads}"
            )
        if len(set(config.hidden)) > 1:
            raise ConfigError("network: the layers of a transformer are equally wide", got=config.hidden)

    def inner(self, x: Tensor) -> Tensor:
        """See `Windowed.inner`."""
        x = self.embed(x)
        for block in self.blocks:
            x = block(x)
        x = self.dense(self.norm(x[self.past :]))
        return torch.tanh(x) if self.tanh else x

    def draw_inner(self, graph: Graph, x: str) -> str:
        """See `Windowed.draw_inner`."""
        x = draw_linear(graph, self.embed, x)
        for block in self.blocks:
            assert isinstance(block, _Block)
            x = block.draw(graph, x)
        if self.past:
            end = graph.integers([np.iinfo(np.int64).max])
            x = graph.add("Slice", x, graph.integers([self.past]), end, graph.integers([0]))
        x = draw_linear(graph, self.dense, draw_norm(graph, self.norm, x))
        return graph.add("Tanh", x) if self.tanh else x


class _Block(nn.Module):
    """Attention over the last `history` samples, then a dense layer, each added to what comes in."""

    def __init__(self, width: int, heads: int, history: int) -> None:
        super().__init__()
        self.heads = heads
        self.history = history
        self.before = nn.LayerNorm(width)
        self.project = nn.Linear(width, 3 * width)
        self.merge = nn.Linear(width, width)
        self.lag = nn.Parameter(torch.zeros(heads, history))
        self.between = nn.LayerNorm(width)
        self.widen = nn.Linear(width, 2 * width)
        self.narrow = nn.Linear(2 * width, width)

    def forward(self, x: Tensor) -> Tensor:
        """(T, B, W) to the same."""
        samples, batch, width = x.shape
        parts = self.project(self.before(x)).view(samples, batch, 3, self.heads, width // self.heads)
        query, key, value = parts.permute(2, 1, 3, 0, 4)  # (B, heads, T, W / heads)
        seen = nn.functional.scaled_dot_product_attention(query, key, value, attn_mask=self._bias(samples))
        x = x + self.merge(seen.permute(2, 0, 1, 3).reshape(samples, batch, width))
        out: Tensor = x + self.narrow(torch.relu(self.widen(self.between(x))))
        return out

    def _bias(self, samples: int) -> Tensor:
        """Bias of each pair of samples, (heads, T, T)."""
        rows = torch.arange(samples, device=self.lag.device)
        lags = (rows[:, None] - rows[None, :] + 1).clamp(0, self.history + 1)
        bias: Tensor = self._table()[:, lags]
        return bias

    def _table(self) -> Tensor:
        """Bias by lag + 1, with what must not be seen at both ends, (heads, history + 2)."""
        outside = self.lag.new_full((self.heads, 1), _HIDDEN)
        return torch.cat([outside, self.lag, outside], dim=1)

    def draw(self, graph: Graph, x: str) -> str:
        """The same as nodes."""
        width = self.merge.in_features
        inner = width // self.heads
        parts = draw_linear(graph, self.project, draw_norm(graph, self.before, x))
        parts = graph.add("Reshape", parts, graph.integers([0, 0, 3, self.heads, inner]))
        query, key, value = graph.add_many(
            "Split", [graph.add("Transpose", parts, perm=[2, 1, 3, 0, 4]), graph.integers([1, 1, 1])], 3, axis=0
        )
        first = graph.integers([0])
        query, key, value = (graph.add("Squeeze", part, first) for part in (query, key, value))
        scores = graph.add("MatMul", query, graph.add("Transpose", key, perm=[0, 1, 3, 2]))
        scores = graph.add("Mul", scores, graph.floats(inner**-0.5))
        count = graph.add("Squeeze", graph.add("Shape", x, start=0, end=1), first)
        rows = graph.add("Range", graph.integers(0), count, graph.integers(1))
        column = graph.add("Unsqueeze", rows, graph.integers([1]))
        lags = graph.add("Add", graph.add("Sub", column, rows), graph.integers(1))
        lags = graph.add("Clip", lags, graph.integers(0), graph.integers(self.history + 1))
        bias = graph.add("Gather", graph.floats(self._table().detach().numpy()), lags, axis=1)
        weights = graph.add("Softmax", graph.add("Add", scores, bias), axis=-1)
        seen = graph.add("Transpose", graph.add("MatMul", weights, value), perm=[2, 0, 1, 3])
        seen = graph.add("Reshape", seen, graph.integers([0, 0, width]))
        x = graph.add("Add", x, draw_linear(graph, self.merge, seen))
        wide = graph.add("Relu", draw_linear(graph, self.widen, draw_norm(graph, self.between, x)))
        return graph.add("Add", x, draw_linear(graph, self.narrow, wide))


KINDS = {"transformer": Transformer}


def methods() -> tuple[Method, ...]:
    """What `--method` chooses here."""
    return (
        Method(
            AugmentConfig("transformer", NetworkConfig("transformer", (64, 64), history=25)),
            "two layers of attention over the last 25 samples each",
        ),
    )
