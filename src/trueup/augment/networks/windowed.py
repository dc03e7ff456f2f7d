"""Networks that see the last samples: linear, MLP, transformer, and the moving average that each must beat."""

from __future__ import annotations

import itertools
from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from trueup.augment.graph import Graph
from trueup.augment.networks.base import Network, SkipSamples, States, draw_linear
from trueup.core.model_card import State

_HIDDEN = -1e9  # of a sample that attention must not see


class Windowed(Network):
    """A network over the current sample and `past` earlier ones."""

    def __init__(self, inputs: int, outputs: int, *, past: int, input_dropout: float = 0.0) -> None:
        super().__init__(inputs, outputs)
        self.past = past
        self.skip = SkipSamples(input_dropout)

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


class Perceptron(Windowed):
    """A linear map of the window, and dense layers with tanh between if there are hidden ones."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        hidden: Sequence[int],
        history: int,
        input_dropout: float = 0.0,
        tanh: bool = False,
    ) -> None:
        super().__init__(inputs, outputs, past=history - 1, input_dropout=input_dropout)
        widths = [*hidden, outputs]
        self.window = nn.Conv1d(inputs, widths[0], history)
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(widths))
        self.tanh = tanh

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


class Transformer(Windowed):
    """Pre-norm encoder whose attention sees the last `history` samples of the layer below, with a bias per lag."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        width: int,
        depth: int,
        heads: int,
        history: int,
        input_dropout: float = 0.0,
        tanh: bool = False,
    ) -> None:
        super().__init__(inputs, outputs, past=depth * (history - 1), input_dropout=input_dropout)
        self.embed = nn.Linear(inputs, width)
        self.blocks = nn.ModuleList(_Block(width, heads, history) for _ in range(depth))
        self.norm = nn.LayerNorm(width)
        self.dense = nn.Linear(width, outputs)
        self.tanh = tanh

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
        x = draw_linear(graph, self.dense, _draw_norm(graph, self.norm, x))
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
        parts = draw_linear(graph, self.project, _draw_norm(graph, self.before, x))
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
        wide = graph.add("Relu", draw_linear(graph, self.widen, _draw_norm(graph, self.between, x)))
        return graph.add("Add", x, draw_linear(graph, self.narrow, wide))


class MovingAverage(Windowed):
    """The mean of the corrected channels over a window, less the current value (LSTM thesis, 6.1).

    Args:
        inputs: I.
        base: for each output the input that is averaged, (K,).
        history: samples of the window; one more if it is centered and the number even, which would have no middle.
        centered: around the current sample, which needs the future, instead of before it.
    """

    base: Tensor

    def __init__(self, inputs: int, base: Sequence[int], *, history: int, centered: bool) -> None:
        super().__init__(inputs, len(base), past=0 if centered else history - 1)
        self.causal = not centered
        self.history = history | 1 if centered else history
        self.now = history // 2 if centered else self.past
        self.register_buffer("base", torch.tensor(list(base)))

    def run(self, x: Tensor, states: States, lengths: Tensor | None) -> tuple[Tensor, States]:
        """See `Network.run`."""
        if self.causal:
            return super().run(x, states, lengths)
        before, after = self.now, self.history - 1 - self.now
        if lengths is not None:  # beyond its end stands a motion's last sample
            rows = torch.arange(x.shape[0])[:, None].minimum(lengths.cpu() - 1).to(x.device)
            x = x.gather(0, rows[..., None].expand(-1, -1, x.shape[-1]))
        return self.inner(torch.cat([x[:1].expand(before, -1, -1), x, x[-1:].expand(after, -1, -1)])), ()

    def inner(self, x: Tensor) -> Tensor:
        """See `Windowed.inner`."""
        x = x[..., self.base]
        mean = nn.functional.avg_pool1d(x.permute(1, 2, 0), self.history, stride=1).permute(2, 0, 1)
        difference: Tensor = mean - x[self.now : self.now + mean.shape[0]]
        return difference

    def draw(self, graph: Graph, x: str, states: Sequence[str]) -> tuple[str, tuple[str, ...]]:
        """See `Network.draw`."""
        if self.causal:
            return super().draw(graph, x, states)
        ends = [
            graph.add("Slice", x, graph.integers([a]), graph.integers([b]), graph.integers([0]))
            for a, b in ((0, 1), (-1, np.iinfo(np.int64).max))
        ]
        copies = (self.now, self.history - 1 - self.now)
        padding = [
            graph.add("Tile", end, graph.integers([count, 1, 1])) for end, count in zip(ends, copies, strict=True)
        ]
        return self.draw_inner(graph, graph.add("Concat", padding[0], x, padding[1], axis=0)), ()

    def draw_inner(self, graph: Graph, x: str) -> str:
        """See `Windowed.draw_inner`."""
        x = graph.add("Gather", x, graph.integers(self.base.numpy()), axis=2)
        turned = graph.add("Transpose", x, perm=[1, 2, 0])
        pooled = graph.add("AveragePool", turned, kernel_shape=[self.history])
        mean = graph.add("Transpose", pooled, perm=[2, 0, 1])
        end = self.history - 1 - self.now
        stop = graph.integers([-end if end else np.iinfo(np.int64).max])
        here = graph.add("Slice", x, graph.integers([self.now]), stop, graph.integers([0]))
        return graph.add("Sub", mean, here)


def _draw_norm(graph: Graph, norm: nn.LayerNorm, x: str) -> str:
    parts = (graph.floats(part.detach().numpy()) for part in (norm.weight, norm.bias))
    return graph.add("LayerNormalization", x, *parts, axis=-1, epsilon=norm.eps)
