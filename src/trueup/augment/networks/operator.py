"""A nonlinear operator: from how the simulator would respond, and a query, to what a command lacks (GapONet, 4).

The sensor predictor S says from the last states and commands how far the simulator would move under each of k fixed
commands (eq. 2, 7); the branch B reads that, the trunk T the current command and the condition (eq. 3, 4). The output
for a joint is an inner product of p features of either (eq. 5). Inputs are position, velocity and command of J joints,
then the conditions, then, where they are not predicted, the sensors' values.

Nothing nonlinear stands between predictor and branch; a graph has both as one layer, the same with half the work.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from trueup.augment.config import Method, NetworkConfig
from trueup.augment.graph import Graph
from trueup.augment.networks.base import Windowed
from trueup.deploy.operator_weights import OperatorWeights
from trueup.errors import ConfigError

_Dense = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class OperatorConfig(NetworkConfig):
    """The options of an operator; `hidden` are the layers of its branch, `history` the samples with the current one.

    Attributes:
        features: of branch and trunk for each joint, p.
        trunk: units of its layers.
        sensors: number of fixed commands whose effects are predicted, k.
        predictor: units of its layers.
        senses: `predicted` from the history (eq. 7), `true` ones as inputs, or `none`: the branch reads the history.
        current: what the predictor reads of the current sample; that and three numbers of each earlier one.
        conditioned: whether the trunk reads conditions, such as a payload.
    """

    kind: str = "operator"
    hidden: tuple[int, ...] = (128, 128, 128)
    history: int = 5
    features: int = 16
    trunk: tuple[int, ...] = (64, 64)
    sensors: int = 20
    predictor: tuple[int, ...] = (128,)
    senses: Literal["predicted", "true", "none"] = "predicted"
    current: tuple[str, ...] = ("position", "velocity")
    conditioned: bool = True

    def __post_init__(self) -> None:
        """Refuse what makes no operator."""
        super().__post_init__()
        sizes = (*self.trunk, *self.predictor, self.features, self.sensors)
        if min(sizes) < 1 or not self.hidden or not self.trunk or not self.predictor:
            raise ConfigError(
                "network: sizes of an operator",
                got=f"hidden {self.hidden}, trunk {self.trunk}, predictor {self.predictor}, features {self.features}, "
                f"sensors {self.sensors}",
                expected="positive ones, and a layer of each",
            )
        if not {"position"} <= set(self.current) <= {"position", "velocity"}:
            raise ConfigError("network: current", got=self.current, expected="position, and velocity if wanted")


class Operator(Windowed):
    """See the module."""

    Config = OperatorConfig
    mixes = True

    reads_branch: Tensor
    reads_trunk: Tensor

    def __init__(self, config: NetworkConfig, inputs: int, base: Sequence[int], rate_hz: float) -> None:
        super().__init__(config, inputs, base, rate_hz)
        assert isinstance(config, OperatorConfig)
        self.stepwise = self.past > 0
        joints = len(base)
        self.senses, self.features = config.senses, config.features
        self.responses = config.sensors * 2 * joints
        first = config.predictor[0] if self.senses == "predicted" else config.hidden[0]
        true = self.responses if self.senses == "true" else 0
        if inputs < 3 * joints + true:
            raise ConfigError(
                "network: an operator reads position, velocity and command of each joint, then conditions",
                got=f"{inputs} inputs for {joints} joints",
            )
        # Which inputs of which samples: what is not read has no weight.
        branch = np.zeros((1, inputs, self.past + 1))
        if self.senses == "true":
            branch[:, inputs - true :, -1] = 1.0
        else:
            branch[:, : 3 * joints, :-1] = 1.0
            branch[:, : joints * len(config.current), -1] = 1.0
        trunk = np.zeros((1, inputs))
        trunk[:, 2 * joints : 3 * joints] = 1.0
        if config.conditioned:
            trunk[:, 3 * joints : inputs - true] = 1.0
        self.register_buffer("reads_branch", torch.tensor(branch, dtype=torch.float32), persistent=False)
        self.register_buffer("reads_trunk", torch.tensor(trunk, dtype=torch.float32), persistent=False)
        self.window = nn.Conv1d(inputs, first, self.past + 1)
        self.predictor = _layers(*config.predictor, self.responses) if self.senses == "predicted" else None
        widths = config.hidden if self.senses != "predicted" else (self.responses, *config.hidden)
        self.branch = _layers(*widths, config.features * joints)
        self.query = nn.Linear(inputs, config.trunk[0])
        self.trunk = _layers(*config.trunk, config.features * joints)

    @property
    def sensed(self) -> bool:
        """Whether it predicts what sensors would say."""
        return self.predictor is not None

    def sensors(self, x: Tensor) -> Tensor:
        """What the sensors would say, normalized, (past + T, B, I) to (T, B, 2 J k)."""
        assert self.predictor is not None
        return _through(self.predictor, self._seen(x))

    def branch_features(self, sensed: Tensor) -> Tensor:
        """B: (T, B, 2 J k), or the first layer's output where nothing is predicted, to (T, B, J p)."""
        if self.predictor is None:
            return _through(self.branch, sensed)
        first, *others = self.branch
        return _through(others, first(sensed))

    def trunk_features(self, x: Tensor) -> Tensor:
        """T of the current samples, (T, B, I) to (T, B, J p)."""
        query = nn.functional.linear(x, self.query.weight * self.reads_trunk, self.query.bias)
        return _through(self.trunk, query)

    def fused(self, branch: Tensor, trunk: Tensor) -> Tensor:
        """The inner products, (T, B, J p) twice to (T, B, J); eq. 5."""
        parts = (branch * trunk).view(*branch.shape[:-1], self.outputs, self.features)
        out: Tensor = parts.sum(-1) / self.features**0.5
        return out

    def inner(self, x: Tensor) -> Tensor:
        """See `Windowed.inner`."""
        sensed = self.sensors(x) if self.sensed else self._seen(x)
        return self.fused(self.branch_features(sensed), self.trunk_features(x[self.past :]))

    def _seen(self, x: Tensor) -> Tensor:
        """The first layer's output, before its activation."""
        window = nn.functional.conv1d(x.permute(1, 2, 0), self.window.weight * self.reads_branch, self.window.bias)
        return window.permute(2, 0, 1)

    def draw_inner(self, graph: Graph, x: str) -> str:
        """See `Windowed.draw_inner`."""
        return self._drawn(graph, x, torch.eye(self.inputs), torch.zeros(self.inputs), torch.ones(self.outputs))

    def draw_scaled(
        self, graph: Graph, x: str, states: Sequence[str], inputs: Tensor, shift: Tensor, outputs: Tensor
    ) -> tuple[str, tuple[str, ...]]:
        """See `Network.draw_scaled`; everything linear around the network goes into its weights."""
        del states
        return self._drawn(graph, x, inputs, shift, outputs), ()

    def mixed_step(self, inputs: Tensor, shift: Tensor, outputs: Tensor) -> OperatorWeights:
        """See `Network.mixed_step`."""
        branch, trunk = self._dense_layers(inputs, shift)
        # The trunk reads the present sample only.
        trunk[0] = (trunk[0][0][-self.inputs :], trunk[0][1])
        arrays = {
            name: [(weight.detach().numpy(), bias.detach().numpy()) for weight, bias in layers]
            for name, layers in (("branch", branch), ("trunk", trunk))
        }
        return OperatorWeights.of(arrays, outputs.numpy() / self.features**0.5)

    def _drawn(self, graph: Graph, x: str, inputs: Tensor, shift: Tensor, outputs: Tensor) -> str:
        """Nodes for `x @ inputs + shift`; of one sample with its history, (past + 1, B, I), as rows (B, ...).

        A convolution would take the B windows one after the other.
        """
        flat = x
        if self.past:
            turned = graph.add("Transpose", x, perm=[1, 0, 2])
            flat = graph.add("Reshape", turned, graph.integers([-1, (self.past + 1) * self.inputs]))
        seen, query = (self._chain(graph, flat, layers) for layers in self._dense_layers(inputs, shift))
        # A sum over the features of each joint as one product with ones and zeros.
        ones = np.kron(np.eye(self.outputs), np.ones((self.features, 1))) / self.features**0.5
        return graph.add("MatMul", graph.add("Mul", seen, query), graph.floats(ones * outputs.numpy()))

    def _dense_layers(self, inputs: Tensor, shift: Tensor) -> tuple[list[_Dense], list[_Dense]]:
        """Of branch and trunk, weights (in, out) and biases; the first ones read a sample with its history as a row."""
        window = (self.window.weight * self.reads_branch).permute(2, 1, 0)
        query = torch.zeros(self.past + 1, self.inputs, len(self.query.weight))
        query[-1] = (self.query.weight * self.reads_trunk).T
        assert self.window.bias is not None
        first = [
            ((inputs.double() @ weight.double()).float().flatten(0, 1), bias + shift @ weight.sum(0))
            for weight, bias in ((window, self.window.bias), (query, self.query.bias))
        ]
        layers = list(self.branch)
        if self.predictor is not None:
            *before, last = self.predictor
            layers = [*before, _merged(last, layers[0]), *layers[1:]]
        return [first[0], *map(_dense_of, layers)], [first[1], *map(_dense_of, self.trunk)]

    def _chain(self, graph: Graph, x: str, layers: Sequence[_Dense]) -> str:
        """Dense layers with ELU between them: a node for each of rows, two where samples are an axis."""
        for number, layer in enumerate(layers):
            if number:
                x = graph.add("Elu", x)
            weight, bias = (graph.floats(part.detach().numpy()) for part in layer)
            x = (
                graph.add("Gemm", x, weight, bias)
                if self.past
                else graph.add("Add", graph.add("MatMul", x, weight), bias)
            )
        return x


def _dense_of(layer: nn.Module) -> _Dense:
    assert isinstance(layer, nn.Linear)
    return layer.weight.T, layer.bias


def _layers(*widths: int) -> nn.ModuleList:
    return nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(widths))


def _through(layers: Sequence[nn.Module] | nn.ModuleList, x: Tensor) -> Tensor:
    """Dense layers with ELU before each of them."""
    for layer in layers:
        x = layer(nn.functional.elu(x))
    return x


def _merged(first: nn.Module, second: nn.Module) -> nn.Linear:
    """Two dense layers with nothing between them as one."""
    assert isinstance(first, nn.Linear)
    assert isinstance(second, nn.Linear)
    one = nn.Linear(first.in_features, second.out_features)
    with torch.no_grad():
        weight = second.weight.double() @ first.weight.double()
        one.weight.copy_(weight)
        one.bias.copy_(second.weight.double() @ first.bias.double() + second.bias.double())
    return one


KINDS = {"operator": Operator}


def methods() -> tuple[Method, ...]:
    """None: an operator says what a command lacks, and `trueup compensate` trains it."""
    return ()
