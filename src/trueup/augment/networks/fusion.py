"""The parts of a temporal fusion transformer (Lim et al., "Temporal Fusion Transformers", 2021), as SAT uses them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from trueup.augment.graph import Graph
from trueup.augment.networks.base import draw_norm
from trueup.deploy.sat_weights import padded


class Gated(nn.Module):
    """A gated linear unit added to what it skips, normalized: TFT, eq. 5 and the end of eq. 2."""

    def __init__(self, inputs: int, width: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.dropout = nn.Dropout(dropout)
        self.both = nn.Linear(inputs, 2 * width)
        self.norm = nn.LayerNorm(width)

    def forward(self, x: Tensor, skipped: Tensor) -> Tensor:
        """(..., inputs) and (..., width) to (..., width)."""
        out: Tensor = self.norm(skipped + nn.functional.glu(self.both(self.dropout(x)), dim=-1))
        return out

    def step_weights(self, before: nn.Linear | None = None) -> dict[str, Tensor]:
        """For machine code; with a dense layer before it that is merged into its own."""
        own = linear(self.both) if before is None else _merged(before, self.both)
        return {**own, "norm": torch.stack([self.norm.weight, self.norm.bias])}

    def draw(self, graph: Graph, x: str, skipped: str) -> str:
        """The same as nodes, (B, inputs) and (B, width)."""
        gated = _draw_glu(graph, draw_gemm(graph, self.both, x))
        return draw_norm(graph, self.norm, graph.add("Add", gated, skipped))


class GatedResidual(nn.Module):
    """Two dense layers, gated, around which the input is led: TFT, eq. 2 to 4, without a context."""

    def __init__(self, inputs: int, width: int, outputs: int | None = None, dropout: float = 0.0) -> None:
        super().__init__()
        outputs = width if outputs is None else outputs
        self.first = nn.Linear(inputs, width)
        self.second = nn.Linear(width, width)
        self.gate = Gated(width, outputs, dropout)
        self.skip = nn.Identity() if inputs == outputs else nn.Linear(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(..., inputs) to (..., outputs)."""
        out: Tensor = self.gate(self.second(nn.functional.elu(self.first(x))), self.skip(x))
        return out

    def draw(self, graph: Graph, x: str) -> str:
        """The same as nodes, (B, inputs)."""
        inner = draw_gemm(graph, self.second, graph.add("Elu", draw_gemm(graph, self.first, x)))
        skipped = draw_gemm(graph, self.skip, x) if isinstance(self.skip, nn.Linear) else x
        return self.gate.draw(graph, inner, skipped)


