"""The moving average that every network must beat; nothing is trained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from trueup.augment.config import AugmentConfig, DataConfig, Method, NetworkConfig
from trueup.augment.graph import Graph
from trueup.augment.networks.base import States, Windowed
from trueup.errors import ConfigError


class MovingAverage(Windowed):
    """The mean of the corrected channels over a window, less the current value (LSTM thesis, 6.1).

    Configured as bidirectional, the window lies around the current sample, which needs the future, instead of before
    it; it is then one sample longer if its number is even, which would have no middle.
    """

    trained = False
    both_ends = True
    base: Tensor

    def __init__(self, config: NetworkConfig, inputs: int, base: Sequence[int], rate_hz: float) -> None:
        super().__init__(config, inputs, base, rate_hz)
        history, centered = config.samples(rate_hz), config.bidirectional
        self.past = 0 if centered else history - 1
        self.causal = not centered
        self.history = history | 1 if centered else history
        self.now = history // 2 if centered else self.past
        self.register_buffer("base", torch.tensor(list(base)))

    @classmethod
    def check(cls, config: NetworkConfig) -> None:
        """See `Network.check`."""
        super().check(config)
        if config.hidden:
            raise ConfigError("network: moving-average has no hidden layer", got=f"hidden: {list(config.hidden)}")
        if config.input_dropout or config.output_activation != "linear":
            raise ConfigError("network: a moving-average has nothing to train", got="input_dropout or tanh")

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


KINDS = {"moving-average": MovingAverage}


def methods() -> tuple[Method, ...]:
    """What `--method` chooses here."""
    # A mean of normalized values is the normalized mean only where input and output are normalized alike.
    as_it_is = DataConfig(normalization="limits", stops=False)
    centered = NetworkConfig("moving-average", (), bidirectional=True, history_s=0.5)
    return (
        Method(
            AugmentConfig("moving-average", centered, as_it_is, epochs=0),
            "mean over 0.5 s around each sample; nothing is trained (LSTM thesis, 6.1)",
        ),
        Method(
            AugmentConfig("moving-average-rt", replace(centered, bidirectional=False), as_it_is, epochs=0),
            "mean over the last 0.5 s",
        ),
    )
