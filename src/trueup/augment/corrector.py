"""A network between SI values: normalization, network, sum with the simulator, gate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float64, Int
from torch import Tensor, nn

from trueup.augment.graph import Graph
from trueup.augment.networks import Network
from trueup.augment.scaling import Scaling
from trueup.core.model_card import State


class Corrector(nn.Module):
    """Corrects K of I simulated channels.

    Args:
        network: normalized inputs to normalized outputs.
        scaling: what "normalized" means.
        base: for each output the input that it corrects, (K,).
        target: what the network's output stands for: what is added to the simulator, or the signal itself.
    """

    center: Tensor
    scale: Tensor
    out_center: Tensor
    out_scale: Tensor
    loss_scale: Tensor
    base: Tensor
    gate: Tensor

    def __init__(
        self, network: Network, scaling: Scaling, base: Int[np.ndarray, "K"], *, target: Literal["residual", "plain"]
    ) -> None:
        super().__init__()
        self.network = network
        self.target = target
        for name in ("center", "scale", "out_center", "out_scale", "loss_scale"):
            self.register_buffer(name, torch.tensor(getattr(scaling, name), dtype=torch.float32))
        self.register_buffer("base", torch.tensor(base))
        self.register_buffer("gate", torch.ones(base.size))

    def forward(self, x: Tensor, lengths: Tensor | None = None) -> Tensor:
        """Corrected outputs of whole motions: (T, B, I) to (T, B, K), SI."""
        base = x[..., self.base]
        out: Tensor = self.out_center + self.out_scale * self.network((x - self.center) / self.scale, lengths)
        corrected: Tensor = base + self.gate * (out if self.target == "residual" else out - base)
        return corrected

    def squares(self, x: Tensor, y: Tensor, lengths: Tensor | None) -> Tensor:
        """Squared errors in units of the loss, (T, B, K), without the gate: what training minimizes (eq. 9, 10)."""
        out = self.network((x - self.center) / self.scale, lengths)
        known = x[..., self.base] if self.target == "residual" else self.out_center
        error: Tensor = out - (y - known) / self.out_scale
        return (error * (self.out_scale / self.loss_scale)) ** 2

    def set_gate(self, gate: Float64[np.ndarray, "K"]) -> None:
        """Set which outputs are used."""
        self.gate.copy_(torch.tensor(gate, dtype=torch.float32))

    @property
    def states(self) -> tuple[State, ...]:
        """What a stream carries: states of the network, and the raw samples of the past."""
        past = self.network.past
        buffer = State("past", (past, 1, self.network.inputs), start="first")
        return (*self.network.states, *((buffer,) if past else ()))

    def exported(self, metadata: Mapping[str, str]) -> bytes:
        """The ONNX model as `core.model_card` describes it."""
        network, graph = self.network, Graph()
        x = graph.input("x", ["T", "B", network.inputs])
        shapes = [_named(state.shape, state.batch_axis) for state in self.states]
        given = [graph.input(state.name, shape) for state, shape in zip(self.states, shapes, strict=True)]
        seen, after_buffer = x, []
        if network.past:
            seen = graph.add("Concat", given.pop(), x, axis=0)
            bounds = (graph.integers([bound]) for bound in (-network.past, np.iinfo(np.int64).max, 0))
            after_buffer = [graph.add("Slice", seen, *bounds)]
        normalized = graph.add("Sub", seen, graph.floats(self.center.numpy()))
        normalized = graph.add("Mul", normalized, graph.floats((1.0 / self.scale).numpy()))
        out, after = network.draw(graph, normalized, given)
        graph.output(self._summed(graph, x, out), "y", ["T", "B", network.outputs])
        for state, name, shape in zip(self.states, (*after, *after_buffer), shapes, strict=True):
            graph.output(name, f"{state.name}_out", shape)
        return graph.serialized(metadata)

    def _summed(self, graph: Graph, x: str, out: str) -> str:
        """The simulator's signal, and the share of the network's correction that the gate lets pass."""
        base, gate = self.base.numpy(), self.gate.numpy()
        if not np.array_equal(base, np.arange(self.network.inputs)):
            x = graph.add("Gather", x, graph.integers(base), axis=2)
        out = graph.add("Mul", out, graph.floats(gate * self.out_scale.numpy()))
        if self.target == "plain":
            out = graph.add("Add", out, graph.floats(gate * self.out_center.numpy()))
            x = graph.add("Mul", x, graph.floats(1.0 - gate))
        return graph.add("Add", x, out)


def _named(shape: Sequence[int], batch_axis: int) -> list[int | str]:
    return ["B" if axis == batch_axis else size for axis, size in enumerate(shape)]
