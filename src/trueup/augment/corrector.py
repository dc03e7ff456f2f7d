"""A network between SI values: normalization, network, sum with the simulator, gate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float64, Int
from torch import Tensor, nn

from trueup.augment.graph import Graph
from trueup.augment.networks.base import Network
from trueup.augment.scaling import Scaling, Stops
from trueup.core.model_card import State
from trueup.deploy.operator_weights import OperatorWeights
from trueup.deploy.sat_weights import SatWeights, Sizes

# How deep a joint can lean into its stop, in widths beyond the one before it.
_BEYOND = 2.0
# How many scales the origin of an input may be away from zero, so that float32 keeps five digits of their difference.
_NEAR = 64.0
# Likewise, of what an input is relative to.
_FAR = 512.0


class Corrector(nn.Module):
    """Corrects K of I simulated channels.

    Args:
        network: normalized inputs to normalized outputs.
        scaling: what "normalized" means.
        base: for each output the input that it corrects, (K,).
        target: what the network's output stands for: what is added to the simulator, or the signal itself.
        relative: for each input the one that is subtracted from it, -1 for none, (I,); none at all if None.
        stops: limits that the network feels; its inputs are one more for each.
    """

    center: Tensor
    scale: Tensor
    out_center: Tensor
    out_scale: Tensor
    loss_scale: Tensor
    base: Tensor
    gate: Tensor
    stop_index: Tensor
    stop_edge: Tensor
    stop_slope: Tensor
    other: Tensor
    has_other: Tensor

    def __init__(
        self,
        network: Network,
        scaling: Scaling,
        base: Int[np.ndarray, "K"],
        *,
        target: Literal["residual", "plain"],
        relative: Int[np.ndarray, "I"] | None = None,
        stops: Stops | None = None,
    ) -> None:
        super().__init__()
        self.network = network
        self.target = target
        for name in ("center", "scale", "out_center", "out_scale", "loss_scale"):
            self.register_buffer(name, torch.tensor(getattr(scaling, name), dtype=torch.float32))
        self.register_buffer("base", torch.tensor(base))
        others = np.full(len(scaling.center), -1) if relative is None else relative
        self._any_relative = bool((others >= 0).any())
        # Not in the file of weights: they follow from the card's channels.
        self.register_buffer("other", torch.tensor(others % len(others)), persistent=False)
        self.register_buffer("has_other", torch.tensor(others >= 0, dtype=torch.float32), persistent=False)
        stops = stops or Stops.none()
        self.register_buffer("stop_index", torch.tensor(stops.index))
        for name in ("edge", "slope"):
            self.register_buffer(f"stop_{name}", torch.tensor(getattr(stops, name), dtype=torch.float32))
        self.register_buffer("gate", torch.ones(base.size))

    def forward(self, x: Tensor, lengths: Tensor | None = None) -> Tensor:
        """Corrected outputs of whole motions: (T, B, I) to (T, B, K), SI."""
        base = x[..., self.base]
        out: Tensor = self.out_center + self.out_scale * self.network(self.read(x), lengths)
        corrected: Tensor = base + self.gate * (out if self.target == "residual" else out - base)
        return corrected

    def read(self, x: Tensor) -> Tensor:
        """What the network reads: normalized inputs, and how near they are to their limits, (T, B, I + N)."""
        shifted = x - x[..., self.other] * self.has_other if self._any_relative else x
        normalized: Tensor = (shifted - self.center) / self.scale
        if not len(self.stop_edge):
            return normalized
        near = (x[..., self.stop_index] - self.stop_edge) * self.stop_slope
        return torch.cat([normalized, near.clamp(0, _BEYOND)], dim=-1)

    def outputs(self, x: Tensor, y: Tensor, lengths: Tensor | None) -> tuple[Tensor, Tensor]:
        """What the network says without the gate, and what it should, normalized, (T, B, K); Realeasy, eq. 9 and 10."""
        known = x[..., self.base] if self.target == "residual" else self.out_center
        wanted: Tensor = (y - known) / self.out_scale
        read = self.read(x)
        out: Tensor = self.network.learn(read, wanted, lengths) if self.training else self.network(read, lengths)
        return out, wanted

    def set_gate(self, gate: Float64[np.ndarray, "K"]) -> None:
        """Set which outputs are used."""
        self.gate.copy_(torch.tensor(gate, dtype=torch.float32))

    @property
    def states(self) -> tuple[State, ...]:
        """What a stream carries: states of the network, and the raw samples of the past."""
        past = self.network.past
        buffer = State("past", (past, 1, len(self.center)), start="first")
        return (*self.network.states, *((buffer,) if past else ()))

    def exported(self, metadata: Mapping[str, str]) -> bytes:
        """The ONNX model as `core.model_card` describes it."""
        network, graph = self.network, Graph()
        samples: int | str = 1 if network.stepwise else "T"
        x = graph.input("x", [samples, "B", len(self.center)])
        shapes = [_named(state.shape, state.batch_axis) for state in self.states]
        given = [graph.input(state.name, shape) for state, shape in zip(self.states, shapes, strict=True)]
        seen, after_buffer = x, []
        if network.past:
            seen = graph.add("Concat", given.pop(), x, axis=0)
            bounds = (graph.integers([bound]) for bound in (-network.past, np.iinfo(np.int64).max, 0))
            after_buffer = [graph.add("Slice", seen, *bounds)]
        scale = torch.cat([1.0 / self.scale, self.stop_slope])
        origin = torch.cat([self.center, self.stop_edge])
        # x scale - origin scale is (x - origin) scale as long as both are not much larger than their difference.
        near = self._near
        left = origin if near else torch.zeros_like(origin)
        if self._mixable:
            read, factors = seen, self._mixed()
        else:
            read = self._bounded(graph, seen, origin - left)
            factors = torch.diag(scale) if network.mixes else scale
        out, after = network.draw_scaled(graph, read, given, factors, -left * scale, self.gate * self.out_scale)
        graph.output(self._summed(graph, x, out), "y", [samples, "B", network.outputs])
        for state, name, shape in zip(self.states, (*after, *after_buffer), shapes, strict=True):
            graph.output(name, f"{state.name}_out", shape)
        return graph.serialized(metadata)

    def step_weights(self) -> SatWeights | OperatorWeights | None:
        """The weights as machine code reads them; None where there is none that can run the network."""
        if self._mixable and self.target == "residual":
            return self.network.mixed_step(self._mixed(), -self.center / self.scale, self.gate * self.out_scale)
        own = self.network.step_weights()
        if own is None:
            return None
        sizes = Sizes(len(self.center), len(self.stop_edge), self.network.outputs, **own.sizes)
        other = torch.where(self.has_other > 0, self.other, -1)
        none = torch.zeros_like(self.gate)
        plain = self.target == "plain"
        rows = {
            # A factor, not what is divided by: of an input that is not read it is zero.
            "read.scaling": (self.center, 1.0 / self.scale, other),
            "read.stops": (self.stop_index, self.stop_edge, self.stop_slope),
            "write.sum": (
                self.base,
                1.0 - self.gate if plain else none + 1.0,
                self.gate * self.out_center,
                self.gate * self.out_scale,
            ),
        }
        given = {name: torch.stack([row.double() for row in group]).cpu().numpy() for name, group in rows.items()}
        return SatWeights.of(sizes, {**own.parts, **given})

    @property
    def _near(self) -> bool:
        """Whether float32 keeps five digits of inputs that are scaled before their origin is subtracted."""
        edges = self.stop_edge * self.stop_slope
        return bool(torch.cat([self.center / self.scale, edges]).abs().max() <= _NEAR)

    @property
    def _mixable(self) -> bool:
        """Whether float32 keeps four digits of differences of inputs whose parts go through weights one by one."""
        if not (self.network.mixes and self._near) or len(self.stop_edge):
            return False
        largest = (self.center.abs() + 3.0 * self.scale)[self.other] * self.has_other
        return bool((largest / self.scale).max() <= _FAR)

    def _mixed(self) -> Tensor:
        """What inputs are multiplied by so that they are relative and scaled, (I, I)."""
        rows = torch.arange(len(self.center))
        matrix = torch.diag(1.0 / self.scale)
        matrix[self.other, rows] -= self.has_other / self.scale
        return matrix

    def _bounded(self, graph: Graph, x: str, origin: Tensor) -> str:
        """`read` as nodes, without the factor of each input, and with no more of its origin than is said, (I + N,)."""
        if self._any_relative:
            other = graph.add("Gather", x, graph.integers(self.other.numpy()), axis=2)
            x = graph.add("Sub", x, graph.add("Mul", other, graph.floats(self.has_other.numpy())))
        count = len(self.stop_edge)
        if count:
            # What may be near a stop is a simulated position, and from those nothing was subtracted.
            rows = np.concatenate([np.arange(len(self.center)), self.stop_index.numpy()])
            x = graph.add("Gather", x, graph.integers(rows), axis=2)
        if origin.any():
            x = graph.add("Sub", x, graph.floats(origin.numpy()))
        if not count:
            return x
        bounds = np.full((2, len(origin)), np.inf) * [[-1], [1]]
        edge = self.stop_edge.numpy() - origin[-count:].numpy()
        bounds[:, -count:] = np.sort([edge, edge + _BEYOND / self.stop_slope.numpy()], axis=0)
        return graph.add("Min", graph.add("Max", x, graph.floats(bounds[0])), graph.floats(bounds[1]))

    def _summed(self, graph: Graph, x: str, out: str) -> str:
        """The simulator's signal, and the share of the network's correction that the gate lets pass."""
        base, gate = self.base.numpy(), self.gate.numpy()
        if not np.array_equal(base, np.arange(len(self.center))):
            x = graph.add("Gather", x, graph.integers(base), axis=2)
        if self.target == "plain":
            out = graph.add("Add", out, graph.floats(gate * self.out_center.numpy()))
            x = graph.add("Mul", x, graph.floats(1.0 - gate))
        return graph.add("Add", x, out)


def _named(shape: Sequence[int], batch_axis: int) -> list[int | str]:
    return ["B" if axis == batch_axis else size for axis, size in enumerate(shape)]
