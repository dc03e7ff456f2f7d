"""What training, export and runtime expect of a network."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from trueup.augment.config import NetworkConfig
from trueup.augment.graph import Graph
from trueup.core.model_card import State
from trueup.deploy.operator_weights import OperatorWeights
from trueup.errors import ConfigError

States = tuple[Tensor, ...]
# Samples that a network without a state works on at a time.
_PIECE = 512


@dataclass(frozen=True, eq=False)
class StepWeights:
    """A network's part of what `deploy.sat_weights` holds.

    Attributes:
        sizes: the fields of `Sizes` that the network knows.
        parts: matrices by their names in `Sizes.shapes`.
    """

    sizes: Mapping[str, int]
    parts: Mapping[str, np.ndarray]


class Network(nn.Module, ABC):
    """Normalized inputs (T, B, I) to normalized outputs (T, B, K), time first.

    Args:
        config: kind and sizes.
        inputs: number of input channels, I.
        base: for each output channel the input that it corrects, (K,).
        rate_hz: samples per second, for windows that are given in seconds.

    Attributes:
        Config: the options that it takes; a subclass of `NetworkConfig` where it has options of its own.
        trained: whether there is anything to train.
        both_ends: whether it can be configured as bidirectional.
        inputs: I.
        outputs: K.
        causal: whether it needs no sample of the future.
        past: samples before the current one that it sees besides.
        stepwise: whether its graph takes one sample at a time.
        one_by_one: whether `forward` does, too.
        tanh: whether the output is bounded.
        mixes: whether `draw_scaled` takes a matrix for the inputs.
    """

    Config: ClassVar[type[NetworkConfig]] = NetworkConfig
    trained: ClassVar[bool] = True
    both_ends: ClassVar[bool] = False
    mixes: ClassVar[bool] = False
    causal: bool = True
    past: int = 0
    stepwise: bool = False
    one_by_one: bool = False

    def __init__(self, config: NetworkConfig, inputs: int, base: Sequence[int], rate_hz: float) -> None:
        del rate_hz
        super().__init__()
        self.inputs = inputs
        self.outputs = len(base)
        self.tanh = config.output_activation == "tanh"

    @classmethod
    def check(cls, config: NetworkConfig) -> None:
        """Refuse, by ConfigError, what this kind cannot use; here, a recurrence's dropout and the second direction."""
        if config.recurrent_dropout:
            raise ConfigError(f"network: {config.kind} has no recurrence", got="recurrent_dropout")
        if config.bidirectional and not cls.both_ends:
            raise ConfigError(f"network: {config.kind} has one direction only", got="bidirectional: true")

    @property
    @abstractmethod
    def states(self) -> tuple[State, ...]:
        """What a stream carries from sample to sample besides the `past` samples; empty if not causal."""

    @abstractmethod
    def run(self, x: Tensor, states: States, lengths: Tensor | None) -> tuple[Tensor, States]:
        """Outputs and the states after the last sample.

        Args:
            x: (past + T, B, I); rows at and beyond a motion's length are padding and must not matter to the others.
            states: tensors of the shapes in `states`.
            lengths: valid samples of each of the B motions, (B,); None if all are.
        """

    @property
    def reach(self) -> int:
        """Samples before the current one that it looks at one by one; 0 where it remembers them only."""
        return self.past

    def begin(self, epoch: int, epochs: int) -> None:
        """Called before each epoch of a training, the first is 1."""

    def learn(self, x: Tensor, wanted: Tensor, lengths: Tensor | None) -> Tensor:
        """Outputs in training (T, B, K), where it is known what they should be; `forward`, unless that is of use.

        Several numbers for each output, (T, B, Q, K), are quantiles.
        """
        del wanted
        out: Tensor = self(x, lengths)
        return out

    @abstractmethod
    def draw(self, graph: Graph, x: str, states: Sequence[str]) -> tuple[str, tuple[str, ...]]:
        """The same as nodes of an ONNX graph; returns the names of the output and of the new states."""

    def draw_scaled(
        self, graph: Graph, x: str, states: Sequence[str], inputs: Tensor, shift: Tensor, outputs: Tensor
    ) -> tuple[str, tuple[str, ...]]:
        """`draw` of `x * inputs + shift`, both (I,), with its output multiplied by `outputs`, (K,).

        Networks with `mixes` get a matrix, (I, I), and draw `x @ inputs + shift`.

        Networks that are run in a control loop have all of it in their weights: there, every node counts.
        """
        x = graph.add("Mul", x, graph.floats(inputs.numpy()))
        if shift.any():
            x = graph.add("Add", x, graph.floats(shift.numpy()))
        out, after = self.draw(graph, x, states)
        return graph.add("Mul", out, graph.floats(outputs.numpy())), after

    def step_weights(self) -> StepWeights | None:
        """What machine code for its step needs; None where there is none, and the graph is all."""
        return None

    def mixed_step(self, inputs: Tensor, shift: Tensor, outputs: Tensor) -> OperatorWeights | None:
        """The same of networks with `mixes`, for inputs and outputs as in `draw_scaled`."""
        del inputs, shift, outputs
        return None

    def initial(self, first: Tensor) -> States:
        """The states before the first sample, (B, I)."""
        made = []
        for state in self.states:
            shape = list(state.shape)
            shape[state.batch_axis] = first.shape[0]
            made.append(first.new_zeros(shape))
        return tuple(made)

    def forward(self, x: Tensor, lengths: Tensor | None = None) -> Tensor:
        """Outputs of B motions from their starts, (T, B, I) to (T, B, K).

        Before its start stands the first sample of a motion, again and again.
        """
        if not self.past:
            return self.run(x, self.initial(x[0]), lengths)[0]
        seen = torch.cat([x[:1].expand(self.past, -1, -1), x])
        # Attention over a long motion at once would need memory with the square of its length.
        parts = [
            self.run(seen[start : start + self.past + _PIECE], self.initial(x[0]), None)[0]
            for start in range(0, len(x), _PIECE)
        ]
        return torch.cat(parts)


class SkipSamples(nn.Module):
    """Input dropout: whole samples are left out in training (Realeasy, IV-C: "if x_t is skipped")."""

    def __init__(self, share: float) -> None:
        super().__init__()
        self.share = share

    def forward(self, x: Tensor) -> Tensor:
        """(T, B, I) with some samples zero, and the others larger by as much."""
        if not self.training or self.share == 0:
            return x
        kept = torch.rand(*x.shape[:2], 1, device=x.device) >= self.share
        return x * kept / (1 - self.share)


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


def draw_linear(graph: Graph, layer: nn.Module, x: str) -> str:
    """The nodes of a dense layer."""
    assert isinstance(layer, nn.Linear)
    x = graph.add("MatMul", x, graph.floats(layer.weight.detach().T.numpy()))
    return graph.add("Add", x, graph.floats(layer.bias.detach().numpy()))


def draw_norm(graph: Graph, norm: nn.LayerNorm, x: str) -> str:
    """The node of a normalization of the last axis."""
    parts = (graph.floats(part.detach().numpy()) for part in (norm.weight, norm.bias))
    return graph.add("LayerNormalization", x, *parts, axis=-1, epsilon=norm.eps)