class VariableSelection(nn.Module):
    """How much each of V numbers counts at this moment, and what it says: TFT, eq. 6 to 8.

    All numbers have the same two layers side by side, each with weights of its own.
    """

    def __init__(self, variables: int, width: int, dropout: float = 0.0) -> None:
        super().__init__()
        bound = width**-0.5
        self.spread = nn.Parameter(torch.empty(variables, width).uniform_(-1, 1))
        self.offset = nn.Parameter(torch.empty(variables, width).uniform_(-1, 1))
        self.inner = nn.Parameter(torch.empty(variables, width, 2 * width).uniform_(-bound, bound))
        self.inner_offset = nn.Parameter(torch.zeros(variables, 2 * width))
        self.norm = nn.LayerNorm(width)
        self.weigh = GatedResidual(variables, width, variables, dropout)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """(..., V) to what they say, (..., width), and how much each counted, (..., V)."""
        shares = torch.softmax(self.weigh(x), dim=-1)
        said = nn.functional.elu(x[..., None] * self.spread + self.offset)
        gated = nn.functional.glu(torch.einsum("...vw,vwu->...vu", said, self.inner) + self.inner_offset, dim=-1)
        return torch.einsum("...v,...vw->...w", shares, self.norm(said + gated)), shares

    def said(self, x: Tensor) -> Tensor:
        """The first of both."""
        out: Tensor = self(x)[0]
        return out

    def step_weights(self) -> dict[str, Tensor]:
        """For machine code."""
        first, weigh = linear(self.weigh.first), self.weigh.gate.step_weights(self.weigh.second)
        weigh |= {name: torch.cat([widened(half) for half in weigh[name].chunk(2, dim=1)], dim=1) for name in _WIDE}
        return {
            "first": first["weight"],
            "first_bias": first["bias"],
            **{f"weigh{name}": weigh[own] for name, own in (("", "weight"), ("_bias", "bias"), ("_norm", "norm"))},
            "spread": self.spread,
            "offset": self.offset,
            "inner": self.inner.flatten(0, 1),
            "inner_bias": self.inner_offset,
            "norm": torch.stack([self.norm.weight, self.norm.bias]),
        }

    def draw(self, graph: Graph, x: str) -> str:
        """What they say, as nodes, (B, V) to (B, W)."""
        shares = graph.add("Softmax", self.weigh.draw(graph, x), axis=-1)
        first, last = (graph.integers([axis]) for axis in (0, -1))
        column = graph.add("Unsqueeze", graph.add("Transpose", x, perm=[1, 0]), last)  # (V, B, 1)
        said = graph.add("Mul", column, graph.floats(self.spread.detach().numpy()[:, None]))
        said = graph.add("Elu", graph.add("Add", said, graph.floats(self.offset.detach().numpy()[:, None])))
        both = graph.add("MatMul", said, graph.floats(self.inner.detach().numpy()))
        both = graph.add("Add", both, graph.floats(self.inner_offset.detach().numpy()[:, None]))
        # Not by "Add": onnxruntime would make one node of sum and normalization, which takes four times as long as two.
        normed = draw_norm(graph, self.norm, graph.add("Sum", said, _draw_glu(graph, both)))
        weights = graph.add("Unsqueeze", graph.add("Transpose", shares, perm=[1, 0]), last)
        return graph.add("ReduceSum", graph.add("Mul", normed, weights), first, keepdims=0)


