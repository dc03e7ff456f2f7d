"""LSTM and GRU, forward ("real-time") or from both ends ("precise"); Realeasy, III-B and IV-C."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor, nn

from trueup.augment.config import AugmentConfig, Method, NetworkConfig
from trueup.augment.graph import Graph
from trueup.augment.networks.base import Network, SkipSamples, States, draw_linear
from trueup.core.model_card import State
from trueup.errors import ConfigError

# Where each gate of torch stands in ONNX: torch has input, forget, cell, output and reset, update, new.
_GATES = {"lstm": (0, 3, 1, 2), "gru": (1, 0, 2)}


class Recurrent(Network):
    """Recurrent layers and a dense one."""

    def __init__(self, config: NetworkConfig, inputs: int, base: Sequence[int], rate_hz: float) -> None:
        super().__init__(config, inputs, base, rate_hz)
        hidden, bidirectional = config.hidden, config.bidirectional
        self.causal = not bidirectional
        self.cell = config.kind
        self.hidden = hidden
        kind = nn.LSTM if config.kind == "lstm" else nn.GRU
        directions = 2 if bidirectional else 1
        widths = [inputs, *(directions * size for size in hidden)]
        self.forwards = nn.ModuleList(kind(width, size) for width, size in zip(widths, hidden, strict=False))
        self.backwards = nn.ModuleList(
            kind(width, size) for width, size in zip(widths, hidden, strict=False) if bidirectional
        )
        self.dense = nn.Linear(hidden[-1], self.outputs)
        self.skip = SkipSamples(config.input_dropout)
        self.recurrent_dropout = config.recurrent_dropout

    @classmethod
    def check(cls, config: NetworkConfig) -> None:
        """See `Network.check`."""
        if not config.hidden:
            raise ConfigError(f"network: {config.kind} needs a hidden layer")

    @property
    def states(self) -> tuple[State, ...]:
        """Hidden (and cell) state of each layer, (1, B, H)."""
        if not self.causal:
            return ()
        names = ("h", "c") if self.cell == "lstm" else ("h",)
        return tuple(State(f"{name}{layer}", (1, 1, size)) for layer, size in enumerate(self.hidden) for name in names)

    def run(self, x: Tensor, states: States, lengths: Tensor | None) -> tuple[Tensor, States]:
        """See `Network.run`."""
        x = self.skip(x)
        after: list[Tensor] = []
        per_layer = 2 if self.cell == "lstm" else 1
        turn = _turn(x.shape[0], lengths) if self.backwards else None
        for number, layer in enumerate(self.forwards):
            before = states[number * per_layer : (number + 1) * per_layer]
            forward, state = self._layer(layer, x, before)
            after += state
            if turn is None:
                x = forward
                continue
            # A motion turned around within its own length, so that padding stays behind it.
            backward, _ = self._layer(self.backwards[number], _turned(x, turn), ())
            backward = _turned(backward, turn)
            last = number == len(self.hidden) - 1
            x = forward + backward if last else torch.cat([forward, backward], dim=-1)
        out = self.dense(x)
        return torch.tanh(out) if self.tanh else out, tuple(after) if self.causal else ()

    def _layer(self, layer: nn.Module, x: Tensor, before: States) -> tuple[Tensor, list[Tensor]]:
        given: tuple[object, ...] = (x,)
        if before:
            given = (x, before if self.cell == "lstm" else before[0])
        if self.training and self.recurrent_dropout > 0:
            # Leaving units of the state out, the same ones at every step, is leaving out columns of U.
            weight = getattr(layer, "weight_hh_l0")  # noqa: B009  # nn.Module types it as a module
            assert isinstance(weight, Tensor)
            keep = 1 - self.recurrent_dropout
            columns = torch.rand(weight.shape[1], device=x.device).lt(keep) / keep
            out, state = torch.func.functional_call(layer, {"weight_hh_l0": weight * columns}, given)
        else:
            out, state = layer(*given)
        return out, list(state) if self.cell == "lstm" else [state]

    def draw(self, graph: Graph, x: str, states: Sequence[str]) -> tuple[str, tuple[str, ...]]:
        """See `Network.draw`."""
        after: list[str] = []
        per_layer = 2 if self.cell == "lstm" else 1
        for number, size in enumerate(self.hidden):
            layers = [self.forwards[number], *(self.backwards[number : number + 1])]
            weights = [onnx_weights(layer, self.cell) for layer in layers]
            before = list(states[number * per_layer : (number + 1) * per_layer])
            made = graph.add_many(
                self.cell.upper(),
                [x, *(graph.floats(torch.stack(part).numpy()) for part in zip(*weights, strict=True)), "", *before],
                1 + per_layer,
                hidden_size=size,
                direction="forward" if self.causal else "bidirectional",
                **({"linear_before_reset": 1} if self.cell == "gru" else {}),
            )
            after += made[1:]
            if self.causal:
                x = graph.add("Squeeze", made[0], graph.integers([1]))  # (T, directions, B, H)
            elif number == len(self.hidden) - 1:
                x = graph.add("ReduceSum", made[0], graph.integers([1]), keepdims=0)
            else:
                turned = graph.add("Transpose", made[0], perm=[0, 2, 1, 3])
                x = graph.add("Reshape", turned, graph.integers([0, 0, 2 * size]))
        x = draw_linear(graph, self.dense, x)
        return graph.add("Tanh", x) if self.tanh else x, tuple(after) if self.causal else ()

    def draw_scaled(
        self, graph: Graph, x: str, states: Sequence[str], inputs: Tensor, shift: Tensor, outputs: Tensor
    ) -> tuple[str, tuple[str, ...]]:
        """See `Network.draw_scaled`."""
        scaled = copy.deepcopy(self)
        with torch.no_grad():
            for layer in (*scaled.forwards[:1], *scaled.backwards[:1]):
                weight = layer.get_parameter("weight_ih_l0")
                layer.get_parameter("bias_ih_l0").add_(weight @ shift)
                weight.mul_(inputs)
            if not self.tanh:
                scaled.dense.weight.mul_(outputs[:, None])
                scaled.dense.bias.mul_(outputs)
        out, after = scaled.draw(graph, x, states)
        return graph.add("Mul", out, graph.floats(outputs.numpy())) if self.tanh else out, after


def onnx_weights(layer: nn.Module, cell: str) -> tuple[Tensor, Tensor, Tensor]:
    """Input weights, recurrent weights and both biases of an `lstm` or `gru`, gates in the order of ONNX."""
    order = _GATES[cell]

    def arranged(name: str) -> Tensor:
        parts = getattr(layer, name).detach().chunk(len(order))
        return torch.cat([parts[gate] for gate in order])

    biases = torch.cat([arranged("bias_ih_l0"), arranged("bias_hh_l0")])
    return arranged("weight_ih_l0"), arranged("weight_hh_l0"), biases


def _turn(samples: int, lengths: Tensor | None) -> Tensor:
    """Rows that turn each motion around, (T, B, 1); empty if all are full."""
    if lengths is None or bool((lengths == samples).all()):
        return torch.empty(0)
    rows = torch.arange(samples, device=lengths.device)[:, None]
    return torch.where(rows < lengths, lengths - 1 - rows, rows)[..., None]


def _turned(x: Tensor, turn: Tensor) -> Tensor:
    if turn.numel() == 0:
        return x.flip(0)
    return x.gather(0, turn.expand(-1, -1, x.shape[-1]))


KINDS = {"lstm": Recurrent, "gru": Recurrent}


def methods() -> tuple[Method, ...]:
    """What `--method` chooses here."""
    precise, real_time = AugmentConfig("realeasy", NetworkConfig(bidirectional=True)), AugmentConfig("realeasy-rt")
    return (
        Method(precise, '"precise" Realeasy: two LSTM layers that see a motion from both ends', paper=_paper(precise)),
        Method(real_time, '"real-time" Realeasy: two forward LSTM layers', paper=_paper(real_time)),
        Method(AugmentConfig("gru", NetworkConfig("gru")), "the same with GRU layers"),
    )


def _paper(config: AugmentConfig) -> AugmentConfig:
    """As the papers have it.

    Realeasy, IV and V; LSTM thesis, 3.2: (100, 21), 16 draws per trajectory and epoch, windows of half the shortest
    trajectory of the batch, RMSprop, 1e-4, reduced on plateaus.
    """
    return replace(
        config,
        network=replace(config.network, hidden=(100, 21)),
        data=replace(config.data, normalization="limits", stops=False),
        window=replace(config.window, rule="half-shortest", draws=16),
        loss=replace(config.loss, scale="normalized"),
        optimizer=replace(config.optimizer, name="rmsprop", rate=1e-4, schedule="plateau", weight_decay=0.0, clip=0.0),
        batch=16,
        epochs=50,
        stop_after=0,
    )