class Attention(nn.Module):
    """Interpretable attention: a query of each head, values that the heads share: TFT, eq. 13 to 16.

    Beside the score of a sample stands a bias of each head for how long ago it is. TFT has none: there a recurrent
    layer tells the order; here, the architectures without one must know it as well. What would be before the start of a
    motion has a key and a value of zero.

    Args:
        width: of what comes in and goes out.
        heads: number of heads.
        history: samples of the past that are seen besides the present one.
    """

    def __init__(self, width: int, heads: int, history: int) -> None:
        super().__init__()
        self.heads, self.history, self.inner = heads, history, width // heads
        self.query = nn.Linear(width, width)
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, self.inner)
        self.merge = nn.Linear(self.inner, width)
        self.lag = nn.Parameter(torch.zeros(heads, history + 1))

    def kept(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """What may be seen of samples (T, B, W): keys (T, B, heads, W / heads) and values (T, B, W / heads)."""
        return self.key(x).unflatten(-1, (self.heads, self.inner)), self.value(x)

    def forward(self, now: Tensor, past: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        """What samples of the present see of the past and of themselves.

        Args:
            now: N samples, (N, B, W).
            past: keys and values of history - 1 + N samples; the present sample n sees `history` from row n on.

        Returns:
            (N, B, W), and how much each sample counted, the oldest first, (N, B, history + 1): the mean of the heads.
        """
        key, value = past
        own_key, own_value = self.kept(now)
        query = self.query(now).unflatten(-1, (self.heads, self.inner)) * self.inner**-0.5
        # The scores of all pairs, then for each sample of the present the band of its own history.
        scores = torch.einsum("nbhw,mbhw->bhnm", query, key)
        band = torch.arange(len(now), device=now.device)[:, None] + torch.arange(self.history, device=now.device)
        scores = scores.gather(3, band.expand(*scores.shape[:2], -1, -1))
        own = torch.einsum("nbhw,nbhw->bhn", query, own_key)[..., None]
        weights = torch.softmax(torch.cat([scores, own], dim=-1) + self.lag[:, None, :], dim=-1).mean(dim=1)
        spread = weights.new_zeros(*weights.shape[:2], len(key))
        spread = spread.scatter(2, band.expand(len(weights), -1, -1), weights[..., : self.history])
        seen = torch.einsum("bnm,mbw->nbw", spread, value) + weights[..., -1].T[..., None] * own_value
        return self.merge(seen), weights.permute(1, 0, 2)

    def draw(self, graph: Graph, now: str, past: str, keys: str, values: str) -> tuple[str, str, str]:
        """One sample as nodes.

        Args:
            graph: that is drawn.
            now: the present, (B, W).
            past: the sample before it, (B, W).
            keys: of the history - 1 samples before that, (B, heads, history - 1, W / heads).
            values: likewise, (B, history - 1, W / heads).

        Returns:
            What is seen, (B, W), and keys and values for the next sample.
        """
        query, own, last = (
            graph.add("Reshape", draw_gemm(graph, layer, x), graph.integers([0, self.heads, -1, self.inner]))
            for layer, x in ((self.query, now), (self.key, now), (self.key, past))
        )
        keys = graph.add("Concat", keys, last, own, axis=2)
        value = [graph.add("Unsqueeze", draw_gemm(graph, self.value, x), graph.integers([1])) for x in (past, now)]
        values = graph.add("Concat", values, *value, axis=1)
        column = graph.add("Reshape", query, graph.integers([0, self.heads, self.inner, 1]))
        scores = graph.add("Mul", graph.add("MatMul", keys, column), graph.floats(self.inner**-0.5))
        scores = graph.add("Add", scores, graph.floats(self.lag.detach().numpy()[..., None]))
        scores = graph.add("Reshape", scores, graph.integers([0, self.heads, 1, self.history + 1]))
        weights = graph.add("ReduceMean", graph.add("Softmax", scores, axis=-1), axes=[1], keepdims=0)
        seen = graph.add("Squeeze", graph.add("MatMul", weights, values), graph.integers([1]))
        bounds = [graph.integers([bound]) for bound in (1, self.history)]
        after = [graph.add("Slice", rows, *bounds, graph.integers([axis])) for rows, axis in ((keys, 2), (values, 1))]
        return draw_gemm(graph, self.merge, seen), after[0], after[1]


def linear(layer: nn.Linear, factor: float = 1.0) -> dict[str, Tensor]:
    """A dense layer for machine code: weights (inputs, outputs) and biases (1, outputs)."""
    return {"weight": factor * layer.weight.double().T, "bias": factor * layer.bias.double()[None]}


_WIDE = ("weight", "bias")


def widened(x: Tensor) -> Tensor:
    """With columns of zeros up to what machine code takes at once."""
    return nn.functional.pad(x, (0, padded(x.shape[1]) - x.shape[1]))


def stacked(layers: Sequence[nn.Linear]) -> dict[str, Tensor]:
    """Dense layers of the same inputs side by side."""
    parts = [linear(layer) for layer in layers]
    return {name: torch.cat([part[name] for part in parts], dim=1) for name in parts[0]}


def _merged(first: nn.Linear, second: nn.Linear) -> dict[str, Tensor]:
    """Two dense layers with nothing between them as one."""
    before, after = linear(first), linear(second)
    return {"weight": before["weight"] @ after["weight"], "bias": before["bias"] @ after["weight"] + after["bias"]}


def draw_gemm(graph: Graph, layer: nn.Linear, x: str) -> str:
    """A dense layer on a matrix (B, inputs)."""
    weight, bias = (graph.floats(part.detach().numpy()) for part in (layer.weight, layer.bias))
    return graph.add("Gemm", x, weight, bias, transB=1)


def _draw_glu(graph: Graph, x: str) -> str:
    value, gate = graph.add_many("Split", [x], 2, axis=-1)
    return graph.add("Mul", value, graph.add("Sigmoid", gate))
